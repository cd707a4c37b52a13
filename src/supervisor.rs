//! The state machine of a flight. Its state decides what the guard before the output lets pass.
//!
//! ```text
//! Connect -> AwaitRelease -> AwaitTelemetry -> Preflight -> Standby -> [Engage] -> Arm -> TakeOff
//!   -> Approach -> Track -> Hold -> Land -> Disarm -> Done
//! ```
//!
//! Every transition is a row of `table.rs`. Setpoints leave in Standby, in Engage, from Arm to
//! Hold, and in Land until the vehicle has taken over. They never leave in another state, and never
//! without a fresh sample. From Engage to Land, a mode change by the pilot leads to PilotControl.
//!
//! Every path to the stream passes AwaitRelease: mode and intended mode must have read something
//! other than OFFBOARD for a while, because PX4 re-enters OFFBOARD by itself as soon as a stream
//! resumes. A vehicle that was flown by command is in OFFBOARD afterwards, because PX4 returns to
//! the mode chosen before arming. If the next flight is commanded, the supervisor requests that a
//! disarmed vehicle leave OFFBOARD. Under the pilot's switch, and with the motors armed, only the
//! pilot leaves OFFBOARD. An OFFBOARD that comes with the stop of the motors is that return and not
//! the pilot's switch.
//!
//! Nothing is commanded and no setpoint leaves while the mode may be outdated: when it was reported
//! before the vehicle fell silent or before this process paused. The pilot may have changed it
//! since.

mod conditions;
mod event;
mod health;
mod modes;
mod preflight;
mod reasons;
mod safety;
mod settings;
mod table;
mod takeover;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use self::event::{Action, Event, Severity};
pub use self::modes::ModeMap;
pub use self::preflight::{
    PreflightCheck, PreflightSettings, RequiredParameter, Standing, preflight,
};
use self::safety::FAULTS;
pub use self::safety::{Fault, FlightCondition, Reaction, SafetySettings, UplinkDelay};
pub use self::settings::SupervisorSettings;
pub use self::table::{FlightState, STATES, TRIGGERS, Trigger};
use self::takeover::ModeTaken;
pub use self::takeover::Takeover;
use crate::clock::HostTime;
use crate::guard::{Obeys, Stance};
#[cfg(test)]
use crate::planted::{self, Planted};
use crate::telemetry::VehicleStatus;

/// Age of the state, s, above which state and setpoints count as stopped. An autopilot's own
/// failsafe may act this early.
const STATE_STOPPED_S: f64 = 0.2;

/// A vehicle no faster than this, m/s, for [`BRAKED_FOR_S`] stops within a hand's breadth.
const BRAKED_M_S: f64 = 0.3;
/// In this time, s, a vehicle that is still tilted to brake leaves that speed again.
const BRAKED_FOR_S: f64 = 0.3;

/// Who decides that the controller takes control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EngagePolicy {
    /// The operator, by command: the controller requests OFFBOARD and arms, once.
    #[default]
    Command,
    /// The pilot, each time, by switching to OFFBOARD while the controller streams; the pilot also
    /// arms.
    PilotSwitch,
}

/// What the supervisor observes, besides time.
#[derive(Clone, Copy, Debug)]
pub struct Observation<'a> {
    /// The vehicle's slow messages.
    pub status: &'a VehicleStatus,
    /// Whether the vehicle is off the ground; `None` where this is unknown.
    pub airborne: Option<bool>,
    /// Whether it is at rest at ground height, according to its own estimate.
    pub at_rest: bool,
    /// Horizontal speed of the newest sample, m/s.
    pub speed_m_s: f64,
    /// Whether samples are fresh and frequent enough.
    pub telemetry_ready: bool,
    /// The preflight checks that fail; empty when all pass.
    pub preflight: &'a [PreflightCheck],
    /// The quantities that faults are judged by.
    pub condition: FlightCondition<'a>,
}

/// A fault whose condition holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    since: HostTime,
    /// Whether the reaction is done.
    is_answered: bool,
}

/// The state machine of a flight. The caller passes the time with each call.
#[derive(Clone, Debug)]
pub struct Supervisor {
    policy: EngagePolicy,
    modes: ModeMap,
    settings: SupervisorSettings,
    safety: SafetySettings,
    state: FlightState,
    /// When the present state began.
    since: HostTime,
    /// Start of the preparation of a flight, through all its states, until the flight begins.
    preparing_since: Option<HostTime>,
    /// Whether a commanded flight is still pending.
    engaged: bool,
    /// Whether the newest sample of the present state was answered with a setpoint.
    streamed: bool,
    /// The first mode read in the present state.
    mode_at_entry: Option<u32>,
    /// Whether the mode read OFFBOARD at some time in the present state, or may have while a hold
    /// was offered or OFFBOARD requested.
    was_offboard: bool,
    /// Since when mode and intended mode have read something other than OFFBOARD.
    other_mode_since: Option<HostTime>,
    /// When the request of the present state was last sent.
    requested_at: Option<HostTime>,
    /// When landing was first requested in the present state.
    landing_requested_at: Option<HostTime>,
    /// Share of the braking time that the cause of a landing allows.
    brake_share: f64,
    /// The vehicle's last refusal in the present state.
    refusal: Option<String>,
    /// The faults whose condition holds.
    faults: BTreeMap<Fault, Held>,
    /// When control began.
    control_since: HostTime,
    /// The mode change that ended control.
    taken: Option<ModeTaken>,
    /// Since when the vehicle has been slow enough for a landing.
    slow_since: Option<HostTime>,
    /// Since when a landing vehicle has been at rest.
    rest_since: Option<HostTime>,
    /// The unhealthy parts that an event of this flight has named.
    reported_unhealthy: u32,
    actions: Vec<Action>,
    events: Vec<Event>,
}

impl Supervisor {
    /// Starts in Connect at `now`. [`EngagePolicy::Command`] implies one commanded flight.
    pub fn new(
        policy: EngagePolicy,
        modes: ModeMap,
        settings: SupervisorSettings,
        safety: SafetySettings,
        now: HostTime,
    ) -> Self {
        Self {
            policy,
            modes,
            settings,
            safety,
            state: FlightState::Connect,
            since: now,
            preparing_since: None,
            engaged: policy == EngagePolicy::Command,
            streamed: false,
            mode_at_entry: None,
            was_offboard: false,
            other_mode_since: None,
            requested_at: None,
            landing_requested_at: None,
            brake_share: 1.0,
            refusal: None,
            faults: BTreeMap::new(),
            control_since: now,
            taken: None,
            slow_since: None,
            rest_since: None,
            reported_unhealthy: 0,
            actions: Vec::new(),
            events: Vec::new(),
        }
    }

    /// The present state of the flight.
    pub fn state(&self) -> FlightState {
        self.state
    }

    /// Seconds in the present state.
    pub fn seconds_in_state(&self, now: HostTime) -> f64 {
        now.since(self.since).as_secs_f64()
    }

    /// The cause of the mode change that ended control, once it is known.
    pub fn takeover(&self) -> Option<&Takeover> {
        self.taken.as_ref()?.by()
    }

    /// Requests a flight, or another one after the last is over.
    pub fn engage(&mut self, now: HostTime) {
        self.engaged = true;
        self.fire(now, Trigger::EngageAsked, "a flight is requested");
    }

    /// Records that the vehicle refused a request; `text` says why, where it is known.
    pub fn refused(&mut self, now: HostTime, action: Action, text: &str) {
        let text = format!("the vehicle refuses {}: {text}", action.text());
        // The request is repeated every second, and mostly refused for the same reason.
        if self.refusal.as_ref() != Some(&text) {
            self.report(now, Severity::Warning, text.clone());
        }
        self.refusal = Some(text);
    }

    /// Requests since the last call, oldest first.
    pub fn take_actions(&mut self) -> Vec<Action> {
        std::mem::take(&mut self.actions)
    }

    /// Events since the last call, oldest first.
    pub fn take_events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Takes the table's transition for `trigger`, if there is one; returns whether there was.
    pub fn fire(&mut self, now: HostTime, trigger: Trigger, why: &str) -> bool {
        let Some(next) = self.state.next(trigger) else { return false };
        let severity = match (next, trigger) {
            (FlightState::Abort, _) => Severity::Error,
            (FlightState::PilotControl, _) | (_, Trigger::TimedOut) => Severity::Warning,
            _ => Severity::Info,
        };
        self.enter(now, next, severity, why);
        true
    }

    fn enter(&mut self, now: HostTime, next: FlightState, severity: Severity, why: &str) {
        let refusal = self.refusal.take().filter(|_| next == FlightState::Abort);
        (self.state, self.since) = (next, now);
        if next.is_preparing() {
            self.preparing_since.get_or_insert(now);
        } else if next != FlightState::Connect && next != FlightState::Standby {
            self.preparing_since = None;
        }
        (self.requested_at, self.landing_requested_at, self.brake_share) = (None, None, 1.0);
        self.mode_at_entry = None;
        self.was_offboard = false;
        self.streamed = false;
        self.faults.clear();
        self.rest_since = None;
        match next {
            FlightState::Standby => self.reported_unhealthy = 0,
            FlightState::Arm => self.control_since = now,
            FlightState::PilotControl => self.taken = Some(ModeTaken::new(now)),
            _ => {}
        }
        if next.is_over() {
            self.engaged = false;
            // Requests of a flight do not outlive it.
            self.actions.clear();
        }
        self.report(now, severity, refusal.unwrap_or_else(|| why.to_owned()));
    }

    /// Adds an event in the present state.
    pub fn report(&mut self, now: HostTime, severity: Severity, text: impl Into<String>) {
        self.events.push(Event { host: now, severity, state: self.state, text: text.into() });
    }

    /// Evaluates vehicle and clock, and takes every transition that follows.
    pub fn observe(&mut self, now: HostTime, seen: &Observation) {
        self.note_release(now, seen.status);
        // The longest chain of transitions in one call is shorter than the number of states.
        for _ in 0..STATES.len() {
            let Some((trigger, why)) = self.trigger(now, seen) else { break };
            if !self.fire(now, trigger, &why) {
                break;
            }
        }
        self.mode_at_entry = self.mode_at_entry.or(seen.status.mode);
        let may_be_obeyed = match self.state {
            FlightState::Standby => self.policy == EngagePolicy::PilotSwitch,
            FlightState::Engage => self.requested_at.is_some(),
            _ => false,
        };
        self.was_offboard |= seen.status.mode == Some(self.modes.offboard)
            || may_be_obeyed && seen.status.is_mode_doubtful();
        let held = |since: Option<HostTime>, holds: bool| holds.then(|| since.unwrap_or(now));
        let is_down = seen.at_rest && self.state == FlightState::Land;
        self.rest_since = held(self.rest_since, is_down);
        self.slow_since = held(self.slow_since, seen.speed_m_s <= BRAKED_M_S);
        self.report_takeover(now, seen.status);
        self.report_unhealthy(now, seen.status);
        self.react(now, seen);
        self.request(now, seen);
    }

    /// Checks only whether the mode ends control, for messages read after a pause.
    pub fn check_mode(&mut self, now: HostTime, status: &VehicleStatus) {
        if self.mode_changed(status) {
            let why = self.control_ends(status);
            self.fire(now, Trigger::ModeChanged, &why);
        }
    }

    fn report_takeover(&mut self, now: HostTime, status: &VehicleStatus) {
        let Some(taken) = &mut self.taken else { return };
        let text = match taken.settle(now, status, &self.modes) {
            None => return,
            Some(Takeover::Pilot { mode }) => format!("the pilot has control, in {mode}"),
            Some(Takeover::Failsafe(text)) => text.clone(),
        };
        self.report(now, Severity::Warning, text);
    }

    /// Reports what the vehicle calls unhealthy, each part once a flight.
    fn report_unhealthy(&mut self, now: HostTime, status: &VehicleStatus) {
        let new = health::watched(status.unhealthy) & !self.reported_unhealthy;
        if new != 0 && self.state.is_in_control() {
            self.reported_unhealthy |= new;
            let text = format!("the vehicle reports as unhealthy: {}", health::names(new));
            self.report(now, Severity::Warning, text);
        }
    }

    /// What the guard before the output may let pass.
    pub fn stance(&self, now: HostTime) -> Stance {
        let handover_s = self.settings.land_handover_s;
        #[cfg(test)]
        let handover_s = match planted::is(Planted::DeadlineDoubled) {
            true => 2.0 * handover_s,
            false => handover_s,
        };
        match self.state {
            FlightState::Standby | FlightState::Engage => Stance::Offer,
            FlightState::Land
                if now.since(self.landing_requested_at.unwrap_or(self.since)).as_secs_f64()
                    >= handover_s =>
            {
                Stance::Silent
            }
            state if state.may_stream() => Stance::Control,
            _ => Stance::Silent,
        }
    }

    /// Whether the vehicle obeys setpoints, according to a recently reported mode.
    pub fn obeys(&self, now: HostTime, status: &VehicleStatus) -> Obeys {
        match status.mode.filter(|_| status.is_mode_known(now)) {
            None => Obeys::Unknown,
            Some(mode) if mode == self.modes.offboard => Obeys::Yes,
            Some(_) => Obeys::No,
        }
    }

    /// Whether viewers may change what is flown: while a trajectory is tracked or a place held, and on
    /// the ground before a flight.
    pub fn accepts_adjustments(&self, airborne: Option<bool>) -> bool {
        match self.state {
            FlightState::Track | FlightState::Hold => true,
            FlightState::Standby => airborne == Some(false),
            state => state.precedes_stream() && airborne == Some(false),
        }
    }

    /// Records whether the newest sample was answered with a setpoint that left.
    pub fn sent(&mut self, is_sent: bool) {
        self.streamed = is_sent;
    }

    /// Reacts to each fault once, as soon as its condition has held for its dwell time.
    fn react(&mut self, now: HostTime, seen: &Observation) {
        if !self.state.is_in_control() {
            return;
        }
        let failsafe = seen.status.failsafe.as_ref().filter(|(at, _)| *at >= self.control_since);
        let failsafe = failsafe.map(|(_, text)| text.as_str());
        let condition = &FlightCondition { failsafe, ..seen.condition };
        for fault in FAULTS {
            let grounded = self.state == FlightState::Arm
                && matches!(fault, Fault::TrackingError | Fault::Tilt | Fault::Geofence);
            if grounded || !self.safety.holds(fault, condition) {
                self.faults.remove(&fault);
                continue;
            }
            let held = self.faults.entry(fault).or_insert(Held { since: now, is_answered: false });
            let held_s = now.since(held.since).as_secs_f64();
            if held.is_answered || held_s < self.safety.dwell_s(fault, condition) {
                continue;
            }
            held.is_answered = true;
            let why = self.safety.describe(fault, condition);
            let reaction = self.safety.reaction(fault);
            let next = reaction.trigger().and_then(|trigger| self.state.next(trigger));
            if let Some(next) = next {
                let aborts = next == FlightState::Abort;
                let severity = if aborts { Severity::Error } else { Severity::Warning };
                self.enter(now, next, severity, &why);
                self.brake_share = self.safety.brake_share(fault, condition);
                return;
            }
            // The event of a jump was more detailed where it was found.
            if fault != Fault::TelemetryJump {
                self.report(now, Severity::Warning, why);
            }
        }
    }

    /// Sends the request of the present state, and repeats it while it has no effect.
    fn request(&mut self, now: HostTime, seen: &Observation) {
        let status = seen.status;
        // After a stop of the state the vehicle's own failsafe may have acted. A mode reported as
        // the silence began does not show that, and a later frame of another kind does not either.
        let stopped_s = seen.condition.sample_age_s;
        let mode_s = status.mode_reported.map_or(f64::INFINITY, |at| now.since(at).as_secs_f64());
        let is_mode_current = stopped_s <= STATE_STOPPED_S || mode_s + STATE_STOPPED_S <= stopped_s;
        if !status.is_mode_known(now) || !is_mode_current {
            return;
        }
        let arms = self.policy == EngagePolicy::Command;
        let offboard = Some(self.modes.offboard);
        let action = match self.state {
            FlightState::AwaitRelease
                if arms
                    && self.engaged
                    && self.modes.hold.is_some()
                    && status.armed == Some(false)
                    && (status.mode == offboard || status.intended_mode == offboard) =>
            {
                Action::SetModeHold
            }
            FlightState::Engage => Action::SetModeOffboard,
            FlightState::Arm if arms && status.armed != Some(true) => Action::Arm,
            FlightState::Land if status.mode == offboard && !self.brakes(now, seen) => {
                self.landing_requested_at.get_or_insert(now);
                Action::SetModeLand
            }
            FlightState::Disarm if self.seconds_in_state(now) >= self.settings.disarm_after_s => {
                Action::Disarm
            }
            _ => return,
        };
        let retry_s = self.settings.retry_s;
        if self.requested_at.is_none_or(|at| now.since(at).as_secs_f64() >= retry_s) {
            self.requested_at = Some(now);
            self.actions.push(action);
        }
    }

    /// Whether feedback still brakes the vehicle, before the request to land.
    fn brakes(&self, now: HostTime, seen: &Observation) -> bool {
        self.landing_requested_at.is_none()
            && seen.condition.sample_age_s <= STATE_STOPPED_S
            && self.slow_since.is_none_or(|at| now.since(at).as_secs_f64() < BRAKED_FOR_S)
            && self.seconds_in_state(now) < self.brake_share * self.settings.land_brake_s
    }
}
