//! Small steps of the closed loop against the closed form of the linear loop.
//!
//! Between two ticks of the on-board loop, moments and thrust are constant and the linearised
//! vehicle moves along polynomials of time. The response of the sampled loop, including the 2 or 4
//! ms transit of a setpoint, is therefore known exactly for small steps. The rest is of second
//! order in the step, plus the precision of MAVLink's floats.

use crate::lockstep::{NANO, QUAD, fly, ideal, params, settings, toml_trajectory};
use downwash::control::{Actuation, AttitudeLoop, HoverVehicle, Lqr};
use downwash::log::record::{Record, Tick};
use downwash::station::End;
use nalgebra::SVector;
use vehicle::AttitudePd;

/// Errors in position, velocity, (roll, pitch, yaw) and body rate.
type Errors = SVector<f64, 12>;

const SAMPLE_MS: u64 = 10;
const PD_MS: u64 = 4;
const DWELL_S: f64 = 2.0;

/// Of position, velocity, angles and body rate, in SI units, for steps of 1 cm or 1 degree. A step
/// of 1 cm tilts the vehicle by 5 mrad, which costs it g / 2 (5e-3)^2 of its lift for a tenth of a
/// second: 1e-5 m/s. Everything else is a float's width; found 2e-9 to 1e-7.
const TOLERANCES: [f64; 4] = [5e-6, 2e-5, 5e-7, 5e-7];

/// North, east, up in m, yaw in degrees.
const STEPS: [[f64; 4]; 4] =
    [[0.01, 0.0, 0.0, 0.0], [0.0, 0.01, 0.0, 0.0], [0.0, 0.0, 0.01, 0.0], [0.0, 0.0, 0.0, 1.0]];

/// `errors` after `h` seconds under constant thrust [N, beyond the weight] and moments (N m).
fn coast(vehicle: &HoverVehicle, s: &Errors, thrust: f64, moment: [f64; 3], h: f64) -> Errors {
    let (h2, h3, h4) = (h * h / 2.0, h.powi(3) / 6.0, h.powi(4) / 24.0);
    let turn: [f64; 3] = std::array::from_fn(|i| moment[i] / vehicle.inertia[i]);
    let mut next = *s;
    for i in 0..3 {
        next[6 + i] += s[9 + i] * h + turn[i] * h2;
        next[9 + i] += turn[i] * h;
    }
    // Nose up pushes south, right side down pushes east.
    for (axis, angle, push) in [(0, 1, -vehicle.gravity), (1, 0, vehicle.gravity)] {
        let (tilt, rate, turn) = (s[6 + angle], s[9 + angle], turn[angle]);
        next[axis] += s[3 + axis] * h + push * (tilt * h2 + rate * h3 + turn * h4);
        next[3 + axis] += push * (tilt * h + rate * h2 + turn * h3);
    }
    next[2] += s[5] * h - thrust / vehicle.mass_kg * h2;
    next[5] -= thrust / vehicle.mass_kg * h;
    next
}

/// The errors at each sample after a step to `errors`, at a sample `pd_phase_ms` before the next
/// on-board tick.
fn response(
    vehicle: &HoverVehicle,
    pd: &AttitudePd,
    lqr: &Lqr,
    pd_phase_ms: u64,
    mut errors: Errors,
    samples: usize,
) -> Vec<Errors> {
    let mut rows = Vec::new();
    // The setpoint before the step: hover at the old yaw.
    let mut setpoint = SVector::<f64, 7>::zeros();
    setpoint[3] = errors[8];
    let (mut thrust, mut moment) = (0.0, [0.0; 3]);
    for now in 0_u64.. {
        if (now + PD_MS - pd_phase_ms).is_multiple_of(PD_MS) {
            thrust = setpoint[0];
            moment = std::array::from_fn(|i| {
                pd.kp[i] * (setpoint[1 + i] - errors[6 + i])
                    + pd.kd[i] * (setpoint[4 + i] - errors[9 + i])
            });
        }
        if now.is_multiple_of(SAMPLE_MS) {
            if rows.len() == samples {
                break;
            }
            rows.push(errors);
            setpoint = lqr.gain() * errors;
        }
        errors = coast(vehicle, &errors, thrust, moment, 1e-3);
    }
    rows
}

fn errors(tick: &Tick) -> Errors {
    let reference = tick.reference.expect("a reference");
    let attitude = tick.state.attitude.euler();
    let [pn, pe, pd] = (tick.state.position - reference.position).to_array();
    let [vn, ve, vd] = tick.state.velocity.to_array();
    let [p, q, r] = tick.state.body_rate.to_array();
    let yaw = attitude.yaw - reference.attitude.yaw;
    SVector::from([pn, pe, pd, vn, ve, vd, attitude.roll, attitude.pitch, yaw, p, q, r])
}

#[test]
fn small_steps_match_the_sampled_linear_loop() {
    for (name, effects) in [
        (NANO, &["motor_lag:tau_s=0", "command_delay:delay_s=0"][..]),
        (QUAD, &["motor_lag:tau_s=0", "command_delay:delay_s=0", "rotor_drag:d_xy=0,d_z=0"]),
    ] {
        let params = params(name);
        for offset in STEPS {
            let text = format!(
                "family = \"steps\"\naltitude_m = 1.0\ndwell_s = {DWELL_S:?}\noffsets = [{offset:?}]"
            );
            let mut settings = settings(&params, toml_trajectory(&text));
            settings.actuation = Actuation::IMMEDIATE;
            // The transient of take-off has decayed when the trajectory begins.
            settings.offboard.guidance.settle_s = 20.0;
            let (end, records) = fly(settings.clone(), &params, effects, ideal(), 1);
            assert_eq!(end, End::Done);
            let ticks: Vec<Tick> = records
                .into_iter()
                .filter_map(|record| match record {
                    Record::Tick(tick) if tick.trajectory_time? >= DWELL_S - 1e-9 => Some(tick),
                    _ => None,
                })
                .collect();
            let pd = settings.attitude_pd.expect("a PD");
            let lqr = Lqr::design(&settings.hover, &AttitudeLoop::from(pd), &settings.control)
                .expect("a gain");
            let start_ms = ticks[0].stamp.vehicle.expect("a vehicle's time").as_us() / 1000;
            let pd_phase_ms = (PD_MS - start_ms % PD_MS) % PD_MS;
            let step = errors(&ticks[0]);
            let expected = response(&settings.hover, &pd, &lqr, pd_phase_ms, step, ticks.len());
            let worst = |rows: [usize; 3]| {
                let of = |e: Errors| rows.iter().map(|&i| e[i] * e[i]).sum::<f64>().sqrt();
                let off = ticks.iter().zip(&expected).map(|(tick, e)| of(errors(tick) - e));
                off.fold(0.0, f64::max)
            };
            let found = [worst([0, 1, 2]), worst([3, 4, 5]), worst([6, 7, 8]), worst([9, 10, 11])];
            println!("{name} {offset:?}: {found:?}");
            let within = found.iter().zip(TOLERANCES).all(|(off, tolerance)| *off < tolerance);
            assert!(within, "{name} {offset:?}: {found:?}");
        }
    }
}
