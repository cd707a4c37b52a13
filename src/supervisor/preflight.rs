//! The checks before a flight, in words.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::clock::HostTime;
use crate::telemetry::Telemetry;

/// What a flight needs before it begins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreflightSettings {
    /// Least rate of control ticks, as a share of the control rate.
    pub tick_rate_min: f64,
    /// Oldest acceptable sample, s.
    pub sample_age_max_s: f64,
    /// Least remaining charge, 0..1, where it is known.
    pub battery_min: f64,
    /// Parameters of the vehicle that must have a value, with the reason in words.
    pub parameters: Vec<RequiredParameter>,
    /// Largest share of the vehicle's frames that the link may lose within a second, 0..1.
    pub link_loss_max: f64,
    /// Largest horizontal distance from the vehicle to the trajectory's start, m.
    pub start_distance_max_m: f64,
}

/// A parameter that the vehicle must have with one value.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RequiredParameter {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Why.
    pub reason: String,
}

impl Default for PreflightSettings {
    fn default() -> Self {
        Self {
            tick_rate_min: 0.8,
            sample_age_max_s: 0.1,
            battery_min: 0.3,
            parameters: Vec::new(),
            link_loss_max: 0.05,
            start_distance_max_m: 20.0,
        }
    }
}

/// A check that fails: what was expected and what was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PreflightCheck {
    /// What was looked at.
    pub subject: String,
    /// What would be right.
    pub expected: String,
    /// What is there.
    pub found: String,
}

impl fmt::Display for PreflightCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: expected {}, found {}", self.subject, self.expected, self.found)
    }
}

/// The checks that fail.
///
/// `link_loss` is the share of the vehicle's frames that the link lost, where known;
/// `start_distance_m` the horizontal distance from the vehicle to the trajectory's start.
pub fn preflight(
    settings: &PreflightSettings,
    rate_hz: f64,
    telemetry: &Telemetry,
    link_loss: Option<f64>,
    start_distance_m: f64,
    now: HostTime,
) -> Vec<PreflightCheck> {
    let mut failed = Vec::new();
    let mut check = |holds: bool, subject: &str, expected: String, found: String| {
        if !holds {
            failed.push(PreflightCheck { subject: subject.to_owned(), expected, found });
        }
    };
    let ticks = telemetry.tick_rate_hz();
    let [odometry, attitude, position] = telemetry.rates_hz();
    check(
        ticks >= settings.tick_rate_min * rate_hz,
        "telemetry rate",
        format!(
            "{:.0} Hz of ODOMETRY, or of attitude and position",
            settings.tick_rate_min * rate_hz
        ),
        format!("{odometry:.0}, {attitude:.0} and {position:.0} Hz"),
    );
    let age = telemetry.age_s(now);
    check(
        age <= settings.sample_age_max_s,
        "state",
        format!("at most {:.2} s old", settings.sample_age_max_s),
        format!("{age:.2} s"),
    );
    if let Some(left) = telemetry.status().battery.remaining {
        check(
            left >= settings.battery_min,
            "battery",
            format!("at least {:.0} %", settings.battery_min * 100.0),
            format!("{:.0} %", left * 100.0),
        );
    }
    for RequiredParameter { name, value, reason } in &settings.parameters {
        let found = telemetry.status().parameters.get(name);
        // PARAM_VALUE carries f32.
        let equal = found.is_some_and(|found| (found - value).abs() <= 1e-6 * value.abs());
        check(
            equal,
            &format!("parameter {name}"),
            format!("{value} ({reason})"),
            found.map_or("no answer".to_owned(), |found| found.to_string()),
        );
    }
    if let Some(loss) = link_loss {
        check(
            loss <= settings.link_loss_max,
            "link",
            format!("at most {:.0} % of frames lost", settings.link_loss_max * 100.0),
            format!("{:.0} %", loss * 100.0),
        );
    }
    check(
        start_distance_m <= settings.start_distance_max_m,
        "trajectory start",
        format!("within {:.1} m of the vehicle", settings.start_distance_max_m),
        format!("{start_distance_m:.1} m"),
    );
    failed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::TelemetrySettings;

    #[test]
    fn a_link_that_loses_too_much_is_refused() {
        let telemetry = Telemetry::new(TelemetrySettings::default());
        let link = |loss| {
            let settings = PreflightSettings::default();
            preflight(&settings, 100.0, &telemetry, loss, 0.0, HostTime::from_ns(0))
                .into_iter()
                .find(|check| check.subject == "link")
                .map(|check| check.to_string())
        };
        assert_eq!((link(None), link(Some(0.05))), (None, None));
        let expected = "link: expected at most 5 % of frames lost, found 20 %";
        assert_eq!(link(Some(0.2)).as_deref(), Some(expected));
    }
}
