//! The ground station, sans I/O: a session with one vehicle, the offboard controller that flies it,
//! and the records for the flight's log. A driver moves the bytes and supplies the time.

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
use crate::link::session::{Delivery, Session, SetpointError};
use crate::log::record::{Direction, FrameRecord, Record, Severity, Source};
use crate::offboard::{Adjustment, LinkEvent, OffboardController, Tick};
use crate::supervisor::FlightState;

/// Gap between two turns of the control path, beyond which this process counts as paused: by a
/// signal, a swap, a suspended machine. Unread bytes are then older than their arrival suggests,
/// and belong in [`Station::catch_up`].
pub const PAUSE: Duration = Duration::from_millis(300);

/// Period at which the log records the link's counters.
const STATS_PERIOD: Duration = Duration::from_secs(1);

/// A session, an offboard controller, and the records of both.
pub struct Station {
    settings: StationSettings,
    session: Session,
    /// `None` before the vehicle is identified, because its profile decides the design, and for a
    /// vehicle that is not flown.
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
    /// Whether the present flight, or the last one, left the ground.
    flown: bool,
    /// The state in which that flight ended.
    over_in: Option<FlightState>,
    /// Runs from that flight's early end until the vehicle is down.
    aftermath: Option<Aftermath>,
    /// Whether another vehicle has replaced the one that began that flight.
    is_replaced: bool,
    /// The newest reason for a departure from the planned flight.
    last_trouble: Option<String>,
    /// The flight state of the last event.
    event_state: FlightState,
    /// The last reported reaction of the vehicle to the loss of this program.
    reported_loss: Option<String>,
    /// When the vehicle was found, until an event reports its rates.
    found: Option<HostTime>,
    /// Whether to run only the checks before a flight; no setpoint is sent.
    is_check: bool,
    waiting: Waiting,
    /// Why the endpoint does not open, until it does.
    open_failure: Option<String>,
    is_version_known: bool,
    is_signing_reported: bool,
    /// Whether the vehicle has answered a TIMESYNC since it was found.
    is_answered: bool,
    /// Whether no other flight begins: the station ends as soon as it does not fly.
    is_stopping: bool,
    end: Option<End>,
}

impl Station {
    /// A station that has received nothing yet.
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
            reported_loss: None,
            found: None,
            is_check: false,
            waiting: Waiting::new(now),
            open_failure: None,
            is_version_known: false,
            is_signing_reported: false,
            is_answered: false,
            is_stopping: false,
            end: None,
        }
    }

    /// Makes this station run only the checks before a flight, and end after them.
    pub fn checking(self) -> Self {
        Self { is_check: true, ..self }
    }

    /// Takes bytes that arrived: passes each message to the controller, and queues the setpoint
    /// that answers it, if any. Everything else that follows waits for [`Station::transmit`], which
    /// sends the setpoint first.
    pub fn receive(&mut self, now: HostTime, peer: Peer, bytes: &[u8], is_datagram: bool) {
        let first_tick = self.ticks.len();
        self.receive_with(now, peer, bytes, is_datagram, OffboardController::handle);
        self.answer(now, first_tick);
    }

    /// Takes bytes that were left unread while this process was paused; no setpoint answers them.
    /// Call [`Station::resumed`] after the last of them.
    pub fn catch_up(&mut self, now: HostTime, peer: Peer, bytes: &[u8], is_datagram: bool) {
        self.receive_with(now, peer, bytes, is_datagram, |offboard, received| {
            offboard.catch_up(received);
            None
        });
    }

    /// Resumes after a pause of this process, once the unread bytes have been taken.
    pub fn resumed(&mut self, now: HostTime, paused: Duration) {
        let paused_s = paused.as_secs_f64();
        let text = format!(
            "this process was paused for {paused_s:.2} s: nothing is commanded until the vehicle \
             reports its mode again"
        );
        self.report(now, Severity::Warning, text);
        self.session.withdraw_commands();
        if let Some(offboard) = &mut self.offboard {
            offboard.resumed(now, paused_s);
        }
        self.follow_up(now);
    }

    /// Hands each message to the controller with `take`, and records it.
    fn receive_with(
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
        session.receive(now, peer, bytes, is_datagram, &mut |delivery| match delivery {
            Delivery::Frame { bytes, .. } => {
                records
                    .extend(FrameRecord::from_bytes(Direction::Rx, now, bytes).map(Record::Frame));
            }
            // First, so that the controller does not take that vehicle's mode for its own
            // vehicle's.
            Delivery::Replaced => {
                if let Some(offboard) = offboard {
                    offboard.link_event(now, LinkEvent::Replaced);
                }
            }
            Delivery::Message(received) => {
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
            // The estimated clock offset has an error; a sample is never newer than its arrival.
            stamp.sampled = mapped.map_or(stamp.host, |sampled| sampled.min(stamp.host));
        }
    }

    /// Queues the setpoint that answers the newest sample since `first_tick`, if it may leave.
    fn answer(&mut self, now: HostTime, first_tick: usize) {
        // Of several samples in one read only the newest gets an answer.
        let is_proposed = self.ticks[first_tick..].last().is_some_and(|it| it.setpoint.is_some());
        let cleared = if is_proposed { self.cleared(now) } else { None };
        let is_sent = cleared.is_some_and(|setpoint| self.send_setpoint(now, &setpoint));
        // The log holds only setpoints that were sent, so the ticks of all others are withheld
        // here.
        let withheld = self.ticks.len() - usize::from(is_sent);
        self.ticks[first_tick..withheld].iter_mut().for_each(Tick::withhold);
        if let Some(offboard) = &mut self.offboard
            && !is_sent
            && first_tick < self.ticks.len()
        {
            offboard.sent(false);
        }
    }

    /// The peer from which the vehicle's messages arrive.
    pub fn vehicle_peer(&self) -> Option<Peer> {
        self.session.vehicle_peer()
    }

    /// Forwards a frame from another ground station to the vehicle.
    pub fn forward(&mut self, frame: &[u8]) {
        self.session.forward(frame);
    }

    /// Takes the change that a viewer requests. Never makes a setpoint; an event reports the
    /// outcome.
    pub fn adjust(&mut self, now: HostTime, request: &Adjustment) {
        match &mut self.offboard {
            Some(offboard) => offboard.adjust(now, request),
            None => {
                let text = "a viewer's change is refused: no vehicle is flown yet";
                self.report(now, Severity::Warning, text.to_owned());
            }
        }
        self.follow_pilot(now);
    }

    /// Does what is due at `now`. Never makes a setpoint.
    pub fn poll(&mut self, now: HostTime) {
        self.session.poll(now);
        if let Some(offboard) = &mut self.offboard {
            offboard.poll(now);
            if !offboard.telemetry().status().is_live(now) {
                // The pilot may have taken over meanwhile, so commands are not repeated.
                self.session.withdraw_commands();
            }
        }
        self.follow_up(now);
        self.report_wait(now);
        if self.stats_due <= now {
            self.stats_due = now + STATS_PERIOD;
            self.record_stats(now);
        }
        let silent = matches!(self.session.state(), LinkState::Searching | LinkState::Lost);
        let last = self.session.last_received().unwrap_or(self.started);
        if let Some(limit) = self.settings.search_timeout_s
            && silent
            && now.since(last).as_secs_f64() > limit
        {
            self.end.get_or_insert_with(|| match self.session.vehicle() {
                None => End::NoVehicle,
                Some(id) => End::LinkLost(format!("nothing more was received from {id}")),
            });
        }
    }

    /// The next time at which [`Station::poll`] must run, at most 20 ms away. That bounds the delay
    /// of safety reactions to silence.
    pub fn next_deadline(&self, now: HostTime) -> HostTime {
        let tick = now + Duration::from_millis(20);
        self.session.next_deadline().min(self.stats_due).clamp(now, tick)
    }

    /// Passes the records since the last call to `log`.
    pub fn take_records(&mut self, log: impl FnMut(Record)) {
        self.records.drain(..).for_each(log);
    }

    /// Notes that the endpoint is open, for the first time or again.
    pub fn opened(&mut self, now: HostTime) {
        self.open_failure = None;
        self.meter.opened();
        self.report(now, Severity::Info, "link open".to_owned());
    }

    /// Notes why an attempt to open the endpoint failed. Reports each reason once.
    pub fn not_opened(&mut self, now: HostTime, why: String) {
        if self.open_failure.as_ref() != Some(&why) {
            self.report(now, Severity::Warning, format!("{why}; trying again until it opens"));
            self.open_failure = Some(why);
        }
    }

    /// Notes that the endpoint closed, and why.
    pub fn closed(&mut self, now: HostTime, why: &str) {
        self.session.transport_closed();
        self.report(now, Severity::Warning, format!("link closed: {why}"));
        if let Some(offboard) = &mut self.offboard {
            offboard.link_event(now, LinkEvent::Lost);
        }
        self.follow_up(now);
    }

    /// Notes that a peer of the endpoint closed.
    pub fn peer_closed(&mut self, now: HostTime, peer: Peer) {
        // Peers other than the vehicle come and go.
        if self.session.peer_closed(peer) {
            let text = "the vehicle's connection closed; waiting for it to connect again";
            self.report(now, Severity::Warning, text.to_owned());
        }
    }

    /// Ends the flight: requests a landing in the air; on the ground, nothing begins any more. Also
    /// ends the recording that follows a flight's early end.
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
        // The end of an earlier flight is not reported again. But a controller still in Abort,
        // because the link has been silent since, has not finished that flight.
        if !self.in_flight && state != FlightState::Abort {
            self.over_in = None;
        }
        self.follow_up(now);
    }

    /// How the station ended, once it has.
    pub fn end(&self) -> Option<&End> {
        self.end.as_ref()
    }

    /// Whether the station has ended and records nothing more. After a flight's early end it
    /// watches the vehicle until it is down, for at most ten seconds.
    pub fn is_over(&self) -> bool {
        self.end.is_some() && self.aftermath.is_none()
    }

    /// Follows up after the controller has acted: hands it the session's events, then handles its
    /// requests and events.
    fn follow_up(&mut self, now: HostTime) {
        while let Some(event) = self.session.next_event() {
            self.session_event(now, event);
        }
        self.follow_pilot(now);
    }

    /// Sends the controller's requests to the vehicle, records its events, and updates the flight's
    /// record.
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
            // A problem that changed no state, such as a refusal before the vehicle agreed, does
            // not count.
            if severity <= Severity::Warning && event.state != self.event_state {
                self.last_trouble = Some(event.text.clone());
            }
            self.event_state = event.state;
            if event.state.is_over() {
                self.over_in = Some(event.state);
            }
            if matches!(event.state, FlightState::Abort | FlightState::PilotControl) {
                // Requests are not repeated to a vehicle that someone else controls now.
                self.session.withdraw_commands();
            }
            self.report(now, severity, format!("{}: {}", event.state.name(), event.text));
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
                format!("recording continues until the vehicle is down, for at most {limit_s} s");
            self.report(now, Severity::Notice, text);
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

    fn report(&mut self, now: HostTime, severity: Severity, text: String) {
        show(severity, &text);
        self.records.push(Record::Event { host: now, severity, source: Source::Daemon, text });
    }

    fn record_stats(&mut self, now: HostTime) {
        let counted = self.session.stats();
        if let (Some(loss), Some(offboard)) = (self.meter.loss(&counted), &mut self.offboard) {
            offboard.link_event(now, LinkEvent::Quality { loss });
        }
        let stats = self.meter.read(now, &counted);
        // The first period includes messages from before the intervals were requested.
        if self.found.is_some_and(|found| now.since(found) >= 2 * STATS_PERIOD) {
            self.found = None;
            let text = format!(
                "receiving attitude at {:.0} Hz, position at {:.0} Hz, odometry at {:.0} Hz",
                stats.attitude_hz, stats.position_hz, stats.odometry_hz
            );
            self.report(now, Severity::Info, text);
        }
        self.records.push(Record::Link { host: now, stats });
    }
}

/// Shows a message on the console.
fn show(severity: Severity, text: &str) {
    match severity {
        Severity::Debug => tracing::debug!("{text}"),
        Severity::Info | Severity::Notice => tracing::info!("{text}"),
        Severity::Warning => tracing::warn!("{text}"),
        _ => tracing::error!("{text}"),
    }
}
