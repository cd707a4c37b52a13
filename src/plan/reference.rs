//! The reference that the controller follows: a state and its input, over time.

use std::sync::Arc;

use vehicle::frame::Ned;

use crate::setpoint::{Expected, Reference, State};

/// Parameters for feeding an acceleration forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForward {
    /// kg
    pub mass_kg: f64,
    /// m/s^2
    pub gravity: f64,
    /// Drag over speed along front and right, and along down, kg/s.
    pub drag_kg_s: [f64; 2],
    /// Largest tilt of the attitude, rad.
    pub tilt_max_rad: f64,
    /// Delay from sending a desired attitude to its use, rotor lag included, s.
    pub attitude_delay_s: f64,
    /// Delay of thrust, likewise, s.
    pub thrust_delay_s: f64,
}

/// A reference from time 0 to its duration, held at both ends.
pub trait ReferenceSource {
    /// Length in s.
    fn duration(&self) -> f64;

    /// The reference at `t` seconds.
    fn sample(&self, t: f64) -> Reference;

    /// The desired position at `t` seconds. A receding plan starts at the vehicle's own state, so
    /// its reference is no measure of the tracking error.
    fn desired(&self, t: f64) -> Ned {
        self.sample(t).position
    }

    /// Radius of the tube at `t` seconds, m: at the plan's confidence, a whole flight stays within
    /// it. `None` without a tube.
    fn tube_radius_m(&self, _t: f64) -> Option<f64> {
        None
    }

    /// What the model expects of the vehicle at `t` seconds beyond thrust, weight and the attitude
    /// loop; `None` while no model leads.
    fn expected(&self, _t: f64) -> Option<Expected> {
        None
    }

    /// The same reference with the trajectory's own acceleration fed forward; `None` if the input
    /// is already a plan's.
    fn with_feed_forward(
        &self,
        _feed_forward: &FeedForward,
    ) -> Option<Arc<dyn ReferenceSource + Send + Sync>> {
        None
    }

    /// Thrust that holds the vehicle at the start, N.
    fn start_thrust_n(&self) -> f64 {
        self.sample(0.0).feedforward.thrust_n
    }

    /// Exponent of the thrust in the pack's voltage, relative to a full pack: the thrust sent
    /// exceeds the feed-forward by this much. 0 if no model provides it.
    fn voltage_exponent(&self) -> f64 {
        0.0
    }

    /// Receives the vehicle's state at each tick, relative to the trajectory's origin. Must not
    /// block.
    fn observe(&self, _t: f64, _state: &State) {}
}

impl<S: ReferenceSource + ?Sized> ReferenceSource for Arc<S> {
    fn duration(&self) -> f64 {
        self.as_ref().duration()
    }

    fn sample(&self, t: f64) -> Reference {
        self.as_ref().sample(t)
    }

    fn desired(&self, t: f64) -> Ned {
        self.as_ref().desired(t)
    }

    fn tube_radius_m(&self, t: f64) -> Option<f64> {
        self.as_ref().tube_radius_m(t)
    }

    fn expected(&self, t: f64) -> Option<Expected> {
        self.as_ref().expected(t)
    }

    fn with_feed_forward(
        &self,
        feed_forward: &FeedForward,
    ) -> Option<Arc<dyn ReferenceSource + Send + Sync>> {
        self.as_ref().with_feed_forward(feed_forward)
    }

    fn start_thrust_n(&self) -> f64 {
        self.as_ref().start_thrust_n()
    }

    fn voltage_exponent(&self) -> f64 {
        self.as_ref().voltage_exponent()
    }

    fn observe(&self, t: f64, state: &State) {
        self.as_ref().observe(t, state);
    }
}
