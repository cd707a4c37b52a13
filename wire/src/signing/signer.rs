//! The end that a sender's frames get.

use super::{Key, SIGNATURE_LEN, Stamp, hash};

/// Signs the frames of one link, each with a later stamp than the one before.
#[derive(Clone, Debug)]
pub struct Signer {
    key: Key,
    link: u8,
    now: Stamp,
    /// The latest that was used, or that was heard and believed.
    newest: Stamp,
}

impl Signer {
    /// A signer whose frames are stamped later than `after`.
    pub fn new(key: Key, link: u8, after: Stamp) -> Self {
        Self { key, link, now: after, newest: after }
    }

    /// Advances the time, which never goes back.
    pub fn turn(&mut self, now: Stamp) {
        self.now = self.now.max(now);
    }

    /// A stamp was heard and believed: whoever heard it takes nothing older from a new stream.
    pub fn heard(&mut self, stamp: Stamp) {
        self.newest = self.newest.max(stamp);
    }

    /// The latest stamp that was used or heard.
    pub fn newest(&self) -> Stamp {
        self.newest
    }

    /// Appends the signature of the frame that `out` holds from `start` on, whose flags and checksum
    /// say that it is signed.
    pub(crate) fn sign(&mut self, out: &mut Vec<u8>, start: usize) {
        self.newest = self.newest.plus(1).max(self.now);
        out.reserve(SIGNATURE_LEN);
        out.push(self.link);
        out.extend(self.newest.to_bytes());
        let hash = hash(&self.key, out.get(start..).unwrap_or_default());
        out.extend(hash);
    }
}
