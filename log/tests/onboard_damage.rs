//! Damaged and truncated on-board logs: what is read, and what is reported.

use crate::onboard_import::{assert_sound, import, left_out, place};
use std::fs;
use std::sync::LazyLock;

use crate::onboard_log::{DataFlash, Ulog, dataflash, ulog};
use downwash_log::import::{Flight, open, read_bytes};
use proptest::prelude::*;

/// A damaged type byte turns a data row into a flag message, whose bits would forbid reading the
/// file.
#[test]
fn flag_message_amid_a_ulog_is_treated_as_damage() {
    let whole = survives(&ULOG).expect("a flight").body_rate.len();
    let rows = (ULOG.len() / 5..ULOG.len()).filter(|at| ULOG[*at] == b'D').step_by(7);
    for at in rows {
        let mut log = ULOG.clone();
        log[at] = b'B';
        let left = survives(&log).expect("a flight").body_rate.len();
        assert!(left + 6 >= whole, "{left} of {whole}, byte {at}");
    }
}

#[test]
fn data_appended_after_a_crash_is_read() {
    let mut log = ulog(1.0);
    let cut = log.bytes.len() - 11;
    let rest = ulog(1.5).bytes;
    // The first part ends within a message; the appended data begin at the stated offset.
    let whole = log.bytes.len();
    log.bytes.truncate(cut);
    log.bytes.extend(&rest[whole..]);
    let flags = 16 + 3;
    log.bytes[flags + 8] = 1;
    log.bytes[flags + 16..flags + 24].copy_from_slice(&(cut as u64).to_le_bytes());
    let flight = import("appended", "flight.ulg", &log.bytes);
    let all = import("appended", "whole.ulg", &rest);
    assert!(flight.body_rate.len() + 2 >= all.body_rate.len(), "{}", flight.body_rate.len());
    assert!(left_out(&flight, "byte") < 80, "{:?}", flight.left_out);
}

#[test]
fn newer_incompatible_ulog_is_refused_by_name() {
    let mut bytes = ulog(0.1).bytes;
    bytes[16 + 3 + 8] = 2;
    let path = place("newer", "flight.ulg");
    fs::write(&path, &bytes).expect("a file");
    let error = open(&path, None).expect_err("not read").to_string();
    assert!(error.contains("newer kind") && error.contains("flight.ulg"), "{error}");
}

static ULOG: LazyLock<Vec<u8>> = LazyLock::new(|| ulog(1.0).bytes);

static DATAFLASH: LazyLock<Vec<u8>> = LazyLock::new(|| dataflash(1.0).bytes);

/// Reads bytes as any kind of log and checks that the streams are sound.
fn survives(bytes: &[u8]) -> Option<Flight> {
    let flights = read_bytes(bytes, "");
    for flight in &flights {
        assert_sound(&flight.attitude);
        assert_sound(&flight.body_rate);
        assert_sound(&flight.specific_force);
        assert_sound(&flight.position);
        assert_sound(&flight.outputs);
        assert_sound(&flight.rotor_speed);
        assert_sound(&flight.setpoint);
        assert_sound(&flight.voltage);
        assert_sound(&flight.in_air);
    }
    flights.into_iter().max_by_key(|flight| flight.body_rate.len())
}

#[test]
fn truncated_logs_are_read_up_to_the_cut() {
    for bytes in [&*ULOG, &*DATAFLASH] {
        let whole = survives(bytes).expect("a flight").body_rate.len();
        let mut before = 0;
        for length in (0..bytes.len()).step_by(37) {
            let Some(flight) = survives(&bytes[..length]) else { continue };
            let samples = flight.body_rate.len();
            assert!(samples + 1 >= before && samples <= whole, "{length}");
            before = samples;
        }
        assert!(before + 3 >= whole);
    }
}

#[test]
fn truncated_or_damaged_log_reports_where() {
    for bytes in [&*ULOG, &*DATAFLASH] {
        assert_eq!(survives(bytes).expect("a flight").losses, Vec::<String>::new());
        // Some of these lengths end between two messages, which looks like a complete log.
        let losses = (1..20).map(|short| {
            survives(&bytes[..bytes.len() - short]).expect("a flight").losses.join(" ")
        });
        let said = losses.filter(|loss| loss.contains("it was cut short")).count();
        assert!(said >= 10, "{said} of 19");
        let middle = bytes.len() / 2;
        let damaged = [&bytes[..middle], &bytes[middle + 333..]].concat();
        let loss = survives(&damaged).expect("a flight").losses.join(" ");
        assert!(loss.contains("belong to no message"), "{loss}");
    }
}

#[test]
fn removed_bytes_lose_only_their_own_messages() {
    for bytes in [&*ULOG, &*DATAFLASH] {
        let whole = survives(bytes).expect("a flight").body_rate.len();
        let middle = bytes.len() / 2;
        for length in [1, 2, 3, 5, 50, 333] {
            let damaged = [&bytes[..middle], &bytes[middle + length..]].concat();
            let flight = survives(&damaged).expect("a flight");
            let lost = whole - flight.body_rate.len();
            assert!(lost <= 4 + length / 20, "{lost} of {length} bytes");
            assert!(left_out(&flight, "") > 0);
            let foreign = [&bytes[..middle], &vec![0x41; length][..], &bytes[middle..]].concat();
            let flight = survives(&foreign).expect("a flight");
            assert!(whole - flight.body_rate.len() <= 3, "{length} foreign bytes");
            assert!(left_out(&flight, "byte") + left_out(&flight, "damaged") > 0);
        }
    }
}

#[test]
fn zeroed_bytes_lose_only_their_own_messages() {
    let whole = survives(&DATAFLASH).expect("a flight").body_rate.len();
    let middle = DATAFLASH.len() / 2;
    for length in [100, 333, 4096] {
        let mut log = DATAFLASH.clone();
        log[middle..middle + length].fill(0);
        let flight = survives(&log).expect("a flight");
        let lost = whole - flight.body_rate.len();
        assert!(lost <= 4 + length / 20, "{lost} of {length} bytes");
        // At both ends of the zeros a message is cut.
        let bytes = left_out(&flight, "byte");
        let expected = length as u64..length as u64 + 100;
        assert!(expected.contains(&bytes), "{bytes} of {length} bytes");
        let loss = flight.losses.join(" ");
        assert!(loss.contains("belong to no message"), "{loss}");
    }
}

#[test]
fn long_damage_is_passed_in_one_sweep() {
    let whole = survives(&DATAFLASH).expect("a flight").body_rate.len();
    let (before, after) = DATAFLASH.split_at(DATAFLASH.len() / 2);
    // Marks alone, and with the types of a definition, of a message and of none.
    let fillings: [&[u8]; 5] =
        [&[0xA3], &[0xA3, 0x95], &[0xA3, 0x95, 128], &[0xA3, 0x95, 10], &[0xA3, 0x95, 99]];
    for filling in fillings {
        let damage = filling.repeat(300_000);
        let flight = survives(&[before, &damage[..], after].concat()).expect("a flight");
        let lost = whole - flight.body_rate.len();
        assert!(lost <= 4, "{lost} lost with {filling:?}");
        let bytes = left_out(&flight, "byte");
        assert!(bytes + 100 > damage.len() as u64, "{bytes} bytes with {filling:?}");
    }
}

/// Length of the definitions at the start of [`DATAFLASH`]: of FMT itself and of nine messages.
const DEFINITIONS: usize = 10 * 89;

#[test]
fn dataflash_log_without_its_first_bytes_is_read_by_the_definitions_that_remain() {
    let whole = survives(&DATAFLASH).expect("a flight");
    // The cut is in the definition of PARM.
    let flight = import("cut_start", "flight.bin", &DATAFLASH[130..]);
    assert_eq!(flight.origin.format, "dataflash");
    assert_eq!((&flight.attitude, &flight.body_rate), (&whole.attitude, &whole.body_rate));
    assert_eq!(left_out(&flight, "without a definition"), 10, "{:?}", flight.left_out);
    let losses = flight.losses.join("; ");
    assert!(
        losses.contains("its start is lost") && losses.contains("the first at byte 0"),
        "{losses}"
    );

    // Messages before the definitions.
    let (definitions, messages) = DATAFLASH.split_at(DEFINITIONS);
    let log = [&messages[messages.len() / 2..], definitions, messages].concat();
    let flight = import("cut_start", "later.bin", &log);
    assert_eq!((&flight.attitude, &flight.body_rate), (&whole.attitude, &whole.body_rate));
    assert!(left_out(&flight, "without a definition") > 100, "{:?}", flight.left_out);
}

#[test]
fn dataflash_log_without_definitions_is_refused_with_the_remedy() {
    let path = place("no_definitions", "flight.bin");
    fs::write(&path, &DATAFLASH[DEFINITIONS..]).expect("a file");
    let error = open(&path, None).expect_err("not read").to_string();
    for said in ["flight.bin", "without the definitions (FMT)", "from the vehicle again"] {
        assert!(error.contains(said), "{error}");
    }
}

/// The high byte of a length: some values point to the start of another message.
#[test]
fn damaged_length_loses_no_later_message() {
    let whole = survives(&ULOG).expect("a flight").body_rate.len();
    let middle = ULOG.len() / 2;
    let head = |at: &usize| ULOG[*at..].starts_with(&[46, 0, b'D', 1, 0]);
    let at = (middle..ULOG.len()).find(head).expect("a row of sensor_combined");
    for high in 1..=u8::MAX {
        let mut log = ULOG.clone();
        log[at + 1] = high;
        let left = survives(&log).expect("a flight").body_rate.len();
        assert!(left + 4 >= whole, "{left} of {whole} with {high}");
    }
}

proptest! {
    #[test]
    fn damaged_onboard_log_never_panics_the_reader(
        is_ulog in any::<bool>(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..40),
        length in any::<prop::sample::Index>(),
    ) {
        let mut log = if is_ulog { ULOG.clone() } else { DATAFLASH.clone() };
        for (at, byte) in changes {
            let at = at.index(log.len());
            log[at] = byte;
        }
        log.truncate(length.index(log.len()) + 1);
        survives(&log);
    }

    #[test]
    fn few_damaged_bytes_lose_few_samples(
        is_ulog in any::<bool>(),
        // Only after the definitions, on which everything else depends.
        changes in prop::collection::vec((0.2..1.0, any::<u8>()), 1..6),
    ) {
        let sound = if is_ulog { &*ULOG } else { &*DATAFLASH };
        let mut log = sound.clone();
        for (at, byte) in &changes {
            let at = (at * log.len() as f64) as usize;
            log[at] = *byte;
        }
        let whole = survives(sound).expect("a flight").body_rate.len();
        let left = survives(&log).expect("a flight").body_rate.len();
        prop_assert!(left + 6 * changes.len() >= whole, "{left} of {whole}");
    }

    #[test]
    fn arbitrary_bytes_after_the_magic_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        survives(&[&Ulog::new().bytes[..], &bytes].concat());
        survives(&[&DataFlash::new().bytes[..], &bytes].concat());
    }
}
