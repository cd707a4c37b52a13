//! A change in flight is reported with its time and cause, and nothing is reported without a
//! change.

use std::fs;
use std::path::{Path, PathBuf};

use downwash::command::{Inputs, Simulation};
use downwash::diagnose::flights::preparation::PreparedFlight;
use downwash::diagnose::onset::{OnsetReport, changes};
use downwash::health::Monitor;
use downwash::log::import::open;
use downwash::log::sink::Listener;
use downwash::onset::change::Change;
use downwash::onset::columns::Cause;
use downwash::onset::detector::Settings;
use vehicle::VehicleParams;
use vehicle::effects::Schedule;

const TRAJECTORY: &str = "family = \"figure-8\"\naltitude_m = 1.2\nduration_s = 32.0\nlength_m = 2.0\nwidth_m = 1.0\nperiod_s = 8.0\n";

/// A flight of the shipped vehicle with these effects, seen from its log and live.
fn flown(name: &str, effects: &[&str]) -> (OnsetReport, Vec<Change>) {
    let folder: PathBuf = Path::new(env!("CARGO_TARGET_TMPDIR")).join("onset").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let trajectory = folder.join("figure-8.toml");
    fs::write(&trajectory, TRAJECTORY).unwrap();
    let arguments: Vec<String> = effects.iter().map(|effect| (*effect).to_owned()).collect();
    let Schedule { effects, onsets } = Schedule::requested(None, &arguments).unwrap();
    let vehicle = Some(PathBuf::from("quad1200"));
    let inputs = Inputs {
        vehicle,
        trajectory: Some(trajectory),
        effects,
        onsets,
        seed: 3,
        ..Inputs::default()
    };
    let vehicle = VehicleParams::load("quad1200").unwrap();
    let mut monitor = Monitor::new(&vehicle, Settings::LIVE).unwrap();
    let simulation = Simulation::load(&inputs).unwrap();
    let (row, _) = simulation.fly_recorded(&folder, |record| monitor.on_record(record)).unwrap();
    let flight = open(&row.log.unwrap(), None).unwrap();
    let flight = PreparedFlight::new(flight, &vehicle).unwrap();
    let seen = changes(&flight, &vehicle, Settings::LOG).unwrap();
    fs::remove_dir_all(&folder).unwrap();
    (seen, monitor.take_changes().collect())
}

#[test]
fn weakened_rotor_is_detected_from_log_and_live() {
    let (seen, live) = flown("rotor", &["rotor_loss:rotor=2,scale=0.92@25"]);
    for (way, found) in [("log", &seen.changes), ("live", &live)] {
        assert_eq!(found.len(), 1, "{way}: {found:?}");
        let change = &found[0];
        assert!((change.at_s - 25.0).abs() < 0.5, "{way}: {change:?}");
        assert_eq!(change.cause, Cause::Rotor2, "{way}: {change:?}");
        let by = change.values[0].change.value;
        assert!((by + 0.08).abs() < 0.02, "{way}: {by}");
    }
}

#[test]
fn constant_difference_from_the_file_is_no_change() {
    let file =
        ["thrust_scale:scale=0.97", "inertia:scale=[1.08,0.94,1.0]", "motor_lag:tau_s=0.034"];
    let (seen, live) = flown("null", &file);
    assert!(seen.changes.is_empty() && live.is_empty(), "{:?} {live:?}", seen.changes);
    assert!(!seen.looks.is_empty(), "the log was searched");
}
