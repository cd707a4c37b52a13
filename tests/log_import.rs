//! A flight imports the same from either log format, and the import counts damaged data.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use crate::damage::{move_vehicle_clock, sign, spoil};
use crate::import_support::{assert_ascends, import, left_out, place, write_tlog};
use crate::{damage, lockstep, log_flight};
use downwash::log::import::{Clock, Flight, ImportError, MotorSource, MotorUnit, open, write};
use downwash::log::record::Record;
use sitl::config::SitlConfig;

/// A whole flight of the nano quadrotor in lockstep, with sensor noise.
static RECORDS: LazyLock<Vec<Record>> = LazyLock::new(|| {
    let params = lockstep::params(lockstep::NANO);
    let settings = lockstep::settings(&params, lockstep::trajectory("sinusoid-xy.toml"));
    lockstep::fly(settings, &params, &[], SitlConfig::default(), 3).1
});

/// The flight's frames as entries of a telemetry log, each with its time in us.
fn entries() -> Vec<(u64, Vec<u8>)> {
    damage::entries(&RECORDS)
}

fn assert_same_streams(a: &Flight, b: &Flight) {
    assert_eq!(a.attitude, b.attitude);
    assert_eq!(a.position, b.position);
    assert_eq!(a.velocity, b.velocity);
    assert_eq!(a.body_rate, b.body_rate);
    assert_eq!(a.specific_force, b.specific_force);
    assert_eq!(a.outputs, b.outputs);
    assert_eq!(a.rotor_speed, b.rotor_speed);
    assert_eq!(a.setpoint, b.setpoint);
    assert_eq!(a.voltage, b.voltage);
    assert_eq!(a.in_air, b.in_air);
    assert_eq!((a.motor_unit, a.motor_source, a.clock), (b.motor_unit, b.motor_source, b.clock));
}

#[test]
fn own_log_and_telemetry_log_import_as_the_same_flight() {
    let folder = place("same", "mcap");
    let _ = fs::remove_dir_all(&folder);
    let mcap = import(&log_flight::write(&folder, &RECORDS));
    let tlog = import(&write_tlog("same", "flight.tlog", &entries()));
    assert_same_streams(&mcap, &tlog);
    assert_eq!(mcap.left_out, []);
    assert_eq!(tlog.left_out, []);
    assert_eq!((mcap.origin.format, tlog.origin.format), ("mcap", "tlog"));
    assert_eq!(tlog.origin.run, "flight");
    assert_eq!(tlog.origin.sha256.len(), 64);

    assert!(mcap.attitude.rate() > 240.0, "{}", mcap.attitude.rate());
    assert!(mcap.body_rate.rate() > 240.0 && mcap.specific_force.rate() > 240.0);
    assert!(mcap.position.rate() > 45.0 && mcap.setpoint.rate() > 95.0);
    assert_eq!((mcap.motor_unit, mcap.motor_source), {
        (MotorUnit::ThrustFraction, MotorSource::ActuatorOutputStatus)
    });
    assert_eq!(mcap.clock, Clock::Synchronised);
    assert!(mcap.in_air.values().contains(&true) && !mcap.voltage.is_empty());
    // The truth is on the vehicle's clock, as its messages are.
    assert!(tlog.truth.is_empty() && mcap.truth.len() > 1000);
    let mut compared = 0;
    for (time, truth) in mcap.truth.iter() {
        if let Some(at) = mcap.attitude.index_at(time)
            && time - mcap.attitude.times()[at] < 1e-6
        {
            assert!(mcap.attitude.values()[at].angle_to(truth.attitude) < 0.02, "at {time}");
            compared += 1;
        }
    }
    assert!(compared > 500, "{compared}");
    // A setpoint has the time of the state that it answers.
    let first = mcap.setpoint.times()[0];
    let at = mcap.attitude.index_at(first + 1e-4).expect("an attitude before");
    assert!(first - mcap.attitude.times()[at] < 0.011);
    for (stream, name) in [(&mcap.voltage, "voltage"), (&tlog.voltage, "voltage")] {
        assert_ascends(stream, name);
    }
}

#[test]
fn imported_flight_round_trips() {
    let folder = place("again", "mcap");
    let _ = fs::remove_dir_all(&folder);
    let flight = import(&log_flight::write(&folder, &RECORDS));
    let path = place("again", "imported.mcap");
    let messages = write(&flight, &path).expect("a log");
    assert!(messages as usize > 3 * flight.attitude.len());
    let back = import(&path);
    assert_same_streams(&back, &flight);
    assert_eq!(back.truth, flight.truth);
    assert_eq!((&back.vehicle_file, &back.left_out), (&flight.vehicle_file, &flight.left_out));
    assert_eq!((back.rows, back.origin.run.as_str()), (None, "imported"));
}

#[test]
fn non_log_file_gives_a_clear_error() {
    let path = place("garbage", "noise.tlog");
    fs::write(&path, [0x55; 5000]).expect("a file");
    let error = open(&path, None).expect_err("no log");
    assert!(matches!(error, ImportError::NotALog { .. }));
    assert!(error.to_string().contains("noise.tlog"), "{error}");
    let missing = open(Path::new("no/such.tlog"), None).expect_err("no file");
    assert!(missing.to_string().contains("no/such.tlog"), "{missing}");
    let ulog = place("garbage", "log.ulg");
    // Truncated in its header: an empty log, whose cut is counted.
    fs::write(&ulog, b"ULog\x01\x12\x35\x01 and").expect("a file");
    let nothing = open(&ulog, None).expect_err("nothing in it").to_string();
    assert!(nothing.contains("log.ulg") && nothing.contains("cut short"), "{nothing}");
}

#[test]
fn short_log_imports_as_a_flight() {
    let all = entries();
    let start = all[0].0;
    let short: Vec<_> = all.into_iter().filter(|(time, _)| time - start < 2_000_000).collect();
    let flight = import(&write_tlog("short", "short.tlog", &short));
    let times = flight.attitude.times();
    assert!(times.last().unwrap() - times[0] < 2.1 && flight.attitude.len() > 100);
    assert_eq!(flight.left_out, []);
}

#[test]
fn truncated_log_gives_its_whole_frames() {
    let path = write_tlog("cut", "flight.tlog", &entries());
    let bytes = fs::read(&path).expect("the log");
    let cut = place("cut", "cut.tlog");
    fs::write(&cut, &bytes[..bytes.len() / 2 - 3]).expect("a file");
    let (whole, cut) = (import(&path), import(&cut));
    assert!(cut.attitude.len() > whole.attitude.len() / 3);
    assert_eq!(cut.attitude.times(), &whole.attitude.times()[..cut.attitude.len()]);
    let skipped = left_out(&cut, "no whole frame");
    assert!(skipped > 0 && skipped < 300, "{skipped}");
}

#[test]
fn nan_burst_is_dropped_and_counted() {
    let mut entries = entries();
    let middle = entries.len() / 2;
    let spoiled = spoil(&mut entries, 31, middle, 400, f32::NAN);
    assert!(spoiled > 20, "{spoiled}");
    let flight = import(&write_tlog("nan", "flight.tlog", &entries));
    assert_eq!(left_out(&flight, "ATTITUDE_QUATERNION"), spoiled);
    assert!(flight.attitude.values().iter().all(|q| q.w.is_finite() && q.z.is_finite()));
}

#[test]
fn duplicated_frames_are_dropped_and_counted() {
    let sound = entries();
    let mut doubled = Vec::new();
    for (number, entry) in sound.iter().enumerate() {
        doubled.push(entry.clone());
        if number % 7 == 0 {
            doubled.push((entry.0 + 50, entry.1.clone()));
        }
    }
    let flight = import(&write_tlog("double", "flight.tlog", &doubled));
    assert_eq!(left_out(&flight, "duplicated") as usize, doubled.len() - sound.len());
    assert_same_streams(&flight, &import(&write_tlog("double", "sound.tlog", &sound)));
}

#[test]
fn longer_part_is_kept_after_a_vehicle_clock_jump() {
    for by_ms in [-20_000, 300_000] {
        let mut entries = entries();
        let two_thirds = entries.len() * 2 / 3;
        move_vehicle_clock(&mut entries, two_thirds, by_ms);
        let flight = import(&write_tlog("jump", &format!("jump{by_ms}.tlog"), &entries));
        let whole = import(&write_tlog("jump", "whole.tlog", &self::entries()));
        let kept = flight.attitude.len();
        assert!(kept < whole.attitude.len() && kept > whole.attitude.len() / 2, "{kept}");
        assert_eq!(flight.attitude.times(), &whole.attitude.times()[..kept]);
        let last = flight.attitude.times()[kept - 1];
        assert!(flight.setpoint.times().iter().all(|time| *time < last + 0.1));
        let other = left_out(&flight, "another run of the vehicle's clock");
        assert!(other as usize > whole.attitude.len() / 5, "{:?}", flight.left_out);
    }
}

#[test]
fn ground_clock_step_leaves_the_streams_unchanged() {
    let whole = import(&write_tlog("step", "whole.tlog", &entries()));
    let mut entries = entries();
    let middle = entries.len() / 2;
    entries.iter_mut().skip(middle).for_each(|(time, _)| *time -= 7_000_000);
    let flight = import(&write_tlog("step", "flight.tlog", &entries));
    assert_eq!(flight.attitude, whole.attitude);
    assert_eq!(flight.body_rate, whole.body_rate);
    assert_eq!(left_out(&flight, "step of the ground's clock"), 1);
    // Setpoints at the step are lost; the others keep their times.
    assert!(flight.setpoint.len() + 250 > whole.setpoint.len());
    let worst = flight.setpoint.iter().map(|(time, _)| {
        let at = whole.setpoint.index_at(time + 1e-3).expect("a setpoint");
        (whole.setpoint.times()[at] - time).abs()
    });
    assert!(worst.fold(0.0, f64::max) < 0.011);
}

#[test]
fn vehicle_with_more_attitudes_is_imported() {
    let mut both = Vec::new();
    for (number, (time, bytes)) in entries().into_iter().enumerate() {
        if bytes[5] == 1 && number % 3 == 0 {
            let mut other = bytes.clone();
            other[5] = 2;
            sign(&mut other);
            both.push((time, other));
        }
        both.push((time, bytes));
    }
    let flight = import(&write_tlog("two", "flight.tlog", &both));
    let alone = import(&write_tlog("two", "alone.tlog", &entries()));
    assert_same_streams(&flight, &alone);
    assert!(left_out(&flight, "another vehicle") > 1000, "{:?}", flight.left_out);
}
