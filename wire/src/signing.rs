//! MAVLink 2 message signing, sans I/O: only a sender that knows the key can send accepted frames.
//!
//! A signed frame ends with the sender's link id, a [`Stamp`] and 48 bits of a hash over the
//! [`Key`] and everything before. A [`Signer`] appends this signature, a [`Verifier`] checks it.
//! Time is an argument.

mod key;
mod signer;
mod verifier;

use sha2::{Digest, Sha256};

pub use key::{KEY_LEN, Key, KeyError};
pub use signer::Signer;
pub use verifier::{Refused, StreamId, StreamStamp, Verifier, VerifierSettings};

/// Bytes of the hash in a frame.
const HASH_LEN: usize = 6;
/// Length of link id, stamp and hash in bytes.
pub(crate) const SIGNATURE_LEN: usize = 13;

/// Signing time: units of 10 us since the first instant of 2015 (UTC), in 48 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stamp(u64);

impl Stamp {
    /// The latest time that a frame can carry, in the year 2104.
    pub const MAX: Self = Self((1 << 48) - 1);
    /// Units per second.
    pub const PER_S: u64 = 100_000;
    /// Start of 2015 in Unix time, s.
    const EPOCH_S: u64 = 1_420_070_400;

    /// Creates a stamp from a number of units, clamped to [`MAX`](Self::MAX).
    pub const fn from_ticks(ticks: u64) -> Self {
        if ticks > Self::MAX.0 { Self::MAX } else { Self(ticks) }
    }

    /// Creates a stamp from nanoseconds since the Unix epoch; zero before 2015.
    pub const fn from_unix_ns(ns: u64) -> Self {
        Self::from_ticks((ns / 10_000).saturating_sub(Self::EPOCH_S * Self::PER_S))
    }

    /// The number of 10 us units.
    pub const fn ticks(self) -> u64 {
        self.0
    }

    /// Seconds from `earlier` to this stamp; negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self.0 as f64 - earlier.0 as f64) / Self::PER_S as f64
    }

    const fn plus(self, ticks: u64) -> Self {
        Self::from_ticks(self.0.saturating_add(ticks))
    }

    pub(crate) fn to_bytes(self) -> [u8; 6] {
        let [a, b, c, d, e, f, ..] = self.0.to_le_bytes();
        [a, b, c, d, e, f]
    }

    pub(crate) fn from_bytes([a, b, c, d, e, f]: [u8; 6]) -> Self {
        Self(u64::from_le_bytes([a, b, c, d, e, f, 0, 0]))
    }
}

/// The hash at the end of a frame signed with `key`; `signed` is everything before it.
fn hash(key: &Key, signed: &[u8]) -> [u8; HASH_LEN] {
    let digest = Sha256::new().chain_update(key.bytes()).chain_update(signed).finalize();
    let mut hash = [0; HASH_LEN];
    hash.iter_mut().zip(digest).for_each(|(to, from)| *to = from);
    hash
}

#[cfg(test)]
mod tests;
