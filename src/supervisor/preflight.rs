//! The checks before a flight, and how they read.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{EngagePolicy, UplinkDelay};
use crate::clock::HostTime;
use crate::telemetry::Telemetry;

/// What a flight requires before it begins.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PreflightSettings {
    /// Least rate of control ticks, as a share of the control rate.
    pub tick_rate_min: f64,
    /// Oldest acceptable sample, s.
    pub sample_age_max_s: f64,
    /// Least remaining charge, 0..1, where it is known.
    pub battery_min: f64,
    /// Parameters that must have a given value on the vehicle, with the reason.
    pub parameters: Vec<RequiredParameter>,
    /// Whether to refuse a vehicle that would not react if this program vanished.
    pub needs_loss_reaction: bool,
    /// Largest share of the vehicle's frames that the link may lose within a second, 0..1.
    pub link_loss_max: f64,
    /// Longest round trip of the link, s. Setpoints that reach the vehicle later steer it badly.
    pub round_trip_max_s: f64,
    /// Largest horizontal distance from the vehicle to the trajectory's start, m.
    pub start_distance_max_m: f64,
}

/// A parameter that must have one value on the vehicle.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RequiredParameter {
    /// The name as PARAM_VALUE gives it.
    pub name: String,
    /// The required value.
    pub value: f64,
    /// Why it is required.
    pub reason: String,
}

impl Default for PreflightSettings {
    fn default() -> Self {
        Self {
            tick_rate_min: 0.8,
            sample_age_max_s: 0.1,
            battery_min: 0.3,
            parameters: Vec::new(),
            needs_loss_reaction: true,
            link_loss_max: 0.05,
            round_trip_max_s: 0.2,
            start_distance_max_m: 20.0,
        }
    }
}

/// A failed check: what was expected and what was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PreflightCheck {
    /// What was checked.
    pub subject: String,
    /// What would pass.
    pub expected: String,
    /// What the vehicle or the link shows.
    pub found: String,
}

impl fmt::Display for PreflightCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: expected {}, found {}", self.subject, self.expected, self.found)
    }
}

/// The situation before a flight, apart from telemetry.
#[derive(Clone, Copy, Debug, Default)]
pub struct Standing {
    /// Control rate, Hz.
    pub rate_hz: f64,
    /// Share of the vehicle's frames that the link lost recently, where known.
    pub link_loss: Option<f64>,
    /// Delay on the way to the vehicle.
    pub uplink: UplinkDelay,
    /// Horizontal distance from the vehicle to the trajectory's start, m.
    pub start_distance_m: f64,
    /// Whether the vehicle is off the ground; `None` where this is unknown.
    pub airborne: Option<bool>,
    /// Whether the vehicle was seen on the ground since this program started.
    pub ground_seen: bool,
    /// Who decides that a flight begins.
    pub policy: EngagePolicy,
    /// Whether a vehicle in the air may be taken over.
    pub take_over: bool,
}

/// Runs the checks and returns those that fail.
pub fn preflight(
    settings: &PreflightSettings,
    standing: &Standing,
    telemetry: &Telemetry,
    now: HostTime,
) -> Vec<PreflightCheck> {
    let Standing { rate_hz, link_loss, start_distance_m, .. } = *standing;
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
        if age.is_finite() { format!("{age:.2} s") } else { "none yet".to_owned() },
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
    if let Some(time_s) = standing.uplink.largest_s() {
        check(
            time_s <= settings.round_trip_max_s,
            "round trip",
            format!("at most {:.2} s from a request to its last answer", settings.round_trip_max_s),
            format!("{time_s:.2} s"),
        );
    }
    check(
        start_distance_m <= settings.start_distance_max_m,
        "trajectory start",
        format!("within {:.1} m of the vehicle", settings.start_distance_max_m),
        if start_distance_m.is_finite() {
            format!("{start_distance_m:.1} m")
        } else {
            "no position yet".to_owned()
        },
    );
    let is_armed = telemetry.status().armed == Some(true);
    match standing.policy {
        EngagePolicy::Command => check(
            standing.take_over || (!is_armed && standing.airborne == Some(false)),
            "vehicle",
            "disarmed and on the ground, because this flight arms it and takes off; to take over a \
             vehicle that others fly, give --take-over"
                .to_owned(),
            location(is_armed, standing.airborne),
        ),
        EngagePolicy::PilotSwitch => check(
            standing.take_over || standing.ground_seen || standing.airborne != Some(true),
            "ground",
            "the vehicle on it at least once since this program started, because heights count \
             from there; land once, or set offboard.supervisor.take_over"
                .to_owned(),
            location(is_armed, standing.airborne),
        ),
    }
    failed
}

fn location(is_armed: bool, airborne: Option<bool>) -> String {
    let armed = if is_armed { "armed" } else { "disarmed" };
    let place = match airborne {
        Some(true) => "in the air",
        Some(false) => "on the ground",
        None => "in the air or on the ground (the vehicle does not report which)",
    };
    format!("{armed}, {place}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::TelemetrySettings;

    #[test]
    fn missing_telemetry_is_reported_as_none_yet() {
        let telemetry = Telemetry::new(TelemetrySettings::default());
        let standing =
            Standing { rate_hz: 100.0, start_distance_m: f64::NAN, ..Standing::default() };
        let settings = PreflightSettings::default();
        let failed = preflight(&settings, &standing, &telemetry, HostTime::default());
        let found = |subject| {
            failed.iter().find(|check| check.subject == subject).map(|check| check.found.as_str())
        };
        assert_eq!(found("state"), Some("none yet"));
        assert_eq!(found("trajectory start"), Some("no position yet"));
    }

    #[test]
    fn lossy_link_fails_preflight() {
        let telemetry = Telemetry::new(TelemetrySettings::default());
        let link = |loss| {
            let settings = PreflightSettings::default();
            let standing = Standing { rate_hz: 100.0, link_loss: loss, ..Standing::default() };
            preflight(&settings, &standing, &telemetry, HostTime::from_ns(0))
                .into_iter()
                .find(|check| check.subject == "link")
                .map(|check| check.to_string())
        };
        assert_eq!((link(None), link(Some(0.05))), (None, None));
        let expected = "link: expected at most 5 % of frames lost, found 20 %";
        assert_eq!(link(Some(0.2)).as_deref(), Some(expected));
    }
}
