//! How long the flight's states may last.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Times of the flight's states.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SupervisorSettings {
    /// Silence of the link that is a loss, s.
    pub link_lost_after_s: f64,
    /// Time for which another mode must have been seen before streaming, s.
    pub release_s: f64,
    /// Time to be ready for a flight when one was commanded, s.
    pub ready_timeout_s: f64,
    /// Hold streamed before OFFBOARD is asked for, s.
    pub stream_before_engage_s: f64,
    /// Time for the mode to read OFFBOARD, s.
    pub engage_timeout_s: f64,
    /// Time for the motors to be armed when the daemon arms, s.
    pub arm_timeout_s: f64,
    /// Time for the pilot to arm after the switch to OFFBOARD on the ground, s.
    pub pilot_arm_timeout_s: f64,
    /// Whether a vehicle that others fly may be taken over in the air: by a commanded flight, or at
    /// the pilot's switch where the ground below was never seen. Heights then count from the origin
    /// of the vehicle's local frame.
    pub take_over: bool,
    /// Time for take-off, and for the approach, s.
    pub take_off_timeout_s: f64,
    /// Time for landing, s.
    pub land_timeout_s: f64,
    /// Longest time for which a vehicle that moves is brought to rest before it is asked to land, s.
    /// One that lands while it moves means to stop further on; where the ground stops it before,
    /// ArduCopter leans towards that place, and never takes itself for landed. Where a fault says
    /// that feedback must not be trusted, landing is asked for at once.
    pub land_brake_s: f64,
    /// Time that control goes on after asking for landing, until the vehicle has taken over, s.
    pub land_handover_s: f64,
    /// Hold after the trajectory or after a fault, s.
    pub hold_s: f64,
    /// Time on the ground after which disarming is asked for, s.
    pub disarm_after_s: f64,
    /// Time for which a landing vehicle lies still at the height of the ground before it counts as
    /// landed though it does not report that, s.
    pub rest_s: f64,
    /// Requests without effect are repeated this often, s.
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
            land_brake_s: 1.0,
            land_handover_s: 2.0,
            hold_s: 2.0,
            disarm_after_s: 4.0,
            rest_s: 5.0,
            retry_s: 1.0,
        }
    }
}
