//! On-board practice logs agree with the telemetry of the same flight.

use crate::onboard_import::left_out;
use std::fs;
use std::path::{Path, PathBuf};

use downwash_log::import::{MotorUnit, Stream, open};
use vehicle::VehicleParams;
use vehicle::frame::{Attitude, Frd, Ned};

/// The vehicle's own log, telemetry of the same flight, and the vehicle file.
fn practice() -> Vec<(PathBuf, PathBuf, VehicleParams)> {
    let folder = match std::env::var_os("DOWNWASH_PRACTICE") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/practice-autopilot"),
    };
    let mut found = Vec::new();
    for case in fs::read_dir(folder).into_iter().flatten().flatten() {
        for file in fs::read_dir(case.path()).into_iter().flatten().flatten() {
            let path = file.path();
            let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
            let tlog = path.with_extension("tlog");
            if ["ulg", "BIN"].contains(&extension) && tlog.exists() {
                let vehicle = VehicleParams::load(case.path().join("vehicle.json"));
                found.push((path, tlog, vehicle.expect("a vehicle")));
            }
        }
    }
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
}

/// The delay of `b` relative to `a` with the smallest difference, and that difference as RMS per
/// component.
fn apart<T>(
    a: &Stream<T>,
    b: &Stream<T>,
    flying: std::ops::Range<f64>,
    difference: impl Fn(&T, &T, &T, f64) -> f64,
) -> (f64, f64) {
    let mut best = (0.0, f64::INFINITY);
    for step in -30..=30 {
        let delay = 1e-3 * f64::from(step);
        let (mut sum, mut count) = (0.0, 0.0);
        for (time, value) in a.iter().filter(|(time, _)| flying.contains(time)) {
            let Some(at) = b.index_at(time + delay) else { continue };
            let (Some(before), Some(after)) = (b.values().get(at), b.values().get(at + 1)) else {
                continue;
            };
            let share = (time + delay - b.times()[at]) / (b.times()[at + 1] - b.times()[at]);
            sum += difference(value, before, after, share).powi(2);
            count += 1.0;
        }
        let error = (sum / count).sqrt();
        if error < best.1 {
            best = (delay, error);
        }
    }
    best
}

#[test]
fn onboard_practice_logs_agree_with_their_telemetry() {
    let practice = practice();
    if practice.is_empty() {
        eprintln!(
            "skipped: no practice flights of autopilots; set DOWNWASH_PRACTICE to their folder"
        );
        return;
    }
    for (own, tlog, vehicle) in practice {
        let name = own.display();
        let own = open(&own, None).expect("the vehicle's log");
        let mut telemetry = open(&tlog, None).expect("telemetry");
        telemetry.normalise_outputs(&vehicle).expect("a unit");
        assert_eq!(own.motor_unit, MotorUnit::ThrustFraction, "{name}");
        assert_eq!(left_out(&own, "byte") + left_out(&own, "order"), 0, "{:?}", own.left_out);
        let flying = {
            let times = telemetry.setpoint.times();
            times[0] + 3.0..times[times.len() - 1] - 1.0
        };
        let mix = |a: f64, b: f64, share: f64| a + share * (b - a);
        let ned =
            |value: &Ned, a: &Ned, b: &Ned, share: f64| (*value - (*a + (*b - *a) * share)).norm();
        let frd =
            |value: &Frd, a: &Frd, b: &Frd, share: f64| (*value - (*a + (*b - *a) * share)).norm();
        let turn = |value: &Attitude, a: &Attitude, b: &Attitude, share: f64| {
            value.angle_to(if share < 0.5 { *a } else { *b }) - a.angle_to(*b) * 0.25
        };
        let outputs = |value: &[f64; 4], a: &[f64; 4], b: &[f64; 4], share: f64| {
            let error = (0..4).map(|i| (value[i] - mix(a[i], b[i], share)).powi(2)).sum::<f64>();
            (0.25 * error).sqrt()
        };
        let found = [
            apart(&own.position, &telemetry.position, flying.clone(), ned),
            apart(&own.velocity, &telemetry.velocity, flying.clone(), ned),
            apart(&own.attitude, &telemetry.attitude, flying.clone(), turn),
            apart(&own.body_rate, &telemetry.body_rate, flying.clone(), frd),
            apart(&own.outputs, &telemetry.outputs, flying.clone(), outputs),
        ];
        println!(
            "{name}: delay in s and difference of position, velocity, attitude, rate, outputs: {found:.4?}"
        );
        // Both logs are decimated, so fast changes between two samples show as differences.
        let most = [0.02, 0.03, 0.01, 0.12, 0.03];
        for ((delay, error), most) in found.into_iter().zip(most) {
            assert!(error < most && delay.abs() < 0.012, "{name}: {found:?}");
        }
    }
}
