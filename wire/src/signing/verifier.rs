//! Whether a frame is believed.

use mavlink::MavlinkVersion;

use super::{HASH_LEN, Key, Stamp, hash};
use crate::framing::{Frame, Signature};

/// Streams that are told apart at once. Only who knows the key begins one.
const STREAMS_MAX: usize = 64;
/// A stream that is not known yet may begin this far behind what is known of the time: a minute, as
/// MAVLink has it.
const BEHIND_MAX: u64 = 60 * Stamp::PER_S;

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
    /// The stream had this stamp before, or a later one.
    #[error("stamp not later than the last of its stream: a replay, a copy or overtaken")]
    Replayed,
    /// A stream that begins more than a minute behind.
    #[error("a new stream whose stamp is more than a minute old")]
    Old,
    /// The stamp is further ahead than clocks differ.
    #[error("stamp too far ahead of this computer's clock")]
    Ahead,
    /// More streams than are told apart.
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

/// Judges the frames of any number of senders with one key.
#[derive(Clone, Debug)]
pub struct Verifier {
    settings: VerifierSettings,
    now: Stamp,
    newest: Stamp,
    streams: Vec<StreamStamp>,
    refused: [u64; Refused::ALL.len()],
    believed: u64,
}

impl Verifier {
    /// A verifier that takes nothing older than `settings.streams` say.
    pub fn new(settings: VerifierSettings, now: Stamp) -> Self {
        let mut streams = Vec::with_capacity(STREAMS_MAX);
        streams.extend(settings.streams.iter().copied().take(STREAMS_MAX));
        Self { settings, now, newest: now, streams, refused: Default::default(), believed: 0 }
    }

    /// Time goes on. It never goes back.
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
        // Before all else: nothing that a stranger says of time or stream is looked at.
        if !is_equal(&signature.hash, &hash(&self.settings.key, signature.signed)) {
            return Err(Refused::Signature);
        }
        let Signature { link, stamp, .. } = signature;
        if stamp > self.now.plus(self.settings.ahead_max) {
            return Err(Refused::Ahead);
        }
        let id = StreamId { system: frame.system(), component: frame.component(), link };
        match self.streams.iter_mut().find(|stream| stream.id == id) {
            Some(stream) if stamp <= stream.newest => return Err(Refused::Replayed),
            Some(stream) => stream.newest = stamp,
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
            self.streams.retain(|known| known.newest.plus(BEHIND_MAX) >= newest);
        }
        if self.streams.len() >= STREAMS_MAX {
            return Err(Refused::Streams);
        }
        self.streams.push(stream);
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
