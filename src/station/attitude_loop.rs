//! The attitude loop that the feedback is designed around, from what is known about the vehicle.

use vehicle::AttitudePd;

use crate::control::AttitudeLoop;
use crate::link::profile::{AttitudeTargetForm, Profile};

/// Typical time constants of an autopilot's body rate loops, s: roll, pitch, yaw.
const RATE_TIME_CONSTANT_S: [f64; 3] = [0.05, 0.05, 0.1];

/// Assumed speed of an unmeasured attitude loop, as a share of the speed measured on another
/// vehicle with that autopilot. Feedback designed for a fast loop makes a slow one oscillate;
/// feedback designed for a slow loop costs some accuracy on a fast one. With this share, a loop a
/// third as fast as measured still flies.
const UNMEASURED_SHARE: f64 = 0.6;

/// The loop from setpoints, in the form that `profile` takes, to the vehicle's motion. `pd` is the
/// on-board loop where the vehicle file has one; `response_rad_s` is the setting for an autopilot's
/// own loop.
pub(super) fn attitude_loop(
    profile: &Profile,
    pd: Option<AttitudePd>,
    response_rad_s: Option<[f64; 3]>,
) -> AttitudeLoop {
    use AttitudeTargetForm::{AttitudeRatesThrust, AttitudeThrust, RatesThrust};
    match (profile.attitude_target, pd) {
        (AttitudeRatesThrust, Some(pd)) => pd.into(),
        (AttitudeThrust, Some(AttitudePd { kp, kd, .. })) => AttitudeLoop::AttitudePd { kp, kd },
        (RatesThrust { gain }, Some(AttitudePd { kd, .. })) => AttitudeLoop::RatePd { gain, kd },
        (RatesThrust { gain }, None) => {
            AttitudeLoop::Rates { gain, time_constant_s: RATE_TIME_CONSTANT_S }
        }
        _ => AttitudeLoop::responding_at(
            response_rad_s.unwrap_or_else(|| unmeasured_response_rad_s(profile)),
        ),
    }
}

/// What is assumed about a loop that is neither known nor set, as a message.
pub(super) fn assumption(
    profile: &Profile,
    pd: Option<AttitudePd>,
    response_rad_s: Option<[f64; 3]>,
) -> Option<String> {
    let is_known = pd.is_some()
        || response_rad_s.is_some()
        || matches!(profile.attitude_target, AttitudeTargetForm::RatesThrust { .. });
    (!is_known).then(|| {
        let [roll, pitch, yaw] = unmeasured_response_rad_s(profile);
        format!(
            "the vehicle's attitude loop is unknown: assuming that it responds at {roll:.1}, \
             {pitch:.1} and {yaw:.1} rad/s in roll, pitch and yaw; set \
             control.attitude_response_rad_s to its response"
        )
    })
}

fn unmeasured_response_rad_s(profile: &Profile) -> [f64; 3] {
    let measured = if profile.name == Profile::ARDUCOPTER.name {
        AttitudeLoop::ARDUCOPTER_RAD_S
    } else {
        AttitudeLoop::PX4_RAD_S
    };
    measured.map(|wn| UNMEASURED_SHARE * wn)
}
