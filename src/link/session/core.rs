//! The session behind its decoders: one frame or one tick at a time.

mod selection;
mod sending;

use std::collections::VecDeque;
use std::time::Duration;

use mavlink::{MavlinkVersion, MessageData};
use message::codec::Codec;
use message::{AttitudeSource, Inbound};
use vehicle::frame::Attitude;
use wire::dialect::*;
use wire::transport::Peer;
use wire::{Encoder, Frame};

use self::selection::autopilot_of;
use super::novelty::Novelty;
use super::outbox::{Outbox, heartbeat};
use super::{Delivery, Event, Settings, VehicleId};
use crate::clock::HostTime;
use crate::link::budget::LineBudget;
use crate::link::counters::{Counters, LinkState};
use crate::link::intervals::Intervals;
use crate::link::mode_reports::Newness;
use crate::link::profile::Profile;
use crate::link::received::Received;
use crate::link::request::Requests;
use crate::link::signing::Signing;
use crate::link::timesync::Answer;
use crate::link::vehicle_clock::VehicleClock;

const HEARTBEAT_PERIOD: Duration = Duration::from_secs(1);
/// AUTOPILOT_VERSION is requested at this interval, this many times.
const VERSION_REPEAT: Duration = Duration::from_millis(400);
const VERSION_ATTEMPTS: u8 = 5;
/// Age above which an attitude closes no loop.
const ATTITUDE_FRESH: Duration = Duration::from_millis(200);
/// Clock jump beyond which the vehicle may be another: backwards if it was started later, forwards
/// if it was started earlier.
const JUMP_NS: u64 = 1_000_000_000;
#[derive(Debug)]
pub(super) struct Vehicle {
    pub(super) id: VehicleId,
    /// `None` from the close of its connection until its next frame.
    pub(super) peer: Option<Peer>,
    pub(super) last_received: HostTime,
    /// Whether it signs its messages.
    pub(super) is_signed: bool,
    /// MAVLink version of its newest frame.
    pub(super) version: MavlinkVersion,
}

/// Everything behind the decoders.
#[derive(Debug)]
pub(super) struct Core {
    pub(super) settings: Settings,
    pub(super) started: HostTime,
    pub(super) state: LinkState,
    pub(super) vehicle: Option<Vehicle>,
    /// Other autopilots, known as well as the vehicle's or as little.
    pub(super) others: Vec<VehicleId>,
    pub(super) profile: Option<Profile>,
    /// When AUTOPILOT_VERSION is requested next, and how often it was; `None` once identified.
    pub(super) version_due: Option<(HostTime, u8)>,
    pub(super) codec: Codec,
    pub(super) counters: Counters,
    pub(super) novelty: Novelty,
    #[cfg(test)]
    sent: Option<(HostTime, Peer, MavMessage)>,
    pub(super) clock: VehicleClock,
    pub(super) intervals: Intervals,
    /// The messages requested over a serial line.
    pub(super) budget: Option<LineBudget>,
    pub(super) requests: Requests,
    pub(super) attitude: Option<(HostTime, AttitudeSource, Attitude)>,
    pub(super) heartbeat_due: HostTime,
    pub(super) timesync_due: HostTime,
    pub(super) events: VecDeque<Event>,
    pub(super) outbox: Outbox,
    pub(super) signing: Option<Signing>,
}

impl Core {
    pub(super) fn new(settings: Settings, now: HostTime) -> Self {
        let mut encoder = Encoder::new(settings.system, settings.component);
        let (signing, signer) = settings.signing.as_ref().map(|it| Signing::new(it, now)).unzip();
        encoder.set_signer(signer);
        Self {
            settings,
            signing,
            started: now,
            state: LinkState::Searching,
            vehicle: None,
            others: Vec::new(),
            profile: None,
            version_due: None,
            codec: Codec::default(),
            counters: Counters::default(),
            novelty: Novelty::default(),
            #[cfg(test)]
            sent: None,
            clock: VehicleClock::default(),
            intervals: Intervals::default(),
            budget: None,
            requests: Requests::default(),
            attitude: None,
            heartbeat_due: now,
            timesync_due: now,
            events: VecDeque::new(),
            outbox: Outbox::new(encoder),
        }
    }

    pub(super) fn frame(
        &mut self,
        now: HostTime,
        peer: Peer,
        frame: &Frame,
        on: &mut impl FnMut(Delivery<'_>),
    ) {
        // It contains a key: neither a log nor another station gets it.
        if frame.id() == SETUP_SIGNING_DATA::ID || !self.is_accepted(now, frame) {
            return;
        }
        on(Delivery::Frame { peer, bytes: frame.bytes() });
        let is_heartbeat = frame.id() == HEARTBEAT_DATA::ID;
        let autopilot = is_heartbeat.then(|| autopilot_of(peer, frame)).flatten();
        if autopilot.is_some_and(|id| self.select(now, id, frame.is_signed())) {
            on(Delivery::Replaced);
        }
        let Some(vehicle) = &mut self.vehicle else {
            self.counters.foreign(frame);
            return;
        };
        let is_vehicle = frame.system() == u32::from(vehicle.id.system)
            && frame.component() == vehicle.id.component;
        // A companion that uses the autopilot's ids is not a source for the vehicle's state.
        let is_impostor = is_heartbeat && autopilot.is_none_or(|id| vehicle.id.is_another(&id));
        if !is_vehicle || is_impostor {
            self.counters.foreign(frame);
            return;
        }
        if vehicle.peer != Some(peer) {
            self.counters.stray += 1;
            return;
        }
        vehicle.last_received = now;
        vehicle.is_signed |= frame.is_signed();
        vehicle.version = frame.version();
        self.counters.vehicle_frames += 1;
        let offboard = self.profile.as_ref().and_then(|profile| profile.modes.offboard);
        match self.novelty.of(now, frame, offboard.map(|mode| mode.custom_mode)) {
            Newness::New => {}
            Newness::Old => {
                self.counters.repeated += 1;
                return;
            }
            Newness::Doubtful => {
                self.counters.repeated += 1;
                return self.doubt(now, Inbound::DoubtfulMode, on);
            }
            Newness::DoubtfulArming => {
                self.counters.repeated += 1;
                return self.doubt(now, Inbound::DoubtfulArming, on);
            }
        }
        self.counters.arrival(frame.id());
        self.set_state(LinkState::Connected);
        if frame.id() == TIMESYNC_DATA::ID {
            if self.timesync(now, frame) {
                self.doubt(now, Inbound::DoubtfulMode, on);
            }
            return;
        }
        match self.codec.decode(frame) {
            Ok(Some((vehicle, message))) => {
                let delay = vehicle.map(|stamp| self.clock.observe(now, stamp));
                self.timesync_due = self.timesync_due.min(now + self.clock.period());
                self.message(now, &message);
                on(Delivery::Message(Received { host: now, vehicle, delay, message }));
            }
            Ok(None) => {}
            Err(refusal) => self.counters.refuse(frame.id(), refusal),
        }
    }

    /// The known mode, or that the motors are armed, may be outdated: nothing requested for it is
    /// repeated.
    fn doubt(&mut self, now: HostTime, message: Inbound, on: &mut dyn FnMut(Delivery<'_>)) {
        self.requests.withdraw();
        self.collect_ended();
        on(Delivery::Message(Received { host: now, vehicle: None, delay: None, message }));
    }

    /// Whether signing admits the frame; true where no key is set.
    fn is_accepted(&mut self, now: HostTime, frame: &Frame) -> bool {
        self.turn(now);
        let Self { signing: Some(signing), outbox, events, .. } = self else { return true };
        match signing.check(frame, outbox.signer()) {
            Ok(()) => true,
            Err(rejection) => {
                events.extend(rejection.map(Event::FrameRejected));
                false
            }
        }
    }

    /// Advances the time used for signatures.
    pub(super) fn turn(&mut self, now: HostTime) {
        if let Some(signing) = &mut self.signing {
            signing.turn(now, self.outbox.signer());
        }
    }

    fn message(&mut self, now: HostTime, message: &Inbound) {
        match message {
            Inbound::Odometry { attitude, .. } => {
                self.attitude = Some((now, AttitudeSource::Quaternion, *attitude));
            }
            Inbound::Attitude { source, attitude, .. } => {
                // The two sources are never mixed: Euler angles serve only where they are the only
                // source.
                let is_served = self.attitude.is_some_and(|(at, served, _)| {
                    served == AttitudeSource::Quaternion && now.since(at) < ATTITUDE_FRESH
                });
                if *source == AttitudeSource::Quaternion || !is_served {
                    self.attitude = Some((now, *source, *attitude));
                }
            }
            Inbound::Heartbeat { custom_mode, .. } | Inbound::CurrentMode { custom_mode, .. } => {
                self.requests.mode(*custom_mode);
                self.collect_ended();
            }
            Inbound::CommandAck { command, result } => self.acknowledged(now, *command, *result),
            Inbound::Parameter { name, value } => {
                self.requests.parameter(now, name, *value);
                self.send_requests(now);
            }
            Inbound::AutopilotVersion { vendor_id, product_id, .. }
                // An unknown autopilot's version decides nothing, and a known autopilot may still
                // appear.
                if self.version_due.is_some()
                    && self.vehicle.as_ref().is_some_and(|vehicle| vehicle.id.is_known()) =>
            {
                self.identify(now, Some((*vendor_id, *product_id)));
            }
            _ => {}
        }
    }

    fn acknowledged(&mut self, now: HostTime, command: u16, result: u8) {
        if command == MavCmd::MAV_CMD_SET_MESSAGE_INTERVAL as u16 {
            let news = self.intervals.acknowledged(now, result == 0);
            self.events.extend(news.map(Event::Interval));
            self.request_intervals(now);
        } else {
            self.requests.acknowledged(now, command, result);
            self.collect_ended();
        }
    }

    fn identify(&mut self, now: HostTime, version: Option<(u16, u16)>) {
        self.version_due = None;
        let Some(vehicle) = &self.vehicle else { return };
        let profile = Profile::identify(
            vehicle.id.autopilot,
            vehicle.id.vehicle_type,
            version,
            self.settings.vehicle_has_attitude_pd,
            self.settings.form,
        );
        self.codec.set_parameter_cast(profile.parameter_cast);
        let budget = match (&self.settings.telemetry, self.settings.baud) {
            (Some(chosen), Some(baud)) => Some(LineBudget::unlimited(chosen, baud)),
            (None, Some(baud)) => Some(LineBudget::fit(profile.telemetry, baud)),
            (_, None) => None,
        };
        let usual = self.settings.telemetry.as_deref().unwrap_or(profile.telemetry);
        let messages = budget.as_ref().map_or(usual, |budget| &budget.messages);
        self.intervals.start(now, messages);
        let is_news = |budget: &&LineBudget| !budget.lowered.is_empty() || !budget.fits();
        let news = budget.as_ref().filter(is_news);
        self.events.extend(news.map(|budget| Event::LineBudget(Box::new(budget.clone()))));
        self.budget = budget;
        let is_version_known = version.is_some();
        let event = Event::Identified { profile: Box::new(profile.clone()), is_version_known };
        self.events.push_back(event);
        self.profile = Some(profile);
        self.request_intervals(now);
    }

    /// Takes a TIMESYNC frame; returns whether it shows a clock that may be another vehicle's, or
    /// that of a restarted one, whose mode is then unknown.
    fn timesync(&mut self, now: HostTime, frame: &Frame) -> bool {
        let Ok(MavMessage::TIMESYNC(data)) = frame.message() else {
            self.counters.refused += 1;
            return false;
        };
        if data.tc1 == 0 {
            let clock = self.clock.estimate();
            let answer_ns = match self.settings.answers_in_vehicle_time {
                false => Some(now.as_ns()),
                true => clock.map(|clock| clock.to_vehicle(now).as_us().saturating_mul(1000)),
            };
            if let Some(answer_ns) = answer_ns.filter(|_| self.settings.answer_timesync) {
                let answer = TIMESYNC_DATA {
                    tc1: i64::try_from(answer_ns).unwrap_or(i64::MAX),
                    ts1: data.ts1,
                    target_system: frame.system() as u8,
                    target_component: frame.component(),
                };
                self.send(&MavMessage::TIMESYNC(answer));
            }
            return false;
        }
        let (system, component) = (self.settings.system, self.settings.component);
        let is_for_us = [0, system].contains(&data.target_system)
            && [0, component].contains(&data.target_component);
        if !is_for_us {
            return false;
        }
        let answer = self.clock.answer(now, data.tc1, data.ts1);
        self.timesync_due = self.timesync_due.min(now + self.clock.period());
        if let Answer::Again { after } = answer {
            self.events.push_back(Event::RequestAgain(after));
        } else if answer != Answer::NotOurs {
            self.events.extend(self.clock.round_trip().map(Event::RoundTrip));
        }
        let by_ns = match answer {
            Answer::NotOurs | Answer::Again { .. } | Answer::Sample => return false,
            Answer::Contradiction { by_ns } => return by_ns.unsigned_abs() > JUMP_NS,
            Answer::Jump { by_ns } => by_ns,
        };
        self.events.push_back(Event::ClockJump { by_ns });
        if by_ns.unsigned_abs() > JUMP_NS {
            // It may be another vehicle, which takes other setpoints.
            self.profile = None;
            self.version_due = Some((now, 0));
        }
        false
    }

    /// Marks the link as stale until the transport is open again.
    pub(super) fn transport_closed(&mut self) {
        if self.state == LinkState::Connected {
            self.set_state(LinkState::Stale);
        }
    }

    fn set_state(&mut self, to: LinkState) {
        let from = std::mem::replace(&mut self.state, to);
        if from != to {
            self.events.push_back(Event::State { from, to });
        }
    }

    pub(super) fn poll(&mut self, now: HostTime) {
        self.turn(now);
        #[cfg(test)]
        self.send_again(now);
        if self.heartbeat_due <= now {
            self.heartbeat_due = now + HEARTBEAT_PERIOD;
            self.outbox.push(None, &heartbeat());
        }
        let Some(vehicle) = &self.vehicle else { return };
        let is_old = vehicle.version == MavlinkVersion::V1;
        let silence = now.since(vehicle.last_received);
        if silence >= self.settings.lost_after {
            if self.state != LinkState::Lost {
                self.lose(now);
            }
            return;
        }
        if silence >= self.settings.stale_after {
            self.set_state(LinkState::Stale);
        }
        if self.timesync_due <= now {
            self.timesync_due = now + self.clock.period();
            let ts1 = self.clock.request(now);
            let request = TIMESYNC_DATA { tc1: 0, ts1, ..self.timesync_target() };
            self.send(&MavMessage::TIMESYNC(request));
        }
        match self.version_due {
            Some((due, VERSION_ATTEMPTS)) if due <= now => self.identify(now, None),
            Some((due, attempts)) if due <= now => {
                self.version_due = Some((now + VERSION_REPEAT, attempts + 1));
                // A MAVLink 1 vehicle may understand no other version.
                if attempts >= VERSION_ATTEMPTS / 2 && is_old {
                    self.outbox.set_version(MavlinkVersion::V1);
                }
                let id = AUTOPILOT_VERSION_DATA::ID as f32;
                let params = [id, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
                self.command(MavCmd::MAV_CMD_REQUEST_MESSAGE, params, attempts);
            }
            _ => {}
        }
        if self.counters.window_end() <= now {
            self.counters.roll(now);
        }
        let (counters, events) = (&self.counters, &mut self.events);
        self.intervals.verify(
            now,
            |id| counters.total(id),
            |event| events.push_back(Event::Interval(event)),
        );
        self.request_intervals(now);
        self.send_requests(now);
    }

    fn lose(&mut self, now: HostTime) {
        self.set_state(LinkState::Lost);
        self.counters.restart(now);
        self.novelty.restart();
        if let Some(vehicle) = &mut self.vehicle {
            vehicle.peer = None;
        }
        self.profile = None;
        self.version_due = None;
        self.attitude = None;
        self.intervals.stop();
        self.requests.abandon();
        self.collect_ended();
    }

    pub(super) fn next_deadline(&self) -> HostTime {
        let Some(vehicle) = self.vehicle.as_ref().filter(|_| self.state != LinkState::Lost) else {
            return self.heartbeat_due;
        };
        let silence = match self.state {
            LinkState::Stale => self.settings.lost_after,
            _ => self.settings.stale_after.min(self.settings.lost_after),
        };
        [
            Some(self.heartbeat_due),
            Some(vehicle.last_received + silence),
            Some(self.timesync_due),
            self.version_due.map(|(due, _)| due),
            Some(self.counters.window_end()),
            self.intervals.next_deadline(),
            self.requests.next_deadline(),
        ]
        .into_iter()
        .flatten()
        .min()
        .unwrap_or(self.heartbeat_due)
    }
}
