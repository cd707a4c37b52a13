//! The settings of the motion-capture bridge.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::room_frame::Up;
use crate::link::external_pose::PoseForm;

/// Settings of `downwash mocap`.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MocapSettings {
    /// Own MAVLink system id. It differs from that of `fly`, so that this HEARTBEAT is not taken
    /// for the controller's.
    pub system: u8,
    /// Own MAVLink component id.
    pub component: u8,
    /// The message that poses are sent as.
    #[serde(rename = "as")]
    pub form: PoseForm,
    /// Highest rate at which poses are forwarded, Hz.
    pub rate_hz: f64,
    /// The room's axis that points up.
    pub up: Up,
    /// Heading of the room's x axis, clockwise from the vehicle's north, degrees.
    pub x_heading_deg: f64,
    /// Direction of the vehicle's nose in the body's axes, clockwise from x, degrees.
    pub nose_deg: f64,
    /// Standard deviation of the position, per axis, m.
    pub position_deviation_m: f64,
    /// Standard deviation of the attitude, about each axis, rad.
    pub attitude_deviation_rad: f64,
    /// Delay of the fastest frame, s: from the exposure, or from the room's own time of sending, to
    /// this computer. Nothing here measures it.
    pub latency_s: f64,
    /// Age above which poses are not forwarded, s.
    pub age_max_s: f64,
    /// NatNet version where no server reports it: major and minor.
    pub natnet_version: [u8; 2],
    /// Which poses are accepted.
    pub watch: WatchSettings,
}

/// Which poses the watch accepts.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WatchSettings {
    /// Distance from the expected position, beyond what the body can accelerate, that is a jump, m.
    pub jump_m: f64,
    /// Largest acceleration of the body, m/s^2.
    pub acceleration_max_m_s2: f64,
    /// Angle from the last attitude, beyond what the body can turn, that is a jump, rad.
    pub turn_rad: f64,
    /// Largest angular rate of the body, rad/s.
    pub turn_max_rad_s: f64,
    /// Time with the same pose under new stamps after which it counts as frozen, s.
    pub frozen_s: f64,
    /// Time without a view of the body after which it is lost, s.
    pub gap_s: f64,
    /// Distance from the expected position within which a lost body is accepted again while armed,
    /// m.
    pub return_m: f64,
    /// Time for which a returning body must be seen steadily, s.
    pub settle_s: f64,
    /// Time for which the body must be seen steadily at the start, and at a different place while
    /// the vehicle is disarmed, s.
    pub settle_anew_s: f64,
}

impl Default for MocapSettings {
    fn default() -> Self {
        Self {
            system: 253,
            component: 197,
            form: PoseForm::Vision,
            rate_hz: 50.0,
            up: Up::Z,
            x_heading_deg: 0.0,
            nose_deg: 0.0,
            position_deviation_m: 0.005,
            attitude_deviation_rad: 0.02,
            latency_s: 0.0,
            age_max_s: 0.1,
            natnet_version: [4, 1],
            watch: WatchSettings::default(),
        }
    }
}

impl Default for WatchSettings {
    fn default() -> Self {
        Self {
            jump_m: 0.05,
            acceleration_max_m_s2: 40.0,
            turn_rad: 0.3,
            turn_max_rad_s: 15.0,
            frozen_s: 0.1,
            gap_s: 0.2,
            return_m: 0.3,
            settle_s: 0.2,
            settle_anew_s: 1.0,
        }
    }
}
