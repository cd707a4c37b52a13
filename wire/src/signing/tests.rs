use std::fs;

use mavlink::MavlinkVersion;
use proptest::prelude::*;

use super::*;
use crate::dialect::*;
use crate::{Encoder, Frame};

const NOW: Stamp = Stamp::from_ticks(36_000_000_000_000);
const DAY: u64 = 86_400 * Stamp::PER_S;
const YEAR: u64 = 365 * DAY;

fn key(byte: u8) -> Key {
    Key::new([byte; KEY_LEN])
}

fn verifier() -> Verifier {
    let unsigned = vec![RADIO_STATUS_DATA_ID];
    let settings = VerifierSettings { key: key(7), unsigned, ahead_max: DAY, streams: vec![] };
    Verifier::new(settings, NOW)
}

const RADIO_STATUS_DATA_ID: u32 = 109;

/// A sender of system 1 component 1 whose next frame is stamped `at`.
fn sender(byte: u8, link: u8, at: Stamp) -> Encoder {
    let mut encoder = Encoder::new(1, 1);
    encoder.set_signer(Some(Signer::new(key(byte), link, Stamp::from_ticks(at.ticks() - 1))));
    encoder
}

fn encoded(encoder: &mut Encoder) -> Vec<u8> {
    let message = MavMessage::ATTITUDE(ATTITUDE_DATA { yaw: 1.5, ..Default::default() });
    let mut bytes = Vec::new();
    assert!(encoder.encode(&message, &mut bytes));
    bytes
}

fn frame(bytes: &[u8]) -> Frame {
    Frame::parse(bytes).expect("a frame")
}

#[test]
fn signed_frame_is_accepted_once_and_stamps_advance() {
    let (mut verifier, mut sender) = (verifier(), sender(7, 3, NOW));
    let mut last = None;
    for _ in 0..100 {
        let bytes = encoded(&mut sender);
        let frame = frame(&bytes);
        assert!(frame.is_signed() && frame.message().is_ok());
        let stamp = verifier.check(&frame).expect("it belongs to the key");
        assert!(stamp > last);
        last = stamp;
        assert_eq!(verifier.check(&frame), Err(Refused::Replayed));
    }
    assert_eq!(verifier.accepted(), 100);
    assert_eq!(verifier.streams().len(), 1);
}

#[test]
fn frames_without_the_key_are_refused_with_the_reason() {
    let mut verifier = verifier();
    let unsigned = encoded(&mut Encoder::new(1, 1));
    assert_eq!(verifier.check(&frame(&unsigned)), Err(Refused::Unsigned));
    let mut old = Encoder::new(1, 1);
    old.set_version(MavlinkVersion::V1);
    assert_eq!(verifier.check(&frame(&encoded(&mut old))), Err(Refused::OldProtocol));
    let other = encoded(&mut sender(8, 3, NOW));
    assert_eq!(verifier.check(&frame(&other)), Err(Refused::Signature));
    // Stamps, ids and links of a sender without the key leave no trace.
    assert!(verifier.streams().is_empty());
    let mut radio = Vec::new();
    let status = MavMessage::RADIO_STATUS(Default::default());
    Encoder::new(51, 68).encode(&status, &mut radio);
    assert_eq!(verifier.check(&frame(&radio)), Ok(None));
    // A signature that is present must be valid even where none is required.
    let mut forged = Encoder::new(51, 68);
    forged.set_signer(Some(Signer::new(key(8), 0, NOW)));
    let mut bytes = Vec::new();
    forged.encode(&status, &mut bytes);
    assert_eq!(verifier.check(&frame(&bytes)), Err(Refused::Signature));
    let counts: Vec<u64> = verifier.refused().map(|(_, count)| count).collect();
    assert_eq!(counts, [1, 1, 2, 0, 0, 0, 0]);
}

#[test]
fn overtaken_frame_is_accepted_once_within_a_second() {
    let (mut verifier, mut sender) = (verifier(), sender(7, 3, NOW));
    let frames: Vec<Frame> = (0..1000)
        .map(|number| {
            let at = Stamp::from_ticks(NOW.ticks() + number * Stamp::PER_S / 500);
            sender.signer().expect("it signs").turn(at);
            frame(&encoded(&mut sender))
        })
        .collect();
    // Nine frames in ten arrive in time; the others arrive half a second late.
    for (number, frame) in frames.iter().enumerate() {
        if number % 10 != 5 {
            assert!(verifier.check(frame).is_ok(), "{number}");
        }
        let late = number.checked_sub(250).filter(|late| late % 10 == 5);
        if let Some(late) = late.and_then(|late| frames.get(late)) {
            assert!(verifier.check(late).is_ok(), "{number}");
            assert_eq!(verifier.check(late), Err(Refused::Replayed));
        }
    }
    // No frame is accepted twice, however old or new.
    for (number, frame) in frames.iter().enumerate() {
        let is_new = number % 10 == 5 && number >= 750;
        assert_eq!(verifier.check(frame).is_ok(), is_new, "{number}");
    }
    let late = Stamp::from_ticks(verifier.streams()[0].newest.ticks() - Stamp::PER_S - 1);
    let old = encoded(&mut self::sender(7, 3, late));
    assert_eq!(verifier.check(&frame(&old)), Err(Refused::Replayed));
}

#[test]
fn new_stream_may_be_a_minute_behind_or_a_day_ahead() {
    let minute = 60 * Stamp::PER_S;
    let at = |ticks: u64| frame(&encoded(&mut sender(7, 9, Stamp::from_ticks(ticks))));
    let now = NOW.ticks();
    assert_eq!(verifier().check(&at(now - minute - 1)), Err(Refused::Old));
    assert!(verifier().check(&at(now - minute)).is_ok());
    assert!(verifier().check(&at(now + DAY)).is_ok());
    assert_eq!(verifier().check(&at(now + DAY + 1)), Err(Refused::Ahead));
    assert_eq!(verifier().check(&at(now + 5 * YEAR)), Err(Refused::Ahead));
    // A known stream may be late, and a refused jump does not lock it out.
    let mut verifier = verifier();
    let mut late = sender(7, 9, Stamp::from_ticks(now - minute));
    assert!(verifier.check(&frame(&encoded(&mut late))).is_ok());
    verifier.turn(Stamp::from_ticks(now + minute));
    assert_eq!(verifier.check(&at(now + 5 * YEAR)), Err(Refused::Ahead));
    assert!(verifier.check(&frame(&encoded(&mut late))).is_ok());
}

#[test]
fn signing_streams_are_separate_and_bounded() {
    let mut verifier = verifier();
    let mut streams: Vec<Encoder> = (0..=255).map(|link| sender(7, link, NOW)).collect();
    let mut accepted = 0;
    for stream in &mut streams {
        match verifier.check(&frame(&encoded(stream))) {
            Ok(_) => accepted += 1,
            Err(refused) => assert_eq!(refused, Refused::Streams),
        }
    }
    assert_eq!((accepted, verifier.streams().len()), (64, 64));
    // Streams that were silent for more than a minute make room, and cannot be replayed.
    let old = frame(&encoded(&mut sender(7, 0, Stamp::from_ticks(NOW.ticks() + 5))));
    verifier.turn(Stamp::from_ticks(NOW.ticks() + 61 * Stamp::PER_S));
    let late = Stamp::from_ticks(NOW.ticks() + 61 * Stamp::PER_S);
    assert!(verifier.check(&frame(&encoded(&mut sender(7, 200, late)))).is_ok());
    assert_eq!(verifier.streams().len(), 1);
    assert_eq!(verifier.check(&old), Err(Refused::Old));
}

#[test]
fn frames_from_before_a_restart_are_refused_as_replays() {
    let (mut before, mut sender) = (verifier(), sender(7, 3, NOW));
    let bytes = encoded(&mut sender);
    before.check(&frame(&bytes)).expect("new");
    let settings = VerifierSettings {
        key: key(7),
        unsigned: vec![],
        ahead_max: DAY,
        streams: before.streams().to_vec(),
    };
    let mut after = Verifier::new(settings, NOW);
    assert_eq!(after.check(&frame(&bytes)), Err(Refused::Replayed));
    assert!(after.check(&frame(&encoded(&mut sender))).is_ok());
}

#[test]
fn stamps_never_decrease_with_any_clock() {
    let mut signer = Signer::new(key(7), 0, NOW);
    let mut last = NOW;
    for clock in [NOW.ticks() - YEAR, NOW.ticks() + 5, NOW.ticks() - 1, NOW.ticks() + 5, 0] {
        signer.turn(Stamp::from_ticks(clock));
        let mut out = vec![];
        signer.sign(&mut out, 0);
        assert!(signer.newest() > last, "{clock}");
        last = signer.newest();
    }
    signer.observe(Stamp::from_ticks(NOW.ticks() + YEAR));
    signer.sign(&mut vec![], 0);
    assert_eq!(signer.newest().ticks(), NOW.ticks() + YEAR + 1);
}

#[test]
fn signer_sends_only_mavlink_2() {
    let mut encoder = sender(7, 0, NOW);
    encoder.set_version(MavlinkVersion::V1);
    assert!(frame(&encoded(&mut encoder)).is_signed());
}

#[test]
fn timestamps_count_from_2015() {
    assert_eq!(Stamp::from_unix_ns(1_420_070_400_000_010_000).ticks(), 1);
    assert_eq!(Stamp::from_unix_ns(1_400_000_000_000_000_000), Stamp::default());
    assert_eq!(Stamp::from_unix_ns(u64::MAX).to_bytes().len(), 6);
    assert_eq!(Stamp::from_bytes(NOW.to_bytes()), NOW);
}

#[cfg(unix)]
#[test]
fn key_file_readable_by_others_is_refused() {
    use std::os::unix::fs::PermissionsExt;
    let path = std::env::temp_dir().join(format!("wire-key-{}", std::process::id()));
    let write = |text: &str, mode: u32| {
        fs::write(&path, text).expect("writable");
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("own file");
        let loaded = Key::load(&path);
        fs::remove_file(&path).expect("there");
        loaded
    };
    let text = key(0xA5).to_hex();
    assert_eq!(write(&format!(" {text}\n"), 0o600).expect("a key"), key(0xA5));
    assert_eq!(write(&text, 0o400).expect("a key"), key(0xA5));
    for mode in [0o640, 0o604, 0o622, 0o700, 0o644] {
        let error = write(&text, mode).expect_err("others may read it").to_string();
        assert!(error.contains("0600") && error.contains("chmod"), "{error}");
        assert!(!error.contains(&text));
    }
    for bad in
        ["", "abc", &text[1..], &format!("{text}00"), &text.replace('a', "x"), &"0".repeat(64)]
    {
        let error = write(bad, 0o600).expect_err("no key").to_string();
        assert!(bad.len() < 8 || !error.contains(bad), "the error reveals a possible key: {error}");
    }
    assert!(Key::load(&path).is_err());
    assert!(!format!("{:?}", key(0xA5)).contains("a5a5"));
}

proptest! {
    #[test]
    fn modified_signed_frame_is_never_accepted(at in 0usize..53, bits in 1u8.., cut in 0usize..53) {
        let bytes = encoded(&mut sender(7, 3, NOW));
        prop_assume!(at < bytes.len());
        let mut changed = bytes.clone();
        changed[at] ^= bits;
        // Recomputes the checksum, as an attacker would.
        let end = bytes.len() - SIGNATURE_LEN - 2;
        if at < end {
            let crc = mavlink::calculate_crc(&changed[1..end], 39).to_le_bytes();
            changed[end..end + 2].copy_from_slice(&crc);
        }
        let mut verifier = verifier();
        let mut decoder = crate::Decoder::new();
        decoder.datagram(&changed, |frame| assert!(verifier.check(&frame).is_err()));
        decoder.datagram(&bytes[..cut.min(bytes.len() - 1)], |frame| {
            assert!(verifier.check(&frame).is_err());
        });
        assert!(verifier.streams().is_empty());
    }
}
