//! The tube in a plan's file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The position whose errors the calibration flights measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PositionSource {
    /// The simulator's true position.
    True,
    /// The vehicle's estimate; the tube does not include the error of the estimate.
    Reported,
}

impl PositionSource {
    /// The name in reports.
    pub fn text(self) -> &'static str {
        match self {
            Self::True => "the true position",
            Self::Reported => "the vehicle's estimate of its position",
        }
    }
}

/// The tube of a plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedTube {
    /// Least probability that a whole flight stays within the tube.
    pub confidence: f64,
    /// Least probability that a whole flight stays within the margin to keep-out regions.
    pub margin_confidence: f64,
    /// The position that the tube bounds.
    pub position: PositionSource,
    /// Number of calibration flights.
    pub flights: usize,
    /// Ratio of the radius to the standard deviation of the position error.
    pub multiplier: f64,
    /// Radius around each planned position, m.
    pub radius_m: Vec<f64>,
}

impl PlannedTube {
    /// Checks the tube of a plan with this number of states.
    pub(super) fn check(&self, states: usize) -> Result<(), String> {
        if self.radius_m.len() != states {
            return Err(format!(
                "expected {states} radii of the tube, found {}",
                self.radius_m.len()
            ));
        }
        let is_sound = self.radius_m.iter().all(|r| r.is_finite() && *r >= 0.0);
        let are_probabilities =
            [self.confidence, self.margin_confidence].iter().all(|c| *c > 0.0 && *c < 1.0);
        if !(is_sound && are_probabilities) {
            return Err("the tube's confidence or a radius is out of range".to_owned());
        }
        Ok(())
    }
}
