//! A scripted vehicle and a session, on a virtual clock.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use downwash::clock::HostTime;
use downwash::control::Limits;
use downwash::guard::{Answered, Cleared, Guard, Obeys, Order, Proposal, Stance};
use downwash::link::attitude_target::ThrustMap;
use downwash::link::counters::LinkState;
use downwash::link::profile::{MessageRate, PD_VEHICLE};
use downwash::link::received::Received;
use downwash::link::request::Outcome;
use downwash::link::session::{Delivery, Event, Session, Settings};
use downwash::setpoint::Setpoint;
use message::Inbound;
use wire::dialect::*;
use wire::transport::Peer;
use wire::{Decoder, Encoder};

pub const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
pub const STEP: Duration = Duration::from_millis(1);
pub const VEHICLE: Peer = Peer::new(7);
pub const STRANGER: Peer = Peer::new(8);
pub const OFFBOARD: u32 = 0x0006_0000;
pub const ATTITUDE_QUATERNION: u32 = 31;

pub fn settings() -> Settings {
    Settings {
        telemetry: Some(vec![MessageRate { id: ATTITUDE_QUATERNION, hz: 100.0 }]),
        vehicle_has_attitude_pd: true,
        ..Settings::new(ThrustMap::linear(20.0).expect("valid"))
    }
}

/// A setpoint that the guard has cleared.
pub fn cleared(now: HostTime, thrust_n: f64) -> Cleared {
    let mut guard = Guard::new(Limits::default(), 20.0, now);
    let setpoint = Setpoint { thrust_n, ..Setpoint::default() };
    let sample = Answered { host: now, ..Answered::default() };
    let order = Order { stance: Stance::Offer, obeys: Obeys::No };
    guard.propose(now, &Proposal { setpoint, sample }, order).expect("permitted");
    guard.clear(now, order).expect("permitted")
}

/// A vehicle that answers the session's requests as PX4 does.
pub struct Vehicle {
    pub booted: HostTime,
    pub autopilot: MavAutopilot,
    pub encoder: Encoder,
    pub decoder: Decoder,
    pub version: Option<(u16, u16)>,
    pub custom_mode: u32,
    /// Requested period by message id.
    pub periods: BTreeMap<u32, Duration>,
    pub requests_of_interval: u32,
    /// Number of commands to ignore.
    pub deaf_for: u32,
    /// Delay of a TIMESYNC answer, by its number.
    pub reply_delay: fn(u32) -> Duration,
    pub replies: u32,
    pub delayed: VecDeque<(HostTime, MavMessage)>,
    pub parameter: (String, f32),
    pub setpoints: Vec<SET_ATTITUDE_TARGET_DATA>,
    pub heartbeats_heard: u32,
}

impl Vehicle {
    pub fn new(system: u8) -> Self {
        Self {
            booted: START - Duration::from_secs(30),
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
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

    /// Time since its last boot; the first is 30 s before START.
    pub fn boot(&self, now: HostTime) -> Duration {
        now.since(self.booted)
    }

    pub fn heartbeat(&self) -> MavMessage {
        MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: self.custom_mode,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: self.autopilot,
            base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
            system_status: MavState::MAV_STATE_ACTIVE,
            mavlink_version: 3,
        })
    }

    pub fn hear(&mut self, now: HostTime, bytes: &[u8]) -> Vec<MavMessage> {
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

    pub fn command(&mut self, command: &COMMAND_LONG_DATA, answers: &mut Vec<MavMessage>) {
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

    pub fn parameter_value(&self) -> MavMessage {
        MavMessage::PARAM_VALUE(PARAM_VALUE_DATA {
            param_value: self.parameter.1,
            param_id: self.parameter.0.as_str().into(),
            param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
            ..Default::default()
        })
    }

    /// The periodic messages and the delayed answers that are due at `now`.
    pub fn due(&mut self, now: HostTime) -> Vec<MavMessage> {
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

    pub fn encode(&mut self, message: &MavMessage) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.encoder.encode(message, &mut bytes);
        bytes
    }
}

/// A session, its events and the messages that it passed on.
pub struct World {
    pub now: HostTime,
    pub session: Session,
    pub events: Vec<Event>,
    pub messages: Vec<Received>,
    pub frames: usize,
}

impl World {
    pub fn new(settings: Settings) -> Self {
        let session = Session::new(settings, START);
        Self { now: START, session, events: Vec::new(), messages: Vec::new(), frames: 0 }
    }

    pub fn deliver(&mut self, peer: Peer, bytes: &[u8]) {
        let (messages, frames) = (&mut self.messages, &mut self.frames);
        self.session.receive(self.now, peer, bytes, true, &mut |delivery| match delivery {
            Delivery::Frame { .. } => *frames += 1,
            Delivery::Message(received) => messages.push(received),
            Delivery::Replaced => {}
        });
    }

    /// Runs session and vehicle for a time, in steps of a millisecond.
    pub fn run(&mut self, vehicle: &mut Vehicle, duration: Duration) {
        let end = self.now + duration;
        while self.now < end {
            for message in vehicle.due(self.now) {
                let bytes = vehicle.encode(&message);
                self.deliver(VEHICLE, &bytes);
            }
            self.idle_step(Some(vehicle));
        }
    }

    pub fn idle_step(&mut self, mut vehicle: Option<&mut Vehicle>) {
        if self.session.next_deadline() <= self.now {
            self.session.poll(self.now);
            assert!(self.session.next_deadline() > self.now, "a poll does all that is due");
        }
        for _ in 0..4 {
            let mut sent = Vec::new();
            self.session.transmit(|to, bytes| {
                sent.push((to, bytes.to_vec()));
                true
            });
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

    pub fn silence(&mut self, duration: Duration) {
        let end = self.now + duration;
        while self.now < end {
            self.idle_step(None);
        }
    }

    pub fn states(&self) -> Vec<LinkState> {
        let states = self.events.iter().filter_map(|event| match event {
            Event::State { to, .. } => Some(*to),
            _ => None,
        });
        states.collect()
    }

    pub fn outcomes(&self) -> Vec<Outcome> {
        let outcomes = self.events.iter().filter_map(|event| match event {
            Event::Request { outcome, .. } => Some(outcome.clone()),
            _ => None,
        });
        outcomes.collect()
    }

    /// The flight modes that the session passed on, in order of arrival.
    pub fn modes(&self) -> Vec<u32> {
        let modes = self.messages.iter().filter_map(|received| match received.message {
            Inbound::Heartbeat { custom_mode, .. } | Inbound::CurrentMode { custom_mode, .. } => {
                Some(custom_mode)
            }
            _ => None,
        });
        modes.collect()
    }
}

pub fn seconds(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}
