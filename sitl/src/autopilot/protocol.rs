//! The autopilot on the wire: its replies and its unsolicited messages.

#![allow(deprecated, reason = "clients still send and request superseded messages")]

mod command;
mod parameter;

use mavlink::Message;
use wire::Frame;
use wire::dialect::*;
use wire::signing::{Key, Stamp};

use crate::config::Home;
use crate::sensors::EstimatorStatus;
use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::{MotorOutput, ROTORS};

use super::commands::Command;
use super::flight::FlightControl;
use super::guidance::Sticks;
use super::link::{Link, Outbox, Peer};
use super::signing::{self, Signing};
use super::streams::Stream;
use super::telemetry::{Battery, Snapshot};
use super::vision::OutsidePose;
use super::{COMPONENT_ID, Mode, SYSTEM_ID, ftp, status_text};

/// Largest number of peers served at once; further ones are ignored.
pub const PEERS_MAX: usize = 64;

/// The vehicle's reported state at one instant.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Position, m.
    pub position: Ned,
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Attitude, body to world.
    pub attitude: Attitude,
    /// Gyro, rad/s.
    pub body_rate: Frd,
    /// Accelerometer, m/s^2.
    pub specific_force: Frd,
    /// State of the pack.
    pub battery: Battery,
    /// Rotor speeds in 1/min, signed by spin, if known.
    pub rpm: Option<[f64; ROTORS]>,
    /// The estimator's status.
    pub estimator: EstimatorStatus,
}

/// The sender of a frame and its link.
#[derive(Clone, Copy, Debug)]
struct Sender {
    link: usize,
    system: u8,
    component: u8,
}

/// The MAVLink protocol of the autopilot, which owns its flight control.
pub struct Protocol {
    pub(super) flight: FlightControl,
    links: Vec<Link>,
    outbox: Outbox,
    now_us: u64,
    report: Report,
    motor_output: Option<MotorOutput>,
    origin: Home,
    /// Active and intended mode in the last CURRENT_MODE.
    announced: (Mode, Mode),
    texts: u16,
    rng: rand_pcg::Pcg64Mcg,
    signing: Option<Signing>,
}

impl Protocol {
    pub(super) fn new(
        flight: FlightControl,
        report: Report,
        motor_output: Option<MotorOutput>,
        origin: Home,
        rng: rand_pcg::Pcg64Mcg,
    ) -> Self {
        let announced = (flight.commander.mode(), flight.commander.intended());
        Self {
            flight,
            links: Vec::new(),
            outbox: Outbox::default(),
            now_us: 0,
            report,
            motor_output,
            origin,
            announced,
            texts: 0,
            rng,
            signing: None,
        }
    }

    pub(super) fn connect(&mut self, peer: Peer) -> bool {
        let room = self.links.len() < PEERS_MAX;
        if room {
            let mut link = Link::new(peer, self.flight.personality.streams(), self.now_us);
            let signing = self.signing.as_ref();
            link.sign(signing.map(|signing| signing.signer(link_number(peer), self.now_us)));
            self.links.push(link);
        }
        room
    }

    pub(super) fn disconnect(&mut self, peer: Peer) {
        self.links.retain(|link| link.peer != peer);
    }

    pub(super) fn take_output(&mut self, deliver: impl FnMut(Peer, &[u8])) {
        self.outbox.take(deliver);
    }

    /// Time at which the next message is due, us.
    pub(super) fn next_us(&self) -> u64 {
        let due = |link: &Link| match link.parameter_list {
            Some(_) => self.now_us,
            None => link.schedule.next_us(),
        };
        self.links.iter().map(due).min().unwrap_or(u64::MAX)
    }

    pub(super) fn set_now(&mut self, now_us: u64) {
        self.now_us = now_us;
        if let Some(signing) = &mut self.signing {
            let now = signing.turn(now_us);
            self.links.iter_mut().for_each(|link| link.turn(now));
        }
    }

    /// Replaces the signing key and time; `None` turns signing off.
    pub(super) fn sign(&mut self, key: Option<(Key, Stamp)>) {
        self.signing = key.map(|(key, now)| Signing::new(key, now, self.now_us));
        for link in &mut self.links {
            let signing = self.signing.as_ref();
            link.sign(signing.map(|signing| signing.signer(link_number(link.peer), self.now_us)));
        }
    }

    pub(super) fn set_report(&mut self, report: Report) {
        self.report = report;
    }

    /// Sends due messages.
    pub(super) fn stream(&mut self) {
        self.announce();
        if self.next_us() > self.now_us {
            return;
        }
        let mut links = std::mem::take(&mut self.links);
        let mut outbox = std::mem::take(&mut self.outbox);
        let snapshot = self.snapshot();
        for link in &mut links {
            link.send_due(&snapshot, &mut outbox);
            if let Some(index) = link.parameter_list {
                if let Some(message) = parameter::value_message(&self.flight.parameters, index) {
                    link.send(&message, &mut outbox);
                }
                link.parameter_list =
                    Some(index + 1).filter(|next| *next < self.flight.parameters.count());
            }
        }
        self.links = links;
        self.outbox = outbox;
    }

    /// Sends pending texts, and CURRENT_MODE after a change of mode.
    pub(super) fn announce(&mut self) {
        if self.flight.commander.has_status_texts() {
            for pending in self.flight.commander.take_status_texts() {
                self.texts = self.texts.wrapping_add(1);
                let text = self.flight.personality.text(&pending.text);
                for message in status_text::status_text(pending.severity, &text, self.texts) {
                    self.broadcast(&message);
                }
            }
        }
        let mode = (self.flight.commander.mode(), self.flight.commander.intended());
        if mode != self.announced {
            self.announced = mode;
            let announces = self.flight.personality.announces_mode();
            let message = self.snapshot().message(Stream::CurrentMode).filter(|_| announces);
            if let Some(message) = message {
                self.broadcast(&message);
            }
        }
    }

    fn snapshot(&self) -> Snapshot<'_> {
        let Self { flight, report, .. } = self;
        let commander = &flight.commander;
        let can_arm =
            commander.armed() || flight.preflight(self.now_us).refusal(commander.mode()).is_none();
        Snapshot {
            personality: flight.personality,
            parameters: &flight.parameters,
            now_us: self.now_us,
            position: report.position,
            velocity: report.velocity,
            attitude: report.attitude,
            body_rate: report.body_rate,
            specific_force: report.specific_force,
            outputs: flight.outputs(),
            rpm: report.rpm,
            motor_output: self.motor_output.as_ref(),
            setpoint: flight.reported_setpoint(),
            battery: report.battery,
            charge: flight.charge_state(),
            estimator: report.estimator,
            position_known: flight.position_known(self.now_us),
            lacks_vision: flight.lacks_vision(self.now_us),
            armed: commander.armed(),
            mode: commander.mode(),
            intended: commander.intended(),
            failsafe: commander.failsafe(),
            landed: flight.landed(),
            can_arm,
            home: flight.home(),
            origin: self.origin,
        }
    }

    fn broadcast(&mut self, message: &MavMessage) {
        for link in &mut self.links {
            link.send(message, &mut self.outbox);
        }
    }

    fn reply(&mut self, to: Sender, message: &MavMessage) {
        if let Some(link) = self.links.get_mut(to.link) {
            link.send(message, &mut self.outbox);
        }
    }

    /// Processes a frame from `peer`.
    pub(super) fn handle(&mut self, peer: Peer, frame: &Frame) {
        let Some(link) = self.links.iter().position(|link| link.peer == peer) else { return };
        // The protocol's target fields cannot address 32-bit system ids.
        let Ok(system) = u8::try_from(frame.system()) else { return };
        let component = frame.component();
        if (system, component) == (SYSTEM_ID, COMPONENT_ID) {
            return;
        }
        if self.signing.as_mut().is_some_and(|signing| !signing.accepts(frame)) {
            return;
        }
        self.links[link].note_version(frame.version());
        let sender = Sender { link, system, component };
        if let Some(command) = Command::from_frame(frame) {
            if addressed(Some(command.target_system), Some(command.target_component)) {
                self.command(sender, &command);
            }
        } else if let Ok(message) = frame.message()
            && addressed(message.target_system_id(), message.target_component_id())
        {
            self.message(sender, &message);
        }
        self.announce();
    }

    fn message(&mut self, sender: Sender, message: &MavMessage) {
        match message {
            MavMessage::SET_ATTITUDE_TARGET(target) => {
                self.flight.receive(self.now_us, target, &mut self.rng);
            }
            MavMessage::VISION_POSITION_ESTIMATE(pose) => {
                let position = Ned::new(pose.x.into(), pose.y.into(), pose.z.into());
                self.take_outside_pose(pose.usec, position, pose.reset_counter);
            }
            MavMessage::ODOMETRY(pose) if self.flight.personality.takes_odometry(pose) => {
                let position = Ned::new(pose.x.into(), pose.y.into(), pose.z.into());
                self.take_outside_pose(pose.time_usec, position, pose.reset_counter);
            }
            MavMessage::TIMESYNC(request) if request.tc1 == 0 => {
                self.reply(sender, &self.timesync_answer(sender, request.ts1));
            }
            MavMessage::HEARTBEAT(heartbeat) => {
                self.flight.receive_heartbeat(self.now_us, sender.system, heartbeat.mavtype);
            }
            MavMessage::MANUAL_CONTROL(sticks)
                if sticks.target == SYSTEM_ID || sticks.target == 0 =>
            {
                self.flight.take_sticks(self.now_us, sticks_of(sticks));
            }
            MavMessage::SET_MODE(request) => {
                let custom =
                    request.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED);
                let mode = self.flight.personality.mode_of_custom_mode(request.custom_mode);
                let result = self.set_mode(custom, mode);
                self.acknowledge(sender, MavCmd::MAV_CMD_DO_SET_MODE as u16, result);
            }
            MavMessage::PARAM_REQUEST_LIST(_) => self.links[sender.link].parameter_list = Some(0),
            MavMessage::PARAM_REQUEST_READ(request) => self.read_parameter(sender, request),
            MavMessage::PARAM_SET(request) => self.set_parameter(sender, request),
            MavMessage::MISSION_REQUEST_LIST(request) => {
                let message = MavMessage::MISSION_COUNT(MISSION_COUNT_DATA {
                    count: 0,
                    target_system: sender.system,
                    target_component: sender.component,
                    mission_type: request.mission_type,
                    ..Default::default()
                });
                self.reply(sender, &message);
            }
            MavMessage::MISSION_CLEAR_ALL(request) => {
                let accepted = MavMissionResult::MAV_MISSION_ACCEPTED;
                self.reply(sender, &mission_ack(sender, accepted, request.mission_type));
            }
            MavMessage::MISSION_COUNT(request) => {
                // The mission is always empty.
                let result = match request.count {
                    0 => MavMissionResult::MAV_MISSION_ACCEPTED,
                    _ => MavMissionResult::MAV_MISSION_UNSUPPORTED,
                };
                self.reply(sender, &mission_ack(sender, result, request.mission_type));
            }
            MavMessage::FILE_TRANSFER_PROTOCOL(request) => {
                if let Some(answer) = ftp::answer(request, sender.system, sender.component) {
                    self.reply(sender, &MavMessage::FILE_TRANSFER_PROTOCOL(answer));
                }
            }
            MavMessage::PING(request)
                if (request.target_system, request.target_component) == (0, 0) =>
            {
                let message = MavMessage::PING(PING_DATA {
                    target_system: sender.system,
                    target_component: sender.component,
                    ..request.clone()
                });
                self.reply(sender, &message);
            }
            // Once a key is set, only a sender that knows it gets here.
            MavMessage::SETUP_SIGNING(data) if !self.flight.commander.armed() => {
                self.sign(signing::requested(data));
            }
            _ => {}
        }
    }

    fn take_outside_pose(&mut self, stamp_us: u64, position: Ned, reset_count: u8) {
        let pose = OutsidePose { stamp_us, position, reset_count };
        self.flight.take_outside_pose(self.now_us, &pose);
    }

    fn timesync_answer(&self, sender: Sender, ts1: i64) -> MavMessage {
        MavMessage::TIMESYNC(TIMESYNC_DATA {
            tc1: (self.now_us * 1000).cast_signed(),
            ts1,
            target_system: sender.system,
            target_component: sender.component,
        })
    }
}

/// The link id of a peer in signatures.
fn link_number(peer: Peer) -> u8 {
    peer.0 as u8
}

/// Whether a message is for this vehicle; 0 or a missing target addresses all.
fn addressed(system: Option<u8>, component: Option<u8>) -> bool {
    system.is_none_or(|id| id == 0 || id == SYSTEM_ID)
        && component.is_none_or(|id| id == 0 || id == COMPONENT_ID)
}

fn sticks_of(message: &MANUAL_CONTROL_DATA) -> Sticks {
    let axis = |value: i16| (f64::from(value) / 1000.0).clamp(-1.0, 1.0);
    Sticks {
        forward: axis(message.x),
        right: axis(message.y),
        // Thrust in 0..1000, centred at 500.
        up: (f64::from(message.z) / 500.0 - 1.0).clamp(-1.0, 1.0),
        turn: axis(message.r),
    }
}

fn mission_ack(to: Sender, mavtype: MavMissionResult, mission_type: MavMissionType) -> MavMessage {
    MavMessage::MISSION_ACK(MISSION_ACK_DATA {
        target_system: to.system,
        target_component: to.component,
        mavtype,
        mission_type,
        ..Default::default()
    })
}
