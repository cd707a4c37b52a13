//! Whether a frame is believed.

use std::collections::VecDeque;

use mavlink::MavlinkVersion;

use super::{HASH_LEN, Key, Stamp, hash};
use crate::framing::{Frame, Signature};

/// Most streams at once. Only a sender that knows the key begins one.
const STREAMS_MAX: usize = 64;
/// A stream that is not known yet may begin this far behind what is known of the time: a minute, as
/// MAVLink has it.
const BEHIND_MAX: u64 = 60 * Stamp::PER_S;

/// Frames overtake one another: one that was never heard is believed this far behind the newest of its
/// stream. A word that the pilot took over, told once, is not to be lost for that.
const OVERTAKEN_MAX: u64 = Stamp::PER_S;
/// Number of stamps that a stream remembers; a frame older than all of them is refused.
const SEEN_MAX: usize = 512;

/// Who counts stamps: each link of each component by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamId {
    /// System id.
    pub system: u32,
    /// Component id.
    pub component: u8,
    /// The sender's number of the link.
    pub link: u8,
}

/// The newest stamp of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StreamStamp {
    /// Which.
    pub id: StreamId,
    /// Nothing that is not later is believed.
    pub newest: Stamp,
}

/// Why a frame is not believed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, thiserror::Error)]
pub enum Refused {
    /// A MAVLink 1 frame: it has no room for a signature.
    #[error("MAVLink 1, which cannot be signed")]
    OldProtocol,
    /// There is no signature.
    #[error("no signature")]
    Unsigned,
    /// The signature is of another key, or of other bytes.
    #[error("wrong signature: another key, or changed on the way")]
    Signature,
    /// The stream had this stamp before, or one that is later by too much.
    #[error("stamp heard before, or too old for its stream: a replay or a copy")]
    Replayed,
    /// A stream that begins more than a minute behind.
    #[error("a new stream whose stamp is more than a minute old")]
    Old,
    /// The stamp is further ahead than clocks differ.
    #[error("stamp too far ahead of this computer's clock")]
    Ahead,
    /// More streams than the table holds.
    #[error("too many streams")]
    Streams,
}

impl Refused {
    /// All of them, in the order of their counters.
    pub const ALL: [Self; 7] = [
        Self::OldProtocol,
        Self::Unsigned,
        Self::Signature,
        Self::Replayed,
        Self::Old,
        Self::Ahead,
        Self::Streams,
    ];

    /// A word for it, as counters are named.
    pub const fn word(self) -> &'static str {
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

/// What is believed.
#[derive(Clone, Debug, PartialEq)]
pub struct VerifierSettings {
    /// The key.
    pub key: Key,
    /// Ids of the messages that are believed without a signature.
    pub unsigned: Vec<u32>,
    /// Stamps further ahead of the clock than this are not believed, units of [`Stamp`].
    pub ahead_max: u64,
    /// What was heard before.
    pub streams: Vec<StreamStamp>,
}

/// The stamps of a stream that may still be overtaken by others.
#[derive(Clone, Debug)]
struct Window {
    /// Neither this nor anything before is believed.
    floor: Stamp,
    /// In order, all of them later than that.
    seen: VecDeque<Stamp>,
}

impl Window {
    fn new(floor: Stamp) -> Self {
        Self { floor, seen: VecDeque::with_capacity(SEEN_MAX) }
    }

    /// Takes a stamp, unless it was taken before or may have been.
    fn take(&mut self, stamp: Stamp) -> bool {
        let Err(place) = self.seen.binary_search(&stamp) else { return false };
        if stamp <= self.floor {
            return false;
        }
        self.seen.insert(place, stamp);
        if self.seen.len() >= SEEN_MAX {
            self.floor = self.seen.pop_front().unwrap_or(self.floor);
        }
        true
    }
}

/// Judges the frames of any number of senders with one key.
#[derive(Clone, Debug)]
pub struct Verifier {
    settings: VerifierSettings,
    now: Stamp,
    newest: Stamp,
    streams: Vec<StreamStamp>,
    /// Of each stream.
    windows: Vec<Window>,
    refused: [u64; Refused::ALL.len()],
    believed: u64,
}

impl Verifier {
    /// A verifier that takes nothing older than `settings.streams` say.
    pub fn new(settings: VerifierSettings, now: Stamp) -> Self {
        let mut streams = Vec::with_capacity(STREAMS_MAX);
        streams.extend(settings.streams.iter().copied().take(STREAMS_MAX));
        let windows =
            streams.iter().map(|stream: &StreamStamp| Window::new(stream.newest)).collect();
        let refused = Default::default();
        Self { settings, now, newest: now, streams, windows, refused, believed: 0 }
    }

    /// Advances the time, which never goes back.
    pub fn turn(&mut self, now: Stamp) {
        self.now = self.now.max(now);
        self.newest = self.newest.max(now);
    }

    /// Judges a frame, and counts it. Gives its stamp, if it has one.
    ///
    /// # Errors
    /// [`Refused`]; nothing is remembered of it but the count.
    pub fn check(&mut self, frame: &Frame) -> Result<Option<Stamp>, Refused> {
        let judged = self.judge(frame);
        match judged {
            Ok(_) => self.believed += 1,
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
        // First: no stamp and no stream of a frame counts before its hash is right.
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

    /// A stream that is not known yet. Those whose frames would be too old to begin anew make room.
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

    /// Frames that were believed.
    pub fn believed(&self) -> u64 {
        self.believed
    }

    /// Frames that were not, by why.
    pub fn refused(&self) -> impl Iterator<Item = (Refused, u64)> + '_ {
        Refused::ALL.into_iter().zip(self.refused.iter().copied())
    }
}

/// Takes as long for any two: how much of a guess is right does not show.
fn is_equal(a: &[u8; HASH_LEN], b: &[u8; HASH_LEN]) -> bool {
    a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b)) == 0
}
