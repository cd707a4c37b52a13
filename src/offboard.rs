//! The line from a message to a setpoint: state -> reference -> feedback -> supervisor -> guard.
//! Pure: time comes with the messages, requests and setpoints are handed out.

mod adjustment;
mod condition;
mod effective_vehicle;
mod goal;
mod guidance;
mod tick;

use std::time::Duration;

use message::Inbound;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::adjustment::{Adjusted, Adjustment, AdjustmentSettings};
pub use self::effective_vehicle::{EffectiveVehicle, Uncontrollable};
use self::guidance::Guidance;
pub use self::guidance::GuidanceSettings;
pub use self::tick::Tick;

use crate::clock::HostTime;
use crate::control::{
    AdaptationNotice, Controller, HoverVehicle, Limits, OffsetFreeSettings, Saturation,
};
use crate::guard::{Answered, Cleared, Guard, Order, Proposal, Withheld};
use crate::link::received::Received;
use crate::plan::reference::ReferenceSource;
use crate::supervisor::{
    Action, EngagePolicy, Event, FlightState, ModeMap, PreflightCheck, PreflightSettings,
    SafetySettings, Severity, Supervisor, SupervisorSettings, Takeover, Trigger,
};
use crate::telemetry::{Sample, Telemetry, TelemetryFault, TelemetrySettings};

/// The settings of the line's parts.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OffboardSettings {
    /// Ticks and what of telemetry is believed.
    pub telemetry: TelemetrySettings,
    /// Times of the flight's states.
    pub supervisor: SupervisorSettings,
    /// Faults and reactions.
    pub safety: SafetySettings,
    /// Checks before a flight.
    pub preflight: PreflightSettings,
    /// Take-off and approach.
    pub guidance: GuidanceSettings,
    /// Bounds on the setpoint.
    pub limits: Limits,
    /// Feedback that leaves no steady error.
    pub offset_free: OffsetFreeSettings,
    /// Bounds of what may be changed in flight.
    pub adjustment: AdjustmentSettings,
}

/// What the controller must know of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Airframe {
    /// Effective mass, inertia and gravity.
    pub hover: HoverVehicle,
    /// Thrust of all rotors at full output, N.
    pub thrust_full_n: f64,
    /// The pack's voltage when full, V.
    pub battery_full_v: f64,
    /// The autopilot's modes.
    pub modes: ModeMap,
}

/// What the link tells beside the vehicle's messages.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkEvent {
    /// The connection broke.
    Lost,
    /// Another vehicle answers on the connection.
    Replaced,
    /// The vehicle refused a request.
    Refused {
        /// Which.
        action: Action,
        /// Result and reason in words.
        text: String,
    },
    /// Share of the vehicle's frames lost lately, 0..1.
    Quality {
        /// 0..1
        loss: f64,
    },
    /// The vehicle answered, so long after it was asked.
    RoundTrip(Duration),
}

/// Flies one vehicle along one trajectory, or holds until it is asked to.
pub struct OffboardController {
    settings: OffboardSettings,
    policy: EngagePolicy,
    airframe: Airframe,
    controller: Controller,
    telemetry: Telemetry,
    supervisor: Supervisor,
    guidance: Guidance,
    guard: Guard,
    /// When it was last told that this process stood still.
    stall_told: Option<HostTime>,
    standing_checks: Vec<PreflightCheck>,
    /// The checks that failed at the last look before the stream.
    failed_checks: Vec<PreflightCheck>,
    link_loss: Option<f64>,
    /// The newest answer: when it came, and how long after the request.
    round_trip: Option<(HostTime, Duration)>,
    tracking_error: f64,
    jumped: bool,
    /// When setpoints may last not have reached the vehicle.
    unheard: Option<HostTime>,
    /// When a slide of the estimate was last told.
    slide_told: Option<HostTime>,
    /// How long this process was paused before the next look, s.
    paused_s: f64,
}

impl OffboardController {
    /// A controller at `now`, before the first message. `standing_checks` are preflight checks that
    /// failed already, such as a trajectory outside of the flight envelope.
    pub fn new(
        settings: OffboardSettings,
        policy: EngagePolicy,
        airframe: Airframe,
        controller: impl Into<Controller>,
        trajectory: Box<dyn ReferenceSource + Send>,
        standing_checks: Vec<PreflightCheck>,
        now: HostTime,
    ) -> Self {
        let supervisor =
            Supervisor::new(policy, airframe.modes, settings.supervisor, settings.safety, now);
        let hover_thrust_n = airframe.hover.hover_thrust_n();
        Self {
            telemetry: Telemetry::new(settings.telemetry),
            supervisor,
            guidance: Guidance::new(settings.guidance, hover_thrust_n, trajectory),
            guard: Guard::new(settings.limits, airframe.thrust_full_n, now),
            stall_told: None,
            settings,
            policy,
            airframe,
            controller: controller.into(),
            standing_checks,
            failed_checks: Vec::new(),
            link_loss: None,
            round_trip: None,
            tracking_error: 0.0,
            jumped: false,
            unheard: None,
            slide_told: None,
            paused_s: 0.0,
        }
    }

    /// Takes a message of the vehicle. Where it fires a control tick, that comes back, with the
    /// setpoint to send if one may be sent; [`sent`](Self::sent) is to be told what became of it.
    pub fn handle(&mut self, received: &Received) -> Option<Tick> {
        let now = received.host;
        let sample = self.take(received);
        if sample.is_none() && !concerns_supervisor(&received.message) {
            return None;
        }
        self.observe(now);
        let sample = sample?;

        let phase = self.supervisor.state();
        let (airborne, lifting_n) = (self.airborne(), self.controller.lifting_n());
        let moving = Sample { state: self.controller.moving(&sample.state), ..sample };
        let guided = self.guidance.guide(phase, &moving, airborne, lifting_n);
        let mut reference = guided.reference;
        if guided.feedback {
            reference.feedforward.thrust_n *= self.voltage_gain();
        }
        if !(phase.is_flying() && guided.feedback) {
            self.controller.reset();
        } else if guided.aloft && !self.may_be_unheard(now) {
            let thrust_gain = self.voltage_gain();
            // The same before the trajectory as along it, or what was learned on the way there would
            // count twice.
            let at_rest = || self.guidance.expected_at_rest(self.airframe.hover.mass_kg);
            let expected = guided.expected.unwrap_or_else(at_rest);
            let is_led = guided.expected.is_some();
            self.controller.observe(sample.vehicle, &sample.state, &expected, is_led, thrust_gain);
        } else {
            self.controller.pause();
        }
        let yaw = sample.state.attitude.yaw();
        let command = if guided.feedback {
            let time_s = sample.vehicle.as_us() as f64 * 1e-6;
            self.controller.command(time_s, &sample.state, &reference)
        } else {
            self.controller.open_loop(&reference, yaw)
        };
        let proposal = Proposal { setpoint: command.setpoint, sample: answered(&sample) };
        let proposed = self.guard.propose(now, &proposal, self.order(now));
        if proposed == Err(Withheld::Stalled) {
            self.tell_stall(now);
        }
        let sent = proposed.ok();
        self.controller.sent(sent.map(|(setpoint, _)| setpoint));
        self.controller.limited(sent.is_some_and(|(_, met)| met.thrust || met.tilt));
        self.tell_adaptation(now, guided.trajectory_time);

        self.tracking_error = (sample.state.position - guided.desired).norm();
        if let Some((trigger, why)) = guided.reached {
            self.supervisor.fire(now, trigger, why);
        }
        Some(Tick {
            host: now,
            vehicle: sample.vehicle,
            state: sample.state,
            reference,
            desired: guided.desired,
            feedforward: reference.feedforward,
            feedback: command.feedback,
            setpoint: sent.map(|(setpoint, _)| setpoint),
            saturation: sent.map_or_else(Saturation::default, |(_, met)| Saturation {
                position_error: command.is_cut,
                ..met
            }),
            phase,
            trajectory_time: guided.trajectory_time,
            tracking_error: self.tracking_error,
            sample_age: sample.excess_delay_s,
        })
    }

    /// The answer to the newest tick, if it may leave by all that was heard since.
    pub fn clear(&mut self, now: HostTime) -> Option<Cleared> {
        let order = self.order(now);
        self.guard.clear(now, order).ok()
    }

    fn order(&self, now: HostTime) -> Order {
        let status = self.telemetry.status();
        Order { stance: self.supervisor.stance(now), obeys: self.supervisor.obeys(now, status) }
    }

    /// Says what adaptation found, and when that began.
    fn tell_adaptation(&mut self, now: HostTime, trajectory_time: Option<f64>) {
        let Some(notice) = self.controller.take_notice() else { return };
        let (severity, when) = match (notice, trajectory_time) {
            (AdaptationNotice::SwitchedOff(_), _) => (Severity::Warning, String::new()),
            (AdaptationNotice::Changed(change), Some(time_s)) => {
                let began_s = time_s - change.began_s_ago;
                (Severity::Info, format!(", at {began_s:.1} s of the trajectory"))
            }
            (AdaptationNotice::Changed(_), None) => (Severity::Info, String::new()),
        };
        self.supervisor.tell(now, severity, format!("{notice}{when}"));
    }

    /// Says, every two seconds at most, that what lay unread while this process stood still is not
    /// answered.
    fn tell_stall(&mut self, now: HostTime) {
        if self.stall_told.is_some_and(|told| now.since(told) < STALL_TOLD) {
            return;
        }
        self.stall_told = Some(now);
        let text = format!(
            "this process stood still for {:.3} s: what lay unread is not answered",
            self.guard.stalled().as_secs_f64()
        );
        self.supervisor.tell(now, Severity::Warning, text);
    }

    /// What became of the newest tick: whether its setpoint left. OFFBOARD is asked for, and taken
    /// for the pilot's word, only while they do.
    pub fn sent(&mut self, is_sent: bool) {
        self.supervisor.sent(is_sent);
        if !is_sent {
            self.controller.sent(None);
        }
    }

    /// Takes a message that lay unread while this process was paused: what it tells is kept, and a
    /// change of the mode ends control; nothing else is decided, and no setpoint answers it.
    /// [`Pilot::resumed`] follows the last of them.
    pub fn catch_up(&mut self, received: &Received) {
        self.guard.turn(received.host);
        self.take(received);
        self.supervisor.heed_mode(received.host, self.telemetry.status());
    }

    /// This process runs again after a pause of `paused_s` seconds, and has read what lay unread.
    /// More may have come than the system kept, so that the mode is not known until it is told
    /// again. For the safety reactions the state was missing for that long.
    pub fn resumed(&mut self, now: HostTime, paused_s: f64) {
        self.telemetry.doubt_mode();
        self.paused_s = paused_s;
        self.observe(now);
    }

    /// The line runs: at every turn of it, before what was heard is taken.
    pub fn turn(&mut self, now: HostTime) {
        self.guard.turn(now);
    }

    /// Looks at the clock in silence: time-outs and stale telemetry. Never makes a setpoint.
    pub fn poll(&mut self, now: HostTime) {
        self.guard.turn(now);
        self.observe(now);
    }

    /// Takes what the link tells.
    pub fn link_event(&mut self, now: HostTime, event: LinkEvent) {
        match event {
            LinkEvent::Lost => self.lose_link(now, "the link is lost"),
            LinkEvent::Replaced => self.lose_link(now, "another vehicle answers on the link"),
            LinkEvent::Refused { action, text } => self.supervisor.refused(now, action, &text),
            LinkEvent::Quality { loss } => self.link_loss = Some(loss),
            LinkEvent::RoundTrip(time) => self.round_trip = Some((now, time)),
        }
    }

    /// Asks for a flight, or for another after the last is over.
    pub fn engage(&mut self, now: HostTime) {
        self.supervisor.engage(now);
    }

    /// Replaces the preflight checks that are known to fail from outside, such as a parameter of
    /// the vehicle that its autopilot's profile has a rule for.
    pub fn set_standing_checks(&mut self, failed: Vec<PreflightCheck>) {
        self.standing_checks = failed;
    }

    /// Ends the flight: the vehicle is asked to land itself.
    pub fn land(&mut self, now: HostTime) {
        self.supervisor.fire(now, Trigger::LandNow, "landing is asked for");
    }

    /// Where the flight stands.
    pub fn flight_state(&self) -> FlightState {
        self.supervisor.state()
    }

    /// The preflight checks that failed at the last look, before the stream.
    pub fn failed_checks(&self) -> &[PreflightCheck] {
        &self.failed_checks
    }

    /// Who ended control by a change of the mode, once that is known.
    pub fn takeover(&self) -> Option<&Takeover> {
        self.supervisor.takeover()
    }

    /// State, rates and slow messages of the vehicle.
    pub fn telemetry(&self) -> &Telemetry {
        &self.telemetry
    }

    /// Requests to the vehicle since the last call.
    pub fn take_actions(&mut self) -> Vec<Action> {
        self.supervisor.take_actions()
    }

    /// Events since the last call.
    pub fn take_events(&mut self) -> Vec<Event> {
        self.supervisor.take_events()
    }

    fn take(&mut self, received: &Received) -> Option<Sample> {
        match self.telemetry.update(received) {
            Ok(sample) => sample,
            Err(fault @ (TelemetryFault::Reboot { .. } | TelemetryFault::ClockJump { .. })) => {
                self.lose_link(received.host, &fault.to_string());
                None
            }
            Err(fault) if fault.is_jump() => {
                self.jumped = true;
                self.controller.jumped();
                if !self.is_slide_told(received.host, &fault) {
                    self.supervisor.tell(received.host, Severity::Warning, fault.to_string());
                }
                None
            }
            Err(_) => None,
        }
    }

    /// A slide is found again and again while it goes on, and told once a second.
    fn is_slide_told(&mut self, now: HostTime, fault: &TelemetryFault) -> bool {
        if !matches!(fault, TelemetryFault::PositionSlide { .. }) {
            return false;
        }
        let is_told = self.slide_told.is_some_and(|told| now.since(told) < SLIDE_TOLD);
        if !is_told {
            self.slide_told = Some(now);
        }
        is_told
    }

    fn lose_link(&mut self, now: HostTime, why: &str) {
        self.supervisor.fire(now, Trigger::LinkLost, why);
        self.forget();
    }

    fn forget(&mut self) {
        self.telemetry.forget();
        self.guard.forget();
        (self.round_trip, self.unheard) = (None, None);
    }
}

/// What the guard gets of a sample.
fn answered(sample: &Sample) -> Answered {
    Answered {
        host: sample.host,
        vehicle: sample.vehicle,
        excess_delay_s: sample.excess_delay_s,
        yaw: sample.state.attitude.yaw(),
    }
}

/// An event reports a slide of the estimate at most this often.
const SLIDE_TOLD: Duration = Duration::from_secs(1);

/// An event reports a stall of this process at most this often.
const STALL_TOLD: Duration = Duration::from_secs(2);

/// Messages that the supervisor must see at once; the rest waits for the next tick or poll.
fn concerns_supervisor(message: &Inbound) -> bool {
    matches!(
        message,
        Inbound::Heartbeat { .. }
            | Inbound::CurrentMode { .. }
            | Inbound::DoubtfulMode
            | Inbound::LandedState(_)
            | Inbound::Battery(_)
    )
}
