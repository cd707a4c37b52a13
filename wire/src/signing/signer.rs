//! Appends signatures to a sender's frames.

use super::{Key, SIGNATURE_LEN, Stamp, hash};

/// Signs the frames of one link, each with a later stamp than the one before.
#[derive(Clone, Debug)]
pub struct Signer {
    key: Key,
    link: u8,
    now: Stamp,
    /// The latest stamp that was used, or received in an accepted frame.
    newest: Stamp,
}

impl Signer {
    /// Creates a signer whose stamps are later than `after`.
    pub fn new(key: Key, link: u8, after: Stamp) -> Self {
        Self { key, link, now: after, newest: after }
    }

    /// Advances the time; an earlier `now` has no effect.
    pub fn turn(&mut self, now: Stamp) {
        self.now = self.now.max(now);
    }

    /// Records the stamp of an accepted frame. A receiver of that frame refuses much older stamps
    /// from a new stream.
    pub fn observe(&mut self, stamp: Stamp) {
        self.newest = self.newest.max(stamp);
    }

    /// The latest stamp that was used or received.
    pub fn newest(&self) -> Stamp {
        self.newest
    }

    /// Appends the signature of the frame that starts at `start` in `out`. Its flags and checksum
    /// must already mark it as signed.
    pub(crate) fn sign(&mut self, out: &mut Vec<u8>, start: usize) {
        self.newest = self.newest.plus(1).max(self.now);
        out.reserve(SIGNATURE_LEN);
        out.push(self.link);
        out.extend(self.newest.to_bytes());
        let hash = hash(&self.key, out.get(start..).unwrap_or_default());
        out.extend(hash);
    }
}
