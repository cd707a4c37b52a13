//! What would keep the vehicle from being flown, and what to do about it.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;
use wire::dialect::MavSysStatusSensor;
use wire::message_name;

use super::observed::{Observed, Report};
use crate::command::listen::Listener;
use crate::link::loss_reaction::LossReaction;
use crate::link::profile::Profile;
use crate::log::import::VehicleKind;

/// Largest rate error of a crystal's clock.
const SKEW_NOTABLE: f64 = 2e-3;
/// Round trip beyond which feedback at 100 Hz suffers, s.
const ROUND_TRIP_NOTABLE_S: f64 = 0.05;
/// Latency of a serial adapter's timer from which it delays every sample, ms.
const LATENCY_TIMER_NOTABLE_MS: u32 = 2;

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Weight {
    /// It may or may not matter.
    Warns,
    /// The flight, OFFBOARD or arming would be refused.
    Refuses,
}

/// A fault and its cure.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub(super) struct Finding {
    pub weight: Weight,
    pub subject: String,
    pub text: String,
}

impl Finding {
    pub(super) fn new(weight: Weight, subject: &str, text: String) -> Self {
        Self { weight, subject: subject.to_owned(), text }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let weight = match self.weight {
            Weight::Warns => "warning",
            Weight::Refuses => "REFUSED",
        };
        write!(f, "{weight:<10} {}: {}", self.subject, self.text)
    }
}

/// All findings about a vehicle.
pub(super) fn findings(
    report: &Report,
    observed: &Observed,
    listener: &Listener,
    is_requesting: bool,
) -> Vec<Finding> {
    let mut found = Findings(Vec::new());
    found.identity(report, observed, listener);
    found.parameters(report, listener);
    found.state(report, listener, is_requesting);
    found.condition(report, observed, listener);
    found.link(report, listener);
    found.0
}

struct Findings(Vec<Finding>);

impl Findings {
    fn refuses(&mut self, subject: &str, text: impl Into<String>) {
        self.0.push(Finding::new(Weight::Refuses, subject, text.into()));
    }

    fn warns(&mut self, subject: &str, text: impl Into<String>) {
        self.0.push(Finding::new(Weight::Warns, subject, text.into()));
    }

    fn identity(&mut self, report: &Report, observed: &Observed, listener: &Listener) {
        let mav_type = listener.session.vehicle().map(|vehicle| vehicle.vehicle_type);
        let kind = mav_type.and_then(VehicleKind::of_mav_type);
        if let Some(kind) = kind.filter(|kind| *kind != VehicleKind::Multirotor) {
            self.refuses("vehicle", format!("it is {kind}; downwash flies only multirotors"));
        } else if report.autopilot == Some(Profile::UNKNOWN.name) {
            self.refuses("autopilot", "its modes are unknown; downwash flies PX4 and ArduCopter");
        }
        if !report.others.is_empty() && listener.session.requested_system().is_none() {
            self.refuses("vehicles", "several autopilots are on the link; choose with --system");
        }
        if report.is_signed
            && !listener.session.signs()
            && observed.version.is_none()
            && !listener.session.is_answered()
        {
            self.refuses(
                "signing",
                "it signs its messages and does not answer unsigned ones; give its key in \
                 link.signing.key_file, or turn signing off on this link",
            );
        } else if observed.version.is_none() {
            self.warns("version", "it sends no AUTOPILOT_VERSION");
        }
        let reports_intended =
            listener.session.profile().is_some_and(|profile| profile.reports_intended_mode);
        if reports_intended && report.intended_mode.is_none() {
            self.warns(
                "mode",
                "no CURRENT_MODE arrives (PX4 before 1.15, MAVLink 1, or nobody requested it): a \
                 flight relies on the mode in HEARTBEAT",
            );
        }
    }

    fn parameters(&mut self, report: &Report, listener: &Listener) {
        let Some(profile) = listener.session.profile() else { return };
        let value = |name: &str| report.parameters.get(name).copied();
        for rule in profile.required {
            let subject = format!("parameter {}", rule.name);
            match value(rule.name) {
                Some(value) if rule.holds(value) => {}
                Some(value) => self.refuses(
                    &subject,
                    format!("is {value}: {}; set it to {}", rule.why, rule.rule),
                ),
                None => self.refuses(&subject, "the vehicle does not answer the request for it"),
            }
        }
        if let Some(rule) = profile.loss_timeout {
            let subject = format!("parameter {}", rule.name);
            if let Some(value) = value(rule.name).filter(|value| !rule.holds(*value)) {
                self.warns(&subject, format!("is {value}: {}; set it to {}", rule.why, rule.rule));
            }
        }
        // If PX4 expects a radio control, it treats a missing one as lost, unless a parameter
        // excepts OFFBOARD.
        let is_set = |name: &str, bits: u32| value(name).is_some_and(|v| v as u32 & bits == bits);
        let needs_rc = value("NAV_RCL_ACT").is_some_and(|action| action != 0.0)
            && value("COM_RC_IN_MODE") == Some(0.0)
            && !is_set("COM_RCL_EXCEPT", 4);
        if needs_rc {
            self.warns(
                "parameter COM_RCL_EXCEPT",
                "without a radio control the vehicle may refuse OFFBOARD or leave it; fly with one, \
                 or set bit 2 (4)",
            );
        }
        let settings = &listener.config.settings;
        if let LossReaction::Nothing { why, cure } =
            profile.loss.reaction(&report.parameters.clone().into(), settings.link.system)
        {
            let text = format!("if downwash vanishes, the vehicle does not react: {why}; {cure}");
            match settings.offboard.preflight.needs_loss_reaction {
                true => self.refuses("loss", text),
                false => self.warns("loss", text),
            }
        }
    }

    fn state(&mut self, report: &Report, listener: &Listener, is_requesting: bool) {
        let settings = &listener.config.settings;
        let needed = settings.offboard.preflight.tick_rate_min * settings.control.rate_hz;
        let comes = report.odometry_hz.max(report.attitude_hz.min(report.position_hz));
        if comes < needed {
            let text = format!(
                "needs {needed:.0} Hz of ODOMETRY, or of attitude and position; {comes:.0} Hz \
                 arrive"
            );
            match (is_requesting, comes > 0.0) {
                (true, _) => self.refuses("state", text),
                (false, _) => {
                    self.warns("state", format!("{text}; a flight requests more: try with --rates"))
                }
            }
        }
        for refused in listener.session.refusals() {
            let name = message_name(refused.id);
            let text = format!("{} rejected: {}", refused.count, refused.refusal);
            match comes < needed {
                true => self.refuses(&name, text),
                false => self.warns(&name, text),
            }
        }
    }

    fn condition(&mut self, report: &Report, observed: &Observed, listener: &Listener) {
        let status = observed.telemetry.status();
        let unhealthy = MavSysStatusSensor::from_bits_truncate(status.unhealthy);
        for (name, bit) in unhealthy.iter_names() {
            if bit == MavSysStatusSensor::MAV_SYS_STATUS_PREARM_CHECK {
                let why: Vec<_> =
                    observed.texts.iter().filter(|text| text.contains("rm")).cloned().collect();
                let why =
                    if why.is_empty() { String::new() } else { format!(": {}", why.join("; ")) };
                self.refuses("arming", format!("the vehicle's prearm check fails{why}"));
            } else {
                self.warns("health", format!("{name} is not healthy"));
            }
        }
        if report.armed == Some(true) {
            self.refuses("armed", "the vehicle is armed already; disarm it first");
        }
        let offboard = listener.session.profile().and_then(|profile| profile.modes.offboard);
        if let Some(offboard) = offboard.map(|mode| mode.custom_mode)
            && (report.mode == Some(offboard) || report.intended_mode == Some(offboard))
        {
            self.warns(
                "mode",
                "it is in OFFBOARD, or intends to enter it; switch it to another mode",
            );
        }
        let least = listener.config.settings.offboard.preflight.battery_min;
        if let Some(left) = report.battery_share.filter(|left| *left < least) {
            let text = format!("{:.0} %, expected at least {:.0} %", 100.0 * left, 100.0 * least);
            self.refuses("battery", text);
        }
    }

    fn link(&mut self, report: &Report, listener: &Listener) {
        let most = listener.config.settings.offboard.preflight.link_loss_max;
        if report.lost_share > most {
            let (lost, most) = (100.0 * report.lost_share, 100.0 * most);
            self.refuses(
                "link",
                format!("loses {lost:.0} % of the frames, expected at most {most:.0} %"),
            );
        }
        if report.clock != Some("TIMESYNC") {
            self.warns(
                "clock",
                "it does not answer TIMESYNC: a slowly growing queue cannot be distinguished from \
                 a slow clock",
            );
        }
        if let Some(skew) = report.clock_skew.filter(|skew| skew.abs() > SKEW_NOTABLE) {
            let rate = 1.0 + skew;
            self.warns(
                "clock",
                format!(
                    "it runs at {rate:.3} times real time: a simulator, or an overloaded vehicle"
                ),
            );
        }
        if report.round_trip_p50_s.is_some_and(|time| time > ROUND_TRIP_NOTABLE_S) {
            self.warns("round trip", "it is long for feedback; use a faster link");
        }
        if let Some(timer) =
            report.serial_latency_timer_ms.filter(|ms| *ms > LATENCY_TIMER_NOTABLE_MS)
        {
            self.warns(
                "serial",
                format!(
                    "the adapter holds back bytes for up to {timer} ms; write 1 to its \
                     latency_timer in /sys/bus/usb-serial/devices"
                ),
            );
        }
    }
}
