//! Verifies the signatures and stamps of frames.

use std::collections::VecDeque;

use mavlink::MavlinkVersion;

use super::{HASH_LEN, Key, Stamp, hash};
use crate::framing::{Frame, Signature};

/// Largest number of streams. Only a sender that knows the key can begin one.
const STREAMS_MAX: usize = 64;
/// Largest lag of a new stream's first stamp behind the newest known time: a minute, as in MAVLink.
const BEHIND_MAX: u64 = 60 * Stamp::PER_S;

/// Frames may overtake one another: a new frame is accepted up to this far behind the newest of its
/// stream. Otherwise a message that the pilot has taken over, sent once, could be lost.
const OVERTAKEN_MAX: u64 = Stamp::PER_S;
/// Number of stamps kept for each stream; a frame older than all of them is refused.
const SEEN_MAX: usize = 512;

/// Identifies a stream of stamps: each link of each component has its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamId {
    /// System id.
    pub system: u32,
    /// Component id.
    pub component: u8,
    /// Link id, chosen by the sender.
    pub link: u8,
}

/// The newest stamp of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamStamp {
    /// The stream.
    pub id: StreamId,
    /// Newest accepted stamp.
    pub newest: Stamp,
}

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
pub enum Refused {
    /// A MAVLink 1 frame, which has no room for a signature.
    #[error("MAVLink 1, which cannot be signed")]
    OldProtocol,
    /// The frame has no signature.
    #[error("no signature")]
    Unsigned,
    /// The signature belongs to a different key or to different bytes.
    #[error("wrong signature: another key, or altered in transit")]
    Signature,
    /// The stream already had this stamp, or one that is too much later.
    #[error("stamp already used, or too old for its stream: a replay or a copy")]
    Replayed,
    /// The stream is new, and its stamp is more than a minute behind the newest accepted stamp or
    /// the clock, whichever is later.
    #[error("a new stream whose stamp is more than a minute behind the newest known time")]
    Old,
    /// The stamp is further ahead of the clock than the settings allow.
    #[error("stamp too far ahead of this computer's clock")]
    Ahead,
    /// The table of streams is full.
    #[error("too many streams")]
    Streams,
}

impl Refused {
    /// Every reason, in the order of the counters.
    pub const ALL: [Self; 7] = [
        Self::OldProtocol,
        Self::Unsigned,
        Self::Signature,
        Self::Replayed,
        Self::Old,
        Self::Ahead,
        Self::Streams,
    ];

    /// The reason's name in counters.
    pub const fn name(self) -> &'static str {
        match self {
            Self::OldProtocol => "mavlink1",
            Self::Unsigned => "unsigned",
            Self::Signature => "signature",
            Self::Replayed => "replayed",
            Self::Old => "old",
            Self::Ahead => "ahead",
            Self::Streams => "streams",
        }
    }
}

/// What a verifier accepts.
#[derive(Clone, Debug, PartialEq)]
pub struct VerifierSettings {
    /// The shared key.
    pub key: Key,
    /// Ids of messages that are accepted without a signature.
    pub unsigned: Vec<u32>,
    /// Largest lead of an accepted stamp over the clock, in units of [`Stamp`].
    pub ahead_max: u64,
    /// Newest stamps from earlier sessions.
    pub streams: Vec<StreamStamp>,
}

/// The recent stamps of a stream, which older ones may still follow.
#[derive(Clone, Debug)]
struct Window {
    /// This stamp and everything before it is refused.
    floor: Stamp,
    /// Accepted stamps after `floor`, in order.
    seen: VecDeque<Stamp>,
}

impl Window {
    fn new(floor: Stamp) -> Self {
        Self { floor, seen: VecDeque::with_capacity(SEEN_MAX + 1) }
    }

    /// Accepts a stamp, unless it was, or may have been, accepted before.
    fn take(&mut self, stamp: Stamp) -> bool {
        let Err(place) = self.seen.binary_search(&stamp) else { return false };
        if stamp <= self.floor {
            return false;
        }
        self.seen.insert(place, stamp);
        if self.seen.len() > SEEN_MAX {
            self.floor = self.seen.pop_front().unwrap_or(self.floor);
        }
        true
    }
}

/// Verifies the frames of any number of senders with one key.
#[derive(Clone, Debug)]
pub struct Verifier {
    settings: VerifierSettings,
    now: Stamp,
    newest: Stamp,
    streams: Vec<StreamStamp>,
    /// One window for each stream.
    windows: Vec<Window>,
    refused: [u64; Refused::ALL.len()],
    accepted: u64,
}

impl Verifier {
    /// Creates a verifier. In the streams of `settings.streams` it accepts only stamps later than
    /// theirs.
    pub fn new(settings: VerifierSettings, now: Stamp) -> Self {
        let mut streams = Vec::with_capacity(STREAMS_MAX);
        streams.extend(settings.streams.iter().copied().take(STREAMS_MAX));
        let windows =
            streams.iter().map(|stream: &StreamStamp| Window::new(stream.newest)).collect();
        let refused = Default::default();
        Self { settings, now, newest: now, streams, windows, refused, accepted: 0 }
    }

    /// Advances the time, which never goes back.
    pub fn turn(&mut self, now: Stamp) {
        self.now = self.now.max(now);
        self.newest = self.newest.max(now);
    }

    /// Verifies and counts a frame. Returns its stamp, or `None` if it is accepted without a
    /// signature.
    ///
    /// # Errors
    /// [`Refused`]. A refused frame changes nothing except its counter.
    pub fn check(&mut self, frame: &Frame) -> Result<Option<Stamp>, Refused> {
        let judged = self.judge(frame);
        match judged {
            Ok(_) => self.accepted += 1,
            Err(refused) => {
                let place = Refused::ALL.iter().position(|it| *it == refused);
                let count = place.and_then(|place| self.refused.get_mut(place));
                count.into_iter().for_each(|count| *count += 1);
            }
        }
        judged
    }

    fn judge(&mut self, frame: &Frame) -> Result<Option<Stamp>, Refused> {
        let Some(signature) = frame.signature() else {
            let may_be = self.settings.unsigned.contains(&frame.id());
            return match frame.version() {
                _ if may_be => Ok(None),
                MavlinkVersion::V1 => Err(Refused::OldProtocol),
                MavlinkVersion::V2 => Err(Refused::Unsigned),
            };
        };
        // The hash comes first: a frame's stamp and stream mean nothing before it is right.
        if !is_equal(&signature.hash, &hash(&self.settings.key, signature.signed)) {
            return Err(Refused::Signature);
        }
        let Signature { link, stamp, .. } = signature;
        if stamp > self.now.plus(self.settings.ahead_max) {
            return Err(Refused::Ahead);
        }
        let id = StreamId { system: frame.system(), component: frame.component(), link };
        let mut known = self.streams.iter_mut().zip(&mut self.windows);
        match known.find(|(stream, _)| stream.id == id) {
            Some((stream, window)) => {
                let is_late = stamp.plus(OVERTAKEN_MAX) < stream.newest;
                if is_late || !window.take(stamp) {
                    return Err(Refused::Replayed);
                }
                stream.newest = stream.newest.max(stamp);
            }
            None if stamp.plus(BEHIND_MAX) < self.newest => return Err(Refused::Old),
            None => self.begin(StreamStamp { id, newest: stamp })?,
        }
        self.newest = self.newest.max(stamp);
        Ok(Some(stamp))
    }

    /// Adds a new stream. If the table is full, it drops streams so old that their frames could not
    /// begin a new one.
    fn begin(&mut self, stream: StreamStamp) -> Result<(), Refused> {
        if self.streams.len() >= STREAMS_MAX {
            let newest = self.newest;
            let is_kept = |stream: &StreamStamp| stream.newest.plus(BEHIND_MAX) >= newest;
            let mut streams = self.streams.iter();
            self.windows.retain(|_| streams.next().is_some_and(is_kept));
            self.streams.retain(is_kept);
        }
        if self.streams.len() >= STREAMS_MAX {
            return Err(Refused::Streams);
        }
        self.streams.push(stream);
        self.windows.push(Window::new(stream.newest));
        Ok(())
    }

    /// The newest stamp of each stream.
    pub fn streams(&self) -> &[StreamStamp] {
        &self.streams
    }

    /// Number of accepted frames.
    pub fn accepted(&self) -> u64 {
        self.accepted
    }

    /// Numbers of refused frames by reason.
    pub fn refused(&self) -> impl Iterator<Item = (Refused, u64)> + '_ {
        Refused::ALL.into_iter().zip(self.refused.iter().copied())
    }
}

/// Compares in constant time, which does not reveal how much of a guess is right.
fn is_equal(a: &[u8; HASH_LEN], b: &[u8; HASH_LEN]) -> bool {
    a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
}
