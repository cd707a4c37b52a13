//! The session with one vehicle, sans I/O: bytes and time in; messages, events and frames out.
//!
//! The driver calls [`Session::receive`] for arriving bytes, and [`Session::poll`] at
//! [`Session::next_deadline`]. After either it drains [`Session::transmit`] and
//! [`Session::next_event`].

mod core;
mod outbox;

use std::fmt;
use std::time::Duration;

use mavlink::{MavlinkVersion, MessageData};
use wire::dialect::{
    AUTOPILOT_VERSION_DATA, COMMAND_ACK_DATA, PARAM_ERROR_DATA, PARAM_VALUE_DATA,
    SET_ATTITUDE_TARGET_DATA, TIMESYNC_DATA,
};
use wire::signing::{Key, Refused, Stamp};
use wire::transport::{PEERS_MAX, Peer};
use wire::{Decoder, DecoderStats};

use self::core::Core;
use super::attitude_target::{EncodeError, ThrustMap};
use super::budget::LineBudget;
use super::counters::{LinkState, LinkStats, RefusalCount, Sender};
use super::external_pose::{ExternalPose, PoseForm};
use super::intervals::IntervalEvent;
use super::load::LinkLoad;
use super::profile::{FormChoice, MessageRate, Profile};
use super::received::Received;
use super::request::{Outcome, Request, RequestId};
use super::signing::{FrameRejection, SigningSettings};
use super::vehicle_clock::ClockEstimate;
use crate::clock::{HostTime, VehicleTime};
use crate::guard::Cleared;

/// Message id of the frames that carry setpoints.
pub const SETPOINT_ID: u32 = SET_ATTITUDE_TARGET_DATA::ID;
/// Messages that answer requests.
const ANSWERS: [u32; 5] = [
    TIMESYNC_DATA::ID,
    COMMAND_ACK_DATA::ID,
    PARAM_VALUE_DATA::ID,
    PARAM_ERROR_DATA::ID,
    AUTOPILOT_VERSION_DATA::ID,
];

/// Settings of a session.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Own system id.
    pub system: u8,
    /// Own component id.
    pub component: u8,
    /// The vehicle's system id; `None` takes the first autopilot that appears.
    pub vehicle_system: Option<u8>,
    /// Whether the vehicle file has `attitude_pd`.
    pub vehicle_has_attitude_pd: bool,
    /// The form of setpoints.
    pub form: FormChoice,
    /// Maps newtons to the thrust field.
    pub thrust: ThrustMap,
    /// Messages to request, whatever they cost; `None` requests the profile's, as far as the line
    /// has room.
    pub telemetry: Option<Vec<MessageRate>>,
    /// Whether to answer the vehicle's TIMESYNC requests. Two stations that answer confuse it.
    pub answer_timesync: bool,
    /// Whether these answers carry the vehicle's own clock as estimated here. The vehicle then
    /// accepts stamps of its own clock unchanged.
    pub answers_in_vehicle_time: bool,
    /// Silence after which the link is stale.
    pub stale_after: Duration,
    /// Silence after which the vehicle is lost.
    pub lost_after: Duration,
    /// The link's name in messages, such as its URL.
    pub endpoint: Option<String>,
    /// Bits per second of a serial line, to which the profile's messages are fitted.
    pub baud: Option<u32>,
    /// Signing; `None` signs nothing and accepts all frames.
    pub signing: Option<SigningSettings>,
}

impl Settings {
    /// The usual settings: an onboard computer (component 191) of system 254.
    pub fn new(thrust: ThrustMap) -> Self {
        Self {
            system: 254,
            component: 191,
            vehicle_system: None,
            vehicle_has_attitude_pd: false,
            form: FormChoice::Profile,
            thrust,
            telemetry: None,
            answer_timesync: true,
            answers_in_vehicle_time: false,
            stale_after: Duration::from_millis(2500),
            lost_after: Duration::from_secs(5),
            endpoint: None,
            baud: None,
            signing: None,
        }
    }
}

/// What [`Session::receive`] delivers, in order of arrival.
#[derive(Debug)]
pub enum Delivery<'a> {
    /// A frame of any sender, as it was on the wire.
    Frame {
        /// The peer that sent it.
        peer: Peer,
        /// The whole frame.
        bytes: &'a [u8],
    },
    /// From here on a different vehicle answers under the ids of the known one.
    /// [`Event::VehicleReplaced`] reports it afterwards.
    Replaced,
    /// A message from the vehicle.
    Message(Received),
}

/// News of the session.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The link's state changed.
    State {
        /// Old state.
        from: LinkState,
        /// New state.
        to: LinkState,
    },
    /// A vehicle was found, for the first time or again after it was lost.
    VehicleFound(VehicleId),
    /// A second autopilot appeared, and nothing decides which one is meant.
    AnotherAutopilot {
        /// The first one.
        vehicle: VehicleId,
        /// The second one.
        other: VehicleId,
    },
    /// The HEARTBEAT shows that a different vehicle answers under the known ids. It is identified
    /// before it gets setpoints, and requests to the former vehicle end.
    VehicleReplaced(VehicleId),
    /// The vehicle is identified and can get setpoints.
    Identified {
        /// Its profile.
        profile: Box<Profile>,
        /// Whether it answered with its version.
        is_version_known: bool,
    },
    /// A request ended.
    Request {
        /// Its id.
        id: RequestId,
        /// The request.
        request: Request,
        /// How it ended.
        outcome: Outcome,
    },
    /// News of a message interval.
    Interval(IntervalEvent),
    /// The wanted messages need more of the serial line than it can carry reliably.
    LineBudget(Box<LineBudget>),
    /// The vehicle answered a TIMESYNC request after this round trip.
    RoundTrip(Duration),
    /// The vehicle's clock jumped. A jump beyond a second, in either direction, may mean another
    /// vehicle, so it is identified again before it gets setpoints.
    ClockJump {
        /// Size of the jump, ns.
        by_ns: i64,
    },
    /// A frame was rejected, for a new reason.
    FrameRejected(FrameRejection),
}

/// The identity of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VehicleId {
    /// System id.
    pub system: u8,
    /// Component id of its autopilot.
    pub component: u8,
    /// MAV_AUTOPILOT.
    pub autopilot: u8,
    /// MAV_TYPE.
    pub vehicle_type: u8,
    /// The peer from which it was received.
    pub peer: Peer,
}

impl VehicleId {
    /// Whether its autopilot is one that can be flown. An unknown autopilot replaces a known one
    /// only under the same ids, once that one is lost.
    pub fn is_known(&self) -> bool {
        matches!(self.autopilot, 3 | 12)
    }

    /// Whether `other`, which has the same system and component, is a different vehicle.
    fn is_another(&self, other: &Self) -> bool {
        (self.autopilot, self.vehicle_type) != (other.autopilot, other.vehicle_type)
    }
}

impl fmt::Display for VehicleId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let autopilot = match self.autopilot {
            3 => "ArduPilot",
            12 => "PX4",
            _ => "unknown",
        };
        let vehicle_type = match self.vehicle_type {
            2 => "quadrotor",
            13 => "hexarotor",
            14 => "octorotor",
            _ => "other",
        };
        write!(
            f,
            "system {} component {}: autopilot {autopilot} ({}), type {vehicle_type} ({})",
            self.system, self.component, self.autopilot, self.vehicle_type
        )
    }
}

/// Why a setpoint was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SetpointError {
    /// No vehicle is connected.
    #[error("no vehicle is connected")]
    NotConnected,
    /// The form that the vehicle takes is not known yet.
    #[error("the vehicle is not identified yet")]
    NotIdentified,
    /// The setpoint has no message in that form.
    #[error(transparent)]
    Encode(#[from] EncodeError),
}

/// A session with one vehicle.
#[derive(Debug)]
pub struct Session {
    datagrams: Decoder,
    streams: Vec<(Peer, Decoder)>,
    /// Statistics of the decoders of closed streams.
    closed: DecoderStats,
    core: Core,
}

impl Session {
    /// A session that has received nothing yet.
    pub fn new(settings: Settings, now: HostTime) -> Self {
        Self {
            datagrams: Decoder::new(),
            streams: Vec::new(),
            closed: DecoderStats::default(),
            core: Core::new(settings, now),
        }
    }

    /// Takes bytes that arrived from a peer, and passes what they contain to `on`.
    pub fn receive(
        &mut self,
        now: HostTime,
        peer: Peer,
        bytes: &[u8],
        is_datagram: bool,
        on: &mut impl FnMut(Delivery<'_>),
    ) {
        let core = &mut self.core;
        if is_datagram {
            return self.datagrams.datagram(bytes, |frame| core.frame(now, peer, &frame, on));
        }
        let index = match self.streams.iter().position(|(known, _)| *known == peer) {
            Some(index) => index,
            None => {
                if self.streams.len() == PEERS_MAX {
                    let (_, oldest) = self.streams.remove(0);
                    self.closed = sum(self.closed, oldest.stats());
                }
                self.streams.push((peer, Decoder::new()));
                self.streams.len() - 1
            }
        };
        let (_, decoder) = &mut self.streams[index];
        decoder.push(bytes);
        while let Some(frame) = decoder.next_frame() {
            core.frame(now, peer, &frame, on);
        }
    }

    /// Notes that a peer's connection closed. Returns whether it was the vehicle's, whose next
    /// heartbeat then gives the new one.
    pub fn peer_closed(&mut self, peer: Peer) -> bool {
        for (_, decoder) in self.streams.extract_if(.., |(known, _)| *known == peer) {
            self.closed = sum(self.closed, decoder.stats());
        }
        let vehicle = self.core.vehicle.as_mut().filter(|vehicle| vehicle.peer == Some(peer));
        vehicle.map(|vehicle| vehicle.peer = None).is_some()
    }

    /// Notes that the transport closed: all peers are gone, and their numbers may be reused.
    pub fn transport_closed(&mut self) {
        for (_, decoder) in self.streams.drain(..) {
            self.closed = sum(self.closed, decoder.stats());
        }
        if let Some(vehicle) = &mut self.core.vehicle {
            vehicle.peer = None;
        }
        self.core.transport_closed();
    }

    /// Does what is due at `now`.
    pub fn poll(&mut self, now: HostTime) {
        self.core.poll(now);
    }

    /// The next time at which [`poll`](Self::poll) must run.
    pub fn next_deadline(&self) -> HostTime {
        self.core.next_deadline()
    }

    /// Queues a setpoint for the vehicle, in the form of its profile.
    ///
    /// # Errors
    /// [`SetpointError`]; then nothing is sent.
    pub fn send_setpoint(
        &mut self,
        now: HostTime,
        setpoint: &Cleared,
    ) -> Result<(), SetpointError> {
        self.core.send_setpoint(now, setpoint)
    }

    /// Queues a pose for the vehicle, stamped with its clock. Returns whether a vehicle is
    /// connected.
    pub fn send_pose(&mut self, pose: &ExternalPose, form: PoseForm) -> bool {
        let is_there = self.core.state == LinkState::Connected && self.vehicle_peer().is_some();
        if is_there {
            self.core.send(&pose.message(form));
        }
        is_there
    }

    /// Sends a request to the vehicle. [`Event::Request`] reports how it ended.
    pub fn request(&mut self, now: HostTime, request: Request) -> RequestId {
        let core = &mut self.core;
        if matches!(core.state, LinkState::Searching | LinkState::Lost) {
            let id = core.requests.refuse(request, Outcome::NotConnected);
            core.collect_ended();
            return id;
        }
        let codec = &core.codec;
        let is_known = |name: &str| codec.parameter_type(name).is_some();
        let id = core.requests.submit(now, request, core.profile.as_ref(), is_known);
        core.send_requests(now);
        id
    }

    /// Sends the vehicle a key and the time to sign with, or an empty key to stop signing. Nothing
    /// acknowledges it, and no log contains it.
    pub fn set_up_signing(&mut self, key: Option<(&Key, Stamp)>) {
        self.core.set_up_signing(key);
    }

    /// Ends all pending commands; none is repeated.
    pub fn withdraw_commands(&mut self) {
        self.core.requests.withdraw();
        self.core.collect_ended();
    }

    /// Forwards another station's frame to the vehicle, if there is one.
    pub fn forward(&mut self, frame: &[u8]) {
        let Core { vehicle, outbox, .. } = &mut self.core;
        if let Some(peer) = vehicle.as_ref().and_then(|vehicle| vehicle.peer) {
            outbox.push_frame(peer, frame);
        }
    }

    /// Passes the frames to send since the last call to `send`, each with its peer; `None` means
    /// every peer. `send` returns whether the frame left. A frame that did not is dropped and
    /// counted.
    pub fn transmit(&mut self, mut send: impl FnMut(Option<Peer>, &[u8]) -> bool) {
        let counters = &mut self.core.counters;
        self.core.outbox.drain(|to, frame| {
            if send(to, frame) {
                counters.sent_frames += 1;
                counters.sent_bytes += frame.len() as u64;
            } else {
                counters.dropped += 1;
            }
        });
    }

    /// The next event, oldest first.
    pub fn next_event(&mut self) -> Option<Event> {
        self.core.events.pop_front()
    }

    /// The state of the link.
    pub fn state(&self) -> LinkState {
        self.core.state
    }

    /// The vehicle, once found.
    pub fn vehicle(&self) -> Option<VehicleId> {
        self.core.vehicle.as_ref().map(|vehicle| vehicle.id)
    }

    /// The vehicle's peer; `None` before it is found, and after its connection closed.
    pub fn vehicle_peer(&self) -> Option<Peer> {
        self.core.vehicle.as_ref().and_then(|vehicle| vehicle.peer)
    }

    /// Autopilots besides the vehicle's, where none was chosen.
    pub fn others(&self) -> &[VehicleId] {
        &self.core.others
    }

    /// The link's name in messages.
    pub fn endpoint(&self) -> Option<&str> {
        self.core.settings.endpoint.as_deref()
    }

    /// The system id from the settings.
    pub fn requested_system(&self) -> Option<u8> {
        self.core.settings.vehicle_system
    }

    /// Senders besides the vehicle, in order of appearance.
    pub fn senders(&self) -> &[Sender] {
        self.core.counters.senders()
    }

    /// Whether the vehicle signs its messages.
    pub fn is_signed(&self) -> bool {
        self.core.vehicle.as_ref().is_some_and(|vehicle| vehicle.is_signed)
    }

    /// Whether the vehicle has answered any frame from this session, signed or not: a TIMESYNC
    /// answer carries the stamp of its request.
    pub fn is_answered(&self) -> bool {
        self.core.clock.round_trip().is_some()
    }

    /// The messages requested over a serial line; `None` on any other link, and before the vehicle
    /// is known.
    pub fn budget(&self) -> Option<&LineBudget> {
        self.core.budget.as_ref()
    }

    /// The load of the vehicle's messages, and the part of it that was not requested.
    pub fn load(&self) -> LinkLoad {
        let Core { counters, intervals, .. } = &self.core;
        let is_requested = |id| intervals.is_requested(id) || ANSWERS.contains(&id);
        LinkLoad::of(&counters.messages(), self.is_signed(), is_requested)
    }

    /// Whether this session signs, and accepts only signed frames.
    pub fn signs(&self) -> bool {
        self.core.signing.is_some()
    }

    /// Frames that were rejected for their signature, by reason.
    pub fn rejected_frames(&self) -> impl Iterator<Item = (Refused, u64)> + '_ {
        self.core.signing.iter().flat_map(|signing| signing.refused())
    }

    /// The MAVLink version of the vehicle's newest frame, 1 or 2.
    pub fn protocol(&self) -> Option<u8> {
        self.core.vehicle.as_ref().map(|vehicle| match vehicle.version {
            MavlinkVersion::V1 => 1,
            MavlinkVersion::V2 => 2,
        })
    }

    /// Messages from the vehicle that were rejected, by id.
    pub fn refusals(&self) -> &[RefusalCount] {
        self.core.counters.refusals()
    }

    /// Statistics of the decoders of all peers, closed ones included.
    pub fn received(&self) -> DecoderStats {
        let streams = self.streams.iter().map(|(_, decoder)| decoder.stats());
        streams.fold(sum(self.closed, self.datagrams.stats()), sum)
    }

    /// When the vehicle's last frame arrived, once it was found.
    pub fn last_received(&self) -> Option<HostTime> {
        self.core.vehicle.as_ref().map(|vehicle| vehicle.last_received)
    }

    /// The vehicle's profile, once identified and until lost.
    pub fn profile(&self) -> Option<&Profile> {
        self.core.profile.as_ref()
    }

    /// Host time at which the vehicle's clock reads `time`, once the offset is known.
    pub fn to_host(&self, time: VehicleTime) -> Option<HostTime> {
        self.core.clock.to_host(time)
    }

    /// The vehicle's clock relative to the host's.
    pub fn clock(&self) -> Option<ClockEstimate> {
        self.core.clock.estimate()
    }

    /// Maps newtons to the thrust field.
    pub fn thrust_map(&self) -> ThrustMap {
        self.core.settings.thrust
    }

    /// A snapshot of the counters.
    pub fn stats(&self) -> LinkStats {
        let core = &self.core;
        LinkStats {
            state: core.state,
            vehicle: core.vehicle.as_ref().map(|v| (v.id.system.into(), v.id.component)),
            received: self.received(),
            foreign: core.counters.foreign,
            stray: core.counters.stray,
            refused: core.counters.refused,
            vehicle_frames: core.counters.vehicle_frames,
            lost: core.sequence.lost(),
            repeated: core.counters.repeated,
            sent_frames: core.counters.sent_frames,
            sent_bytes: core.counters.sent_bytes,
            dropped: core.counters.dropped,
            round_trip: core.clock.round_trip(),
            clock: core.clock.estimate(),
            messages: core.counters.messages(),
        }
    }
}

fn sum(a: DecoderStats, b: DecoderStats) -> DecoderStats {
    DecoderStats {
        bytes: a.bytes + b.bytes,
        frames: a.frames + b.frames,
        crc_errors: a.crc_errors + b.crc_errors,
        unknown: a.unknown + b.unknown,
        unframed_bytes: a.unframed_bytes + b.unframed_bytes,
    }
}
