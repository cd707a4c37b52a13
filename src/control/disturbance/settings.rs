//! Settings of feedback without steady-state error.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Feedback without steady-state error.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OffsetFreeSettings {
    /// Whether disturbances are estimated and rejected.
    pub observer: Use,
    /// Whether a desired trajectory's own acceleration is fed forward.
    pub feed_forward: Use,
    /// Time constant with which the velocity in the feedback becomes the slope of the position, s.
    /// The two disagree where an estimator corrects its position but not its velocity; the
    /// controller tracks the position.
    pub velocity_time_constant_s: f64,
    /// Time constant of the other estimates, s. Wind and an estimate's wander change over several
    /// seconds; velocity noise over this time becomes an acceleration that the vehicle flies.
    pub time_constant_s: f64,
    /// Largest difference between the reported velocity and the slope of the position that is
    /// corrected, m/s.
    pub velocity_max_m_s: f64,
    /// Largest acceleration that is attributed to a disturbance, m/s^2.
    pub acceleration_max_m_s2: f64,
    /// Largest error that is attributed to the attitude loop or to the attitude estimate, rad.
    pub attitude_max_rad: f64,
}

impl Default for OffsetFreeSettings {
    fn default() -> Self {
        Self {
            observer: Use::Auto,
            feed_forward: Use::Auto,
            velocity_time_constant_s: 0.02,
            time_constant_s: 0.5,
            velocity_max_m_s: 1.0,
            acceleration_max_m_s2: 6.0,
            attitude_max_rad: 0.2,
        }
    }
}

/// When something is used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Use {
    /// On with autopilots that have their own loop; the bundled vehicle flies as in the paper.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

impl Use {
    /// Whether the feature is on for a vehicle whose attitude loop is (`is_own_loop`) or is not its
    /// autopilot's own.
    pub fn applies(self, is_own_loop: bool) -> bool {
        match self {
            Self::Auto => is_own_loop,
            Self::On => true,
            Self::Off => false,
        }
    }
}
