//! The prediction errors that make up the gap.

use schemars::JsonSchema;
use serde::Serialize;

/// Selects the prediction errors that make up the gap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Metric {
    /// Position, velocity and attitude at 0.5 and 1 s.
    Mean,
    /// Without a known on-board loop: position and velocity at 0.5 and 1 s with the body rotating
    /// as reported, attitude and body rate at 0.1 s about the axes whose rotation the motor outputs
    /// predict. A small moment that nothing counteracts turns a body far within a second.
    Guided,
    /// As `guided` without attitude and body rate: motor outputs predict the rotation about no axis.
    Forces,
}

/// Most parts of any metric.
pub const PARTS_MAX: usize = 6;

impl Metric {
    /// Its name in evidence and answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Guided => "guided",
            Self::Forces => "forces",
        }
    }

    /// Indices of the horizons and quantities of its parts.
    pub fn parts(self) -> &'static [(usize, usize)] {
        match self {
            Self::Mean => &[(1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)],
            Self::Guided => &[(1, 0), (1, 1), (2, 0), (2, 1), (0, 2), (0, 3)],
            Self::Forces => &[(1, 0), (1, 1), (2, 0), (2, 1)],
        }
    }
}
