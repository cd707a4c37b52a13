//! The closed loop against RotorPy, a simulator that shares no code with this one, under a
//! controller that shares none either (`golden/make_closed_loop.py`).
//!
//! Both integrate the same equations at the same instants, so physics and timing need no tolerance:
//! the sensors are perfect and without latency, and the golden file's on-board ticks fall between
//! samples as they do here, which is checked. The rest is the precision of MAVLink's fields: half a
//! unit in the last place of a float is 6e-8 between 1 and 2 (m, or a quaternion near 1) and 3e-8
//! of the thrust at half of its range. The attitude loop turns that into body rates, at 17 1/s,
//! whose reports are rounded once more. Found: 1.5e-7 in SI units, 7e-7 rad/s in the body rate. The
//! integrators' errors (RotorPy 1e-11 relative, RK4 at 1 ms) are far below.

use crate::lockstep::{fly, ideal, settings, toml_trajectory};
use downwash::control::ControlSettings;
use downwash::log::record::{Record, Tick};
use downwash::station::{End, StationSettings};
use serde::Deserialize;
use vehicle::VehicleParams;
use vehicle::frame::{Attitude, Euler, Frd, Ned, wrap_angle};

/// Tolerance between two identical flights, in SI units; thrust as a fraction of the weight.
const TOLERANCE: f64 = 2e-6;

#[derive(Deserialize)]
struct Golden {
    /// Time from the first sample of the trajectory to the next on-board tick, which may coincide
    /// with it.
    pd_phase_ms: u64,
    vehicle: VehicleParams,
    feedback: ControlSettings,
    flights: Vec<Flight>,
}

#[derive(Deserialize)]
struct Flight {
    /// A trajectory file.
    trajectory: String,
    samples: Vec<Sample>,
}

#[derive(Deserialize)]
struct Sample {
    t: f64,
    position: [f64; 3],
    velocity: [f64; 3],
    attitude: [f64; 4],
    body_rate: [f64; 3],
    thrust_n: f64,
    desired_attitude: [f64; 3],
    desired_body_rate: [f64; 3],
}

fn golden() -> Golden {
    let mut golden: Golden =
        serde_json::from_str(include_str!("golden/closed_loop.json")).expect("a golden file");
    golden.vehicle = golden.vehicle.checked().expect("a vehicle");
    golden
}

/// The ticks along the golden flight's trajectory, flown over the protocol with perfect sensors.
fn ticks(
    golden: &Golden,
    flight: &Flight,
    feedback: &ControlSettings,
    effects: &[&str],
) -> Vec<Tick> {
    let mut settings = StationSettings {
        control: feedback.clone(),
        ..settings(&golden.vehicle, toml_trajectory(&flight.trajectory))
    };
    // The transient of take-off has decayed when the trajectory begins.
    settings.offboard.guidance.settle_s = 20.0;
    let (end, records) = fly(settings, &golden.vehicle, effects, ideal(), 1);
    assert_eq!(end, End::Done);
    let ticks = records.into_iter().filter_map(|record| match record {
        Record::Tick(tick) if tick.trajectory_time.is_some() => Some(tick),
        _ => None,
    });
    ticks.collect()
}

/// Largest differences from the golden flight: position m, velocity m/s, attitude rad, body rate
/// rad/s, and of the setpoint: thrust as a fraction of the weight, attitude rad, body rate rad/s.
fn differences(golden: &Golden, flight: &Flight, ticks: &[Tick]) -> [f64; 7] {
    let weight = golden.vehicle.mass * golden.vehicle.gravity;
    let mut worst = [0.0_f64; 7];
    let start = ticks[0].reference.expect("a reference").position;
    let anchor = start - Ned::from(flight.samples[0].position);
    for sample in &flight.samples {
        let tick = &ticks[(sample.t * 100.0).round() as usize];
        let t = tick.trajectory_time.expect("along the trajectory");
        assert!(
            (t - sample.t).abs() < 1e-9,
            "{t} s, not {} s: ticks are not 10 ms apart",
            sample.t
        );
        assert_eq!(tick.saturation, 0, "the golden controller has no limits");
        let setpoint = tick.setpoint.expect("a setpoint");
        let [w, x, y, z] = sample.attitude;
        let [roll, pitch, yaw] = sample.desired_attitude;
        let angles = |e: Euler| Ned::new(e.roll, e.pitch, e.yaw);
        let off = angles(setpoint.attitude) - Ned::new(roll, pitch, yaw);
        let errors = [
            (tick.state.position - anchor - Ned::from(sample.position)).norm(),
            (tick.state.velocity - Ned::from(sample.velocity)).norm(),
            tick.state.attitude.angle_to(Attitude { w, x, y, z }),
            (tick.state.body_rate - Frd::from(sample.body_rate)).norm(),
            (setpoint.thrust_n - sample.thrust_n).abs() / weight,
            off.map(wrap_angle).norm(),
            (setpoint.body_rate - Frd::from(sample.desired_body_rate)).norm(),
        ];
        worst = std::array::from_fn(|i| worst[i].max(errors[i]));
    }
    worst
}

#[test]
fn flight_matches_rotorpy_under_an_independent_controller() {
    let golden = golden();
    assert_eq!(golden.flights.len(), 2);
    for flight in &golden.flights {
        let ticks = ticks(&golden, flight, &golden.feedback, &[]);
        let start_ms = ticks[0].stamp.vehicle.expect("a vehicle's time").as_us() / 1000;
        let period_ms = 4;
        let phase_ms = (period_ms - start_ms % period_ms) % period_ms;
        assert_eq!(phase_ms, golden.pd_phase_ms, "PD_PHASE_MS in make_closed_loop.py");
        let worst = differences(&golden, flight, &ticks);
        println!("{}{worst:?}", flight.trajectory);
        assert!(worst.iter().all(|&difference| difference < TOLERANCE), "{worst:?}");
        // The flights must move: agreement at rest would prove nothing.
        let farthest = ticks.iter().map(|tick| tick.state.position - ticks[0].state.position);
        assert!(farthest.map(Ned::norm).fold(0.0, f64::max) > 0.6);
    }
}

/// Proves that the comparison can fail.
#[test]
fn comparison_detects_small_gain_vehicle_and_timing_errors() {
    let golden = golden();
    let flight = &golden.flights[0];
    let feedback = &golden.feedback;
    let found = |feedback: &ControlSettings, effects: &[&str]| {
        let ticks = ticks(&golden, flight, feedback, effects);
        differences(&golden, flight, &ticks).into_iter().fold(0.0, f64::max)
    };
    let widened = |position_m| ControlSettings { position_m, ..feedback.clone() };
    let gains = [
        ("5 % of the horizontal weight", widened([0.315, 0.315, 0.2])),
        ("5 % of the vertical weight", widened([0.3, 0.3, 0.21])),
    ];
    for (what, wrong) in gains {
        let difference = found(&wrong, &[]);
        assert!(difference > 1000.0 * TOLERANCE, "{what}: {difference}");
    }
    let effects = [
        "parasitic_drag:cda_m2=0.0001",
        "rotor_drag:d_xy=0.001",
        "mass:mass_kg=0.0301",
        "inertia:scale=[1.01,1.0,1.0]",
        "yaw_torque:scale=1.01",
        "pd_gain:kd_scale=[1.01,1.0,1.0]",
        "motor_lag:tau_s=0.001",
        "estimator_latency:latency_s=0.001",
        "command_delay:delay_s=0.003",
    ];
    for effect in effects {
        let difference = found(feedback, &[effect]);
        assert!(difference > 100.0 * TOLERANCE, "{effect}: {difference}");
    }
}
