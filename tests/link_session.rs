//! The session against a vehicle made of messages, on a virtual clock.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use downwash::clock::HostTime;
use downwash::link::attitude_target::ThrustMap;
use downwash::link::counters::LinkState;
use downwash::link::intervals::IntervalEvent;
use downwash::link::message::{Inbound, Received};
use downwash::link::profile::{MessageRate, PD_VEHICLE, Profile};
use downwash::link::request::{FlightMode, Outcome, Request};
use downwash::link::session::{Event, Heard, Session, SetpointError, Settings};
use downwash::link::timesync::ClockSource;
use downwash::setpoint::Setpoint;
use wire::dialect::*;
use wire::transport::Peer;
use wire::{Decoder, Encoder};

const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
const STEP: Duration = Duration::from_millis(1);
const VEHICLE: Peer = Peer::new(7);
const STRANGER: Peer = Peer::new(8);
const OFFBOARD: u32 = 0x0006_0000;
const ATTITUDE_QUATERNION: u32 = 31;

fn settings() -> Settings {
    Settings {
        telemetry: Some(vec![MessageRate { id: ATTITUDE_QUATERNION, hz: 100.0 }]),
        vehicle_has_attitude_pd: true,
        ..Settings::new(ThrustMap::linear(20.0).expect("valid"))
    }
}

/// A vehicle that answers as PX4 does, in as far as the session asks.
struct Vehicle {
    booted: HostTime,
    encoder: Encoder,
    decoder: Decoder,
    version: Option<(u16, u16)>,
    custom_mode: u32,
    /// Period by message id, as asked for.
    periods: BTreeMap<u32, Duration>,
    requests_of_interval: u32,
    /// Commands to let pass unanswered.
    deaf_for: u32,
    /// Delay of TIMESYNC answers, by their number.
    reply_delay: fn(u32) -> Duration,
    replies: u32,
    delayed: VecDeque<(HostTime, MavMessage)>,
    parameter: (String, f32),
    setpoints: Vec<SET_ATTITUDE_TARGET_DATA>,
    heartbeats_heard: u32,
}

impl Vehicle {
    fn new(system: u8) -> Self {
        Self {
            booted: START - Duration::from_secs(30),
            encoder: Encoder::new(system, 1),
            decoder: Decoder::new(),
            version: Some(PD_VEHICLE),
            custom_mode: 0x0304_0000,
            periods: BTreeMap::new(),
            requests_of_interval: 0,
            deaf_for: 0,
            reply_delay: |_| Duration::from_micros(100),
            replies: 0,
            delayed: VecDeque::new(),
            parameter: ("COM_OF_LOSS_T".to_owned(), 1.0),
            setpoints: Vec::new(),
            heartbeats_heard: 0,
        }
    }

    /// Time since its boot, 30 s before START if it was not booted since.
    fn boot(&self, now: HostTime) -> Duration {
        now.since(self.booted)
    }

    fn heartbeat(&self) -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: self.custom_mode,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    }

    fn hear(&mut self, now: HostTime, bytes: &[u8]) -> Vec<MavMessage> {
        let mut answers = Vec::new();
        self.decoder.push(bytes);
        while let Some(frame) = self.decoder.next_frame() {
            match frame.message().expect("the session sends what the dialect has") {
                MavMessage::COMMAND_LONG(_) if self.deaf_for > 0 => self.deaf_for -= 1,
                MavMessage::COMMAND_LONG(command) => self.command(&command, &mut answers),
                MavMessage::TIMESYNC(data) if data.tc1 == 0 => {
                    let delay = (self.reply_delay)(self.replies);
                    self.replies += 1;
                    let tc1 = self.boot(now).as_nanos() as i64;
                    let reply = TIMESYNC_DATA { tc1, ts1: data.ts1, ..Default::default() };
                    self.delayed.push_back((now + delay, MavMessage::TIMESYNC(reply)));
                }
                MavMessage::PARAM_SET(data) => {
                    self.parameter.1 = data.param_value;
                    answers.push(self.parameter_value());
                }
                MavMessage::PARAM_REQUEST_READ(_) => answers.push(self.parameter_value()),
                MavMessage::SET_ATTITUDE_TARGET(data) => self.setpoints.push(data),
                MavMessage::HEARTBEAT(data) => {
                    assert_eq!(data.mavtype, MavType::MAV_TYPE_ONBOARD_CONTROLLER);
                    self.heartbeats_heard += 1;
                }
                _ => {}
            }
        }
        answers
    }

    fn command(&mut self, command: &COMMAND_LONG_DATA, answers: &mut Vec<MavMessage>) {
        match command.command {
            MavCmd::MAV_CMD_DO_SET_MODE => {
                self.custom_mode = (command.param2 as u32) << 16 | (command.param3 as u32) << 24;
            }
            MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL => {
                let period = Duration::from_micros(command.param2 as u64);
                self.periods.insert(command.param1 as u32, period);
                self.requests_of_interval += 1;
            }
            MavCmd::MAV_CMD_REQUEST_MESSAGE => {
                if let Some((vendor_id, product_id)) = self.version {
                    answers.push(MavMessage::AUTOPILOT_VERSION(AUTOPILOT_VERSION_DATA {
                        vendor_id,
                        product_id,
                        ..Default::default()
                    }));
                }
            }
            _ => {}
        }
        answers.push(MavMessage::COMMAND_ACK(COMMAND_ACK_DATA {
            command: command.command,
            result: MavResult::MAV_RESULT_ACCEPTED,
            ..Default::default()
        }));
    }

    fn parameter_value(&self) -> MavMessage {
        MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_value: self.parameter.1,
            param_id: self.parameter.0.as_str().into(),
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
            ..Default::default()
        })
    }

    /// What is due by itself.
    fn due(&mut self, now: HostTime) -> Vec<MavMessage> {
        let mut due = Vec::new();
        let elapsed = now.since(START);
        let every = |period: Duration| elapsed.as_micros().is_multiple_of(period.as_micros());
        if every(Duration::from_secs(1)) {
            due.push(self.heartbeat());
        }
        if self.periods.get(&ATTITUDE_QUATERNION).is_some_and(|&period| every(period)) {
            due.push(MavMessage::ATTITUDE_QUATERNION(ATTITUDE_QUATERNION_DATA {
                time_boot_ms: self.boot(now).as_millis() as u32,
                q1: 1.0,
                ..Default::default()
            }));
        }
        while self.delayed.front().is_some_and(|(at, _)| *at <= now) {
            due.extend(self.delayed.pop_front().map(|(_, message)| message));
        }
        due
    }

    fn encode(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encoder.encode(message, &mut bytes);
        bytes
    }
}

/// A session and what it said.
struct World {
    now: HostTime,
    session: Session,
    events: Vec<Event>,
    messages: Vec<Received>,
    frames: usize,
}

impl World {
    fn new(settings: Settings) -> Self {
        let session = Session::new(settings, START);
        Self { now: START, session, events: Vec::new(), messages: Vec::new(), frames: 0 }
    }

    fn deliver(&mut self, peer: Peer, bytes: &[u8]) {
        let (messages, frames) = (&mut self.messages, &mut self.frames);
        self.session.receive(self.now, peer, bytes, true, &mut |heard| match heard {
            Heard::Frame { .. } => *frames += 1,
            Heard::Message(received) => messages.push(received),
        });
    }

    /// Runs both for a time, in steps of a millisecond.
    fn run(&mut self, vehicle: &mut Vehicle, duration: Duration) {
        let end = self.now + duration;
        while self.now < end {
            for message in vehicle.due(self.now) {
                let bytes = vehicle.encode(&message);
                self.deliver(VEHICLE, &bytes);
            }
            self.idle_step(Some(vehicle));
        }
    }

    fn idle_step(&mut self, mut vehicle: Option<&mut Vehicle>) {
        if self.session.next_deadline() <= self.now {
            self.session.poll(self.now);
            assert!(self.session.next_deadline() > self.now, "a poll does all that is due");
        }
        for _ in 0..4 {
            let mut sent = Vec::new();
            self.session.transmit(|to, bytes| sent.push((to, bytes.to_vec())));
            for (to, bytes) in sent {
                let Some(vehicle) = vehicle.as_deref_mut() else { continue };
                if to.is_none_or(|to| to == VEHICLE) {
                    for answer in vehicle.hear(self.now, &bytes) {
                        let bytes = vehicle.encode(&answer);
                        self.deliver(VEHICLE, &bytes);
                    }
                }
            }
        }
        while let Some(event) = self.session.next_event() {
            self.events.push(event);
        }
        self.now = self.now + STEP;
    }

    fn silence(&mut self, duration: Duration) {
        let end = self.now + duration;
        while self.now < end {
            self.idle_step(None);
        }
    }

    fn states(&self) -> Vec<LinkState> {
        let states = self.events.iter().filter_map(|event| match event {
            Event::State { to, .. } => Some(*to),
            _ => None,
        });
        states.collect()
    }

    fn outcomes(&self) -> Vec<Outcome> {
        let outcomes = self.events.iter().filter_map(|event| match event {
            Event::Request { outcome, .. } => Some(outcome.clone()),
            _ => None,
        });
        outcomes.collect()
    }
}

fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

#[test]
fn a_vehicle_is_found_identified_and_streams_as_asked() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(5.0));
    let found = world.session.vehicle().expect("found");
    assert_eq!((found.system, found.component, found.peer), (1, 1, VEHICLE));
    assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
    assert_eq!(world.states(), [LinkState::Connected]);
    assert_eq!(vehicle.requests_of_interval, 1, "a rate that comes is not asked for again");
    let stats = world.session.stats();
    let attitude = stats.messages.iter().find(|message| message.id == ATTITUDE_QUATERNION);
    assert!((attitude.expect("counted").rate_hz - 100.0).abs() < 2.0);
    assert_eq!((stats.foreign, stats.stray, stats.refused, stats.lost), (0, 0, 0, 0));
    assert!((4..=6).contains(&vehicle.heartbeats_heard));
    assert_eq!(world.frames as u64, stats.received.frames);
}

#[test]
fn a_vehicle_that_does_not_tell_its_version_gets_the_safe_form() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    vehicle.version = None;
    world.run(&mut vehicle, seconds(1.0));
    let early = world.session.send_setpoint(world.now, &Setpoint::default());
    assert_eq!(early, Err(SetpointError::NotIdentified));
    world.run(&mut vehicle, seconds(3.0));
    assert_eq!(world.session.profile(), Some(&Profile::PX4));
    world.session.send_setpoint(world.now, &Setpoint::default()).expect("sent");
    world.run(&mut vehicle, STEP);
    assert_eq!(vehicle.setpoints[0].type_mask.bits(), 0x07);
    assert_eq!(vehicle.setpoints[0].target_system, 1);
}

#[test]
fn others_never_take_the_vehicles_place() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let heard = world.messages.len();

    // Another autopilot, a ground station, and someone with the vehicle's ids elsewhere.
    let mut other = Vehicle::new(2);
    let bytes = other.encode(&other.heartbeat());
    world.deliver(STRANGER, &bytes);
    let mut station = Encoder::new(255, 190);
    let mut bytes = Vec::new();
    let data = HEARTBEAT_DATA { mavtype: MavType::MAV_TYPE_GCS, ..Default::default() };
    station.encode(&MavMessage::HEARTBEAT(data), &mut bytes);
    world.deliver(STRANGER, &bytes);
    let mut twin = Vehicle::new(1);
    let bytes = twin.encode(&twin.heartbeat());
    world.deliver(STRANGER, &bytes);

    assert_eq!(world.messages.len(), heard);
    let stats = world.session.stats();
    assert_eq!((stats.foreign, stats.stray), (2, 1));
    assert_eq!(world.session.vehicle().map(|v| (v.system, v.peer)), Some((1, VEHICLE)));
}

#[test]
fn a_configured_system_is_waited_for() {
    let settings = Settings { vehicle_system: Some(3), ..settings() };
    let mut world = World::new(settings);
    world.run(&mut Vehicle::new(1), seconds(2.0));
    assert_eq!(world.session.vehicle(), None);
    assert_eq!(world.session.state(), LinkState::Searching);
    world.run(&mut Vehicle::new(3), seconds(2.0));
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.system), Some(3));
}

#[test]
fn silence_is_stale_then_lost_and_the_vehicle_is_found_again_elsewhere() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let pending = Request::ReadParameter("X".to_owned());
    world.session.request(world.now, pending);
    world.silence(seconds(6.0));
    use LinkState::{Connected, Lost, Stale};
    assert_eq!(world.states(), [Connected, Stale, Lost]);
    assert_eq!(world.outcomes(), [Outcome::NoAnswer]);
    world.session.request(world.now, Request::Arm);
    world.silence(STEP);
    assert_eq!(world.outcomes(), [Outcome::NoAnswer, Outcome::NotConnected]);
    assert_eq!(
        world.session.send_setpoint(world.now, &Setpoint::default()),
        Err(SetpointError::NotConnected)
    );
    let bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(STRANGER, &bytes);
    world.silence(seconds(0.1));
    assert_eq!(world.states(), [Connected, Stale, Lost, Connected]);
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.peer), Some(STRANGER));
    assert_eq!(world.session.profile(), None, "it is identified anew");
}

#[test]
fn a_closed_connection_is_relearnt_at_once() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    world.session.peer_closed(VEHICLE);
    assert_eq!(
        world.session.send_setpoint(world.now, &Setpoint::default()),
        Err(SetpointError::NotConnected)
    );
    let bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(STRANGER, &bytes);
    assert_eq!(world.session.vehicle().map(|vehicle| vehicle.peer), Some(STRANGER));
    assert!(world.session.send_setpoint(world.now, &Setpoint::default()).is_ok());
    assert_eq!(world.states(), [LinkState::Connected]);
}

#[test]
fn the_clock_converges_through_lopsided_jitter() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    // Answers wait up to 37 ms; one in eight comes at once.
    vehicle.reply_delay = |n| match n % 8 {
        0 => Duration::ZERO,
        n => Duration::from_millis(u64::from(n * 7919 % 38)),
    };
    world.run(&mut vehicle, seconds(8.0));
    let clock = world.session.clock().expect("known");
    assert_eq!(clock.source, ClockSource::Timesync);
    let truth = 30_000_000_000 - START.as_ns() as i64;
    let error = (clock.offset_ns - truth).unsigned_abs();
    // The virtual clock steps by a millisecond, so an answer "at once" takes one.
    assert!(error <= 1_000_000, "{error} ns");
}

#[test]
fn a_vehicle_that_was_started_anew_is_identified_anew() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(3.0));
    assert_eq!(world.session.profile(), Some(&Profile::BUNDLED));
    // Another one with the same ids, at once: it must not get setpoints of the old one's form.
    vehicle.booted = world.now;
    vehicle.version = None;
    world.run(&mut vehicle, seconds(0.6));
    assert_eq!(world.session.profile(), None);
    world.run(&mut vehicle, seconds(3.0));
    assert_eq!(world.session.profile(), Some(&Profile::PX4));
    assert!(world.events.iter().any(|e| matches!(e, Event::ClockJump { by_ns } if *by_ns < 0)));
}

#[test]
fn a_ground_station_is_no_vehicle_whatever_it_calls_its_autopilot() {
    let mut world = World::new(settings());
    for mavtype in [MavType::MAV_TYPE_GCS, MavType::MAV_TYPE_ONBOARD_CONTROLLER] {
        let data = HEARTBEAT_DATA {
            mavtype,
            autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
            ..Default::default()
        };
        let mut bytes = Vec::new();
        Encoder::new(255, 190).encode(&MavMessage::HEARTBEAT(data), &mut bytes);
        world.deliver(STRANGER, &bytes);
    }
    assert_eq!(world.session.vehicle(), None);
    assert_eq!(world.session.stats().foreign, 2);
}

#[test]
fn a_lowered_rate_is_asked_for_again() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(5.0));
    // Another ground station wants it slow.
    vehicle.periods.insert(ATTITUDE_QUATERNION, Duration::from_millis(250));
    world.run(&mut vehicle, seconds(8.0));
    assert_eq!(vehicle.periods[&ATTITUDE_QUATERNION], Duration::from_millis(10));
    let news: Vec<_> = world.events.iter().filter(|e| matches!(e, Event::Interval(_))).collect();
    assert!(
        matches!(
            news[..],
            [
                Event::Interval(IntervalEvent::Short { id: ATTITUDE_QUATERNION, .. }),
                Event::Interval(IntervalEvent::Served { id: ATTITUDE_QUATERNION, .. }),
            ]
        ),
        "{news:?}"
    );
}

#[test]
fn requests_are_repeated_and_modes_read_back() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    vehicle.deaf_for = 2;
    world.session.request(world.now, Request::SetMode(FlightMode::Offboard));
    world.run(&mut vehicle, seconds(2.5));
    assert_eq!(vehicle.custom_mode, OFFBOARD);
    assert_eq!(world.outcomes(), [Outcome::Done]);
    world.events.clear();
    let set = Request::SetParameter { name: "COM_OF_LOSS_T".to_owned(), value: 0.2 };
    world.session.request(world.now, set);
    world.run(&mut vehicle, seconds(0.5));
    assert_eq!(vehicle.parameter.1, 0.2);
    assert_eq!(world.outcomes(), [Outcome::Parameter(0.2f32.into())]);
}

#[test]
fn the_vehicles_timesync_is_answered_from_the_host_clock() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let request = TIMESYNC_DATA { tc1: 0, ts1: 12_345, ..Default::default() };
    let bytes = vehicle.encode(&MavMessage::TIMESYNC(request));
    world.session.transmit(|_, _| {});
    world.deliver(VEHICLE, &bytes);
    let mut answers = Vec::new();
    world.session.transmit(|to, bytes| {
        let mut decoder = Decoder::new();
        decoder.push(bytes);
        answers.push((to, decoder.next_frame().expect("whole").message().expect("valid")));
    });
    let expected = TIMESYNC_DATA {
        tc1: world.now.as_ns() as i64,
        ts1: 12_345,
        target_system: 1,
        target_component: 1,
    };
    assert_eq!(answers, [(Some(VEHICLE), MavMessage::TIMESYNC(expected))]);
}

#[test]
fn broken_content_is_counted_and_not_passed_on() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let heard = world.messages.len();
    let broken = ATTITUDE_QUATERNION_DATA { q1: f32::NAN, ..Default::default() };
    let mut bytes = vehicle.encode(&MavMessage::ATTITUDE_QUATERNION(broken));
    world.deliver(VEHICLE, &bytes);
    assert_eq!(world.session.stats().refused, 1);
    *bytes.last_mut().expect("not empty") ^= 0xFF;
    world.deliver(VEHICLE, &bytes);
    world.deliver(VEHICLE, b"garbage");
    assert_eq!(world.session.stats().received.crc_errors, 1);
    assert_eq!(world.messages.len(), heard);
    // The next whole frame is heard as ever.
    let bytes = vehicle.encode(&vehicle.heartbeat());
    world.deliver(VEHICLE, &bytes);
    let last = world.messages.last().map(|received| &received.message);
    assert!(matches!(last, Some(Inbound::Heartbeat { autopilot: 12, .. })));
}

#[test]
fn payloads_of_a_wrong_length_are_padded_cut_or_refused_and_never_end_the_session() {
    let (mut world, mut vehicle) = (World::new(settings()), Vehicle::new(1));
    world.run(&mut vehicle, seconds(2.0));
    let level = ATTITUDE_QUATERNION_DATA { q1: 1.0, ..Default::default() };
    let honest = vehicle.encode(&MavMessage::ATTITUDE_QUATERNION(level));
    let extra_crc = <MavMessage as mavlink::Message>::extra_crc(ATTITUDE_QUATERNION);
    let (heard, refused) = (world.messages.len(), world.session.stats().refused);
    for len in 0..=u8::MAX {
        let mut bytes = honest.clone();
        bytes.truncate(bytes.len() - 2);
        bytes.resize(10 + usize::from(len), 0);
        bytes[1] = len;
        bytes.extend(mavlink::calculate_crc(&bytes[1..], extra_crc).to_le_bytes());
        world.deliver(VEHICLE, &bytes);
    }
    // Without all of q1 there is no attitude; without the zeros that follow there is.
    let refused = world.session.stats().refused - refused;
    assert_eq!((refused, world.messages.len() - heard), (8, 256 - 8));
    assert_eq!(world.session.state(), LinkState::Connected);
}

#[test]
fn streams_of_several_peers_do_not_mix() {
    let mut session = Session::new(settings(), START);
    let mut vehicle = Vehicle::new(1);
    let frame = vehicle.encode(&vehicle.heartbeat());
    let (first, rest) = frame.split_at(9);
    let mut count = 0;
    let mut on = |heard: Heard<'_>| count += usize::from(matches!(heard, Heard::Frame { .. }));
    session.receive(START, VEHICLE, first, false, &mut on);
    session.receive(START, STRANGER, first, false, &mut on);
    session.receive(START, VEHICLE, rest, false, &mut on);
    session.receive(START, STRANGER, rest, false, &mut on);
    assert_eq!(count, 2);
    assert_eq!(session.stats().received.unframed_bytes, 0);
}

#[test]
fn a_serial_line_is_asked_for_what_it_has_room_for() {
    let over = |baud| Settings { telemetry: None, baud, ..settings() };
    let asked = |world: &World, vehicle: &Vehicle| {
        let hz = |id| vehicle.periods.get(&id).map(|period| (1.0 / period.as_secs_f64()).round());
        let news = world.events.iter().find_map(|event| match event {
            Event::LineBudget(budget) => Some(budget.to_string()),
            _ => None,
        });
        // ATTITUDE_QUATERNION, LOCAL_POSITION_NED, ODOMETRY, HIGHRES_IMU.
        ([31, 32, 331, 105].map(hz), news)
    };
    let cases = [
        (None, [Some(250.0), Some(100.0), Some(100.0), Some(250.0)]),
        (Some(921_600), [Some(250.0), Some(100.0), Some(100.0), Some(100.0)]),
        (Some(115_200), [Some(50.0), Some(50.0), None, Some(25.0)]),
    ];
    for (baud, expected) in cases {
        let (mut world, mut vehicle) = (World::new(over(baud)), Vehicle::new(1));
        world.run(&mut vehicle, seconds(3.0));
        let (rates, news) = asked(&world, &vehicle);
        assert_eq!(rates, expected, "{baud:?}");
        assert_eq!(news.is_some(), baud.is_some(), "{baud:?}: {news:?}");
    }
}
