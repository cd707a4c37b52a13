//! Floor contact: resting, take-off, hard landings and tipping over, always numerically stable.

use crate::common::{effects, quad, root};
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::frame::{Euler, Frd, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;

fn on_floor(vehicle: &VehicleParams, set: &EffectSet) -> Plant {
    Plant::new(vehicle, set, &Setup::default(), 1).unwrap()
}

fn vehicles() -> [VehicleParams; 2] {
    let nano = VehicleParams::load(root().join("config/vehicles/crazyflie.toml")).unwrap();
    [quad(), nano]
}

#[test]
fn vehicle_at_rest_on_the_floor_measures_its_weight() {
    for vehicle in vehicles() {
        let mut plant = on_floor(&vehicle, &EffectSet::new());
        for _ in 0..5000 {
            plant.step([0.1; 4]);
            assert!(plant.on_ground());
        }
        assert!((plant.specific_force() - Frd::new(0.0, 0.0, -9.80665)).norm() < 1e-6);
        assert!(plant.state().velocity.norm() < 1e-6);
        assert!(plant.state().position.norm() < 5e-3);
    }
}

#[test]
fn unpowered_vehicle_rests_exactly_on_the_floor() {
    let mut plant = on_floor(&quad(), &EffectSet::new());
    for _ in 0..1000 {
        plant.step([0.0; 4]);
    }
    assert!(plant.state().position.norm() < 1e-9);
    assert!((plant.specific_force() - Frd::new(0.0, 0.0, -9.80665)).norm() < 1e-9);
}

#[test]
fn airborne_plant_has_no_floor() {
    let mut plant = on_floor(&quad(), &EffectSet::new()).airborne();
    for _ in 0..1000 {
        plant.step([0.0; 4]);
    }
    let fallen = 0.5 * 9.80665;
    assert!(!plant.on_ground());
    assert!((plant.state().position.down() - fallen).abs() < 0.01 * fallen);
}

#[test]
fn thrust_above_hover_takes_off() {
    let mut plant = on_floor(&quad(), &EffectSet::new());
    for _ in 0..1000 {
        plant.step([0.6; 4]);
    }
    assert!(!plant.on_ground() && plant.state().position.down() < -0.5);
    assert!(plant.state().attitude.tilt() < 1e-9);
}

#[test]
fn hard_landing_ends_at_rest() {
    for vehicle in vehicles() {
        for speed in [0.5, 3.0, 20.0, 200.0] {
            let mut plant = on_floor(&vehicle, &EffectSet::new());
            plant.set_state(State {
                position: Ned::new(0.0, 0.0, -1.0),
                velocity: Ned::new(1.0, -0.5, speed),
                attitude: Euler::new(0.2, -0.1, 0.5).attitude(),
                ..State::default()
            });
            let mut highest = 0.0_f64;
            for step in 0..20_000 {
                plant.step([0.0; 4]);
                assert!(plant.state().is_finite(), "at {speed} m/s, step {step}");
                if step > 1000 {
                    highest = highest.min(plant.state().position.down());
                }
            }
            assert!(plant.on_ground() && plant.state().velocity.norm() < 1e-3, "at {speed} m/s");
            let limit = 0.05 * speed * speed / 9.8 + 0.1;
            assert!(-highest < limit.max(1.0), "bounced {highest} m at {speed} m/s");
        }
    }
}

#[test]
fn full_thrust_while_inverted_stays_finite() {
    for vehicle in vehicles() {
        let mut plant = on_floor(&vehicle, &EffectSet::new());
        plant.set_state(State {
            attitude: Euler::new(3.1, 0.0, 0.0).attitude(),
            ..State::default()
        });
        for step in 0..20_000_u32 {
            let u = |i: u32| f64::from((step / 97 * (i + 3) + i) % 5) / 4.0;
            plant.step([u(0), u(1), u(2), u(3)]);
            assert!(plant.state().is_finite(), "step {step}");
        }
    }
}

#[test]
fn one_sided_thrust_tips_the_vehicle_over() {
    let mut plant = on_floor(&quad(), &EffectSet::new());
    let mut most = 0.0_f64;
    for _ in 0..1500 {
        plant.step([1.0, 1.0, 0.0, 0.0]);
        most = most.max(plant.state().attitude.tilt());
    }
    assert!(most > 1.5, "tilted by {most} rad");
    assert!(plant.state().is_finite());
}

#[test]
fn extreme_effects_do_not_make_the_floor_unstable() {
    let set = effects(&["inertia:scale=[0.05,0.05,0.05]", "com_offset:x_m=0.05,y_m=-0.05"]);
    let mut plant = on_floor(&quad(), &set);
    for _ in 0..5000 {
        plant.step([0.0; 4]);
    }
    assert!(plant.state().is_finite() && plant.state().body_rate.norm() < 1e-3);
    assert!(plant.on_ground());
}

#[test]
fn floor_at_another_height_supports_the_vehicle() {
    let mut setup = Setup { floor_down_m: 2.0, ..Setup::default() };
    setup.start.position_m = [3.0, 4.0, 2.0];
    let mut plant = Plant::new(&quad(), &EffectSet::new(), &setup, 1).unwrap();
    for _ in 0..1000 {
        plant.step([0.0; 4]);
    }
    assert!((plant.state().position - Ned::new(3.0, 4.0, 2.0)).norm() < 1e-9);
}
