//! The plant against closed-form motions.

use crate::common::{airborne, effects, moving, quad};
use vehicle::effects::EffectSet;
use vehicle::frame::{Attitude, Euler, Frd, Ned};
use vehicle::plant::Plant;
use vehicle::rigid_body::State;
use vehicle::rotor::Allocation;

fn run(plant: &mut Plant, steps: usize, outputs: [f64; 4]) {
    for _ in 0..steps {
        plant.step(outputs);
    }
}

#[test]
fn free_fall_has_no_specific_force() {
    let mut plant = airborne(&quad(), &EffectSet::new());
    run(&mut plant, 2000, [0.0; 4]);
    let fall = 0.5 * 9.80665 * 2.0 * 2.0;
    assert!((plant.state().position - Ned::new(0.0, 0.0, -100.0 + fall)).norm() < 1e-9);
    assert!((plant.state().velocity.down() - 2.0 * 9.80665).abs() < 1e-10);
    assert!(plant.specific_force().norm() < 1e-12);
    assert_eq!(plant.time_us(), 2_000_000);
}

#[test]
fn hover_thrust_keeps_the_vehicle_in_place() {
    let vehicle = quad();
    let mut plant = airborne(&vehicle, &EffectSet::new());
    run(&mut plant, 10_000, [vehicle.hover_thrust; 4]);
    // hover_thrust is written with seven digits.
    assert!((plant.state().position - Ned::new(0.0, 0.0, -100.0)).norm() < 1e-4);
    assert!((plant.specific_force() - Frd::new(0.0, 0.0, -9.80665)).norm() < 1e-5);
    assert!(plant.state().attitude.angle_to(Attitude::default()) < 1e-9);
}

#[test]
fn rotor_lag_step_response_is_exponential() {
    let mut vehicle = quad();
    vehicle.motor_time_constant_s = 0.05;
    let mut plant = airborne(&vehicle, &EffectSet::new());
    plant.set_rotor_states([0.2; 4]);
    run(&mut plant, 75, [0.8; 4]);
    let expected = 0.8 - 0.6 * (-1.5_f64).exp();
    for s in plant.rotor_states() {
        assert!((s - expected).abs() < 1e-12);
    }
    // Velocity is the integral of thrust over mass.
    let time = 0.075;
    let area = 0.8 * time - 0.6 * 0.05 * (1.0 - (-1.5_f64).exp());
    let climb = 24.0 / 1.2 * area - 9.80665 * time;
    assert!((plant.state().velocity.down() + climb).abs() < 1e-9);
}

#[test]
fn yaw_moment_gives_constant_angular_acceleration() {
    let vehicle = quad();
    let allocation = Allocation::new(&vehicle.rotors).unwrap();
    let weight = vehicle.mass * vehicle.gravity;
    let mut plant = airborne(&vehicle, &EffectSet::new());
    run(&mut plant, 1000, allocation.outputs([weight, 0.0, 0.0, 0.021]));
    assert!((plant.state().body_rate - Frd::new(0.0, 0.0, 1.0)).norm() < 1e-9);
    assert!((plant.state().attitude.euler().yaw - 0.5).abs() < 1e-9);
}

#[test]
fn energy_change_equals_the_work_of_thrust() {
    let vehicle = quad();
    let mut plant = airborne(&vehicle, &EffectSet::new());
    plant.set_state(State { position: Ned::new(0.0, 0.0, -100.0), ..moving() });
    let energy = |state: &State| {
        0.5 * vehicle.mass * state.velocity.dot(state.velocity)
            + 0.5 * state.body_rate.dot(state.body_rate.scale_by(vehicle.inertia))
            - vehicle.mass * vehicle.gravity * state.position.down()
    };
    let outputs = [0.5, 0.505, 0.49, 0.495];
    let [thrust, moments @ ..] = vehicle.allocation().unwrap().wrench(outputs);
    let power = |state: &State| {
        let force = state.attitude.to_world(Frd::new(0.0, 0.0, -thrust));
        force.dot(state.velocity) + Frd::from(moments).dot(state.body_rate)
    };
    let start = energy(plant.state());
    let mut work = 0.0;
    for _ in 0..1000 {
        // Simpson's rule over two half-known points: the plant steps in pairs.
        let a = power(plant.state());
        plant.step(outputs);
        let b = power(plant.state());
        plant.step(outputs);
        let c = power(plant.state());
        work += 2e-3 / 6.0 * (a + 4.0 * b + c);
    }
    let gained = energy(plant.state()) - start;
    assert!(gained.abs() > 1.0 && (gained - work).abs() < 1e-7, "gained {gained}, work {work}");
}

/// Rotating the whole scene about the vertical rotates the trajectory and changes nothing else.
#[test]
fn physics_is_invariant_under_heading_rotation() {
    let vehicle = quad();
    let angle = 0.9;
    let turn = Euler::new(0.0, 0.0, angle).attitude();
    let rotated = |v: Ned| turn.to_world(Frd::from(v.to_array()));
    let wind = Ned::new(3.0, -1.0, 0.5);
    let fly = |wind: Ned, start: State| {
        let [n, e, d] = wind.to_array();
        let wind = format!("wind:north_m_s={n},east_m_s={e},down_m_s={d}");
        let drag = "parasitic_drag:cda_m2=0.02";
        let mut plant = airborne(&vehicle, &effects(&[&wind, "rotor_drag:d_xy=0.3", drag]));
        plant.set_state(start);
        run(&mut plant, 1000, [0.5, 0.51, 0.49, 0.5]);
        *plant.state()
    };
    let start = State { position: Ned::new(0.0, 0.0, -100.0), ..moving() };
    let turned = State {
        velocity: rotated(start.velocity),
        attitude: turn.compose(start.attitude),
        ..start
    };
    let (first, second) = (fly(wind, start), fly(rotated(wind), turned));
    assert!((rotated(first.position) - second.position).norm() < 1e-9);
    assert!(turn.compose(first.attitude).angle_to(second.attitude) < 1e-7);
    assert!((first.body_rate - second.body_rate).norm() < 1e-9);
}

/// The vehicle is its own mirror image about the front-down plane, with rotors exchanged.
#[test]
fn left_and_right_are_mirror_images() {
    let vehicle = quad();
    let fly = |outputs| {
        let mut plant = airborne(&vehicle, &effects(&["rotor_drag:d_xy=0.3,d_z=0.1"]));
        run(&mut plant, 500, outputs);
        *plant.state()
    };
    let (a, b) = (fly([0.5, 0.52, 0.49, 0.48]), fly([0.48, 0.49, 0.52, 0.5]));
    let mirror = |v: Ned| Ned::new(v.north(), -v.east(), v.down());
    assert!((mirror(a.position) - b.position).norm() < 1e-9);
    let [p, q, r] = a.body_rate.to_array();
    assert!((Frd::new(-p, q, -r) - b.body_rate).norm() < 1e-9);
}

/// Body and rotors together keep their angular momentum about the spin axis when rotor speeds
/// change and drag torques are out of play, with and without lag, from standstill too.
#[test]
fn rotors_and_body_exchange_angular_momentum() {
    let gyroscopic = "rotor_gyroscopic:rotor_inertia_kgm2=4e-5";
    for (tau, start) in [(0.0, 0.3), (0.05, 0.3), (0.05, 0.0)] {
        let mut vehicle = quad();
        vehicle.motor_time_constant_s = tau;
        let mut plant = airborne(&vehicle, &effects(&[gyroscopic, "yaw_torque:scale=0"]));
        plant.set_rotor_states([start; 4]);
        let momentum = |plant: &Plant| {
            let max = 8500.0 * std::f64::consts::TAU / 60.0;
            let [a, b, c, d] = plant.rotor_speeds();
            0.021 * plant.state().body_rate.down() - 4e-5 * max * (a - b + c - d)
        };
        let before = momentum(&plant);
        run(&mut plant, 300, [0.6, 0.4, 0.6, 0.4]);
        assert!(plant.state().body_rate.down() > 0.2, "tau {tau}");
        let change = momentum(&plant) - before;
        assert!(change.abs() < 1e-7, "tau {tau} from {start}: {change}");
    }
}

#[test]
fn non_finite_outputs_are_clamped() {
    let vehicle = quad();
    let fly = |outputs| {
        let mut plant = airborne(&vehicle, &EffectSet::new());
        run(&mut plant, 10, outputs);
        *plant.state()
    };
    let odd = fly([f64::NAN, f64::INFINITY, -3.0, f64::NEG_INFINITY]);
    assert!(odd.is_finite());
    assert_eq!(odd, fly([0.0, 1.0, 0.0, 0.0]));
}

#[test]
fn non_finite_state_is_ignored() {
    let mut plant = airborne(&quad(), &EffectSet::new());
    let before = *plant.state();
    plant.set_state(State { velocity: Ned::new(f64::NAN, 0.0, 0.0), ..before });
    let null = Attitude { w: 0.0, x: 0.0, y: 0.0, z: 0.0 };
    plant.set_state(State { attitude: null, ..before });
    assert_eq!(*plant.state(), before);
}

#[test]
fn hover_collective_is_found_under_any_effects() {
    let vehicle = quad();
    let sets: [&[&str]; 3] = [
        &[],
        &["mass:mass_kg=1.5", "thrust_curve:a=0.6", "thrust_scale:scale=0.9"],
        &["rotor_loss:rotor=1,scale=0.8", "thrust_curve:a=-0.3"],
    ];
    for set in sets {
        let plant = airborne(&vehicle, &effects(set));
        let physics = plant.physics();
        let env = physics.calm();
        let collective = physics.hover_collective(&env).unwrap();
        let rest = State::default();
        let (acceleration, _) =
            physics.accelerations_for_wrench(&rest, &[collective, 0.0, 0.0, 0.0], &env);
        assert!(acceleration.norm() < 1e-9, "{set:?}");
    }
    let heavy = airborne(&vehicle, &effects(&["mass:mass_kg=3"]));
    assert!(heavy.physics().hover_collective(&heavy.physics().calm()).is_none());
}

/// Rotors lag, so commands that alternate from period to period slow them down in no vehicle. A
/// plan may not gain from it.
#[test]
fn alternating_commands_leave_the_rotor_drag_alone() {
    let vehicle = quad();
    let plant = airborne(&vehicle, &effects(&["rotor_drag:d_xy=0.5,d_z=0.2"]));
    let physics = plant.physics();
    let env = physics.calm();
    let moves = State { velocity: Ned::new(4.0, -2.0, 0.5), ..State::default() };
    let collective = physics.hover_collective(&env).unwrap();
    let force = |share: f64, yaw_nm: f64| {
        let wrench = [share * collective, 0.0, 0.0, yaw_nm];
        physics.accelerations_for_wrench(&moves, &wrench, &env).0
    };
    let hover = force(1.0, 0.0);
    let (flown, _) = physics.accelerations(&moves, &[vehicle.hover_thrust; 4], &env);
    assert!((hover - flown).norm() < 1e-5, "the plant's drag at hover");
    assert!((force(1.0, 0.1) - hover).norm() < 1e-9, "moments");
    let alternating = (force(0.4, 0.0) + force(1.6, 0.0)) * 0.5;
    assert!((alternating - hover).norm() < 1e-9, "thrusts");
}
