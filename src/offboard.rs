//! The control path from a message to a setpoint: state -> reference -> feedback -> supervisor ->
//! guard. It does no I/O and reads no clock: messages bring the time, and the caller sends the
//! requests and setpoints.

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
use self::guidance::{Guidance, LiftOff};
pub use self::guidance::{GuidanceSettings, TRAJECTORY_DONE};
pub use self::tick::Tick;

use crate::clock::HostTime;
use crate::control::{
    AdaptationEvent, Controller, HoverVehicle, Limits, OffsetFreeSettings, Saturation,
};
use crate::guard::{Answered, Cleared, Guard, Order, Proposal, Withheld};
use crate::link::received::Received;
use crate::plan::reference::ReferenceSource;
use crate::supervisor::{
    Action, EngagePolicy, Event, FlightState, ModeMap, PreflightCheck, PreflightSettings,
    SafetySettings, Severity, Supervisor, SupervisorSettings, Takeover, Trigger,
};
use crate::telemetry::{Sample, Telemetry, TelemetryFault, TelemetrySettings};

/// The settings of each part of the control path.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OffboardSettings {
    /// Control ticks and the acceptance of telemetry.
    pub telemetry: TelemetrySettings,
    /// Time limits of the flight states.
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

/// What the controller must know about the vehicle.
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

/// What the link reports besides the vehicle's messages.
#[derive(Clone, Debug, PartialEq)]
pub enum LinkEvent {
    /// The connection broke.
    Lost,
    /// A different vehicle answers on the connection.
    Replaced,
    /// The vehicle refused a request.
    Refused {
        /// The refused request.
        action: Action,
        /// Result and reason, for people.
        text: String,
    },
    /// The share of the vehicle's frames that the link lost recently.
    Quality {
        /// 0..1
        loss: f64,
    },
    /// The vehicle answered a TIMESYNC request after this round trip.
    RoundTrip(Duration),
    /// The vehicle answered a request again this long after its first answer.
    RequestAgain(Duration),
}

/// Flies one vehicle along one trajectory, or waits in a hold until a flight is requested.
pub struct OffboardController {
    settings: OffboardSettings,
    policy: EngagePolicy,
    airframe: Airframe,
    controller: Controller,
    telemetry: Telemetry,
    supervisor: Supervisor,
    guidance: Guidance,
    guard: Guard,
    /// When the last event reported a stall of this process.
    stall_reported_at: Option<HostTime>,
    standing_checks: Vec<PreflightCheck>,
    /// The checks that failed when last run, before the stream.
    failed_checks: Vec<PreflightCheck>,
    link_loss: Option<f64>,
    /// The newest answer: its arrival and its round trip.
    round_trip: Option<(HostTime, Duration)>,
    /// The newest second answer to one request: its arrival and its delay.
    again: Option<(HostTime, Duration)>,
    tracking_error: f64,
    jumped: bool,
    /// The last time at which setpoints may not have reached the vehicle.
    unreachable_at: Option<HostTime>,
    /// When the last event reported a slide of the estimate.
    slide_reported_at: Option<HostTime>,
    /// How long this process was paused before the next observation, s.
    paused_s: f64,
}

impl OffboardController {
    /// Creates a controller at `now`, before the first message. `standing_checks` are preflight
    /// checks that have already failed, such as a trajectory outside the flight envelope.
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
        Self {
            telemetry: Telemetry::new(settings.telemetry),
            supervisor,
            guidance: Guidance::new(settings.guidance, airframe.hover, trajectory),
            guard: Guard::new(settings.limits, airframe.thrust_full_n, now),
            stall_reported_at: None,
            settings,
            policy,
            airframe,
            controller: controller.into(),
            standing_checks,
            failed_checks: Vec::new(),
            link_loss: None,
            round_trip: None,
            again: None,
            tracking_error: 0.0,
            jumped: false,
            unreachable_at: None,
            slide_reported_at: None,
            paused_s: 0.0,
        }
    }

    /// Takes a message from the vehicle. If the message fires a control tick, returns the tick,
    /// with the setpoint to send where one may be sent. The caller reports what became of it to
    /// [`sent`](Self::sent).
    pub fn handle(&mut self, received: &Received) -> Option<Tick> {
        let now = received.host;
        let sample = self.take(received);
        if sample.is_none() && !concerns_supervisor(&received.message) {
            return None;
        }
        self.observe(now);
        let sample = sample?;

        let phase = self.supervisor.state();
        let lift_off = LiftOff {
            airborne: self.airborne(),
            thrust_n: self.controller.lifting_n(),
            waits: self.answers_late(now),
        };
        let moving = Sample { state: self.controller.moving(&sample.state), ..sample };
        let guided = self.guidance.guide(phase, &moving, lift_off);
        let mut reference = guided.reference;
        if guided.feedback {
            reference.feedforward.thrust_n *= self.voltage_gain();
        }
        if !(phase.is_flying() && guided.feedback) {
            self.controller.reset();
        } else if guided.aloft && !self.may_be_unreachable(now) {
            let thrust_gain = self.voltage_gain();
            // The expectation before the trajectory must match the one along it. Otherwise what was
            // learned on the way there would count twice.
            let expected = guided.expected.unwrap_or_else(|| self.guidance.expected_at_rest());
            let Sample { vehicle, state, .. } = &sample;
            self.controller.observe(*vehicle, state, &expected, guided.is_led, thrust_gain);
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
            self.report_stall(now);
        }
        let sent = proposed.ok();
        self.controller.sent(sent.map(|(setpoint, _)| setpoint));
        self.controller.limited(sent.is_some_and(|(_, met)| met.thrust || met.tilt));
        self.report_adaptation(now, guided.trajectory_time);

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
            tube_radius_m: guided.tube_radius_m,
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

    /// The setpoint of the newest tick, if everything received since still allows it to leave.
    pub fn clear(&mut self, now: HostTime) -> Option<Cleared> {
        let order = self.order(now);
        self.guard.clear(now, order).ok()
    }

    fn order(&self, now: HostTime) -> Order {
        let status = self.telemetry.status();
        Order { stance: self.supervisor.stance(now), obeys: self.supervisor.obeys(now, status) }
    }

    /// Reports what adaptation found, and when it began.
    fn report_adaptation(&mut self, now: HostTime, trajectory_time: Option<f64>) {
        let Some(event) = self.controller.take_event() else { return };
        let (severity, when) = match (event, trajectory_time) {
            (AdaptationEvent::SwitchedOff(_), _) => (Severity::Warning, String::new()),
            (AdaptationEvent::Changed(change), Some(time_s)) => {
                let began_s = time_s - change.began_s_ago;
                (Severity::Info, format!(", at {began_s:.1} s of the trajectory"))
            }
            (AdaptationEvent::Changed(_), None) => (Severity::Info, String::new()),
        };
        self.supervisor.report(now, severity, format!("{event}{when}"));
    }

    /// Reports, at most every two seconds, that messages left unread during a stall of this process
    /// get no answer.
    fn report_stall(&mut self, now: HostTime) {
        if self.stall_reported_at.is_some_and(|at| now.since(at) < STALL_REPORT_PERIOD) {
            return;
        }
        self.stall_reported_at = Some(now);
        let text = format!(
            "this process stalled for {:.3} s: messages that arrived meanwhile get no answer",
            self.guard.stalled().as_secs_f64()
        );
        self.supervisor.report(now, Severity::Warning, text);
    }

    /// Records whether the setpoint of the newest tick left. The supervisor requests OFFBOARD, and
    /// takes it for the pilot's decision, only while setpoints leave.
    pub fn sent(&mut self, is_sent: bool) {
        self.supervisor.sent(is_sent);
        if !is_sent {
            self.controller.sent(None);
        }
    }

    /// Takes a message that was left unread while this process was paused. Telemetry keeps its
    /// content, and a mode change ends control. Nothing else is decided, and no setpoint answers
    /// it. Call [`resumed`](Self::resumed) after the last such message.
    pub fn catch_up(&mut self, received: &Received) {
        self.guard.turn(received.host);
        self.take(received);
        self.supervisor.check_mode(received.host, self.telemetry.status());
    }

    /// Resumes after a pause of `paused_s` seconds, once the unread messages have been read. More
    /// may have arrived than the system buffered, so the mode is unknown until the vehicle reports
    /// it again. The safety reactions treat the state as missing for that long.
    pub fn resumed(&mut self, now: HostTime, paused_s: f64) {
        self.telemetry.doubt_mode();
        self.paused_s = paused_s;
        self.observe(now);
    }

    /// Notes that the control path runs. Call it on every turn, before handling received messages.
    pub fn turn(&mut self, now: HostTime) {
        self.guard.turn(now);
    }

    /// Checks the clock in silence, for time-outs and stale telemetry. Never makes a setpoint.
    pub fn poll(&mut self, now: HostTime) {
        self.guard.turn(now);
        self.observe(now);
    }

    /// Takes an event of the link.
    pub fn link_event(&mut self, now: HostTime, event: LinkEvent) {
        match event {
            LinkEvent::Lost => self.lose_link(now, "the link is lost"),
            LinkEvent::Replaced => self.lose_link(now, "another vehicle answers on the link"),
            LinkEvent::Refused { action, text } => self.supervisor.refused(now, action, &text),
            LinkEvent::Quality { loss } => self.link_loss = Some(loss),
            LinkEvent::RoundTrip(time) => self.round_trip = Some((now, time)),
            LinkEvent::RequestAgain(after) => self.again = Some((now, after)),
        }
    }

    /// Requests a flight, or another one after the last is over.
    pub fn engage(&mut self, now: HostTime) {
        self.supervisor.engage(now);
    }

    /// Replaces the preflight checks that fail for reasons outside this controller, such as a
    /// vehicle parameter that breaks a rule of its autopilot's profile.
    pub fn set_standing_checks(&mut self, failed: Vec<PreflightCheck>) {
        self.standing_checks = failed;
    }

    /// Ends the flight: requests that the vehicle land itself.
    pub fn land(&mut self, now: HostTime) {
        self.supervisor.fire(now, Trigger::LandNow, "a landing is requested");
    }

    /// The present state of the flight.
    pub fn flight_state(&self) -> FlightState {
        self.supervisor.state()
    }

    /// The preflight checks that failed when last run, before the stream.
    pub fn failed_checks(&self) -> &[PreflightCheck] {
        &self.failed_checks
    }

    /// The cause of the mode change that ended control, once it is known.
    pub fn takeover(&self) -> Option<&Takeover> {
        self.supervisor.takeover()
    }

    /// The vehicle's state, message rates and slow messages.
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
                if !self.is_slide_reported(received.host, &fault) {
                    self.supervisor.report(received.host, Severity::Warning, fault.to_string());
                }
                None
            }
            Err(_) => None,
        }
    }

    /// Whether an event has reported this slide within the last second: a slide is found again at
    /// each sample while it lasts.
    fn is_slide_reported(&mut self, now: HostTime, fault: &TelemetryFault) -> bool {
        if !matches!(fault, TelemetryFault::PositionSlide { .. }) {
            return false;
        }
        let is_reported =
            self.slide_reported_at.is_some_and(|at| now.since(at) < SLIDE_REPORT_PERIOD);
        if !is_reported {
            self.slide_reported_at = Some(now);
        }
        is_reported
    }

    fn lose_link(&mut self, now: HostTime, why: &str) {
        self.supervisor.fire(now, Trigger::LinkLost, why);
        self.forget();
    }

    fn forget(&mut self) {
        self.telemetry.forget();
        self.guard.forget();
        (self.round_trip, self.again, self.unreachable_at) = (None, None, None);
    }
}

/// The part of a sample that the guard checks.
fn answered(sample: &Sample) -> Answered {
    Answered {
        host: sample.host,
        vehicle: sample.vehicle,
        excess_delay_s: sample.excess_delay_s,
        yaw: sample.state.attitude.yaw(),
    }
}

/// Shortest time between events that report a slide of the estimate.
const SLIDE_REPORT_PERIOD: Duration = Duration::from_secs(1);

/// Shortest time between events that report a stall of this process.
const STALL_REPORT_PERIOD: Duration = Duration::from_secs(2);

/// Messages that the supervisor must see at once. All others wait for the next tick or poll.
fn concerns_supervisor(message: &Inbound) -> bool {
    matches!(
        message,
        Inbound::Heartbeat { .. }
            | Inbound::CurrentMode { .. }
            | Inbound::DoubtfulMode
            | Inbound::DoubtfulArming
            | Inbound::LandedState(_)
            | Inbound::Battery(_)
    )
}
