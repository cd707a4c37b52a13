//! The settings of the bridge.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::room_frame::Up;
use crate::link::external_pose::PoseForm;

/// Settings of `downwash mocap`.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MocapSettings {
    /// Own MAVLink system id: another than that of `fly`, so that its HEARTBEAT does not pass for that of
    /// who flies.
    pub system: u8,
    /// Own MAVLink component id.
    pub component: u8,
    /// The message that poses are sent as.
    #[serde(rename = "as")]
    pub form: PoseForm,
    /// Poses a second that are forwarded at most, Hz.
    pub rate_hz: f64,
    /// The room's axis that points up.
    pub up: Up,
    /// Heading of the room's x axis, clockwise from the vehicle's north, degrees.
    pub x_heading_deg: f64,
    /// Where the vehicle's nose points in the body's axes, clockwise from x, degrees.
    pub nose_deg: f64,
    /// Standard deviation of the position, per axis, m.
    pub position_deviation_m: f64,
    /// Standard deviation of the attitude, about each axis, rad.
    pub attitude_deviation_rad: f64,
    /// What the quickest frame takes from the exposure, or from what the room says it was sent at, to this
    /// computer: nothing measures it here, s.
    pub latency_s: f64,
    /// Older poses are not forwarded, s.
    pub age_max_s: f64,
    /// Version of NatNet, where no server says it: major and minor.
    pub natnet_version: [u8; 2],
    /// What is believed.
    pub watch: WatchSettings,
}

/// What the watch believes.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WatchSettings {
    /// A place that is this far from where the body must be, beyond what it can accelerate, is a jump, m.
    pub jump_m: f64,
    /// What the body can accelerate, m/s^2.
    pub acceleration_max_m_s2: f64,
    /// An attitude that is this far off, beyond what the body can turn, is a jump, rad.
    pub turn_rad: f64,
    /// What the body can turn, rad/s.
    pub turn_max_rad_s: f64,
    /// The same pose under new stamps for this long is said to be frozen, s.
    pub frozen_s: f64,
    /// A body that is not seen for this long is lost, s.
    pub gap_s: f64,
    /// While the vehicle is armed a body that was lost is taken back within this of where it was to be, m.
    pub return_m: f64,
    /// For how long a body that comes back must come steadily, s.
    pub settle_s: f64,
    /// The same at first, and for a body at another place while the vehicle is disarmed, s.
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
