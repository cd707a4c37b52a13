//! Settings of take-off and approach.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Take-off, and the approach to the trajectory's start.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GuidanceSettings {
    /// Thrust on the ground before take-off, as a fraction of hover thrust.
    pub idle_thrust: f64,
    /// Time over which thrust rises before the climb, s.
    pub spool_s: f64,
    /// Thrust at the end of the spool time, as a fraction of hover thrust: too little to lift off
    /// even if the rotors give a third more than the model says.
    pub spool_thrust: f64,
    /// Fastest climb, m/s.
    pub climb_speed_m_s: f64,
    /// Fastest approach to the start, m/s.
    pub approach_speed_m_s: f64,
    /// Fastest turn during the approach, rad/s.
    pub approach_yaw_rate_rad_s: f64,
    /// Height over which horizontal feedback fades in, m. On the ground it would only tip the
    /// vehicle over.
    pub feedback_height_m: f64,
    /// Distance within which the start counts as reached, m.
    pub settle_radius_m: f64,
    /// Speed below which the start counts as reached, m/s.
    pub settle_speed_m_s: f64,
    /// Time for which both must hold, s.
    pub settle_s: f64,
    /// Time after which a steady offset is accepted, s. Without it, a vehicle heavier than its
    /// model would never start.
    pub settle_timeout_s: f64,
}

impl Default for GuidanceSettings {
    fn default() -> Self {
        Self {
            idle_thrust: 0.1,
            spool_s: 1.0,
            spool_thrust: 0.6,
            climb_speed_m_s: 0.7,
            approach_speed_m_s: 1.0,
            approach_yaw_rate_rad_s: 1.0,
            feedback_height_m: 0.15,
            settle_radius_m: 0.3,
            settle_speed_m_s: 0.25,
            settle_s: 0.5,
            settle_timeout_s: 5.0,
        }
    }
}
