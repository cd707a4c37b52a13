//! What may be set of feedback that leaves no steady error.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Feedback that leaves no steady error.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OffsetFreeSettings {
    /// Whether disturbances are estimated and taken out.
    pub observer: Use,
    /// Whether a desired trajectory's own acceleration is fed forward.
    pub feed_forward: Use,
    /// Time constant after which the velocity that is fed back is the position's own slope, s. The
    /// two disagree where an estimator corrects its position without saying so in its velocity; the
    /// position is what is tracked.
    pub velocity_time_constant_s: f64,
    /// Time constant of the other estimates, s. Wind and an estimate's wander change over several
    /// seconds; the velocity's noise over this time is an acceleration that is flown.
    pub time_constant_s: f64,
    /// Largest difference that is taken to be between the velocity that is reported and that of the
    /// position, m/s.
    pub velocity_max_m_s: f64,
    /// Largest acceleration that is taken for a disturbance, m/s^2.
    pub acceleration_max_m_s2: f64,
    /// Largest error that is taken for the attitude loop's, or for the attitude's own, rad.
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
    /// With autopilots whose loop is their own; the bundled vehicle is flown as in the paper.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

impl Use {
    /// Whether it is used with a vehicle whose attitude loop is its autopilot's own or not.
    pub fn applies(self, is_own_loop: bool) -> bool {
        match self {
            Self::Auto => is_own_loop,
            Self::On => true,
            Self::Off => false,
        }
    }
}
