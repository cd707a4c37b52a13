//! The key of signed flights, and their stamps.

use std::time::Duration;

use wire::Encoder;
use wire::signing::{Key, Signer, Stamp};

use super::script::Script;
use crate::clock::HostTime;
use crate::link::signing::{Ledger, Remembered, SigningSettings};

/// Link id used by signers other than vehicle and station.
const LINK: u8 = 200;

/// The key that station, vehicle and pilot share.
pub fn key() -> Key {
    Key::new([0x5A; wire::signing::KEY_LEN])
}

/// The stamp of a host time.
pub(super) fn stamp(now: HostTime) -> Stamp {
    Stamp::from_unix_ns(now.as_ns())
}

/// The station's signing settings.
pub(super) fn settings() -> SigningSettings {
    SigningSettings {
        key: key(),
        link: 0,
        unsigned: vec![109],
        ahead_max: Duration::from_secs(86_400),
        before: Remembered::default(),
        ledger: Ledger::default(),
    }
}

/// An encoder that signs where the script says so.
pub(super) fn encoder(script: &Script, system: u8, component: u8, now: HostTime) -> Encoder {
    let mut encoder = Encoder::new(system, component);
    encoder.set_signer(script.signed.then(|| Signer::new(key(), LINK, stamp(now))));
    encoder
}

/// Advances an encoder's time.
pub(super) fn turn(encoder: &mut Encoder, now: HostTime) {
    encoder.signer().into_iter().for_each(|signer| signer.turn(stamp(now)));
}
