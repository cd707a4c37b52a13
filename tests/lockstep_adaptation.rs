//! Parameter adaptation in flight: unannounced changes, under both laws, and flights in which
//! adaptation must not be trusted.

use crate::lockstep::{QUAD, fly, hover, params, setpoint_frames, settings, tracked};
use downwash::control::{Law, Use};
use downwash::lockstep;
use downwash::log::record::Record;
use downwash::station::{End, Station, StationSettings};
use sitl::autopilot::Vehicle;
use sitl::config::{GpsGlitch, SitlConfig};
use vehicle::effects::EffectSet;
use vehicle::foreign::Foreign;

/// Time along the trajectory at which the vehicle changes, s.
const CHANGE_S: f64 = 5.0;

fn with(law: Law, adaptive: bool, seconds: f64) -> StationSettings {
    let mut settings = settings(&params(QUAD), hover(seconds));
    settings.control.law = law;
    settings.control.adaptive = adaptive;
    settings
}

/// A hover in which the vehicle changes.
fn changed(settings: StationSettings, change: &Foreign, seed: u64) -> (End, Vec<Record>) {
    let config = SitlConfig::default();
    let mut vehicle =
        Vehicle::new(params(QUAD), EffectSet::new(), config, seed).expect("a vehicle that flies");
    let mut station = Station::new(settings, lockstep::host_time(0));
    let (mut records, mut due) = (Vec::new(), true);
    let act = |vehicle: &mut Vehicle, station: &mut Station| {
        let time_s = station.status().progress.map(|(time_s, _)| time_s);
        if due && time_s.is_some_and(|time_s| time_s >= CHANGE_S) {
            due = false;
            vehicle.disturb(change.clone(), seed);
        }
    };
    let log = |record| records.push(record);
    let end = lockstep::fly_disturbed(&mut vehicle, &mut station, 120.0, log, |_, _| {}, act);
    (end.expect("an end"), records)
}

/// Largest distance from the reference from `after_s` after the change on, m.
fn largest_m(records: &[Record], after_s: f64) -> f64 {
    let rows = tracked(records);
    let late = rows.iter().filter(|row| row.t > CHANGE_S + after_s);
    late.map(|row| row.error_m).fold(0.0, f64::max)
}

fn words(records: &[Record]) -> Vec<&str> {
    let events = records.iter().filter_map(|record| match record {
        Record::Event { text, .. } => Some(text.as_str()),
        _ => None,
    });
    events.filter(|text| text.contains("adapt")).collect()
}

#[test]
fn payload_and_weak_rotor_are_compensated_and_reported_under_both_laws() {
    let payload = (Foreign::Payload { share: 0.3 }, "mass +", 0.06, 0.012);
    let wear = Foreign::RotorWear { rotor: 0, loss: 0.25, torque_share: 1.0 };
    let rotor = (wear, "less thrust at the front right rotor", 0.09, 0.012);
    for (change, expected, peak_m, late_m) in [payload, rotor] {
        for law in [Law::LQR, Law::GEOMETRIC] {
            let (end, records) = changed(with(law, true, 9.0), &change, 1);
            assert_eq!(end, End::Done, "{law}");
            let (peak, late) = (largest_m(&records, 0.0), largest_m(&records, 2.0));
            assert!(peak < peak_m && late < late_m, "{law}, {}: {peak} {late}", change.name());
            let words = words(&records);
            assert!(words.iter().any(|text| text.contains(expected)), "{law}: {words:?}");
            let (_, plain) = changed(with(law, false, 9.0), &change, 1);
            assert!(largest_m(&plain, 2.0) > 5.0 * late_m, "{law}: the change has no effect");
        }
    }
}

#[test]
fn adaptation_is_silent_and_harmless_without_a_change() {
    let mean = |records: &[Record]| {
        let rows = tracked(records);
        (rows.iter().map(|row| row.error_m.powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
    };
    let [plain, adapted] = [false, true].map(|adaptive| {
        let settings = with(Law::LQR, adaptive, 12.0);
        let (end, records) = fly(settings, &params(QUAD), &[], SitlConfig::default(), 1);
        assert_eq!(end, End::Done);
        (mean(&records), words(&records).len())
    });
    assert!(adapted.0 < 1.01 * plain.0, "{} and {} m", adapted.0, plain.0);
    assert_eq!((plain.1, adapted.1), (0, 0));
}

#[test]
fn adaptation_settings_have_no_effect_when_switched_off() {
    let flown = |adaptive: bool, forgetting_s: f64| {
        let mut settings = with(Law::LQR, adaptive, 2.0);
        settings.control.adaptation.forgetting_s = forgetting_s;
        setpoint_frames(&fly(settings, &params(QUAD), &[], SitlConfig::default(), 1).1)
    };
    let off = flown(false, 4.0);
    assert!(off == flown(false, 1.0));
    assert!(off != flown(true, 4.0));
}

#[test]
fn estimate_jump_ends_the_flight_as_without_adaptation() {
    let flown = |adaptive: bool, observer: Use| {
        let mut settings = with(Law::LQR, adaptive, 20.0);
        settings.offboard.offset_free.observer = observer;
        let mut config = SitlConfig::default();
        config.estimator.gps_glitch =
            Some(GpsGlitch { at_s: 14.0, for_s: 30.0, offset_m: [1.0, -1.0, 0.0] });
        config.estimator.reset_after_s = 2.0;
        let (end, records) = fly(settings, &params(QUAD), &[], config, 1);
        let farthest = tracked(&records).iter().map(|row| row.error_m).fold(0.0, f64::max);
        (end, farthest)
    };
    let (plain, _) = flown(false, Use::Off);
    for observer in [Use::Off, Use::On] {
        let (end, farthest) = flown(true, observer);
        assert_eq!(end, plain);
        assert!(farthest < 2.0, "{farthest} m");
    }
}
