//! MAVLink 2 signing on board: one key for all links, as in PX4 and ArduPilot.

use wire::Frame;
use wire::dialect::SETUP_SIGNING_DATA;
use wire::signing::{KEY_LEN, Key, Signer, Stamp, Verifier, VerifierSettings};

/// Messages accepted unsigned: RADIO_STATUS, which radios generate and cannot sign.
const UNSIGNED: [u32; 1] = [109];
/// Largest accepted lead of a stamp over the clock: a day.
const AHEAD_MAX: u64 = 86_400 * Stamp::PER_S;
/// Microseconds in a unit of a stamp.
const US: u64 = 10;

/// The active key with its clock and verifier.
#[derive(Debug)]
pub(super) struct Signing {
    key: Key,
    /// The stamp at vehicle time 0.
    booted: Stamp,
    verifier: Verifier,
}

impl Signing {
    /// Creates the state for `key`; the signing time is `now` at vehicle time `now_us`.
    pub(super) fn new(key: Key, now: Stamp, now_us: u64) -> Self {
        let booted = Stamp::from_ticks(now.ticks().saturating_sub(now_us / US));
        let unsigned = UNSIGNED.to_vec();
        let streams = Vec::new();
        let settings =
            VerifierSettings { key: key.clone(), unsigned, ahead_max: AHEAD_MAX, streams };
        Self { verifier: Verifier::new(settings, now), key, booted }
    }

    fn stamp(&self, now_us: u64) -> Stamp {
        Stamp::from_ticks(self.booted.ticks().saturating_add(now_us / US))
    }

    /// Advances the time and returns it as a stamp.
    pub(super) fn turn(&mut self, now_us: u64) -> Stamp {
        let stamp = self.stamp(now_us);
        self.verifier.turn(stamp);
        stamp
    }

    /// Whether a frame is accepted.
    pub(super) fn accepts(&mut self, frame: &Frame) -> bool {
        self.verifier.check(frame).is_ok()
    }

    /// A signer for the frames of the link with this id.
    pub(super) fn signer(&self, link: u8, now_us: u64) -> Signer {
        Signer::new(self.key.clone(), link, self.stamp(now_us))
    }
}

/// Decodes SETUP_SIGNING: a key and the time, or `None` for a key of zeros, which turns signing
/// off.
pub(super) fn requested(data: &SETUP_SIGNING_DATA) -> Option<(Key, Stamp)> {
    let is_off = data.secret_key == [0; KEY_LEN];
    (!is_off).then(|| (Key::new(data.secret_key), Stamp::from_ticks(data.initial_timestamp)))
}
