//! Laws outside the catalogue, against their equations at one state.

use crate::common::{airborne, effects, quad};
use vehicle::foreign::Foreign;
use vehicle::frame::{Euler, Frd, Ned};
use vehicle::plant::Plant;
use vehicle::rigid_body::State;

const HIGH: f64 = -50.0;

/// The plant under these laws two steps after `state`, with outputs that support the weight.
fn after(laws: &[Foreign], state: State) -> Plant {
    let vehicle = quad();
    let mut plant = airborne(&vehicle, &effects(&[]));
    laws.iter().for_each(|law| plant.disturb(law.clone(), 3));
    let outputs = [vehicle.hover_share(); 4];
    plant.set_rotor_states(outputs);
    plant.set_state(state);
    // The second step includes the first step's effect on the rotors.
    plant.step(outputs);
    plant.step(outputs);
    plant
}

fn moving(velocity: Ned) -> State {
    State { position: Ned::new(0.0, 0.0, HIGH), velocity, ..State::default() }
}

/// Force added by the laws, N.
fn added(laws: &[Foreign], state: State) -> Frd {
    let by = |laws: &[Foreign]| after(laws, state).specific_force();
    (by(laws) - by(&[])) * quad().mass
}

/// Moment added by the laws, N m.
fn turned(laws: &[Foreign], state: State) -> Frd {
    let by = |laws: &[Foreign]| after(laws, state).angular_acceleration();
    (by(laws) - by(&[])).scale_by(quad().inertia)
}

fn near(a: Frd, b: Frd, within: f64) -> bool {
    (a - b).norm() <= within
}

#[test]
fn plate_drag_is_quadratic_per_axis() {
    let law = Foreign::DragPlates { quadratic: [0.01, 0.02, 0.03] };
    let force = added(&[law], moving(Ned::new(3.0, -2.0, 1.0)));
    assert!(near(force, Frd::new(-0.09, 0.08, -0.03), 1e-3), "{force:?}");
}

#[test]
fn two_laws_add_up() {
    let plates = Foreign::DragPlates { quadratic: [0.01; 3] };
    let power = Foreign::DragPower { coefficient: 0.05, exponent: 1.0 };
    let state = moving(Ned::new(4.0, 1.0, 0.0));
    let both = added(&[plates.clone(), power.clone()], state);
    assert!(near(both, added(&[plates], state) + added(&[power], state), 1e-4), "{both:?}");
}

#[test]
fn worn_rotor_loses_less_torque_than_thrust() {
    let vehicle = quad();
    let level = moving(Ned::zero());
    let worn = |torque_share| {
        let law = Foreign::RotorWear { rotor: 0, loss: 0.2, torque_share };
        (added(std::slice::from_ref(&law), level), turned(&[law], level))
    };
    let thrust = vehicle.mass * vehicle.gravity / 4.0;
    let torque = thrust * vehicle.rotors[0].drag_torque_per_thrust_m;
    let (force, same) = worn(1.0);
    assert!((force.down() - 0.2 * thrust).abs() < 1e-3 * thrust, "{force:?}");
    let lost = -0.2 * torque * f64::from(vehicle.rotors[0].spin);
    assert!((same.down() - lost).abs() < 1e-3 * torque, "{same:?}");
    let (_, half) = worn(0.5);
    assert!((half.down() - 0.5 * lost).abs() < 1e-3 * torque, "{half:?}");
}

#[test]
fn rotors_near_the_floor_level_a_tilted_vehicle() {
    let law = Foreign::GroundPerRotor { radius_m: 0.3 };
    let state = |height: f64, roll: f64| State {
        position: Ned::new(0.0, 0.0, -height),
        attitude: Euler::new(roll, 0.0, 0.0).attitude(),
        ..State::default()
    };
    let laws = [law];
    let thrust = quad().mass * quad().gravity;
    let share = (0.3_f64 / (4.0 * 0.4)).powi(2);
    let lift = -added(&laws, state(0.4, 0.0)).down();
    assert!((lift / (thrust * share / (1.0 - share)) - 1.0).abs() < 1e-2, "{lift}");
    assert!(turned(&laws, state(0.4, 0.2)).front() < 0.0);
    assert!(turned(&laws, state(0.4, -0.2)).front() > 0.0);
    assert!(turned(&laws, state(20.0, 0.2)).norm() < 1e-4);
}

#[test]
fn payload_drag_pitches_the_vehicle_against_its_motion() {
    let law = [Foreign::PayloadLever { drag_ns_m: 0.2, sunk_m: 0.05 }];
    // M = (0, 0, -z) x (-c v): forward flight pitches up.
    let moment = turned(&law, moving(Ned::new(5.0, 0.0, 0.0)));
    assert!(near(moment, Frd::new(0.0, 0.05, 0.0), 1e-4), "{moment:?}");
    let moment = turned(&law, moving(Ned::new(0.0, 5.0, 0.0)));
    assert!(near(moment, Frd::new(-0.05, 0.0, 0.0), 1e-4), "{moment:?}");
}

#[test]
fn lift_saturates() {
    let law = [Foreign::LiftSaturating { gain: 0.2, speed_m_s: 3.0 }];
    let thrust = quad().mass * quad().gravity;
    let lift = |speed: f64| -added(&law, moving(Ned::new(speed, 0.0, 0.0))).down() / thrust;
    assert!((lift(3.0) - 0.1).abs() < 1e-3 && (lift(300.0) - 0.2).abs() < 1e-3);
}

#[test]
fn curves_and_packs_scale_the_thrust() {
    let vehicle = quad();
    let thrust = vehicle.mass * vehicle.gravity;
    let s = vehicle.hover_share();
    let lost = |law: Foreign| added(&[law], moving(Ned::zero())).down() / thrust;
    let curve = lost(Foreign::CurvePower { dead: 0.05, power: 1.4 });
    let wanted = 1.0 - ((s - 0.05) / 0.95).powf(1.4) / s;
    assert!((curve - wanted).abs() < 1e-3, "{curve} {wanted}");
    let full = lost(Foreign::SagAffine { slope: 2.0, recovery_s: 1.0 });
    assert!(full.abs() < 0.02, "a full pack: {full}");
}

#[test]
fn power_law_torque_is_nominal_at_hover() {
    let vehicle = quad();
    let hover_n = vehicle.mass * vehicle.gravity / 4.0;
    let law = |by, apart, power| [Foreign::YawTorquePower { by, apart, power, hover_n }];
    let level = moving(Ned::zero());
    assert!(turned(&law(0.3, 0.0, 1.2), level).norm() < 1e-6, "equal rotors cancel");
    let torque = hover_n * vehicle.rotors[0].drag_torque_per_thrust_m;
    let apart = turned(&law(0.0, 0.1, 1.0), level);
    assert!((apart.down() - 0.4 * torque).abs() < 1e-3 * torque, "{apart:?}");
}

#[test]
fn eddies_have_the_configured_deviation() {
    let law = Foreign::GustEddies { sigma_m_s: 2.0, length_m: 10.0, speed_m_s: 5.0 };
    let mut plant = airborne(&quad(), &effects(&[]));
    plant.disturb(law, 5);
    let mut squares = [0.0; 3];
    let steps = 60_000;
    for _ in 0..steps {
        plant.step([0.5; 4]);
        for (square, air) in squares.iter_mut().zip(plant.air_velocity().to_array()) {
            *square += air * air / f64::from(steps);
        }
    }
    for square in squares {
        assert!((square.sqrt() / 2.0 - 1.0).abs() < 0.1, "{squares:?}");
    }
}
