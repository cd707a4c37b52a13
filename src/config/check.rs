//! Checks of values that no layer may set.

use std::time::Duration;

use toml::Value;

use crate::control::{AdaptationSettings, Limits, OffsetFreeSettings};
use crate::offboard::{GuidanceSettings, OffboardSettings};
use crate::supervisor::SupervisorSettings;

/// Numbers that may be negative: down is negative in flight, and a heading may be to the west.
const SIGNED: [&str; 5] = [
    "plan.box_m",
    "plan.keep_out",
    "collect.headings_deg",
    "mocap.x_heading_deg",
    "mocap.nose_deg",
];

/// The longest time limit or wait of a flight state.
const TIME_MAX: Duration = Duration::from_secs(24 * 60 * 60);

/// Checks that every number is finite, because a NaN limit would limit nothing. Only the [`SIGNED`]
/// ones may be negative, and those in tables of an array, such as positions and parameters.
pub(super) fn check_numbers(path: &str, value: &Value) -> Result<(), String> {
    check_number(path, value, SIGNED.contains(&path))
}

fn check_number(path: &str, value: &Value, is_signed: bool) -> Result<(), String> {
    let (is_finite, is_negative) = match value {
        Value::Float(number) => (number.is_finite(), *number < 0.0),
        Value::Integer(number) => (true, *number < 0),
        Value::Array(values) => {
            return values.iter().try_for_each(|value| check_number(path, value, is_signed));
        }
        Value::Table(table) => {
            return table
                .iter()
                .try_for_each(|(key, value)| check_number(&format!("{path}.{key}"), value, true));
        }
        _ => return Ok(()),
    };
    if is_finite && (is_signed || !is_negative) {
        return Ok(());
    }
    let least = if is_signed { "" } else { " of at least 0" };
    Err(format!("{path}: expected a finite number{least}, found {value}"))
}

/// A value that makes a flight impossible.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Impossible {
    /// The setting, and the one that it contradicts, if any.
    pub settings: &'static [&'static str],
    /// What would be valid.
    pub expected: String,
    /// The value found.
    pub found: f64,
}

/// Checks that the setpoint limits can be kept and that the controller's times can be counted.
pub(super) fn check_offboard(settings: &OffboardSettings) -> Result<(), Impossible> {
    check_limits(&settings.limits)?;
    let GuidanceSettings {
        climb_speed_m_s,
        approach_speed_m_s,
        approach_yaw_rate_rad_s,
        settle_speed_m_s,
        ..
    } = settings.guidance;
    positive(&["offboard.guidance.climb_speed_m_s"], climb_speed_m_s)?;
    positive(&["offboard.guidance.approach_speed_m_s"], approach_speed_m_s)?;
    positive(&["offboard.guidance.approach_yaw_rate_rad_s"], approach_yaw_rate_rad_s)?;
    positive(&["offboard.guidance.settle_speed_m_s"], settle_speed_m_s)?;
    positive(&["offboard.safety.tilt_max_rad"], settings.safety.tilt_max_rad)?;
    let OffsetFreeSettings { time_constant_s, velocity_time_constant_s, .. } = settings.offset_free;
    positive(&["offboard.offset_free.time_constant_s"], time_constant_s)?;
    positive(&["offboard.offset_free.velocity_time_constant_s"], velocity_time_constant_s)?;
    let feedback_scale_max = settings.adjustment.feedback_scale_max;
    require(feedback_scale_max >= 1.0, || Impossible {
        settings: &["offboard.adjustment.feedback_scale_max"],
        expected: "a factor of at least 1".to_owned(),
        found: feedback_scale_max,
    })?;
    check_times(&settings.supervisor)
}

/// Checks that the adaptation's settings are usable.
pub(super) fn check_adaptation(settings: &AdaptationSettings) -> Result<(), Impossible> {
    let AdaptationSettings { forgetting_s, trust_per_s, thrust_share_max, .. } = *settings;
    positive(&["control.adaptation.forgetting_s"], forgetting_s)?;
    positive(&["control.adaptation.trust_per_s"], trust_per_s)?;
    require(thrust_share_max < 1.0, || Impossible {
        settings: &["control.adaptation.thrust_share_max"],
        expected: "a share below 1".to_owned(),
        found: thrust_share_max,
    })
}

fn check_limits(limits: &Limits) -> Result<(), Impossible> {
    let Limits {
        thrust_min,
        thrust_max,
        tilt_max_rad,
        body_rate_max_rad_s,
        yaw_error_max_rad,
        thrust_change_max_per_s,
        attitude_change_max_rad_s,
        body_rate_change_max_rad_s2,
    } = *limits;
    require(thrust_max > 0.0 && thrust_max <= 1.0, || Impossible {
        settings: &["offboard.limits.thrust_max"],
        expected: "a share above 0 and at most 1".to_owned(),
        found: thrust_max,
    })?;
    require(thrust_min >= 0.0 && thrust_min < thrust_max, || Impossible {
        settings: &["offboard.limits.thrust_min", "offboard.limits.thrust_max"],
        expected: format!("at least 0 and less than offboard.limits.thrust_max, {thrust_max}"),
        found: thrust_min,
    })?;
    positive(&["offboard.limits.tilt_max_rad"], tilt_max_rad)?;
    positive(&["offboard.limits.body_rate_max_rad_s"], body_rate_max_rad_s)?;
    positive(&["offboard.limits.yaw_error_max_rad"], yaw_error_max_rad)?;
    positive(&["offboard.limits.thrust_change_max_per_s"], thrust_change_max_per_s)?;
    positive(&["offboard.limits.attitude_change_max_rad_s"], attitude_change_max_rad_s)?;
    positive(&["offboard.limits.body_rate_change_max_rad_s2"], body_rate_change_max_rad_s2)
}

fn check_times(times: &SupervisorSettings) -> Result<(), Impossible> {
    // Listed one by one, so that a new field is not forgotten.
    let SupervisorSettings {
        link_lost_after_s,
        release_s,
        ready_timeout_s,
        stream_before_engage_s,
        engage_timeout_s,
        arm_timeout_s,
        pilot_arm_timeout_s,
        take_over: _,
        take_off_timeout_s,
        land_timeout_s,
        land_brake_s,
        land_handover_s,
        hold_s,
        disarm_after_s,
        rest_s,
        retry_s,
    } = *times;
    time(&["offboard.supervisor.link_lost_after_s"], link_lost_after_s)?;
    time(&["offboard.supervisor.release_s"], release_s)?;
    time(&["offboard.supervisor.ready_timeout_s"], ready_timeout_s)?;
    time(&["offboard.supervisor.stream_before_engage_s"], stream_before_engage_s)?;
    time(&["offboard.supervisor.engage_timeout_s"], engage_timeout_s)?;
    time(&["offboard.supervisor.arm_timeout_s"], arm_timeout_s)?;
    time(&["offboard.supervisor.pilot_arm_timeout_s"], pilot_arm_timeout_s)?;
    time(&["offboard.supervisor.take_off_timeout_s"], take_off_timeout_s)?;
    time(&["offboard.supervisor.land_timeout_s"], land_timeout_s)?;
    time(&["offboard.supervisor.land_brake_s"], land_brake_s)?;
    time(&["offboard.supervisor.land_handover_s"], land_handover_s)?;
    time(&["offboard.supervisor.hold_s"], hold_s)?;
    time(&["offboard.supervisor.disarm_after_s"], disarm_after_s)?;
    time(&["offboard.supervisor.rest_s"], rest_s)?;
    time(&["offboard.supervisor.retry_s"], retry_s)
}

fn positive(settings: &'static [&'static str], found: f64) -> Result<(), Impossible> {
    require(found > 0.0, || Impossible { settings, expected: "a number above 0".to_owned(), found })
}

fn time(settings: &'static [&'static str], found: f64) -> Result<(), Impossible> {
    let is_time = Duration::try_from_secs_f64(found).is_ok_and(|time| time <= TIME_MAX);
    let expected = || format!("a time from 0 to {} s", TIME_MAX.as_secs());
    require(is_time, || Impossible { settings, expected: expected(), found })
}

fn require(holds: bool, otherwise: impl FnOnce() -> Impossible) -> Result<(), Impossible> {
    if holds { Ok(()) } else { Err(otherwise()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_settings_pass_the_checks() {
        assert_eq!(check_offboard(&OffboardSettings::default()), Ok(()));
    }

    #[test]
    fn nested_numbers_are_checked() {
        let check = |path: &str, text: &str| check_numbers(path, &text.parse().expect("a value"));
        for (path, text) in [
            ("plan.box_m", "[[-2.0, -2.0, -3.0], [2.0, 2.0, -0.3]]"),
            ("plan.keep_out", "[{ sphere = { centre_m = [1.0, 0.0, -1.0], radius_m = 0.3 } }]"),
            ("collect.headings_deg", "[-90, 0.0, 90.0]"),
            ("offboard.preflight.parameters", "[{ name = 'A', value = -1.0, reason = 'b' }]"),
        ] {
            assert_eq!(check(path, text), Ok(()), "{path}");
        }
        for (path, text, expected) in [
            ("plan.box_m", "[[-inf, 0.0, 0.0], [1.0, 1.0, 1.0]]", "plan.box_m: expected a finite"),
            (
                "plan.keep_out",
                "[{ sphere = { centre_m = [1.0, nan, 0.0], radius_m = 0.3 } }]",
                "plan.keep_out.sphere.centre_m: expected a finite",
            ),
            ("collect.headings_deg", "[nan]", "collect.headings_deg: expected a finite"),
            ("collect.half_size_m", "[2.0, -2]", "at least 0, found -2"),
        ] {
            let message = check(path, text).expect_err("refused");
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn contradictory_limits_are_refused() {
        let refused = |limits: Limits| {
            let settings = OffboardSettings { limits, ..OffboardSettings::default() };
            check_offboard(&settings).expect_err("refused").settings[0]
        };
        let limits = Limits::default();
        for thrust_min in [5.0, 0.9, -0.1, f64::NAN] {
            assert_eq!(refused(Limits { thrust_min, ..limits }), "offboard.limits.thrust_min");
        }
        for thrust_max in [0.0, 1.1, f64::NAN] {
            assert_eq!(refused(Limits { thrust_max, ..limits }), "offboard.limits.thrust_max");
        }
        let flat = Limits { tilt_max_rad: 0.0, ..limits };
        assert_eq!(refused(flat), "offboard.limits.tilt_max_rad");
    }

    #[test]
    fn adaptation_without_memory_or_bounds_is_refused() {
        let settings = AdaptationSettings::default();
        assert_eq!(check_adaptation(&settings), Ok(()));
        let refused = |settings| check_adaptation(&settings).expect_err("refused").settings[0];
        let hasty = AdaptationSettings { forgetting_s: 0.0, ..settings };
        assert_eq!(refused(hasty), "control.adaptation.forgetting_s");
        let credulous = AdaptationSettings { thrust_share_max: 1.0, ..settings };
        assert_eq!(refused(credulous), "control.adaptation.thrust_share_max");
    }

    #[test]
    fn zero_speeds_are_refused() {
        let mut settings = OffboardSettings::default();
        settings.guidance.climb_speed_m_s = 0.0;
        let impossible = check_offboard(&settings).expect_err("refused");
        assert_eq!(impossible.settings, ["offboard.guidance.climb_speed_m_s"]);
    }

    #[test]
    fn out_of_range_times_are_refused() {
        for retry_s in [1e300, 86_401.0, -1.0, f64::NAN, f64::INFINITY] {
            let mut settings = OffboardSettings::default();
            settings.supervisor.retry_s = retry_s;
            let impossible = check_offboard(&settings).expect_err("refused");
            assert_eq!(impossible.settings, ["offboard.supervisor.retry_s"]);
        }
        let mut settings = OffboardSettings::default();
        settings.supervisor.hold_s = 86_400.0;
        assert_eq!(check_offboard(&settings), Ok(()));
    }
}
