//! Logs in poor condition: setpoints are restored to their send times.

use std::fs;
use std::path::Path;

use downwash::exam::case::Case;
use downwash::exam::condition::Condition;
use downwash::exam::order::{Kind, Order, Settings};
use downwash::log::import::{self, Flight};

/// A flight of a drawn vehicle, as logged in each of the conditions.
fn flown(name: &str, conditions: &[Condition]) -> Vec<Flight> {
    let settings = Settings { flights: 1, ..Settings::default() };
    let case = Case::fly(&settings, 11, 0, name, &Order::from(Kind::Null)).expect("a case");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log-conditions").join(name);
    fs::create_dir_all(&folder).expect("a folder");
    let log = case.logs.first().expect("a log");
    conditions
        .iter()
        .map(|condition| {
            let path = folder.join(format!("{}.tlog", condition.name()));
            fs::write(&path, condition.apply(log, 5)).expect("a file");
            import::open(&path, None).expect("a log")
        })
        .collect()
}

#[test]
fn rough_setpoint_timestamps_are_restored_to_send_times() {
    let flights = flown("rough", &[Condition::Plain, Condition::Jitter]);
    let [plain, rough] = flights.as_slice() else { panic!("two logs") };
    assert_eq!(plain.setpoint.values(), rough.setpoint.values());
    let off: Vec<f64> =
        plain.setpoint.times().iter().zip(rough.setpoint.times()).map(|(a, b)| b - a).collect();
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    // The timestamps are up to 5 ms off; those of the ground station have whole milliseconds.
    assert!(mean.abs() < 6e-4, "{mean}");
    assert!(off.iter().all(|off| (off - mean).abs() < 1.2e-3), "{off:?}");
    // Data with vehicle timestamps are unchanged.
    assert_eq!(plain.attitude, rough.attitude);
}

#[test]
fn missing_setpoints_are_counted() {
    let conditions = [Condition::Plain, Condition::HalfRate, Condition::Dropouts];
    let flights = flown("lacking", &conditions);
    let [plain, half, lost] = flights.as_slice() else { panic!("three logs") };
    assert!(plain.setpoints_missing.is_empty());
    for thinned in [half, lost] {
        let missing: u32 = thinned.setpoints_missing.values().iter().sum();
        let lacks = plain.setpoint.len() - thinned.setpoint.len();
        // Nothing reveals the missing setpoints after the last one.
        assert!((lacks as u32).abs_diff(missing) <= 2, "{missing} of {lacks}");
        let is_at_one = |time: &f64| thinned.setpoint.times().contains(time);
        assert!(thinned.setpoints_missing.times().iter().all(is_at_one));
    }
}

#[test]
fn missing_setpoint_counts_survive_an_import() {
    let flights = flown("kept", &[Condition::HalfRate]);
    let half = flights.first().expect("a flight");
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("log-conditions/kept/half.mcap");
    import::write(half, &path).expect("a file");
    let again = import::open(&path, None).expect("a log");
    assert!(!again.setpoints_missing.is_empty());
    assert_eq!(again.setpoints_missing, half.setpoints_missing);
    assert_eq!(again.setpoint.times(), half.setpoint.times());
}
