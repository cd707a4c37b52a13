//! Messages about what a flight waits for: within three seconds, and again when that changes.

use std::iter::once;
use std::time::Duration;

use message::LandedState;
use wire::message_name;

use super::Station;
use crate::clock::HostTime;
use crate::link::counters::LinkState;
use crate::link::silence::Silence;
use crate::log::record::Severity;
use crate::offboard::OffboardController;
use crate::supervisor::{EngagePolicy, FlightState, PreflightCheck};

/// Period of this check.
const PERIOD: Duration = Duration::from_millis(100);
/// A wait that ends within this time is not reported.
const PATIENCE: Duration = Duration::from_millis(2500);
/// A check that has failed for this long, with all telemetry present, needs somebody to act.
const SETTLED: Duration = Duration::from_millis(300);

/// A reason that ends and comes back within this time is not reported again: it would fill the
/// screen.
const QUIET: Duration = Duration::from_secs(3);

/// What is awaited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wait {
    /// A message from a vehicle.
    Vehicle,
    /// A mode other than OFFBOARD.
    Release,
    /// The state, at the required rate.
    Telemetry,
    /// Checks that still fail.
    Checks,
    /// The pilot's switch, or arming by the pilot.
    Pilot,
}

impl Wait {
    fn is_preparing(self) -> bool {
        matches!(self, Self::Release | Self::Telemetry | Self::Checks)
    }
}

/// Why the flight does not begin: the subject, which decides whether the reason is new, and the
/// message.
#[derive(Clone, Debug, PartialEq)]
struct Reason {
    subject: String,
    severity: Severity,
    line: String,
}

impl Reason {
    /// Something that may need a cure.
    fn warning(subject: impl Into<String>, line: impl Into<String>) -> Self {
        Self { subject: subject.into(), severity: Severity::Warning, line: line.into() }
    }

    /// A wait of every flight.
    fn normal(subject: impl Into<String>, line: impl Into<String>) -> Self {
        Self { severity: Severity::Info, ..Self::warning(subject, line) }
    }
}

impl From<Silence> for Reason {
    fn from(Silence { subject, line }: Silence) -> Self {
        Self::warning(subject, line)
    }
}

/// Reports each reason once.
#[derive(Debug)]
pub(super) struct Waiting {
    due: HostTime,
    /// What is awaited, and since when.
    wait: Option<(Wait, HostTime)>,
    /// Since when only checks are awaited.
    checking: Option<HostTime>,
    /// Reported subjects, and when.
    reported: Vec<(String, HostTime)>,
}

impl Waiting {
    pub(super) fn new(now: HostTime) -> Self {
        Self { due: now, wait: None, checking: None, reported: Vec::new() }
    }

    /// The reasons to report now, from what is awaited and why.
    fn news(&mut self, now: HostTime, found: Option<(Wait, Vec<Reason>)>) -> Vec<Reason> {
        let Some((wait, reasons)) = found else {
            (self.wait, self.reported) = (None, Vec::new());
            return Vec::new();
        };
        // All preparation for a flight is one wait, whatever its subject. It continues the wait for
        // a vehicle if that was not reported.
        let since = match self.wait {
            Some((known, since)) if known.is_preparing() == wait.is_preparing() => since,
            Some((Wait::Vehicle, since)) if wait.is_preparing() && self.reported.is_empty() => {
                since
            }
            _ => now,
        };
        let checking = self.checking.filter(|_| wait == Wait::Checks);
        self.checking = (wait == Wait::Checks).then(|| checking.unwrap_or(now));
        self.wait = Some((wait, since));
        let is_settled = self.checking.is_some_and(|checking| now.since(checking) >= SETTLED);
        if now.since(since) < PATIENCE && !is_settled {
            return Vec::new();
        }
        // A subject that was fixed and fails again is reported again.
        self.reported.retain(|(subject, at)| {
            now.since(*at) < QUIET || reasons.iter().any(|reason| reason.subject == *subject)
        });
        let is_news =
            |reason: &Reason| self.reported.iter().all(|(subject, _)| *subject != reason.subject);
        let news: Vec<_> = reasons.into_iter().filter(is_news).collect();
        self.reported.extend(news.iter().map(|reason| (reason.subject.clone(), now)));
        news
    }
}

impl Station {
    /// Reports what is awaited, if that is new.
    pub(super) fn report_wait(&mut self, now: HostTime) {
        if now < self.waiting.due {
            return;
        }
        self.waiting.due = now + PERIOD;
        self.report_signing(now);
        let found = self.waits_for(now);
        for reason in self.waiting.news(now, found) {
            self.report(now, reason.severity, format!("waiting: {}", reason.line));
        }
    }

    fn waits_for(&self, now: HostTime) -> Option<(Wait, Vec<Reason>)> {
        if self.end.is_some() {
            return None;
        }
        // Nothing can arrive: why it does not open is all that somebody can act on.
        if self.open_failure.is_some() {
            return None;
        }
        if self.session.state() != LinkState::Connected {
            // In flight, other events report the loss of the link.
            let is_prepared = self.offboard.as_ref().is_some_and(|offboard| {
                let state = offboard.flight_state();
                !state.precedes_stream() && !state.is_over()
            });
            return (!is_prepared)
                .then(|| (Wait::Vehicle, vec![Silence::of(&self.session, now).into()]));
        }
        // A newly found vehicle has no controller yet: the wait continues.
        let Some(offboard) = self.offboard.as_ref() else {
            return Some((Wait::Telemetry, Vec::new()));
        };
        let by_pilot = self.settings.policy == EngagePolicy::PilotSwitch;
        match offboard.flight_state() {
            FlightState::AwaitRelease => {
                let stands_s = self.settings.offboard.supervisor.release_s;
                let mode = self.release(offboard).unwrap_or_else(|| {
                    let line = format!("the mode to stay as it is for {stands_s} s");
                    Reason::normal("mode", line)
                });
                let others = checks(offboard, |subject| !is_of_the_state(subject));
                Some((Wait::Release, once(mode).chain(others).collect()))
            }
            FlightState::Connect | FlightState::AwaitTelemetry => {
                let mut reasons = self.telemetry_reasons(now, offboard);
                reasons.extend(checks(offboard, |subject| !is_of_the_state(subject)));
                Some((Wait::Telemetry, reasons))
            }
            FlightState::Preflight => Some((Wait::Checks, checks(offboard, |_| true))),
            FlightState::Standby if by_pilot => {
                let line = "ready; the pilot switches to OFFBOARD (ArduCopter: GUIDED) to fly";
                Some((Wait::Pilot, vec![Reason::normal("switch", line)]))
            }
            FlightState::Arm if by_pilot => {
                let line = "in OFFBOARD; the pilot arms";
                Some((Wait::Pilot, vec![Reason::normal("arming", line)]))
            }
            _ => None,
        }
    }

    /// What keeps the vehicle's mode from counting as another one than OFFBOARD; `None` for a mode
    /// that has just changed.
    fn release(&self, offboard: &OffboardController) -> Option<Reason> {
        let status = offboard.telemetry().status();
        let offboard = self.profile.as_ref().and_then(|profile| profile.modes.offboard);
        let offboard = offboard.map(|mode| mode.custom_mode);
        let line = match (status.mode, status.intended_mode) {
            (None, _) => "the vehicle's mode; no HEARTBEAT from its autopilot yet",
            (mode, _) if mode == offboard => {
                "the vehicle is in OFFBOARD (ArduCopter: GUIDED); switch it to another mode"
            }
            (_, intended) if intended == offboard => {
                "the vehicle intends to enter OFFBOARD; switch it to another mode"
            }
            (_, None) => "CURRENT_MODE, which reports the vehicle's intended mode",
            _ => return None,
        };
        Some(Reason::warning("mode", line))
    }

    /// The link's load, and what could be dropped from it.
    fn load(&self) -> String {
        let load = self.session.load();
        let stats = self.session.stats();
        let lost = stats.lost as f64 / (stats.lost + stats.vehicle_frames).max(1) as f64;
        let mut text = format!("; {load}");
        if lost > self.settings.offboard.preflight.link_loss_max {
            text += &format!("; the link loses {:.0} % of the frames", 100.0 * lost);
        }
        if let Some(budget) = self.session.budget() {
            text += &format!("; the line carries {:.0} bytes/s", budget.bytes_per_s());
        }
        if let Some(profile) = self.profile.as_ref().filter(|_| !load.unrequested.is_empty()) {
            text += "; lower unrequested messages on the vehicle with ";
            text += profile.stream_parameters;
        }
        text
    }

    fn telemetry_reasons(&self, now: HostTime, offboard: &OffboardController) -> Vec<Reason> {
        let telemetry = offboard.telemetry();
        let [odometry, attitude, position] = telemetry.rates_hz();
        let needed = self.settings.offboard.preflight.tick_rate_min
            * self.settings.offboard.telemetry.rate_hz;
        let is_refused = !self.session.refusals().is_empty();
        let cure = if is_refused {
            ""
        } else if position == 0.0 && odometry == 0.0 {
            "; no position arrives: the vehicle's estimate needs GPS or motion capture"
        } else if attitude == 0.0 && odometry == 0.0 {
            "; no attitude arrives"
        } else if telemetry.tick_rate_hz() < needed {
            "; the link is too slow for them, or control.rate_hz too high for it"
        } else {
            "; they do not arrive steadily"
        };
        let is_slow = telemetry.tick_rate_hz() < needed && !is_refused;
        let load = if is_slow { self.load() } else { String::new() };
        let late = telemetry.late();
        let late = if late.count > 0 { format!("; {late}") } else { String::new() };
        let rates = format!(
            "at least {needed:.0} Hz of ODOMETRY, or of attitude and position; found ODOMETRY at \
             {odometry:.0} Hz, attitude at {attitude:.0} Hz, position at {position:.0} Hz{cure}{load}{late}"
        );
        let subject = format!("rates{cure}");
        let status = telemetry.status();
        let unknown = match (status.armed, status.landed) {
            (None, _) => Some(("armed", "HEARTBEAT, which reports whether the motors are armed")),
            (Some(true), LandedState::Undefined) => {
                Some(("landed", "EXTENDED_SYS_STATE, which reports whether the vehicle has landed"))
            }
            _ => None,
        };
        let unknown = unknown.map(|(subject, line)| Reason::warning(subject, line));
        let refused = self.session.refusals().iter().map(|refused| {
            let name = message_name(refused.id);
            let line = format!("{} {name} rejected: {}", refused.count, refused.refusal);
            Reason::warning(format!("refused {name}"), line)
        });
        let stale_s = self.settings.offboard.safety.stale_after_s;
        let is_short = telemetry.tick_rate_hz() < needed || telemetry.age_s(now) > stale_s;
        let rates = is_short.then(|| Reason::warning(subject, rates));
        unknown.into_iter().chain(refused).chain(rates).collect()
    }
}

/// The failed checks whose subject is selected.
fn checks(offboard: &OffboardController, is_selected: impl Fn(&str) -> bool) -> Vec<Reason> {
    let selected = offboard.failed_checks().iter().filter(|check| is_selected(&check.subject));
    let reason = |check: &PreflightCheck| {
        let line = format!("{check}{}", cure(&check.subject));
        Reason::warning(check.subject.clone(), line)
    };
    selected.map(reason).collect()
}

/// Whether the check can pass only once the state arrives.
fn is_of_the_state(subject: &str) -> bool {
    matches!(subject, "telemetry rate" | "state" | "trajectory start")
}

fn cure(subject: &str) -> &'static str {
    match subject {
        "telemetry rate" => "; lower control.rate_hz, or use a faster link",
        "battery" => "; charge it, or lower offboard.preflight.battery_min",
        "signing" => "; turn it off, or connect by USB, where unsigned messages are accepted",
        "link" => "; bring the antennas closer, or raise offboard.preflight.link_loss_max",
        "trajectory start" => "; carry the vehicle there, or move the trajectory",
        subject if subject.starts_with("parameter ") => "; set it with your ground station",
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reason(subject: &str) -> Reason {
        Reason::warning(subject, subject)
    }

    #[test]
    fn wait_is_reported_within_three_seconds_and_on_change() {
        let start = HostTime::from_ns(0);
        let mut waiting = Waiting::new(start);
        let mut reported = Vec::new();
        for k in 0..200u32 {
            let now = start + PERIOD * k;
            let found = match k {
                // Nothing from 0 to 4 s; then checks, one of which is fixed at 6 s and fails again
                // at 8 s.
                0..40 => Some((Wait::Vehicle, vec![reason("silence")])),
                60..80 => Some((Wait::Checks, vec![reason("b")])),
                40..100 => Some((Wait::Checks, vec![reason("a"), reason("b")])),
                _ => None,
            };
            reported.extend(waiting.news(now, found).into_iter().map(|reason| (k, reason.line)));
        }
        let reported: Vec<_> = reported.iter().map(|(k, line)| (*k, line.as_str())).collect();
        assert_eq!(reported, [(25, "silence"), (43, "a"), (43, "b"), (80, "a")]);
    }

    #[test]
    fn flapping_reason_is_reported_only_occasionally() {
        let start = HostTime::from_ns(0);
        let mut waiting = Waiting::new(start);
        let reported = (0..100u32).filter(|k| {
            let subject = if k % 2 == 0 { "rate" } else { "pose" };
            let found = Some((Wait::Telemetry, vec![reason(subject)]));
            !waiting.news(start + PERIOD * *k, found).is_empty()
        });
        let reported: Vec<_> = reported.collect();
        assert!((4..=6).contains(&reported.len()), "{reported:?}");
    }

    #[test]
    fn telemetry_wait_is_reported_sooner_after_waiting_for_vehicle() {
        let start = HostTime::from_ns(0);
        let mut waiting = Waiting::new(start);
        let reported = (0..100u32).find(|k| {
            let wait = if *k < 11 { Wait::Vehicle } else { Wait::Telemetry };
            let found = Some((wait, vec![reason("frame")]));
            !waiting.news(start + PERIOD * *k, found).is_empty()
        });
        assert_eq!(reported, Some(25), "2.5 s after the start");
    }
}
