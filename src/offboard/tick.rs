//! What the line saw and decided at one sample.

use vehicle::frame::Ned;

use crate::clock::{HostTime, VehicleTime};
use crate::control::Saturation;
use crate::setpoint::{Reference, Setpoint, State};
use crate::supervisor::FlightState;

/// All that one tick saw and decided; what the log records.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Host time of the message that fired it.
    pub host: HostTime,
    /// Vehicle time of the state.
    pub vehicle: VehicleTime,
    /// The state.
    pub state: State,
    /// What it is to be.
    pub reference: Reference,
    /// Where it is wanted: a plan that is made anew in flight leads there.
    pub desired: Ned,
    /// The reference's input.
    pub feedforward: Setpoint,
    /// What the control law adds to it, zero on the ground.
    pub feedback: Setpoint,
    /// Their sum within limits; `None` where nothing is sent.
    pub setpoint: Option<Setpoint>,
    /// Limits that were met; none where nothing is sent.
    pub saturation: Saturation,
    /// Where the flight stands.
    pub phase: FlightState,
    /// Seconds into the trajectory, while it is tracked.
    pub trajectory_time: Option<f64>,
    /// Distance from where it is wanted, m.
    pub tracking_error: f64,
    /// How much later than the quickest messages the state came, s.
    pub sample_age: f64,
}

impl Tick {
    /// The tick's setpoint was not sent after all.
    pub fn withhold(&mut self) {
        self.setpoint = None;
        self.saturation = Saturation::default();
    }
}
