//! The suggested flight, once flown, distinguishes rival explanations.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use crate::command;
use crate::lockstep::{NANO, QUAD, config_file};
use downwash::diagnose::likelihood::noise::ReportNoise;
use downwash::diagnose::next_flight::{LiveHypothesis, NextFlight, Proposal, separating};
use downwash::exam::interval::Rate;
use downwash::plan::FlightEnvelope;
use downwash::plan::manoeuvres::Room;
use downwash::plan::programme::{Capability, ProgrammeSettings};
use serde_json::Value;
use sitl::config::SensorConfig;
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;

/// Pairs that a hover at one heading with a fresh pack cannot distinguish.
const PAIRS: [(&str, &str, &str); 11] = [
    (
        QUAD,
        "wind:north_m_s=2,east_m_s=-1,down_m_s=0",
        "attitude_trim:roll_rad=0.024,pitch_rad=0.047,yaw_rad=0",
    ),
    (NANO, "thrust_scale:scale=0.93", "battery_sag:exponent=1.5"),
    (NANO, "thrust_scale:scale=0.93", "thrust_curve:a=0.25"),
    (NANO, "thrust_curve:a=0.25", "battery_sag:exponent=1.5"),
    (NANO, "com_offset:x_m=0.001,y_m=-0.001", "rotor_loss:rotor=1,scale=0.93"),
    (
        NANO,
        "rotor_drag:d_xy=0.008,d_z=0.003",
        "blade_flapping:moment_Nms_m=0.0001,tilt_rad_s_m=0.01",
    ),
    (NANO, "rotor_drag:d_xy=0.008,d_z=0.003", "parasitic_drag:cda_m2=0.006"),
    (NANO, "motor_lag:tau_s=0.06", "command_delay:delay_s=0.025"),
    (
        NANO,
        "inertia:scale=[1.35,1.35,1.3]",
        "pd_gain:kp_scale=[0.75,0.75,0.8],kd_scale=[0.75,0.75,0.8]",
    ),
    (
        NANO,
        "attitude_trim:roll_rad=0.015,pitch_rad=-0.02,yaw_rad=0",
        "com_offset:x_m=0.001,y_m=-0.001",
    ),
    (NANO, "yaw_torque:scale=1.4", "inertia:scale=[1,1,0.7]"),
];

fn vehicle(name: &str) -> PathBuf {
    config_file("vehicles", name)
}

fn folder(name: &str) -> PathBuf {
    command::folder(&format!("next-flight/{name}"))
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    let output = command::downwash(folder).args(arguments).output().expect("the command runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Flies a trajectory file in SITL with a hidden effect; returns the log.
fn fly(folder: &Path, vehicle_file: &str, trajectory: &Path, effect: &str, seed: u64) -> PathBuf {
    let out = folder.join(format!("flown-{}", trajectory.file_stem().unwrap().to_string_lossy()));
    let (vehicle, seed) = (vehicle(vehicle_file), seed.to_string());
    let text = |path: &Path| path.to_str().expect("a path in UTF-8").to_owned();
    let output = run(
        folder,
        &[
            "demo",
            "--fly",
            "model-free",
            "--json",
            "--seed",
            &seed,
            "--effect",
            effect,
            "--vehicle",
            &text(&vehicle),
            "--trajectory",
            &text(trajectory),
            "--out",
            &text(&out),
        ],
    );
    let summary: Value = serde_json::from_slice(&output.stdout).expect("a summary");
    assert_eq!(summary["end"], "done", "{summary}");
    PathBuf::from(summary["log"].as_str().expect("a log"))
}

fn live(effect: &str) -> LiveHypothesis {
    let mut effects = EffectSet::new();
    effects.insert_argument(effect).expect("an effect");
    LiveHypothesis { effects, probability: 0.5 }
}

/// The suggested flight for a pair.
fn suggested(vehicle_file: &str, pair: [&str; 2], seed: u64) -> NextFlight {
    let vehicle = VehicleParams::load(vehicle(vehicle_file)).expect("a vehicle");
    let pd = vehicle.attitude_pd.expect("attitude_pd");
    let bandwidth = |axis: usize| (pd.kp[axis] / vehicle.inertia[axis]).sqrt();
    let capability = Capability {
        gravity: vehicle.gravity,
        thrust_to_weight: 1.0 / vehicle.hover_thrust,
        tilt_bandwidth: bandwidth(0).min(bandwidth(1)),
        yaw_bandwidth: bandwidth(2),
    };
    let envelope = FlightEnvelope::default();
    let sensors = SensorConfig::default();
    let proposal = Proposal {
        vehicle: &vehicle,
        setpoint_leg: true,
        noise: ReportNoise {
            position: sensors.position_noise_m,
            velocity: sensors.velocity_noise_m_s,
            attitude: sensors.attitude_noise_rad,
            body_rate: sensors.gyro.noise,
            specific_force: sensors.accelerometer.noise,
        },
        room: Room::new(&ProgrammeSettings::default(), &envelope, &capability),
        envelope,
        seed,
    };
    let next = separating(&proposal, &pair.map(live)).expect("a vehicle that flies");
    next.expect("a flight that can be flown")
}

fn id(effect: &str) -> &str {
    effect.split(':').next().expect("an id")
}

/// Diagnoses a hover at one heading together with the suggested flight; returns whether the answer
/// names the truth and excludes the rival.
fn is_resolved(name: &str, vehicle_file: &str, truth: &str, rival: &str, seed: u64) -> bool {
    let folder = folder(name);
    let next = suggested(vehicle_file, [truth, rival], seed);
    let (hover_file, next_file) = (folder.join("hover.toml"), folder.join("next.toml"));
    fs::write(&hover_file, "family = \"hover\"\naltitude_m = 1.2\nduration_s = 20.0\n")
        .expect("a file");
    fs::write(&next_file, &next.file).expect("a file");
    let old = fly(&folder, vehicle_file, &hover_file, truth, seed);
    let new = fly(&folder, vehicle_file, &next_file, truth, seed + 1);
    let text = |path: &Path| path.to_str().expect("a path in UTF-8").to_owned();
    let vehicle = text(&vehicle(vehicle_file));
    let (old, new) = (text(&old), text(&new));
    let arguments =
        ["diagnose", "--json", "--twins", "0", "--vehicle", &vehicle, &old, "--new", &new];
    let answer: Value =
        serde_json::from_slice(&run(&folder, &arguments).stdout).expect("an answer");
    let has = |list: &Value, id: &str| {
        list.as_array().is_some_and(|list| list.iter().any(|entry| entry == id))
    };
    let named = |id: &str| {
        let effects = answer["effects"].as_array().expect("effects");
        let of = |effect: &&Value| effect["id"] == id;
        effects.iter().find(of).is_some_and(|effect| effect["probability"].as_f64() >= Some(0.5))
    };
    let (truth, rival) = (id(truth), id(rival));
    let resolved = named(truth) && !named(rival) && !has(&answer["ambiguous_with"], rival);
    let least = next.tried.first().and_then(|tried| tried.least_nats).unwrap_or(f64::NAN);
    println!(
        "{} {truth} not {rival}: {} ({:.0} s, {least:.0} nats expected): {}",
        if resolved { "ok" } else { "--" },
        next.manoeuvre,
        next.seconds,
        answer["finding"]
    );
    resolved
}

#[test]
fn suggested_flight_distinguishes_wind_from_trim() {
    let (vehicle_file, wind, trim) = PAIRS[0];
    let next = suggested(vehicle_file, [wind, trim], 1);
    let truths: Vec<&str> = next.outlook.iter().flat_map(|o| o.truth.clone()).collect();
    assert_eq!(truths, ["wind", "attitude_trim"]);
    for outlook in &next.outlook {
        assert!(outlook.expected > 0.92, "{outlook:?}");
    }
    assert!(next.tried[0].least_nats > Some(60.0), "{:?}", next.tried);
}

/// Every pair, with either truth and two seeds; `--nocapture` prints the answers.
#[test]
#[ignore = "long: tests/run --all"]
fn suggested_flight_resolves_ambiguous_pairs() {
    let mut resolved = Vec::new();
    for (index, (vehicle_file, a, b)) in PAIRS.into_iter().enumerate() {
        for (truth, rival) in [(a, b), (b, a)] {
            for seed in [1, 2] {
                let name = format!("pair-{index}-{}-{seed}", id(truth));
                resolved.push(is_resolved(&name, vehicle_file, truth, rival, seed));
            }
        }
    }
    let rate = Rate::of(resolved);
    println!("{} of {} resolved, 95 % interval {:.2?}", rate.count, rate.of, rate.interval);
    assert!(rate.rate >= Some(0.85), "{rate:?}");
}
