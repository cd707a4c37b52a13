//! A batch behaves like the same number of single plants under every effect.

use vehicle::VehicleParams;
use vehicle::batch::{Batch, Precision, Width};
use vehicle::effects::EffectSet;
use vehicle::frame::{Euler, Frd, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;

use crate::common::{effects, quad};
use crate::every_effect::EVERY_EFFECT;

/// More than one block, the last one incomplete.
const COUNT: usize = 70;
const SECOND: usize = 1000;

/// Outputs that hold height and a level attitude.
fn controlled(vehicle: &VehicleParams, state: &State, height: f64) -> [f64; 4] {
    let Euler { roll, pitch, yaw } = state.attitude.euler();
    let [p, q, r] = state.body_rate.to_array();
    let [ix, iy, iz] = vehicle.inertia;
    let up = 6.0 * (state.position.down() + height) + 4.0 * state.velocity.down();
    let moment = |inertia: f64, angle: f64, rate: f64| -inertia * (90.0 * angle + 16.0 * rate);
    let allocation = vehicle.allocation().unwrap();
    allocation.outputs([
        vehicle.mass * (vehicle.gravity + up),
        moment(ix, roll, p),
        moment(iy, pitch, q),
        moment(iz, 0.1 * yaw, r),
    ])
}

fn start(index: usize, height: f64) -> State {
    let spread = |k: usize| ((index * k) % 17) as f64 / 17.0 - 0.5;
    State {
        position: Ned::new(spread(3), spread(5), -height),
        velocity: Ned::new(2.0 * spread(7), 2.0 * spread(11), 3.0 * spread(2)),
        attitude: Euler::new(0.4 * spread(13), 0.4 * spread(4), 3.0 * spread(6)).attitude(),
        body_rate: Frd::new(spread(9), spread(10), spread(12)),
    }
}

/// Largest distance (m) and angle (rad) between a batch and single plants after a second of flight
/// under feedback from each vehicle's own state.
fn apart<F: Precision>(vehicle: &VehicleParams, effects: &EffectSet, height: f64) -> (f64, f64) {
    let mut setup = Setup::default();
    setup.start.heading_rad = 0.3;
    let mut batch = Batch::<F>::new(vehicle, effects, &setup, 40, COUNT).unwrap();
    let mut plants: Vec<Plant> = (0..COUNT as u64)
        .map(|index| Plant::new(vehicle, effects, &setup, 40 + index).unwrap())
        .collect();
    for (index, plant) in plants.iter_mut().enumerate() {
        let state = start(index, height);
        plant.set_state(state);
        plant.set_rotor_states([0.5; 4]);
        batch.set(index, state, [0.5; 4]);
    }
    for _ in 0..SECOND {
        let outputs: Vec<[F; 4]> = (0..COUNT)
            .map(|index| controlled(vehicle, &batch.state(index).unwrap(), 1.0).map(F::from_f64))
            .collect();
        batch.step(&outputs, 1);
        for plant in &mut plants {
            plant.step(controlled(vehicle, plant.state(), 1.0));
        }
    }
    plants.iter().enumerate().fold((0.0, 0.0), |(distance, angle): (f64, f64), (index, plant)| {
        let state = batch.state(index).unwrap();
        let off = (state.position - plant.state().position).norm();
        let turned = state.attitude.angle_to(plant.state().attitude);
        (distance.max(off), angle.max(turned))
    })
}

#[test]
fn batch_matches_plants_with_every_effect_alone_and_together() {
    let mut vehicle = quad();
    // Feedback against the reaction torque of lag-free rotors amplifies rounding.
    vehicle.motor_time_constant_s = 0.02;
    let alone = EVERY_EFFECT.iter().map(|effect| effects(&[effect]));
    let at_once = effects(&["motor_lag:tau_s=0"]);
    for set in alone.chain([EffectSet::new(), at_once, effects(&EVERY_EFFECT)]) {
        let (distance, angle) = apart::<f64>(&vehicle, &set, 1.2);
        assert!(distance < 1e-8 && angle < 1e-8, "{set:?}: {distance} m, {angle} rad");
        let (distance, angle) = apart::<f32>(&vehicle, &set, 1.2);
        assert!(distance < 1e-4 && angle < 1e-4, "{set:?}: {distance} m, {angle} rad");
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let vehicle = quad();
    let flown = |width: Width, set: &EffectSet| {
        let batch = Batch::<f32>::new(&vehicle, set, &Setup::default(), 3, COUNT).unwrap();
        let mut batch = batch.airborne().at_most(width);
        assert_eq!(batch.instructions(), width.name());
        (0..COUNT).for_each(|index| batch.set(index, start(index, 5.0), [0.5; 4]));
        batch.step(&[[0.5, 0.49, 0.5, 0.51]; COUNT], 300);
        (0..COUNT).map(|index| batch.state(index).unwrap()).collect::<Vec<State>>()
    };
    for set in [EffectSet::new(), effects(&EVERY_EFFECT)] {
        let narrowest = flown(Width::Baseline, &set);
        for width in Width::available() {
            assert_eq!(flown(width, &set), narrowest, "{}", width.name());
        }
    }
}

#[test]
fn batch_floor_contact_matches_the_plant() {
    // Some fall onto the floor, rotated, before they climb.
    let mut vehicle = quad();
    for lag in [0.0, 0.03] {
        vehicle.motor_time_constant_s = lag;
        let (distance, angle) = apart::<f64>(&vehicle, &EffectSet::new(), 0.15);
        assert!(distance < 1e-7 && angle < 1e-7, "{distance} m, {angle} rad");
    }
    let mut batch =
        Batch::<f32>::new(&vehicle, &EffectSet::new(), &Setup::default(), 1, 3).unwrap();
    batch.step(&[[0.0; 4]; 3], 500);
    let rest = batch.state(2).unwrap();
    assert!(rest.position.norm() < 1e-3 && rest.velocity.norm() < 1e-3, "{rest:?}");
}

#[test]
fn batch_accepts_any_numbers() {
    let vehicle = quad();
    let new = |count| {
        Batch::<f32>::new(&vehicle, &EffectSet::new(), &Setup::default(), 1, count).unwrap()
    };
    let mut none = new(0);
    none.step(&[[0.5; 4]], 10);
    assert!(none.is_empty() && none.state(0).is_none());
    let mut batch = new(65).airborne();
    assert_eq!(batch.len(), 65);
    batch.step(&[[f32::NAN, f32::INFINITY, -1.0, 0.5]; 65], 1);
    assert_eq!(batch.rotor_states(64).unwrap(), [0.0, 1.0, 0.0, 0.5]);
    batch.set(64, State { position: Ned::new(f64::NAN, 0.0, 0.0), ..State::default() }, [0.0; 4]);
    assert!(batch.state(64).unwrap().is_finite());
    assert!(batch.state(65).is_none());
}
