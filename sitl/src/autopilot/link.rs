//! The vehicle's end of a link to a peer.

use mavlink::MavlinkVersion;
use wire::dialect::MavMessage;
use wire::signing::{Signer, Stamp};
use wire::{Decoder, Encoder, Frame};

use super::streams::{Schedule, StreamRules};
use super::telemetry::Snapshot;
use super::{COMPONENT_ID, SYSTEM_ID};

/// A remote end, with a number chosen by the owner of the transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Peer(pub u32);

/// How bytes from a peer arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkKind {
    /// Whole datagrams (UDP, or in-process frames): no frame spans two.
    Datagrams,
    /// A stream (TCP, serial): a frame may arrive in pieces.
    Stream,
}

/// Decodes the bytes of one peer to frames.
pub(super) struct Receiver {
    pub(super) peer: Peer,
    kind: LinkKind,
    decoder: Decoder,
}

impl Receiver {
    pub(super) fn new(peer: Peer, kind: LinkKind) -> Self {
        Self { peer, kind, decoder: Decoder::new() }
    }

    pub(super) fn receive(&mut self, bytes: &[u8], mut on_frame: impl FnMut(&Frame)) {
        if self.kind == LinkKind::Datagrams {
            return self.decoder.datagram(bytes, |frame| on_frame(&frame));
        }
        self.decoder.push(bytes);
        while let Some(frame) = self.decoder.next_frame() {
            on_frame(&frame);
        }
    }
}

/// Outgoing frames, in order.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    bytes: Vec<u8>,
    frames: Vec<(Peer, usize)>,
}

impl Outbox {
    /// Delivers and removes all frames; keeps the buffers.
    pub(super) fn take(&mut self, mut deliver: impl FnMut(Peer, &[u8])) {
        let mut start = 0;
        for (peer, end) in self.frames.drain(..) {
            deliver(peer, &self.bytes[start..end]);
            start = end;
        }
        self.bytes.clear();
    }
}

/// The outgoing side of a link: encoder, schedule and pending parameter list.
///
/// As with PX4, the vehicle sends MAVLink 1 until the peer sends MAVLink 2; until then it skips
/// messages that MAVLink 1 cannot carry. PX4's streams belong to a link. Here each peer has its own
/// rates, so one peer cannot change another's.
pub(super) struct Link {
    pub(super) peer: Peer,
    encoder: Encoder,
    uses_v2: bool,
    pub(super) schedule: Schedule,
    /// Index of the next parameter, while a parameter list is being sent.
    pub(super) parameter_list: Option<usize>,
}

impl Link {
    pub(super) fn new(peer: Peer, rules: &'static StreamRules, now_us: u64) -> Self {
        let mut encoder = Encoder::new(SYSTEM_ID, COMPONENT_ID);
        encoder.set_version(MavlinkVersion::V1);
        let schedule = Schedule::new(rules, now_us);
        Self { peer, encoder, uses_v2: false, schedule, parameter_list: None }
    }

    /// Starts or stops signing with the next frame. Signed frames are MAVLink 2.
    pub(super) fn sign(&mut self, signer: Option<Signer>) {
        self.uses_v2 |= signer.is_some();
        self.encoder.set_signer(signer);
    }

    /// Advances the signing time.
    pub(super) fn turn(&mut self, now: Stamp) {
        self.encoder.signer().into_iter().for_each(|signer| signer.turn(now));
    }

    /// Records the peer's protocol version.
    pub(super) fn note_version(&mut self, version: MavlinkVersion) {
        if version == MavlinkVersion::V2 && !self.uses_v2 {
            self.uses_v2 = true;
            self.encoder.set_version(MavlinkVersion::V2);
        }
    }

    /// Whether the peer's protocol version can carry a message with this id.
    pub(super) fn can_carry(&self, id: u32) -> bool {
        self.uses_v2 || id <= u8::MAX.into()
    }

    /// Queues `message`, unless the peer's protocol version cannot carry it.
    pub(super) fn send(&mut self, message: &MavMessage, outbox: &mut Outbox) {
        if self.encoder.encode(message, &mut outbox.bytes) {
            outbox.frames.push((self.peer, outbox.bytes.len()));
        }
    }

    /// Queues the messages that are due at the time of `snapshot`.
    pub(super) fn send_due(&mut self, snapshot: &Snapshot<'_>, outbox: &mut Outbox) {
        let Self { peer, encoder, schedule, .. } = self;
        schedule.take_due(snapshot.now_us, |stream| {
            if let Some(message) = snapshot.message(stream)
                && encoder.encode(&message, &mut outbox.bytes)
            {
                outbox.frames.push((*peer, outbox.bytes.len()));
            }
        });
    }

    /// Queues a message that the dialect's types cannot express.
    pub(super) fn send_data<D: mavlink::MessageData>(&mut self, data: &D, outbox: &mut Outbox) {
        if self.encoder.encode_data(data, &mut outbox.bytes) {
            outbox.frames.push((self.peer, outbox.bytes.len()));
        }
    }
}
