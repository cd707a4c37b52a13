//! Closed-form motions of the plant under one effect at a time, and the statistics of gusts. No
//! practice flight has these effects; `effects.rs` checks their equations at one state.

use std::f64::consts::{PI, TAU};

use crate::common::{airborne, effects, quad};
use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::plant::Plant;
use vehicle::rigid_body::State;

const G: f64 = 9.80665;
const MASS: f64 = 1.2;
const AIR_DENSITY: f64 = 1.2;

fn start() -> Ned {
    Ned::new(0.0, 0.0, -100.0)
}

fn level(velocity: Ned) -> State {
    State { position: start(), velocity, ..State::default() }
}

/// The plant under `arguments`, level at this velocity, with outputs that support the weight.
fn hovering(arguments: &[&str], velocity: Ned) -> (Plant, impl Fn(&mut Plant, usize) + use<>) {
    let vehicle = quad();
    let mut plant = airborne(&vehicle, &effects(arguments));
    // hover_thrust is written with seven digits.
    let outputs = [vehicle.mass * vehicle.gravity / 24.0; 4];
    plant.set_rotor_states(outputs);
    plant.set_state(level(velocity));
    (plant, move |plant: &mut Plant, steps| (0..steps).for_each(|_| plant.step(outputs)))
}

/// v = v_t tanh(g t / v_t) and z = v_t^2 / g ln cosh(g t / v_t), v_t^2 = 2 m g / (rho CdA).
#[test]
fn fall_with_parasitic_drag_reaches_terminal_velocity() {
    let mut plant = airborne(&quad(), &effects(&["parasitic_drag:cda_m2=0.2"]));
    let terminal = (2.0 * MASS * G / (AIR_DENSITY * 0.2)).sqrt();
    for step in 1..=6000 {
        plant.step([0.0; 4]);
        let x = G * f64::from(step) * Plant::STEP / terminal;
        let fallen = (plant.state().position - start()).down();
        assert!((plant.state().velocity.down() - terminal * x.tanh()).abs() < 1e-9);
        assert!((fallen - terminal * terminal / G * x.cosh().ln()).abs() < 1e-9);
    }
    assert!(
        (plant.state().velocity.down() / terminal - 1.0).abs() < 1e-4,
        "it reached the terminal velocity"
    );
}

/// With the weight supported: v = v_0 / (1 + k v_0 t), k = rho CdA / (2 m), along the velocity.
#[test]
fn parasitic_drag_brakes_along_the_velocity() {
    let velocity = Ned::new(6.0, -8.0, 2.0);
    let (mut plant, fly) = hovering(&["parasitic_drag:cda_m2=0.05"], velocity);
    let k = 0.5 * AIR_DENSITY * 0.05 / MASS;
    fly(&mut plant, 3000);
    let slowed = 1.0 + k * velocity.norm() * 3.0;
    assert!((plant.state().velocity - velocity * slowed.recip()).norm() < 1e-9);
    let way = velocity * (slowed.ln() / (k * velocity.norm()));
    assert!((plant.state().position - start() - way).norm() < 1e-9);
}

/// In a steady horizontal wind without drag V_h is constant: the climb accelerates uniformly by g k
/// V_h^2, up to g / 2.
#[test]
fn translational_lift_accelerates_a_climb_with_the_square_of_the_wind() {
    for (wind, share) in [(3.0, 0.02 * 9.0), (-4.0, 0.02 * 16.0), (10.0, 0.5)] {
        let wind = format!("wind:north_m_s={},east_m_s={},down_m_s=2", 0.6 * wind, 0.8 * wind);
        let lift = "translational_lift:k_s2_m2=0.02";
        let (mut plant, fly) = hovering(&[lift, &wind], Ned::zero());
        fly(&mut plant, 2000);
        let climbed = -(plant.state().position - start()).down();
        assert!((climbed - 0.5 * G * share * 4.0).abs() < 1e-9, "{wind}: {climbed} m");
    }
}

/// Induced velocity of the hovering quadrotor.
fn induced() -> f64 {
    (MASS * G / (2.0 * AIR_DENSITY * 4.0 * PI * 0.127 * 0.127)).sqrt()
}

/// Beyond the full ratio a constant share of the thrust is lost: the fall is uniformly
/// accelerated, by less where the air flows across. Below the onset nothing happens.
#[test]
fn vortex_ring_loses_its_full_thrust_share_beyond_the_full_ratio() {
    for across in [0.0, 0.7] {
        let wind = format!("wind:east_m_s={}", across * induced());
        let (mut plant, fly) =
            hovering(&["vortex_ring:loss_max=0.25", &wind], Ned::new(0.0, 0.0, induced()));
        fly(&mut plant, 1000);
        let lost = 0.25 * (-across * across).exp();
        let gained = plant.state().velocity.down() - induced();
        assert!((gained - G * lost).abs() < 1e-9, "{across}: {gained} m/s");
    }
    let slow = Ned::new(0.0, 0.0, 0.19 * induced());
    let (mut plant, fly) = hovering(&["vortex_ring:loss_max=0.25"], slow);
    fly(&mut plant, 1000);
    assert!((plant.state().velocity - slow).norm() < 1e-9);
}

/// Between onset and full ratio dv/dt = g loss S(v): the time from one speed to another is the
/// integral of its inverse.
#[test]
fn vortex_ring_onset_is_a_smooth_step() {
    let v_i = induced();
    let (from, to) = (0.35 * v_i, 0.75 * v_i);
    let (mut plant, fly) = hovering(&["vortex_ring:loss_max=0.25"], Ned::new(0.0, 0.0, from));
    let pace = |v: f64| {
        let x = (v / v_i - 0.2) / 0.6;
        (G * 0.25 * x * x * (3.0 - 2.0 * x)).recip()
    };
    let simpson = |a: f64, b: f64| (b - a) / 6.0 * (pace(a) + 4.0 * pace(0.5 * (a + b)) + pace(b));
    let h = (to - from) / 1000.0;
    let expected: f64 = (0..1000).map(|i| f64::from(i) * h + from).map(|v| simpson(v, v + h)).sum();
    while plant.state().velocity.down() < to {
        fly(&mut plant, 1);
    }
    // Interpolated back to the crossing within the last step.
    let late = (plant.state().velocity.down() - to) * pace(to);
    assert!((plant.time() - late - expected).abs() < 1e-5, "{} s not {expected} s", plant.time());
}

/// A body with I_x = I_y and rotors of constant momentum h along z precesses: p and q turn with
/// lambda = ((I_z - I_x) r + h) / I_x.
#[test]
fn rotor_momentum_makes_the_body_precess() {
    let mut vehicle = quad();
    vehicle.inertia = [0.012, 0.012, 0.021];
    let gyroscopic = "rotor_gyroscopic:rotor_inertia_kgm2=4e-5";
    let outputs = [0.64, 0.36, 0.64, 0.36];
    for (r, inertia) in [(0.0, 4e-5), (2.0, 4e-5), (2.0, 0.0)] {
        let effect = if inertia > 0.0 { vec![gyroscopic] } else { vec![] };
        let mut plant =
            airborne(&vehicle, &effects(&[&effect[..], &["yaw_torque:scale=0"]].concat()));
        plant.set_rotor_states(outputs);
        plant.set_state(State { body_rate: Frd::new(0.8, 0.0, r), ..level(Ned::zero()) });
        // Rotors 0 and 2 spin about +z at 0.8, 1 and 3 about -z at 0.6 of 8500 rpm; spin = +1 is
        // the sign of the drag torque on the body, and the rotor turns the other way.
        let h = -inertia * 8500.0 * TAU / 60.0 * 2.0 * (0.8 - 0.6);
        let lambda = (0.009 * r + h) / 0.012;
        for step in 1..=1000 {
            plant.step(outputs);
            let (sin, cos) = (lambda * f64::from(step) * Plant::STEP).sin_cos();
            let expected = Frd::new(0.8 * cos, 0.8 * sin, r);
            assert!((plant.state().body_rate - expected).norm() < 1e-9, "r {r}, J {inertia}");
        }
    }
}

/// Without drag torque no external moment acts on body and rotors: the finite difference of the
/// rotors' angular momentum in the world is the negative of the torque on the body.
#[test]
fn body_and_rotors_conserve_angular_momentum_while_tumbling() {
    for (tau, tolerance) in [(0.05, 1e-9), (0.0, 1e-4)] {
        let mut vehicle = quad();
        vehicle.motor_time_constant_s = tau;
        let arguments = ["rotor_gyroscopic:rotor_inertia_kgm2=4e-5", "yaw_torque:scale=0"];
        let mut plant = airborne(&vehicle, &effects(&arguments));
        plant.set_rotor_states([0.5; 4]);
        let attitude = Euler::new(0.3, -0.4, 1.2).attitude();
        let body_rate = Frd::new(2.0, -1.5, 1.0);
        plant.set_state(State { attitude, body_rate, ..level(Ned::zero()) });
        let world = |plant: &Plant| {
            let [a, b, c, d] = plant.rotor_speeds();
            let h = -4e-5 * 8500.0 * TAU / 60.0 * (a - b + c - d);
            let State { attitude, body_rate, .. } = *plant.state();
            let body = body_rate.scale_by(vehicle.inertia);
            (attitude.to_world(body + Frd::new(0.0, 0.0, h)), attitude.to_world(body))
        };
        let (whole, body) = world(&plant);
        let mut exchanged: f64 = 0.0;
        for step in 0..1000 {
            let u = 0.2 * (0.01 * f64::from(step)).sin();
            plant.step([0.5 + u, 0.5 - u, 0.5 + u, 0.5 - u]);
            let (now, body_now) = world(&plant);
            exchanged = exchanged.max((body_now - body).norm());
            let change = (now - whole).norm();
            assert!(change < tolerance, "tau {tau}, step {step}: {change} N m s");
        }
        assert!(exchanged > 5e-3, "only {exchanged} N m s went between them");
    }
}

const TIME_CONSTANT: f64 = 0.2;
const SIGMA: f64 = 1.5;
/// Steps between samples of the air, and samples in a segment of 8 s.
const EVERY: usize = 5;
const SEGMENT: usize = 1600;
const SEGMENTS: usize = 250;

/// The air's velocity under gusts, and the velocity of a vehicle whose drag has the gusts' time
/// constant.
fn gusty_flight() -> (Vec<[f64; 3]>, Vec<f64>) {
    let gusts = format!("gusts:sigma_m_s={SIGMA},length_m=1.2,speed_m_s=6");
    let drag = format!("rotor_drag:d_xy={}", MASS / TIME_CONSTANT);
    let (mut plant, fly) = hovering(&[&gusts, &drag], Ned::zero());
    let sample = |_| {
        fly(&mut plant, EVERY);
        (plant.air_velocity().to_array(), plant.state().velocity.north())
    };
    let rows = (0..SEGMENT * SEGMENTS).map(sample).unzip();
    assert!(plant.state().attitude.angle_to(Attitude::default()) < 1e-6, "drag has no moment");
    rows
}

fn mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.map(|v| v * v).sum::<f64>() / count
}

/// Variance, autocorrelation after one time constant, and spectral density of the air, against
/// Dryden's: north sigma^2 2 tau / (1 + w^2), across sigma^2 tau (1 + 3 w^2) / (1 + w^2)^2 with
/// w = tau omega. Over 2000 s a variance is known to 3 %, a spectral density to 7 %.
#[test]
fn gusts_match_dryden_variance_correlation_and_spectrum() {
    let (air, _) = gusty_flight();
    let dt = EVERY as f64 * Plant::STEP;
    let lag = (TIME_CONSTANT / dt).round() as usize;
    let e = (-1.0_f64).exp();
    for (axis, (sigma, correlated)) in
        [(SIGMA, e), (SIGMA, 0.5 * e), (0.6 * SIGMA, 0.5 * e)].into_iter().enumerate()
    {
        let found = mean_square(air.iter().map(|v| v[axis]));
        assert!((found / (sigma * sigma) - 1.0).abs() < 0.1, "axis {axis}: variance {found}");
        let products: f64 = air.iter().zip(&air[lag..]).map(|(a, b)| a[axis] * b[axis]).sum();
        let correlation = products / (air.len() - lag) as f64 / found;
        assert!((correlation - correlated).abs() < 0.05, "axis {axis}: {correlation}");
        for cycles in [2, 6, 20, 60] {
            let omega = TAU * f64::from(cycles) / (SEGMENT as f64 * dt);
            let density: f64 = air
                .chunks_exact(SEGMENT)
                .map(|segment| periodogram(segment.iter().map(|v| v[axis]), omega, dt))
                .sum::<f64>()
                / SEGMENTS as f64;
            let w2 = (TIME_CONSTANT * omega).powi(2);
            let expected = if axis == 0 {
                2.0 * TIME_CONSTANT / (1.0 + w2)
            } else {
                TIME_CONSTANT * (1.0 + 3.0 * w2) / (1.0 + w2).powi(2)
            } * sigma
                * sigma;
            let ratio = density / expected;
            assert!((ratio - 1.0).abs() < 0.2, "axis {axis}, {omega} rad/s: {ratio}");
        }
    }
}

/// |sum of hann(t) x(t) exp(-j omega t) dt|^2 over the window's energy: two-sided density.
fn periodogram(values: impl Iterator<Item = f64>, omega: f64, dt: f64) -> f64 {
    let (mut re, mut im, mut energy) = (0.0, 0.0, 0.0);
    for (i, value) in values.enumerate() {
        let t = i as f64;
        let window = 0.5 - 0.5 * (TAU * t / SEGMENT as f64).cos();
        let (sin, cos) = (omega * t * dt).sin_cos();
        re += window * value * cos * dt;
        im -= window * value * sin * dt;
        energy += window * window * dt;
    }
    (re * re + im * im) / energy
}

/// A vehicle with drag of time constant m / d follows first-order gusts of time constant tau with
/// variance sigma^2 tau / (tau + m / d): half, where both are the same.
#[test]
fn vehicle_with_drag_low_passes_the_gusts() {
    let (_, north) = gusty_flight();
    let settled = &north[SEGMENT..];
    let share = mean_square(settled.iter().copied()) / (SIGMA * SIGMA);
    assert!((share - 0.5).abs() < 0.06, "{share} of the gusts' variance");
}

/// Under outputs that change like an on-board loop's, over a second in which the vehicle tumbles.
#[test]
fn plant_by_the_midpoint_rule_matches_the_fine_one() {
    let set = ["motor_lag:tau_s=0.03", "rotor_drag:d_xy=0.3,d_z=0.1", "wind:north_m_s=3"];
    for (step_us, most) in [(1000, 1e-5), (2000, 4e-5)] {
        let mut fine = airborne(&quad(), &effects(&set));
        fine.set_rotor_states([0.5; 4]);
        fine.set_state(level(Ned::new(2.0, -1.0, 0.5)));
        let mut coarse = fine.clone().midpoint(step_us);
        let steps = step_us / 1000;
        for k in 0..1000 / steps {
            // The outputs change every 4 ms.
            let turn = 0.1 * (0.04 * ((k * steps) / 4) as f64).cos();
            let outputs = [0.5 + turn, 0.5 - turn, 0.5 - turn, 0.5 + turn];
            (0..steps).for_each(|_| fine.step(outputs));
            coarse.step(outputs);
        }
        assert_eq!(coarse.time_us(), fine.time_us());
        let (is, to) = (coarse.state(), fine.state());
        let angle = to.attitude.angle_to(Attitude::default());
        assert!(angle > 0.2, "it turned: {angle}");
        assert!(is.attitude.angle_to(to.attitude) < most * angle, "{step_us}");
        assert!((is.position - to.position).norm() < most * (to.position - start()).norm());
        assert_ne!(is, to);
    }
}
