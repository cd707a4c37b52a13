//! The session with one vehicle, sans I/O: bytes and time in; messages, events and frames out.
//!
//! The driver calls [`Session::receive`] for arriving bytes, and [`Session::poll`] at
//! [`Session::next_deadline`]. After either it drains [`Session::transmit`] and
//! [`Session::next_event`].

mod core;
mod decoders;
mod event;
mod novelty;
mod outbox;
mod settings;
mod vehicle_id;

use mavlink::{MavlinkVersion, MessageData};
use wire::dialect::{
    AUTOPILOT_VERSION_DATA, COMMAND_ACK_DATA, PARAM_ERROR_DATA, PARAM_VALUE_DATA,
    SET_ATTITUDE_TARGET_DATA, TIMESYNC_DATA,
};
use wire::signing::{Key, Refused, Stamp};
use wire::transport::Peer;
use wire::{DecoderStats, Frame};

use self::core::Core;
use self::decoders::Decoders;
pub use self::event::{Delivery, Event};
pub use self::settings::Settings;
pub use self::vehicle_id::VehicleId;
use super::attitude_target::EncodeError;
use super::budget::LineBudget;
use super::counters::{LinkState, LinkStats, RefusalCount, Sender};
use super::external_pose::{ExternalPose, PoseForm};
use super::load::LinkLoad;
use super::profile::Profile;
use super::request::{Outcome, Request, RequestId};
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
    decoders: Decoders,
    core: Core,
}

impl Session {
    /// A session that has received nothing yet.
    pub fn new(settings: Settings, now: HostTime) -> Self {
        Self { decoders: Decoders::default(), core: Core::new(settings, now) }
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
        let Self { decoders, core } = self;
        let on_frame = |frame: Frame| core.frame(now, peer, &frame, on);
        if is_datagram {
            decoders.datagram(bytes, on_frame);
        } else {
            decoders.stream(peer, bytes, on_frame);
        }
    }

    /// Notes that a peer's connection closed. Returns whether it was the vehicle's, whose next
    /// heartbeat then gives the new one.
    pub fn peer_closed(&mut self, peer: Peer) -> bool {
        self.decoders.close(peer);
        let vehicle = self.core.vehicle.as_mut().filter(|vehicle| vehicle.peer == Some(peer));
        vehicle.map(|vehicle| vehicle.peer = None).is_some()
    }

    /// Notes that the transport closed: all peers are gone, and their numbers may be reused.
    pub fn transport_closed(&mut self) {
        self.decoders.close_all();
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
        self.decoders.stats()
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
            lost: core.novelty.lost(),
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
