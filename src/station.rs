//! The ground station, sans I/O: a session with one vehicle, the offboard controller that flies it, and what the
//! flight's log is told. A driver moves the bytes and the clock.

mod aftermath;
mod attitude_loop;
mod ending;
mod events;
mod feedback;
mod identification;
mod records;
mod requests;
mod settings;
mod status;
mod transmission;
mod waiting;

use std::time::Duration;

use message::Inbound;
use wire::transport::Peer;

use self::aftermath::Aftermath;
pub use self::ending::End;
use self::records::{LinkMeter, record_of};
use self::requests::request_of;
pub use self::settings::StationSettings;
pub use self::status::Status;
use self::waiting::Waiting;
use crate::clock::HostTime;
use crate::link::counters::LinkState;
use crate::link::profile::Profile;
use crate::link::received::Received;
use crate::link::session::{Heard, Session, SetpointError};
use crate::log::record::{Direction, FrameRecord, Record, Severity, Source};
use crate::offboard::{Adjustment, LinkEvent, OffboardController, Tick};
use crate::supervisor::FlightState;

/// A process whose control line runs again after longer than this was paused: by a signal, a swap, a
/// suspended machine. What lies unread is then older than it looks, and goes to
/// [`Station::catch_up`].
pub const PAUSE: Duration = Duration::from_millis(300);

/// Period of the link's counters in the log.
const STATS_PERIOD: Duration = Duration::from_secs(1);

/// A session, an offboard controller, and the records of both.
pub struct Station {
    settings: StationSettings,
    session: Session,
    /// There is none before the vehicle is identified, whose profile decides the design, and none
    /// for a vehicle that is not flown.
    offboard: Option<OffboardController>,
    profile: Option<Profile>,
    records: Vec<Record>,
    ticks: Vec<Tick>,
    started: HostTime,
    stats_due: HostTime,
    meter: LinkMeter,
    setpoints: u64,
    setpoint_error: Option<SetpointError>,
    tracking_error_m: f64,
    trajectory_time: Option<f64>,
    in_flight: bool,
    /// Whether the flight at hand, or the last, left the ground.
    flown: bool,
    /// The state in which that flight was over.
    over_in: Option<FlightState>,
    /// Since that flight ended early, until the vehicle is down.
    aftermath: Option<Aftermath>,
    /// Since that flight began another vehicle has taken the place of the one that flew it.
    is_replaced: bool,
    /// Why the flight was led another way than planned.
    last_trouble: Option<String>,
    /// The flight's state after the last event.
    event_state: FlightState,
    /// What was told of the vehicle's reaction to the loss of this program.
    told_loss: Option<String>,
    /// When the vehicle was found, until an event reports its rates.
    found: Option<HostTime>,
    /// Only the checks before a flight are made: nothing is sent to fly it.
    is_check: bool,
    waiting: Waiting,
    is_version_known: bool,
    is_signing_told: bool,
    /// Whether the vehicle answered a TIMESYNC since it was found.
    is_answered: bool,
    /// No other flight begins: the station ends as soon as it does not fly.
    is_stopping: bool,
    end: Option<End>,
}

impl Station {
    /// A station that has heard nothing yet.
    pub fn new(settings: StationSettings, now: HostTime) -> Self {
        Self {
            session: Session::new(settings.session.clone(), now),
            settings,
            offboard: None,
            profile: None,
            records: Vec::new(),
            ticks: Vec::new(),
            started: now,
            stats_due: now + STATS_PERIOD,
            meter: LinkMeter::new(now),
            setpoints: 0,
            setpoint_error: None,
            tracking_error_m: 0.0,
            trajectory_time: None,
            in_flight: false,
            flown: false,
            over_in: None,
            aftermath: None,
            is_replaced: false,
            last_trouble: None,
            event_state: FlightState::Connect,
            told_loss: None,
            found: None,
            is_check: false,
            waiting: Waiting::new(now),
            is_version_known: false,
            is_signing_told: false,
            is_answered: false,
            is_stopping: false,
            end: None,
        }
    }

    /// The same, which makes the checks before a flight and ends.
    pub fn checking(self) -> Self {
        Self { is_check: true, ..self }
    }

    /// Takes bytes that arrived. The line: each message to the controller, and the setpoint that it
    /// answers with, if any, to the vehicle. What else follows waits for
    /// [`Station::transmit`], which sends the setpoint first.
    pub fn receive(&mut self, now: HostTime, peer: Peer, bytes: &[u8], is_datagram: bool) {
        let first_tick = self.ticks.len();
        self.hear(now, peer, bytes, is_datagram, OffboardController::handle);
        self.answer(now, first_tick);
    }

    /// Takes bytes that lay unread while this process was paused: nothing answers them.
    /// [`Station::resumed`] follows the last of them.
    pub fn catch_up(&mut self, now: HostTime, peer: Peer, bytes: &[u8], is_datagram: bool) {
        self.hear(now, peer, bytes, is_datagram, |offboard, received| {
            offboard.catch_up(received);
            None
        });
    }

    /// This process runs again after a pause, and has read what lay unread.
    pub fn resumed(&mut self, now: HostTime, paused: Duration) {
        let paused_s = paused.as_secs_f64();
        let text = format!(
            "this process was paused for {paused_s:.2} s: nothing is commanded until the vehicle \
             tells its mode again"
        );
        self.tell(now, Severity::Warning, text);
        self.session.withdraw_commands();
        if let Some(offboard) = &mut self.offboard {
            offboard.resumed(now, paused_s);
        }
        self.follow_up(now);
    }

    /// Each message to the controller, by `take`, and to the log.
    fn hear(
        &mut self,
        now: HostTime,
        peer: Peer,
        bytes: &[u8],
        is_datagram: bool,
        mut take: impl FnMut(&mut OffboardController, &Received) -> Option<Tick>,
    ) {
        let Self { session, offboard, profile, records, ticks, .. } = self;
        let motors = profile.as_ref().map(|profile| profile.motor_outputs);
        let first = records.len();
        if let Some(offboard) = offboard {
            offboard.turn(now);
        }
        session.receive(now, peer, bytes, is_datagram, &mut |heard| match heard {
            Heard::Frame { bytes, .. } => {
                records
                    .extend(FrameRecord::from_bytes(Direction::Rx, now, bytes).map(Record::Frame));
            }
            // Before the controller takes the mode of that vehicle for a word of the one that it flies.
            Heard::Replaced => {
                if let Some(offboard) = offboard {
                    offboard.link_event(now, LinkEvent::Replaced);
                }
            }
            Heard::Message(received) => {
                if let Some(offboard) = offboard {
                    ticks.extend(take(offboard, &received));
                }
                if let Inbound::StatusText { severity, text } = &received.message {
                    show(Severity::from(*severity), &format!("vehicle: {text}"));
                }
                records.extend(record_of(&received, motors));
            }
        });
        for stamp in records[first..].iter_mut().filter_map(Record::stamp_mut) {
            let mapped = stamp.vehicle.and_then(|vehicle| session.to_host(vehicle));
            // The clocks' estimate has an error; a sample is never newer than its arrival.
            stamp.sampled = mapped.map_or(stamp.host, |sampled| sampled.min(stamp.host));
        }
    }

    /// The setpoint that answers the samples since `first_tick`, on its way where it may leave.
    fn answer(&mut self, now: HostTime, first_tick: usize) {
        // Of several samples in one read only the newest is acted upon.
        let is_proposed = self.ticks[first_tick..].last().is_some_and(|it| it.setpoint.is_some());
        let cleared = if is_proposed { self.cleared(now) } else { None };
        let is_sent = cleared.is_some_and(|setpoint| self.send_setpoint(now, &setpoint));
        // The log has what was sent; what of this does not leave is withheld then.
        let withheld = self.ticks.len() - usize::from(is_sent);
        self.ticks[first_tick..withheld].iter_mut().for_each(Tick::withhold);
        if let Some(offboard) = &mut self.offboard
            && !is_sent
            && first_tick < self.ticks.len()
        {
            offboard.sent(false);
        }
    }

    /// Where the vehicle is heard.
    pub fn vehicle_peer(&self) -> Option<Peer> {
        self.session.vehicle_peer()
    }

    /// Passes a frame of another ground station on to the vehicle.
    pub fn pass_on(&mut self, frame: &[u8]) {
        self.session.pass_on(frame);
    }

    /// Takes what a viewer asks to be changed. Never makes a setpoint; an event says what became of it.
    pub fn adjust(&mut self, now: HostTime, asked: &Adjustment) {
        match &mut self.offboard {
            Some(offboard) => offboard.adjust(now, asked),
            None => {
                let text = "a viewer's change is refused: no vehicle is flown yet";
                self.tell(now, Severity::Warning, text.to_owned());
            }
        }
        self.follow_pilot(now);
    }

    /// Does what is due by the clock. Never makes a setpoint.
    pub fn poll(&mut self, now: HostTime) {
        self.session.poll(now);
        if let Some(offboard) = &mut self.offboard {
            offboard.poll(now);
            if !offboard.telemetry().status().is_heard(now) {
                // The pilot may have taken over meanwhile: what was commanded is not repeated.
                self.session.withdraw_commands();
            }
        }
        self.follow_up(now);
        self.tell_wait(now);
        if self.stats_due <= now {
            self.stats_due = now + STATS_PERIOD;
            self.record_stats(now);
        }
        let silent = matches!(self.session.state(), LinkState::Searching | LinkState::Lost);
        let heard = self.session.last_heard().unwrap_or(self.started);
        if let Some(limit) = self.settings.search_timeout_s
            && silent
            && now.since(heard).as_secs_f64() > limit
        {
            self.end.get_or_insert_with(|| match self.session.vehicle() {
                None => End::NoVehicle,
                Some(id) => End::LinkLost(format!("nothing more was heard of {id}")),
            });
        }
    }

    /// When [`Station::poll`] has something to do next, at most 20 ms away: safety reactions to
    /// silence are not late by more than that.
    pub fn next_deadline(&self, now: HostTime) -> HostTime {
        let tick = now + Duration::from_millis(20);
        self.session.next_deadline().min(self.stats_due).clamp(now, tick)
    }

    /// Gives what the log is to be told since the last call.
    pub fn take_records(&mut self, log: impl FnMut(Record)) {
        self.records.drain(..).for_each(log);
    }

    /// The endpoint is open (again).
    pub fn opened(&mut self, now: HostTime) {
        self.meter.opened();
        self.tell(now, Severity::Info, "link open".to_owned());
    }

    /// The endpoint is gone, for the reason given.
    pub fn closed(&mut self, now: HostTime, why: &str) {
        self.session.transport_closed();
        self.tell(now, Severity::Warning, format!("link closed: {why}"));
        if let Some(offboard) = &mut self.offboard {
            offboard.link_event(now, LinkEvent::Lost);
        }
        self.follow_up(now);
    }

    /// A peer of the endpoint is gone.
    pub fn peer_closed(&mut self, now: HostTime, peer: Peer) {
        // Strangers come and go.
        if self.session.peer_closed(peer) {
            let text = "the vehicle's connection closed; waiting for it to connect again";
            self.tell(now, Severity::Warning, text.to_owned());
        }
    }

    /// Ends the flight: in the air the vehicle is asked to land, on the ground nothing begins.
    /// After a flight that ended early it ends what is still recorded.
    pub fn land(&mut self, now: HostTime) {
        self.is_stopping = true;
        self.end_aftermath();
        let Some(offboard) = &mut self.offboard else {
            self.end.get_or_insert(End::Stopped);
            return;
        };
        let state = offboard.flight_state();
        if state.is_flying() {
            offboard.land(now);
        }
        // What became of an earlier flight is no news: but one that has not been left yet, because
        // the link is silent since, is not over for whoever stops now.
        if !self.in_flight && state != FlightState::Abort {
            self.over_in = None;
        }
        self.follow_up(now);
    }

    /// How it ended, once it has.
    pub fn end(&self) -> Option<&End> {
        self.end.as_ref()
    }

    /// Whether it has ended and nothing more is to be recorded: a vehicle whose flight ended early
    /// is watched until it is down, for at most ten seconds.
    pub fn is_over(&self) -> bool {
        self.end.is_some() && self.aftermath.is_none()
    }

    /// After the controller has acted: the session's news to the controller, its requests to the
    /// vehicle.
    fn follow_up(&mut self, now: HostTime) {
        while let Some(event) = self.session.next_event() {
            self.session_event(now, event);
        }
        self.follow_pilot(now);
    }

    /// The controller's requests to the vehicle, its events to the log, and what they make of the
    /// flight.
    fn follow_pilot(&mut self, now: HostTime) {
        let Some(offboard) = &mut self.offboard else { return };
        let (actions, events) = (offboard.take_actions(), offboard.take_events());
        let state = offboard.flight_state();
        for action in actions.into_iter().filter(|_| !self.is_check) {
            self.session.request(now, request_of(action));
        }
        for event in events {
            let severity = match event.severity {
                crate::supervisor::Severity::Info => Severity::Info,
                crate::supervisor::Severity::Warning => Severity::Warning,
                crate::supervisor::Severity::Error => Severity::Error,
            };
            // What changed nothing, such as a refusal before the vehicle agreed, is forgiven.
            if severity <= Severity::Warning && event.state != self.event_state {
                self.last_trouble = Some(event.text.clone());
            }
            self.event_state = event.state;
            if event.state.is_over() {
                self.over_in = Some(event.state);
            }
            if matches!(event.state, FlightState::Abort | FlightState::PilotControl) {
                // What was asked for is not repeated to a vehicle that others lead now.
                self.session.withdraw_commands();
            }
            self.tell(now, severity, format!("{}: {}", event.state.name(), event.text));
        }
        self.watch(now, state);
    }

    /// Marks the flight's beginning and end in the log.
    fn mark_flight(&mut self, now: HostTime, state: FlightState) {
        let was_in_flight = self.in_flight;
        self.in_flight = state.is_in_control() || state == FlightState::Land;
        if self.in_flight && !was_in_flight {
            self.end_aftermath();
            (self.flown, self.over_in) = (false, None);
            self.is_replaced = false;
            self.records.push(Record::FlightBegins(now));
        } else if was_in_flight && !self.in_flight {
            let is_early =
                matches!(self.over_in, Some(FlightState::Abort | FlightState::PilotControl));
            if !(is_early && self.flown) || self.is_replaced {
                return self.records.push(Record::FlightEnds);
            }
            self.aftermath = Some(Aftermath::new(now));
            let limit_s = aftermath::LIMIT.as_secs();
            let text =
                format!("recording goes on until the vehicle is down, for at most {limit_s} s");
            self.tell(now, Severity::Notice, text);
        } else if let (Some(aftermath), Some(offboard)) = (&mut self.aftermath, &self.offboard)
            && aftermath.is_over(now, offboard.telemetry().status())
        {
            self.end_aftermath();
        }
    }

    fn end_aftermath(&mut self) {
        if self.aftermath.take().is_some() {
            self.records.push(Record::FlightEnds);
        }
    }

    fn tell(&mut self, now: HostTime, severity: Severity, text: String) {
        show(severity, &text);
        self.records.push(Record::Event { host: now, severity, source: Source::Daemon, text });
    }

    fn record_stats(&mut self, now: HostTime) {
        let counted = self.session.stats();
        if let (Some(loss), Some(offboard)) = (self.meter.loss(&counted), &mut self.offboard) {
            offboard.link_event(now, LinkEvent::Quality { loss });
        }
        let stats = self.meter.read(now, &counted);
        // The first period has what came before the intervals were asked for.
        if self.found.is_some_and(|found| now.since(found) >= 2 * STATS_PERIOD) {
            self.found = None;
            let text = format!(
                "receiving attitude at {:.0} Hz, position at {:.0} Hz, odometry at {:.0} Hz",
                stats.attitude_hz, stats.position_hz, stats.odometry_hz
            );
            self.tell(now, Severity::Info, text);
        }
        self.records.push(Record::Link { host: now, stats });
    }
}

/// Shows a message to whoever watches.
fn show(severity: Severity, text: &str) {
    match severity {
        Severity::Debug => tracing::debug!("{text}"),
        Severity::Info | Severity::Notice => tracing::info!("{text}"),
        Severity::Warning => tracing::warn!("{text}"),
        _ => tracing::error!("{text}"),
    }
}
