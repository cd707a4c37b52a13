//! The judge: compares the frames that the station sends with those that it receives, and watches
//! the vehicle.
//!
//! It knows the frames in both directions with their true times, the vehicle's true state, and the
//! bounds that the operator was promised. It knows nothing of supervisor, telemetry or guard, and
//! shares no code with them.

use wire::dialect::*;

pub use super::bounds::Bounds;
use super::bounds::Sent;
use super::channel::{Origin, Passing};
use super::frame_content;
pub use super::rule::{Rule, Violation};
use super::script::Script;
use super::truth::Envelope;
use crate::supervisor::EngagePolicy;

pub use super::truth::{Ending, Seen};

/// Time for which a reported mode is valid, s.
const MODE_KNOWN_S: f64 = 2.5;
/// Silence after which the mode is unknown, s.
const SILENCE_S: f64 = 0.5;
/// A process stopped for longer than this must not answer unread messages, s.
const STALL_S: f64 = 0.05;
/// Time for which setpoints may continue after the request to land, s.
const HANDOVER_S: f64 = 2.0;
/// Time in another mode after which a new stream may begin under the pilot's switch, s.
const RELEASE_S: f64 = 1.0;
/// Delay beyond which a state must not be answered, s.
const LATE_S: f64 = 0.2;
/// Longest interval at which the station checks its deadlines, s.
const LOOK_S: f64 = 0.03;
/// Time after a stall within which unread messages are read, and none is answered, s.
const DRAIN_S: f64 = 0.01;
/// Time that an answer may take on sockets, s: a stall too short for the guard, and the system
/// calls.
pub(super) const IN_TRANSIT_S: f64 = STALL_S + 0.01;

/// A report of the mode and the motors.
#[derive(Clone, Copy, Debug)]
struct Mode {
    custom_mode: u32,
    sent_us: u64,
    received_us: u64,
}

/// A received state.
#[derive(Clone, Copy, Debug)]
struct State {
    sent_us: u64,
    received_us: u64,
    arrival_us: u64,
}

/// Judges one flight.
pub struct Judge {
    bounds: Bounds,
    policy: EngagePolicy,
    envelope: Envelope,
    violations: Vec<Violation>,
    mode: Option<Mode>,
    /// Since when the newest received mode has been other than OFFBOARD.
    left_us: Option<u64>,
    received_us: Option<u64>,
    /// When the last silence began.
    silent_us: u64,
    armed: Option<bool>,
    /// Restart of the vehicle, until its first report after that arrives.
    rebooted_us: Option<u64>,
    /// Whether setpoints left while the vehicle reported that it obeys.
    flew: bool,
    disarmed_us: Option<u64>,
    land_us: Option<u64>,
    states: Vec<State>,
    quickest_us: u64,
    /// When a setpoint last reached the vehicle.
    reached_us: Option<u64>,
    ran_us: u64,
    woke_us: u64,
    /// How long an answer may be in transit, s. In lockstep it leaves at the instant of the message
    /// that it answers.
    in_transit_s: f64,
    last: Option<Sent>,
    /// Number of setpoints that left.
    pub setpoints: u64,
}

impl Judge {
    /// A judge before the flight of `script`; `path` is where the trajectory leads.
    pub fn new(script: &Script, bounds: Bounds, path: &[[f64; 3]]) -> Self {
        Self {
            bounds,
            policy: script.policy,
            envelope: Envelope::new(script, path),
            violations: Vec::new(),
            mode: None,
            left_us: None,
            received_us: None,
            silent_us: 0,
            armed: None,
            rebooted_us: None,
            flew: false,
            disarmed_us: None,
            land_us: None,
            states: Vec::new(),
            quickest_us: u64::MAX,
            reached_us: None,
            ran_us: 0,
            woke_us: 0,
            in_transit_s: 0.0,
            last: None,
            setpoints: 0,
        }
    }

    /// Makes the judge allow answers `seconds` in transit, for a process on sockets.
    pub(super) fn patient(self, seconds: f64) -> Self {
        Self { in_transit_s: seconds, ..self }
    }

    /// The broken rules, in order of time.
    pub fn violations(&self) -> &[Violation] {
        &self.violations
    }

    fn violated(&mut self, rule: Rule, now_us: u64, what: impl Into<String>) {
        if !self.violations.iter().any(|violation| violation.rule == rule) {
            let at_s = now_us as f64 * 1e-6;
            self.violations.push(Violation { rule, at_s, what: what.into() });
        }
    }

    /// Notes that the station's process runs at `now_us`.
    pub fn runs(&mut self, now_us: u64) {
        if seconds(self.ran_us, now_us) > STALL_S {
            self.woke(now_us);
        }
        self.ran_us = now_us;
        self.states.retain(|state| state.arrival_us + 1_000_000 > now_us);
    }

    /// Notes that the station's process runs again after a stall.
    pub(super) fn woke(&mut self, now_us: u64) {
        self.woke_us = now_us;
    }

    /// Notes that a new process of the station starts without any knowledge.
    pub fn restarted(&mut self, now_us: u64) {
        (self.mode, self.left_us, self.received_us, self.armed) = (None, None, None, None);
        (self.flew, self.disarmed_us, self.land_us, self.last) = (false, None, None, None);
        (self.silent_us, self.woke_us, self.ran_us) = (now_us, now_us, now_us);
        self.states.clear();
        self.reached_us = None;
    }

    /// Notes that the vehicle restarted: earlier reports expire with its first state or mode. The
    /// controller need not read any other message.
    pub fn rebooted(&mut self, now_us: u64) {
        self.rebooted_us = Some(now_us);
    }

    /// Takes a frame that the station receives.
    pub(super) fn station_received(&mut self, now_us: u64, passing: &Passing) {
        let Passing { arrival_us, sent_us, origin, bytes } = passing;
        let (frame, sent_us) = (bytes.as_slice(), *sent_us);
        if frame_content::is_state(frame) {
            // A state changed by others is still a state, and the controller must take it for one.
            self.states.push(State { sent_us, received_us: now_us, arrival_us: *arrival_us });
            self.quickest_us = self.quickest_us.min(arrival_us.saturating_sub(sent_us));
        }
        if *origin == Origin::Nobody {
            return;
        }
        if *origin == Origin::Vehicle {
            let shows_it = frame_content::is_state(frame) || frame_content::is_mode(frame);
            if shows_it && self.rebooted_us.is_some_and(|rebooted| sent_us >= rebooted) {
                (self.mode, self.rebooted_us) = (None, None);
            }
            if self.received_us.is_none_or(|received| {
                seconds(received, now_us) > SILENCE_S + LOOK_S + self.in_transit_s
            }) {
                self.silent_us = self.received_us.unwrap_or(now_us);
            }
            self.received_us = Some(now_us);
        }
        let Some((custom_mode, armed)) = frame_content::reported_mode(frame) else { return };
        tracing::trace!(now_us, sent_us, ?origin, ?armed, "mode {custom_mode:#x}");
        if self.mode.is_some_and(|mode| {
            mode.sent_us >= sent_us && *origin == Origin::Copy || mode.sent_us > sent_us
        }) {
            return;
        }
        self.mode = Some(Mode { custom_mode, sent_us, received_us: now_us });
        // The pilot may switch back just as the release is over, before an offer leaves.
        self.detect_release(now_us);
        self.left_us =
            if custom_mode == self.bounds.obeys { None } else { self.left_us.or(Some(now_us)) };
        if let Some(armed) = armed {
            if self.flew && self.armed == Some(true) && !armed {
                self.disarmed_us = self.disarmed_us.or(Some(now_us));
            }
            self.armed = Some(armed);
        }
    }

    /// Takes a frame that the station sends.
    pub fn station_sent(&mut self, now_us: u64, frame: &[u8]) {
        match frame_content::id(frame) {
            Some(frame_content::SET_ATTITUDE_TARGET) => {}
            Some(frame_content::COMMAND_LONG) => return self.commanded(now_us, frame),
            _ => return,
        }
        let Some(MavMessage::SET_ATTITUDE_TARGET(target)) = frame_content::message(frame) else {
            return;
        };
        tracing::trace!(now_us, "setpoint");
        self.setpoints += 1;
        self.check_limits(now_us, &target);
        self.check_fresh(now_us);
        self.check_mode(now_us);
    }

    fn check_limits(&mut self, now_us: u64, target: &SET_ATTITUDE_TARGET_DATA) {
        let sent = Sent::new(now_us, target);
        if !self.bounds.admit(&sent, target) {
            self.violated(Rule::Limits, now_us, format!("{target:?}"));
        }
        if let Some(last) = self.last.filter(|last| seconds(last.at_us, now_us) < 0.49) {
            let dt_s = seconds(last.at_us, now_us).max(0.005) + self.in_transit_s;
            if !self.bounds.admit_change(&last, &sent, dt_s) {
                self.violated(Rule::Changes, now_us, format!("{last:?}, then {sent:?}"));
            }
        }
        self.last = Some(sent);
    }

    /// A setpoint must answer the newest state received at this instant. On sockets it answers one
    /// received just before, and each state is answered once.
    fn check_fresh(&mut self, now_us: u64) {
        let in_transit_s = self.in_transit_s;
        let is_now = |state: &State| seconds(state.received_us, now_us).abs() <= in_transit_s;
        let newest = self.states.iter().copied().filter(is_now);
        // On a socket, an old copy that arrived last need not be the answered state.
        let arrival_us = |state: &State| if in_transit_s > 0.0 { 0 } else { state.arrival_us };
        let newest = newest.max_by_key(|state| (arrival_us(state), state.sent_us));
        let answered = self.states.iter().position(is_now).filter(|_| in_transit_s > 0.0);
        self.states.drain(..answered.map_or(self.states.len(), |first| first + 1));
        let Some(state) = newest else {
            return self.violated(Rule::Fresh, now_us, "it answers no state that has just arrived");
        };
        // Without a common clock, a constant delay of the link cannot be detected.
        let base_s = self.quickest_us as f64 * 1e-6;
        let age_s = seconds(state.sent_us, now_us);
        if age_s > LATE_S + LOOK_S + STALL_S + 3.0 * base_s + in_transit_s {
            let what =
                format!("the newest state is {age_s:.3} s old, the fastest one was {base_s:.3} s");
            self.violated(Rule::Fresh, now_us, what);
        }
        let early_s = seconds(state.arrival_us, self.woke_us);
        if early_s > 0.015 {
            let what = format!("the newest state arrived {early_s:.3} s before the stall's end");
            self.violated(Rule::Stalled, now_us, what);
        }
        let since_s = seconds(self.woke_us, now_us);
        if self.woke_us > 0 && (0.0..DRAIN_S).contains(&since_s) {
            let what = format!("{since_s:.3} s after a stall, while the backlog is read");
            self.violated(Rule::Stalled, now_us, what);
        }
    }

    fn check_mode(&mut self, now_us: u64) {
        self.detect_release(now_us);
        let is_stopped = self.disarmed_us.is_some_and(|at| self.is_known_since(at, now_us));
        if is_stopped && self.policy == EngagePolicy::Command {
            self.violated(
                Rule::AfterDisarming,
                now_us,
                "the vehicle reported that its motors stopped",
            );
        }
        if let Some(land_us) = self.land_us
            && seconds(land_us, now_us) > HANDOVER_S + LOOK_S + self.in_transit_s
        {
            let what = format!("{:.2} s after the landing request", seconds(land_us, now_us));
            self.violated(Rule::AfterLanding, now_us, what);
        }
        let Some(mode) = self.mode else {
            if self.flew {
                self.violated(Rule::OldMode, now_us, "another vehicle answers");
            }
            return;
        };
        if mode.custom_mode == self.bounds.obeys {
            // Under the pilot's switch a hold is offered on the ground, whatever the mode.
            self.flew |= self.policy == EngagePolicy::Command || self.armed == Some(true);
            let known_s = seconds(mode.received_us, now_us);
            if known_s > MODE_KNOWN_S + LOOK_S + self.in_transit_s {
                let what = format!("the vehicle last reported its mode {known_s:.2} s ago");
                self.violated(Rule::OldMode, now_us, what);
            }
            if mode.sent_us < self.silent_us {
                let what =
                    "the vehicle reported its mode before the link fell silent, and not since";
                self.violated(Rule::OldMode, now_us, what);
            }
        } else if self.flew && self.left_us.is_none_or(|left| self.is_known_since(left, now_us)) {
            let left_s = self.left_us.map_or(0.0, |left| seconds(left, now_us));
            let what =
                format!("{left_s:.3} s after the vehicle reported mode {:#x}", mode.custom_mode);
            self.violated(Rule::AgainstThePilot, now_us, what);
        }
    }

    /// Whether a report at `at_us` must be known to a setpoint that leaves now, given its time in
    /// transit.
    fn is_known_since(&self, at_us: u64, now_us: u64) -> bool {
        seconds(at_us, now_us) >= self.in_transit_s
    }

    /// Under the pilot's switch a new flight may begin once the vehicle was in another mode for a
    /// while: setpoints that leave then are an offer.
    fn detect_release(&mut self, now_us: u64) {
        let least_s = RELEASE_S - LOOK_S - self.in_transit_s;
        let is_released = self.left_us.is_some_and(|left| seconds(left, now_us) >= least_s);
        if self.policy == EngagePolicy::PilotSwitch && is_released {
            (self.flew, self.disarmed_us, self.land_us) = (false, None, None);
        }
    }

    fn commanded(&mut self, now_us: u64, frame: &[u8]) {
        let Some(MavMessage::COMMAND_LONG(data)) = frame_content::message(frame) else { return };
        let sets_mode = data.command == MavCmd::MAV_CMD_DO_SET_MODE;
        // The vehicle itself refuses to disarm in the air.
        let arms = data.command == MavCmd::MAV_CMD_COMPONENT_ARM_DISARM && data.param1 != 0.0;
        if !sets_mode && !arms {
            return;
        }
        tracing::trace!(now_us, "{:?} {} {}", data.command, data.param2, data.param3);
        let is_landing = sets_mode && {
            let [main, sub] = [data.param2 as u32, data.param3 as u32];
            main << 16 | sub << 24 == self.bounds.lands || main == self.bounds.lands
        };
        if is_landing && self.flew {
            self.land_us = self.land_us.or(Some(now_us));
        }
        let led = self.mode.filter(|mode| {
            self.flew
                && mode.custom_mode != self.bounds.obeys
                && mode.custom_mode != self.bounds.lands
                && self.left_us.is_none_or(|left| self.is_known_since(left, now_us))
        });
        if let Some(mode) = led.filter(|_| self.policy == EngagePolicy::Command) {
            let what = format!(
                "{:?} while the vehicle reported mode {:#x}",
                data.command, mode.custom_mode
            );
            self.violated(Rule::Commands, now_us, what);
        }
    }

    /// Takes a frame from the station that reaches the vehicle.
    pub(super) fn reached(&mut self, now_us: u64, frame: &[u8]) {
        if frame_content::id(frame) == Some(frame_content::SET_ATTITUDE_TARGET) {
            self.reached_us = Some(now_us);
        }
    }

    /// Takes the vehicle's true state.
    pub fn sees(&mut self, seen: &Seen) {
        let is_led = self.reached_us.is_some_and(|at| seconds(at, seen.now_us) < 0.3);
        if let Some((rule, what)) = self.envelope.sees(seen, is_led) {
            self.violated(rule, seen.now_us, what);
        }
    }

    /// Judges the flight's true end; `None` where it had none.
    pub fn ends(&mut self, now_us: u64, ending: Option<Ending>) {
        match ending {
            None => self.violated(Rule::Ends, now_us, "the station never ended"),
            Some(Ending::Adrift) => {
                let what = "it flies on in the mode that obeys setpoints, and nobody sends any";
                self.violated(Rule::GoodEnd, now_us, what);
            }
            Some(_) => {}
        }
    }
}

/// From one time to another, s; negative where the second is earlier.
fn seconds(from_us: u64, to_us: u64) -> f64 {
    (to_us as f64 - from_us as f64) * 1e-6
}

#[cfg(test)]
mod tests;
