//! What the control path saw and decided at one sample.

use vehicle::frame::Ned;

use crate::clock::{HostTime, VehicleTime};
use crate::control::Saturation;
use crate::setpoint::{Reference, Setpoint, State};
use crate::supervisor::FlightState;

/// Everything that one tick saw and decided, as the log records it.
#[derive(Clone, Debug, PartialEq)]
pub struct Tick {
    /// Host time of the message that fired it.
    pub host: HostTime,
    /// Vehicle time of the state.
    pub vehicle: VehicleTime,
    /// The vehicle's state.
    pub state: State,
    /// The reference that the control law follows.
    pub reference: Reference,
    /// Where the vehicle is wanted. A plan that is remade in flight leads there.
    pub desired: Ned,
    /// Radius of the tube around the reference, m; `None` without a tube.
    pub tube_radius_m: Option<f64>,
    /// The reference's input.
    pub feedforward: Setpoint,
    /// What the control law adds to the feed-forward; zero on the ground.
    pub feedback: Setpoint,
    /// Their sum within limits; `None` where nothing is sent.
    pub setpoint: Option<Setpoint>,
    /// The limits that were met; none where nothing is sent.
    pub saturation: Saturation,
    /// The state of the flight.
    pub phase: FlightState,
    /// Seconds into the trajectory, while it is tracked.
    pub trajectory_time: Option<f64>,
    /// Distance from `desired`, m.
    pub tracking_error: f64,
    /// How much longer the state took to arrive than the fastest messages, s.
    pub sample_age: f64,
}

impl Tick {
    /// Removes the setpoint: it was not sent after all.
    pub fn withhold(&mut self) {
        self.setpoint = None;
        self.saturation = Saturation::default();
    }
}
