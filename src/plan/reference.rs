//! What the pilot follows: a state and the input that goes with it, over time.

use std::sync::Arc;

use crate::setpoint::{Reference, State};

/// A reference from time 0 to its duration, held at both ends.
pub trait ReferenceSource {
    /// Length in s.
    fn duration(&self) -> f64;

    /// The reference at `t` seconds.
    fn sample(&self, t: f64) -> Reference;

    /// Thrust that holds the vehicle at the start, N.
    fn start_thrust_n(&self) -> f64 {
        self.sample(0.0).feedforward.thrust_n
    }

    /// Power of the pack's voltage, over that of a full one, that thrust goes with: what is sent is
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
