//! What of the errors of predictions tells how far a simulator is from flights.

use schemars::JsonSchema;
use serde::Serialize;

/// What of the errors tells how far a simulator is from flights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Metric {
    /// Position, velocity and attitude at 0.5 and 1 s.
    Mean,
    /// For want of a known on-board loop: position and velocity at 0.5 and 1 s with the body
    /// turning as reported, attitude and body rate at 0.1 s about the axes whose turning the motor
    /// outputs explain. A small moment that nothing counteracts turns a body far within a second.
    Guided,
    /// Position and velocity alone, where the motor outputs explain the turning about no axis.
    Forces,
}

/// The most parts that a metric is the mean over.
pub const PARTS_MAX: usize = 6;

impl Metric {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Guided => "guided",
            Self::Forces => "forces",
        }
    }

    /// The horizons and quantities that it is the mean over.
    pub fn parts(self) -> &'static [(usize, usize)] {
        match self {
            Self::Mean => &[(1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)],
            Self::Guided => &[(1, 0), (1, 1), (2, 0), (2, 1), (0, 2), (0, 3)],
            Self::Forces => &[(1, 0), (1, 1), (2, 0), (2, 1)],
        }
    }
}
