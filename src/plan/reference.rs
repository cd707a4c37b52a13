//! What the pilot follows: a state and the input that goes with it, over time.

use crate::setpoint::Reference;

/// A reference from time 0 to its duration, held at both ends.
pub trait ReferenceSource {
    /// Length in s.
    fn duration(&self) -> f64;

    /// The reference at `t` seconds.
    fn sample(&self, t: f64) -> Reference;
}
