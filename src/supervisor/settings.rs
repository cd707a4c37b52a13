//! The time limits of the flight states.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Time limits and waits of the flight states.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupervisorSettings {
    /// Silence of the vehicle that counts as a lost link, s.
    pub link_lost_after_s: f64,
    /// Time for which another mode must be seen before streaming, s.
    pub release_s: f64,
    /// Time limit from a commanded flight to readiness, s.
    pub ready_timeout_s: f64,
    /// Time for which a hold is streamed before OFFBOARD is requested, s.
    pub stream_before_engage_s: f64,
    /// Time limit for the mode to read OFFBOARD, s.
    pub engage_timeout_s: f64,
    /// Time limit for the motors to be armed by the controller, s.
    pub arm_timeout_s: f64,
    /// Time limit for the pilot to arm after the switch to OFFBOARD on the ground, s.
    pub pilot_arm_timeout_s: f64,
    /// Whether the controller may take over a vehicle in the air that someone else flies: by a
    /// commanded flight, or at the pilot's switch where the ground below was never seen. Heights
    /// then count from the origin of the vehicle's local frame.
    pub take_over: bool,
    /// Time limit for take-off, and for the approach, s.
    pub take_off_timeout_s: f64,
    /// Time limit for landing, s.
    pub land_timeout_s: f64,
    /// Longest time for which a moving vehicle is braked before landing is requested, s. A vehicle
    /// that lands while moving aims to stop further on. If the ground stops it earlier, ArduCopter
    /// leans towards that place and never considers itself landed. Where a fault makes feedback
    /// unreliable, landing is requested at once.
    pub land_brake_s: f64,
    /// Time for which control continues after the request to land, until the vehicle takes over, s.
    pub land_handover_s: f64,
    /// Hold after the trajectory or after a fault, s.
    pub hold_s: f64,
    /// Time on the ground after which disarming is requested, s.
    pub disarm_after_s: f64,
    /// Time for which a landing vehicle must be at rest at ground height before it counts as landed
    /// without reporting it, s.
    pub rest_s: f64,
    /// Interval at which requests without effect are repeated, s.
    pub retry_s: f64,
}

impl Default for SupervisorSettings {
    fn default() -> Self {
        Self {
            link_lost_after_s: 2.5,
            release_s: 1.0,
            ready_timeout_s: 60.0,
            stream_before_engage_s: 0.5,
            engage_timeout_s: 5.0,
            arm_timeout_s: 5.0,
            pilot_arm_timeout_s: 30.0,
            take_over: false,
            take_off_timeout_s: 30.0,
            land_timeout_s: 60.0,
            land_brake_s: 2.0,
            land_handover_s: 2.0,
            hold_s: 2.0,
            disarm_after_s: 4.0,
            rest_s: 5.0,
            retry_s: 1.0,
        }
    }
}
