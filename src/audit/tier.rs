//! The most that a log's channels can show.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

use super::Rates;
use crate::log::import::{Flight, SetpointSource};

/// Least rate of an IMU that separates measurement from dynamics, Hz.
const IMU_HZ: f64 = 80.0;
/// Least rate of outputs, or of rates, that shows the rotors' response, Hz.
pub const FAST_HZ: f64 = 40.0;

/// The channels of a log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize)]
pub struct Channels {
    /// Attitude.
    pub attitude: bool,
    /// Position and velocity.
    pub motion: bool,
    /// Body rate, from whatever source.
    pub body_rate: bool,
    /// Specific force and body rate at 80 Hz and more.
    pub imu: bool,
    /// Motor outputs.
    pub outputs: bool,
    /// New motor outputs often enough to show lag, delay and inertia.
    pub fast_outputs: bool,
    /// Pack voltage.
    pub voltage: bool,
    /// Rotor speeds.
    pub rotor_speed: bool,
    /// Setpoints as the offboard controller sent them.
    pub setpoint: bool,
    /// Some of these hold attitude, rates and thrust together.
    pub whole_setpoint: bool,
}

impl Channels {
    /// The channels of a flight.
    pub fn of(flight: &Flight) -> Self {
        let setpoints = flight.setpoint.values();
        let is_complete = setpoints
            .iter()
            .any(|s| s.attitude.is_some() && s.body_rate.is_some() && s.thrust.is_some());
        let from_ground = flight.setpoint_source == SetpointSource::Ground;
        let imu = flight.body_rate.rate().min(flight.specific_force.rate());
        Self {
            attitude: !flight.attitude.is_empty(),
            motion: !flight.position.is_empty() && !flight.velocity.is_empty(),
            body_rate: !flight.body_rate.is_empty(),
            imu: imu >= IMU_HZ,
            outputs: !flight.outputs.is_empty(),
            fast_outputs: Rates::of(flight).outputs_hz.is_some_and(|rate| rate >= FAST_HZ),
            voltage: !flight.voltage.is_empty(),
            rotor_speed: !flight.rotor_speed.is_empty(),
            setpoint: !setpoints.is_empty() && from_ground,
            whole_setpoint: is_complete && from_ground,
        }
    }

    /// Whether position, velocity and attitude are all logged.
    pub fn pose(&self) -> bool {
        self.attitude && self.motion
    }
}

/// How much of a flight was logged; each tier includes those below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize)]
pub enum Tier {
    /// Position, velocity and attitude.
    T0,
    /// As T0, with an IMU.
    T1,
    /// As T1, with motor outputs and voltage.
    T2,
    /// As T2, with rotor speeds.
    T3,
}

impl Tier {
    /// The highest tier of these channels; `None` without a pose.
    pub fn of(channels: &Channels) -> Option<Self> {
        let steps = [
            (channels.pose(), Self::T0),
            (channels.imu, Self::T1),
            (channels.outputs && channels.voltage, Self::T2),
            (channels.rotor_speed, Self::T3),
        ];
        steps.iter().take_while(|(has, _)| *has).last().map(|(_, tier)| *tier)
    }
}

impl fmt::Display for Tier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::T0 => "T0 (pose)",
            Self::T1 => "T1 (pose, IMU)",
            Self::T2 => "T2 (pose, IMU, motor outputs and voltage)",
            Self::T3 => "T3 (pose, IMU, motor outputs and voltage, rotor speeds)",
        })
    }
}
