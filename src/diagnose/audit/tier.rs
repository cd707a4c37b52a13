//! What a log's channels can show.

use std::fmt;

use serde::Serialize;
use sitl::effects::EffectId;

use crate::log::import::{Flight, SetpointSource};

/// Least rate of an IMU that separates measurement from dynamics, Hz.
const IMU_HZ: f64 = 80.0;
/// Least rate of outputs, or of rates, that shows how rotors answer, Hz.
pub(super) const FAST_HZ: f64 = 40.0;
/// A voltage that changes less than this share shows no sag.
const VOLTAGE_RANGE: f64 = 0.02;

/// What was logged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
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
    /// Motor outputs often enough to show lag, delay and inertia.
    pub fast_outputs: bool,
    /// Pack voltage.
    pub voltage: bool,
    /// Rotor speeds.
    pub rotor_speed: bool,
    /// Setpoints as the ground sent them.
    pub setpoint: bool,
    /// All of attitude, rates and thrust in these.
    pub whole_setpoint: bool,
}

impl Channels {
    /// What a flight has.
    pub fn of(flight: &Flight) -> Self {
        let setpoints = flight.setpoint.values();
        let is_whole = setpoints
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
            fast_outputs: flight.outputs.rate() >= FAST_HZ,
            voltage: !flight.voltage.is_empty(),
            rotor_speed: !flight.rotor_speed.is_empty(),
            setpoint: !setpoints.is_empty() && from_ground,
            whole_setpoint: is_whole && from_ground,
        }
    }

    /// Position, velocity and attitude.
    pub fn pose(&self) -> bool {
        self.attitude && self.motion
    }
}

/// How much of a flight was logged; each holds all that is below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum Tier {
    /// Pose, velocity and attitude.
    T0,
    /// And an IMU.
    T1,
    /// And motor outputs and voltage.
    T2,
    /// And rotor speeds.
    T3,
}

impl Tier {
    /// The most that channels reach; `None` without a pose.
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

/// An effect that a log cannot show.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Untestable {
    /// Its id in the catalogue.
    pub effect: EffectId,
    /// What is missing.
    pub reason: String,
}

/// Lowest and highest voltage, V.
pub fn voltage_range(voltages: impl Iterator<Item = f64>) -> [f64; 2] {
    voltages.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)])
}

/// Whether voltages within a range show no sag.
pub fn is_flat([low, high]: [f64; 2]) -> bool {
    high - low < VOLTAGE_RANGE * high
}

/// The effects of the catalogue that these channels cannot show, whatever was flown.
pub(super) fn untestable(flight: &Flight, channels: &Channels) -> Vec<Untestable> {
    let missing = |effect: EffectId| {
        reason(effect, flight, channels).map(|reason| Untestable { effect, reason })
    };
    EffectId::ALL.into_iter().filter_map(missing).collect()
}

fn reason(id: EffectId, flight: &Flight, channels: &Channels) -> Option<String> {
    use EffectId as E;
    let lacks = |has: bool, what: &str| (!has).then(|| what.to_owned());
    let driven = channels.outputs || channels.rotor_speed || channels.setpoint;
    let input = || lacks(driven, "nothing that was commanded is logged");
    let pose = || lacks(channels.pose(), "position, velocity and attitude are not all logged");
    let motion =
        || lacks(channels.pose() || channels.imu, "neither pose nor accelerometer is logged");
    let moment = || {
        lacks(channels.body_rate || channels.attitude, "neither body rate nor attitude is logged")
            .or(lacks(
                channels.outputs || channels.rotor_speed,
                "motor outputs are not logged, so that rotors cannot be told apart",
            ))
    };
    let fast = || {
        let slow = || {
            let rate = flight.outputs.rate();
            format!("motor outputs come at {rate:.0} Hz only; at least {FAST_HZ:.0} Hz are needed")
        };
        let is_slow = channels.outputs && !channels.fast_outputs && !channels.rotor_speed;
        is_slow.then(slow)
    };
    match id {
        E::ThrustScale | E::Mass | E::ThrustCurve => input().or_else(motion),
        E::BatterySag => {
            let range @ [low, high] = voltage_range(flight.voltage.values().iter().copied());
            let is_flat = channels.voltage && is_flat(range);
            let flat = || format!("the voltage stays within {low:.2} to {high:.2} V in this log");
            input()
                .or_else(motion)
                .or(lacks(channels.voltage, "the voltage is not logged"))
                .or_else(|| is_flat.then(flat))
        }
        E::RotorLoss | E::ComOffset | E::YawTorque => moment(),
        E::MotorLag | E::Inertia => moment().or_else(fast),
        E::CommandDelay => {
            input().or_else(motion).or_else(|| if channels.setpoint { None } else { fast() })
        }
        E::RotorDrag
        | E::ParasiticDrag
        | E::Wind
        | E::Gusts
        | E::TranslationalLift
        | E::VortexRing
        | E::GroundEffect => pose().or_else(input),
        E::BladeFlapping => pose().or_else(moment),
        E::RotorGyroscopic => moment().or_else(fast),
        E::AttitudeTrim => lacks(channels.attitude, "the attitude is not logged").or_else(|| {
            lacks(
                channels.motion || channels.body_rate,
                "neither velocity nor body rate is logged beside the attitude",
            )
        }),
        E::EstimatorLatency => pose().or(lacks(
            channels.imu,
            "no IMU is logged at 80 Hz or more, against which the estimate could be late",
        )),
        E::PdGain => moment().or(lacks(
            channels.whole_setpoint,
            "setpoints with attitude, rates and thrust, as the ground sent them, are not logged",
        )),
    }
}
