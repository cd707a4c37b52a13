//! The vehicle's end of a link to one peer.

use mavlink::MavlinkVersion;
use wire::dialect::MavMessage;
use wire::signing::{Signer, Stamp};
use wire::{Decoder, Encoder, Frame};

use super::streams::{Schedule, StreamRules};
use super::telemetry::Snapshot;
use super::{COMPONENT_ID, SYSTEM_ID};

/// A remote end, numbered by whoever carries the bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Peer(pub u32);

/// How bytes come from a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkKind {
    /// Whole datagrams (UDP, or frames handed over in process): no frame spans two.
    Datagrams,
    /// A stream (TCP, serial): a frame may come in pieces.
    Stream,
}

/// Bytes to frames, of one peer.
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

/// Frames on their way out, in order.
#[derive(Debug, Default)]
pub(super) struct Outbox {
    bytes: Vec<u8>,
    frames: Vec<(Peer, usize)>,
}

impl Outbox {
    /// Hands over every frame and forgets it; the buffers stay.
    pub(super) fn take(&mut self, mut deliver: impl FnMut(Peer, &[u8])) {
        let mut start = 0;
        for (peer, end) in self.frames.drain(..) {
            deliver(peer, &self.bytes[start..end]);
            start = end;
        }
        self.bytes.clear();
    }
}

/// What the vehicle sends to one peer, and when.
///
/// As PX4, the vehicle speaks MAVLink 1 to a peer until it hears MAVLink 2 from it; messages that
/// MAVLink 1 cannot carry are then left out. Unlike PX4, whose streams belong to a link, every peer
/// has its own rates, so that one cannot change another's.
pub(super) struct Link {
    pub(super) peer: Peer,
    encoder: Encoder,
    speaks_v2: bool,
    pub(super) schedule: Schedule,
    /// Index of the next parameter of a list that is being sent.
    pub(super) parameter_list: Option<usize>,
}

impl Link {
    pub(super) fn new(peer: Peer, rules: &'static StreamRules, now_us: u64) -> Self {
        let mut encoder = Encoder::new(SYSTEM_ID, COMPONENT_ID);
        encoder.set_version(MavlinkVersion::V1);
        let schedule = Schedule::new(rules, now_us);
        Self { peer, encoder, speaks_v2: false, schedule, parameter_list: None }
    }

    /// Signs from the next frame on, or not any more. What is signed is MAVLink 2.
    pub(super) fn sign(&mut self, signer: Option<Signer>) {
        self.speaks_v2 |= signer.is_some();
        self.encoder.set_signer(signer);
    }

    /// Advances the time of the signatures.
    pub(super) fn turn(&mut self, now: Stamp) {
        self.encoder.signer().into_iter().for_each(|signer| signer.turn(now));
    }

    /// Notes the version that the peer speaks.
    pub(super) fn hear(&mut self, version: MavlinkVersion) {
        if version == MavlinkVersion::V2 && !self.speaks_v2 {
            self.speaks_v2 = true;
            self.encoder.set_version(MavlinkVersion::V2);
        }
    }

    /// Whether a message of this id reaches the peer.
    pub(super) fn can_carry(&self, id: u32) -> bool {
        self.speaks_v2 || id <= u8::MAX.into()
    }

    /// Queues `message`, unless the peer's protocol version cannot carry it.
    pub(super) fn send(&mut self, message: &MavMessage, outbox: &mut Outbox) {
        if self.encoder.encode(message, &mut outbox.bytes) {
            outbox.frames.push((self.peer, outbox.bytes.len()));
        }
    }

    /// Queues what is due at the time of `snapshot`.
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

    /// Queues a message given as payload.
    pub(super) fn send_data<D: mavlink::MessageData>(&mut self, data: &D, outbox: &mut Outbox) {
        if self.encoder.encode_data(data, &mut outbox.bytes) {
            outbox.frames.push((self.peer, outbox.bytes.len()));
        }
    }
}
