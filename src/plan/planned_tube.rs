//! The tube around a plan, as the plan's file holds it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Which position the calibration flights' errors are of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PositionSource {
    /// The simulator's.
    True,
    /// The vehicle's own estimate: the tube bounds that, not its error.
    Reported,
}

impl PositionSource {
    /// For people.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::True => "the true position",
            Self::Reported => "the vehicle's own estimate of its position",
        }
    }
}

/// The tube of a plan, as its file holds it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedTube {
    /// Probability with which a whole flight stays within, at least.
    pub confidence: f64,
    /// Probability with which a whole flight stays as near to the plan as the margin to what it avoids.
    pub margin_confidence: f64,
    /// The position that it bounds.
    pub position: PositionSource,
    /// Calibration flights behind it.
    pub flights: usize,
    /// q, in standard deviations.
    pub multiplier: f64,
    /// Radius around each planned position, m.
    pub radius_m: Vec<f64>,
}

impl PlannedTube {
    /// Checks it as part of a plan of so many states.
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
