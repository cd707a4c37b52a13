//! What the controller follows: a state and its input, over time.

use std::sync::Arc;

use vehicle::frame::Ned;

use crate::setpoint::{Expected, Reference, State};

/// What an acceleration is fed forward with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForward {
    /// kg
    pub mass_kg: f64,
    /// m/s^2
    pub gravity: f64,
    /// Drag over speed along front and right, and along down, kg/s.
    pub drag_kg_s: [f64; 2],
    /// The attitude is taken no further from level than this, rad.
    pub tilt_max_rad: f64,
    /// From a desired attitude's sending to its use, lag of the rotors included, s.
    pub attitude_delay_s: f64,
    /// The same of thrust, s.
    pub thrust_delay_s: f64,
}

/// A reference from time 0 to its duration, held at both ends.
pub trait ReferenceSource {
    /// Length in s.
    fn duration(&self) -> f64;

    /// The reference at `t` seconds.
    fn sample(&self, t: f64) -> Reference;

    /// Where the vehicle is wanted at `t` seconds. A reference that begins where the vehicle is seen
    /// leads there, and is no measure of how near it comes.
    fn desired(&self, t: f64) -> Ned {
        self.sample(t).position
    }

    /// What its model expects of the vehicle at `t` seconds beside thrust, weight and the attitude
    /// loop; `None` while no model leads.
    fn expected(&self, _t: f64) -> Option<Expected> {
        None
    }

    /// The same with the trajectory's own acceleration fed forward; `None` where the input is a
    /// plan's already.
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

    /// Power of the pack's voltage, over that of a full one, that thrust is proportional to: what is sent is
    /// more than the feed-forward by as much. 0 where the feed-forward is not of a model that
    /// knows.
    fn voltage_exponent(&self) -> f64 {
        0.0
    }

    /// Told at each tick where the vehicle is, relative to the trajectory's origin. Never waits.
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
