//! The audit of flights with known faults finds those faults and no others.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;

use crate::{damage, lockstep};
use downwash::audit::{Audit, Channels, Estimate, Severity, Tier};
use downwash::diagnose::flights::rotor_order;
use downwash::diagnose::verdict::untestable;
use downwash::log::import::{Flight, MotorUnit, Stream, open, write};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde_json::Value;
use sitl::config::{ImuNoise, SensorConfig, SitlConfig};
use vehicle::frame::{Attitude, Euler, Frd, Ned};

/// Rotates and moves in every axis.
pub const LIVELY: &str = r#"
family = "multisine"
altitude_m = 1.5
duration_s = 24
north = [{ amplitude_m = 0.5, period_s = 3.1 }, { amplitude_m = 0.1, period_s = 1.3 }]
east = [{ amplitude_m = 0.6, period_s = 2.7 }, { amplitude_m = 0.1, period_s = 1.1, phase_deg = 40 }]
up = [{ amplitude_m = 0.3, period_s = 2.3 }]
yaw = [{ amplitude_deg = 60, period_s = 4.3 }]
"#;

fn place(name: &str) -> PathBuf {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join("audit");
    fs::create_dir_all(&directory).expect("a folder");
    directory.join(name)
}

/// A flight of the nano quadrotor with sensor noise.
pub fn fly(name: &str, trajectory: &str, config: SitlConfig, seed: u64) -> Flight {
    let params = lockstep::params(lockstep::NANO);
    let trajectory = lockstep::toml_trajectory(trajectory);
    let settings = lockstep::settings(&params, trajectory);
    let (_, records) = lockstep::fly(settings, &params, &lockstep::SLOW, config, seed);
    let path = place(&format!("{name}-{seed}.tlog"));
    damage::write_tlog(&path, &damage::entries(&records));
    open(&path, None).expect("a flight")
}

/// Noise as usual, but no bias.
pub fn unbiased() -> SitlConfig {
    let usual = SensorConfig::default();
    let unbiased = |imu: ImuNoise| ImuNoise { bias: 0.0, bias_walk: 0.0, ..imu };
    let sensors = SensorConfig {
        gyro: unbiased(usual.gyro),
        accelerometer: unbiased(usual.accelerometer),
        ..usual
    };
    SitlConfig { sensors, ..SitlConfig::default() }
}

pub static FLIGHT: LazyLock<Flight> = LazyLock::new(|| fly("lively", LIVELY, unbiased(), 7));

fn trim() -> Attitude {
    Euler::new(0.008, -0.014, 0.011).attitude()
}

/// The flight with delayed, rotated and biased streams.
fn corrupted(flight: &Flight) -> Flight {
    let mut flight = flight.clone();
    flight.attitude = flight.attitude.map(|q| q.compose(trim())).shifted(0.0173);
    flight.position = flight.position.shifted(0.0264);
    flight.velocity = flight.velocity.shifted(0.0231);
    flight.body_rate = flight.body_rate.map(|w| *w + Frd::new(0.03, -0.02, 0.01));
    flight.specific_force = flight.specific_force.map(|f| *f + Frd::new(0.12, -0.25, 0.3));
    flight
}

/// A stream without a random tenth of its samples.
fn thinned<T: Clone>(stream: &Stream<T>, seed: u64) -> Stream<T> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    stream.filter_map(|value| (random.random::<f64>() > 0.1).then(|| value.clone()))
}

fn assert_near(estimate: impl Into<Option<Estimate>>, expected: f64, most: f64, name: &str) {
    let estimate = estimate.into().expect(name);
    assert!((estimate.value - expected).abs() < most, "{name}: {estimate:?}, expected {expected}");
    assert!(estimate.half_width < 2.0 * most, "{name}: {estimate:?}");
}

/// Delay to 1 ms, rotation to 0.1 degree, bias to 0.02 m/s^2.
fn assert_recovered(audit: &Audit) {
    let kinematics = &audit.kinematics;
    let attitude = kinematics.attitude.expect("the attitude turns");
    assert_near(attitude.delay_s, 0.0173, 1e-3, "attitude delay");
    for (found, expected) in attitude.rotation_rad.into_iter().zip([0.008, -0.014, 0.011]) {
        assert_near(found, expected, 0.1_f64.to_radians(), "trim");
    }
    for (found, expected) in attitude.bias.into_iter().zip([0.03, -0.02, 0.01]) {
        assert_near(found, expected, 2e-3, "gyro bias");
    }
    let position = kinematics.position.expect("the vehicle moves");
    assert_near(position.delay_s, 0.0264 - 0.0231, 1e-3, "position delay");
    let velocity = kinematics.velocity.expect("the vehicle moves");
    assert_near(velocity.delay_s, 0.0231, 1e-3, "velocity delay");
    for (found, expected) in velocity.bias.into_iter().zip([0.12, -0.25, 0.3]) {
        assert_near(found, expected, 0.02, "accelerometer bias");
    }
}

#[test]
fn delays_rotations_and_biases_are_recovered() {
    let audit = Audit::of(&corrupted(&FLIGHT));
    assert_recovered(&audit);
    assert!(!audit.is_faulty(), "{:#?}", audit.findings);
    let found: Vec<(&str, Option<&str>)> =
        audit.findings.iter().map(|finding| (finding.check, finding.stream)).collect();
    for expected in [
        ("delay", Some("attitude")),
        ("rotation", Some("attitude")),
        ("delay", Some("velocity")),
        ("bias", Some("velocity")),
    ] {
        assert!(found.contains(&expected), "{expected:?} in {found:?}");
    }
}

#[test]
fn losing_a_tenth_of_the_samples_biases_nothing() {
    let mut flight = corrupted(&FLIGHT);
    flight.attitude = thinned(&flight.attitude, 1);
    flight.position = thinned(&flight.position, 2);
    flight.velocity = thinned(&flight.velocity, 3);
    flight.body_rate = thinned(&flight.body_rate, 4);
    flight.specific_force = thinned(&flight.specific_force, 5);
    let audit = Audit::of(&flight);
    assert_recovered(&audit);
    assert!(!audit.is_faulty(), "{:#?}", audit.findings);
}

#[test]
fn wrong_heading_is_found() {
    let mut flight = FLIGHT.clone();
    let turn = Euler::new(0.0, 0.0, 0.15).attitude();
    flight.attitude = flight.attitude.map(|q| turn.compose(*q));
    let velocity = Audit::of(&flight).kinematics.velocity.expect("the vehicle moves");
    assert_near(velocity.rotation_rad[2], 0.15, 0.01, "heading");
}

#[test]
fn scale_of_each_axis_is_recovered() {
    let mut flight = FLIGHT.clone();
    flight.velocity = flight.velocity.map(|v| {
        let [n, e, d] = v.to_array();
        Ned::new(1.08 * n, e, 0.94 * d)
    });
    let audit = Audit::of(&flight);
    let position = audit.kinematics.position.expect("the vehicle moves");
    for (scale, by) in position.scale.into_iter().zip([1.08, 1.0, 0.94]) {
        assert_near(scale, 1.0 / by, 0.01, "scale");
    }
    let scales: Vec<f64> =
        audit.findings.iter().filter(|f| f.check == "scale").map(|f| f.found).collect();
    assert!(scales.iter().any(|found| (found - 1.0 / 1.08).abs() < 0.01), "{:?}", audit.findings);
    assert!(!audit.is_faulty(), "{:#?}", audit.findings);
}

/// Noise in the velocity flattens the slope of the position against it; the interval covers the
/// truth.
#[test]
fn scale_interval_covers_noise_in_either_stream() {
    let mut random = Pcg64Mcg::seed_from_u64(3);
    let mut noisy = |v: &Ned| {
        let mut noise = || random.random_range(-1.5..1.5);
        *v + Ned::new(noise(), noise(), noise())
    };
    let mut flight = FLIGHT.clone();
    flight.velocity = flight.velocity.map(&mut noisy);
    let audit = Audit::of(&flight);
    let position = audit.kinematics.position.expect("the vehicle moves");
    for scale in position.scale.into_iter().flatten() {
        assert!((scale.value - 1.0).abs() < scale.half_width, "{scale:?}");
    }
    assert!(position.scale[0].is_some_and(|scale| scale.half_width < 0.3), "{position:?}");
    assert!(audit.findings.iter().all(|f| f.check != "scale"), "{:#?}", audit.findings);
}

#[test]
fn clock_drift_is_found() {
    let mut flight = FLIGHT.clone();
    let mut drifting = Stream::default();
    let start = flight.attitude.times()[0];
    for (time, q) in flight.attitude.iter() {
        drifting.push(time + 3e-3 * (time - start), *q);
    }
    flight.attitude = drifting;
    let audit = Audit::of(&flight);
    assert!(audit.findings.iter().any(|f| f.check == "clock_drift"), "{:#?}", audit.findings);
}

/// Flights of each kind in turn, each with its own parameters.
fn clean(seed: u64) -> Flight {
    let kinds = [
        LIVELY,
        "family = \"sinusoid-yaw\"\naltitude_m = 1.0\nduration_s = 15\namplitude_m = 1.0\nperiod_s = 5.0\nyaw_period_s = 10.0\n",
        "family = \"hover\"\naltitude_m = 1.0\nduration_s = 12\n",
        "family = \"figure-8\"\naltitude_m = 1.0\nduration_s = 16\nlength_m = 3.0\nwidth_m = 1.5\nperiod_s = 8.0\nclimb_m = 0.6\n",
    ];
    fly("clean", kinds[seed as usize % kinds.len()], SitlConfig::default(), seed)
}

fn assert_no_alarm(seeds: std::ops::Range<u64>) {
    use rayon::prelude::*;
    let alarms: Vec<String> = seeds
        .into_par_iter()
        .flat_map_iter(|seed| {
            let audit = Audit::of(&clean(seed));
            let alarms = audit.findings.into_iter().filter(|f| f.severity > Severity::Note);
            alarms.map(move |finding| format!("seed {seed}: {finding}")).collect::<Vec<_>>()
        })
        .collect();
    assert!(alarms.is_empty(), "{}", alarms.join("\n"));
}

#[test]
fn clean_flights_raise_no_alarm() {
    assert_no_alarm(1000..1020);
}

#[test]
#[ignore = "long: tests/run --all; the test above is a sample of it"]
fn two_hundred_clean_flights_raise_no_alarm() {
    assert_no_alarm(0..200);
}

/// Checks that the audit reports a fault.
fn assert_fault(flight: &Flight, check: &str, words: &str) {
    let audit = Audit::of(flight);
    let found = audit.findings.iter().find(|f| f.check == check && f.severity == Severity::Fault);
    let found = found.unwrap_or_else(|| panic!("{check}: {:#?}", audit.findings));
    assert!(found.to_string().contains(words), "{found}");
}

#[test]
fn wrong_units_are_found() {
    let mut flight = FLIGHT.clone();
    flight.body_rate = flight.body_rate.map(|w| *w * 1f64.to_degrees());
    assert_fault(&flight, "unit", "degrees");
    let mut flight = FLIGHT.clone();
    flight.position = flight.position.map(|p| *p * 1e3);
    assert_fault(&flight, "unit", "mm");
    let mut flight = FLIGHT.clone();
    flight.velocity = flight.velocity.map(|v| *v * 100.0);
    assert_fault(&flight, "unit", "cm");
    let mut flight = FLIGHT.clone();
    flight.specific_force = flight.specific_force.map(|f| *f * (1.0 / 9.81));
    assert_fault(&flight, "gravity", "in g");
    let mut flight = FLIGHT.clone();
    flight.voltage = flight.voltage.map(|v| v * 1e3);
    assert_fault(&flight, "unit", "millivolts");
    // Milliseconds taken for microseconds.
    let mut flight = FLIGHT.clone();
    let mut hurried = Stream::default();
    for (time, attitude) in FLIGHT.attitude.iter() {
        hurried.push(1e-3 * time, *attitude);
    }
    flight.attitude = hurried;
    assert_fault(&flight, "unit", "times in another unit");
}

#[test]
fn wrong_quaternion_order_and_axes_are_found() {
    let mut flight = FLIGHT.clone();
    flight.attitude = flight.attitude.map(|q| q.inverse());
    assert_fault(&flight, "quaternion", "world to body");
    let mut flight = FLIGHT.clone();
    flight.attitude = flight.attitude.map(|q| Attitude { w: q.x, x: q.y, y: q.z, z: q.w });
    assert_fault(&flight, "quaternion", "x, y, z, w");
    let mut flight = FLIGHT.clone();
    let swapped = |w: &Frd| {
        let [x, y, z] = w.to_array();
        Frd::new(x, -y, -z)
    };
    flight.specific_force = flight.specific_force.map(swapped);
    assert_fault(&flight, "gravity", "front, left, up");
    let mut flight = FLIGHT.clone();
    flight.body_rate = flight.body_rate.map(swapped);
    assert_fault(&flight, "axes", "degrees");
    let mut flight = FLIGHT.clone();
    flight.velocity = flight.velocity.map(|v| {
        let [n, e, d] = v.to_array();
        Ned::new(e, n, d)
    });
    assert_fault(&flight, "axes", "handedness");
}

#[test]
fn impossible_motor_outputs_are_found() {
    let mut flight = FLIGHT.clone();
    flight.outputs = flight.outputs.map(|u| [u[0], u[1], u[2] * 2.2, u[3]]);
    assert_fault(&flight, "illegal_output", "outside");
    let mut flight = FLIGHT.clone();
    flight.outputs = flight.outputs.map(|u| [u[0], 0.5, u[2], u[3]]);
    assert_fault(&flight, "stuck_output", "output 2");
    let mut flight = FLIGHT.clone();
    flight.facts.motors = Some(6);
    assert_fault(&flight, "motor_count", "6 motors");
    let mut flight = FLIGHT.clone();
    flight.motor_unit = MotorUnit::VehicleFile;
    flight.outputs = flight.outputs.map(|u| u.map(|u| 1000.0 + 3000.0 * u));
    assert_fault(&flight, "illegal_output", "2250");
}

#[test]
fn non_multirotor_is_a_fault() {
    use downwash::log::import::{StatedKind, VehicleKind};
    let stated = |kind| StatedKind { kind, by: "MAV_TYPE is 1".to_owned() };
    let mut flight = FLIGHT.clone();
    flight.facts.kinds = vec![stated(VehicleKind::Multirotor), stated(VehicleKind::FixedWing)];
    assert_fault(&flight, "vehicle_kind", "an aeroplane: MAV_TYPE is 1");
    flight.facts.kinds.pop();
    assert!(!Audit::of(&flight).is_faulty());
}

#[test]
fn constant_outputs_in_flight_are_found() {
    for held in [0.0, 0.5] {
        let mut flight = FLIGHT.clone();
        flight.outputs = flight.outputs.map(|_| [held; 4]);
        assert_fault(&flight, "still_outputs", "all four stay");
    }
    // The outputs change only at arming, in the middle of the flight, and drive no motor.
    let mut flight = FLIGHT.clone();
    let middle = flight.outputs.len() / 2;
    let mut outputs = Stream::default();
    for (at, time) in flight.outputs.times().iter().enumerate() {
        outputs.push(*time, if at < middle { [0.0; 4] } else { [0.1; 4] });
    }
    flight.outputs = outputs;
    assert_fault(&flight, "still_outputs", "all four stay");
    // Outputs need not move on the ground.
    let mut flight = FLIGHT.clone();
    flight.outputs = flight.outputs.map(|_| [0.5; 4]);
    flight.body_rate = flight.body_rate.map(|_| Frd::new(0.0, 0.0, 0.0));
    flight.velocity = flight.velocity.map(|_| Ned::new(0.0, 0.0, 0.0));
    let still = Audit::of(&flight).findings.iter().any(|f| f.check == "still_outputs");
    assert!(!still);
}

#[test]
fn wrong_output_order_is_found() {
    use downwash::log::import::RotorFact;
    let params = lockstep::params(lockstep::NANO);
    let fact = |i: usize| {
        let rotor = &params.rotors[i];
        RotorFact { front: rotor.position_m[0], right: rotor.position_m[1], spin: rotor.spin }
    };
    let rotors: [RotorFact; 4] = std::array::from_fn(fact);
    let effects = Audit::of(&FLIGHT).rotors.expect("the outputs turn the vehicle");
    let sure = effects.turning.iter().flatten().filter(|e| e.differs_from_zero(2.0)).count();
    assert!(sure >= 8, "{effects:?}");

    let mut flight = FLIGHT.clone();
    flight.facts.rotors = rotors.to_vec();
    assert!(!Audit::of(&flight).is_faulty());
    flight.outputs = flight.outputs.map(|u| [u[1], u[2], u[3], u[0]]);
    assert_fault(&flight, "motor_order", "order");

    // The log does not state the rotor positions, but the vehicle file does.
    flight.facts.rotors.clear();
    let checked = |flight: &Flight| {
        let mut audit = [Audit::of(flight)];
        assert!(!audit[0].is_faulty());
        rotor_order::check(&mut audit, &params);
        let [audit] = audit;
        audit
    };
    let audit = checked(&flight);
    let finding = audit.findings[0].to_string();
    assert!(
        finding.contains("vehicle file's rotors would, but in the order 4, 1, 2, 3 they do"),
        "{finding}"
    );
    let audit = checked(&FLIGHT);
    assert!(!audit.is_faulty(), "{:?}", audit.findings);

    // The opposite directions of rotation, and outputs logged after their effect.
    let mut reversed = FLIGHT.clone();
    reversed.facts.rotors = rotors.map(|rotor| RotorFact { spin: -rotor.spin, ..rotor }).to_vec();
    assert_fault(&reversed, "motor_order", "with the opposite directions of rotation");
    let mut late = FLIGHT.clone();
    late.outputs = late.outputs.clone().shifted(0.12);
    let audit = checked(&late);
    assert_eq!((audit.findings[0].check, audit.findings[0].stream), ("delay", Some("outputs")));
}

#[test]
fn frozen_jumping_and_impossible_values_are_found() {
    let mut flight = FLIGHT.clone();
    let middle = flight.velocity.times()[flight.velocity.len() / 2];
    let mut frozen = Stream::default();
    let held = *flight.position.held_at(middle).expect("a position");
    for (time, position) in flight.position.iter() {
        let value = if (middle..middle + 1.0).contains(&time) { held } else { *position };
        frozen.push(time, value);
    }
    flight.position = frozen;
    assert_fault(&flight, "frozen", "freezes");

    let mut flight = FLIGHT.clone();
    let mut jumped = Stream::default();
    for (time, position) in flight.position.iter() {
        let east = if time > middle { 1.5 } else { 0.0 };
        jumped.push(time, *position + Ned::new(0.0, east, 0.0));
    }
    flight.position = jumped;
    let audit = Audit::of(&flight);
    let step = audit.findings.iter().find(|f| f.check == "step").expect("a step");
    assert!((step.found - 1.5).abs() < 0.2 && step.stream == Some("position"), "{step}");
    let span = audit.unusable.iter().find(|span| span.stream == "position").expect("a span");
    assert!((span.from_s - middle).abs() < 0.1, "{span:?}");

    let mut flight = FLIGHT.clone();
    let mut count = 0;
    flight.body_rate = flight.body_rate.map(|w| {
        count += 1;
        if count % 50 == 0 { Frd::new(900.0, 0.0, 0.0) } else { *w }
    });
    assert_fault(&flight, "impossible", "no sensor");
}

#[test]
fn tier_determines_untestable_effects() {
    let tier = |flight: &Flight| Audit::of(flight).tier;
    let names = |flight: &Flight| -> Vec<&'static str> {
        let untestable = untestable::of(flight, &Channels::of(flight));
        untestable.iter().map(|untestable| untestable.effect.name()).collect()
    };
    assert!(tier(&FLIGHT) >= Some(Tier::T2));
    let whole = names(&FLIGHT);
    assert!(!whole.contains(&"inertia") && !whole.contains(&"wind"), "{whole:?}");

    let mut slow = FLIGHT.clone();
    let mut number = 0;
    slow.outputs = slow.outputs.filter_map(|u| {
        number += 1;
        (number % 10 == 0).then_some(*u)
    });
    let found = names(&slow);
    assert!(["motor_lag", "inertia"].iter().all(|id| found.contains(id)), "{found:?}");
    assert!(!found.contains(&"rotor_loss") && !found.contains(&"rotor_drag"), "{found:?}");

    let mut blind = FLIGHT.clone();
    blind.attitude = Stream::default();
    blind.position = Stream::default();
    blind.velocity = Stream::default();
    let found = names(&blind);
    assert_eq!(tier(&blind), None);
    for id in ["wind", "rotor_drag", "ground_effect", "attitude_trim"] {
        assert!(found.contains(&id), "{found:?}");
    }
    assert!(!found.contains(&"inertia") && !found.contains(&"motor_lag"), "{found:?}");

    let mut poor = FLIGHT.clone();
    poor.outputs = Stream::default();
    poor.rotor_speed = Stream::default();
    poor.voltage = Stream::default();
    let found = names(&poor);
    assert_eq!(tier(&poor), Some(Tier::T1));
    for id in ["rotor_loss", "battery_sag", "yaw_torque"] {
        assert!(found.contains(&id), "{found:?}");
    }
}

#[test]
fn command_prints_json_and_fails_only_on_request() {
    let path = place("faulty.mcap");
    let mut flight = FLIGHT.clone();
    flight.outputs = flight.outputs.map(|u| [u[0], 0.5, u[2], u[3]]);
    write(&flight, &path).expect("a log");
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_downwash"));
        command.args(["log", "audit"]).arg(&path).args(arguments).output().expect("it runs")
    };
    let plain = run(&[]);
    assert_eq!(plain.status.code(), Some(0));
    assert!(String::from_utf8_lossy(&plain.stdout).contains("output 2 stays constant"));
    let json = run(&["--json"]);
    let summary: Value = serde_json::from_slice(&json.stdout).expect("one object");
    assert_eq!(summary["schema"], "downwash.log.audit");
    let log = &summary["logs"][0];
    assert_eq!(log["findings"][0]["severity"], "fault");
    assert_eq!(log["findings"][0]["check"], "stuck_output");
    assert!(log["kinematics"]["attitude"]["delay_s"]["value"].is_number(), "{log}");
    assert_eq!(run(&["--fail-on", "fault"]).status.code(), Some(10));
    assert_eq!(run(&["--fail-on", "nothing"]).status.code(), Some(2));
}
