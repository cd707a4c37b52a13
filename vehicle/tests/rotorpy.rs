//! The plant against RotorPy, a simulator that shares no code with this one.
//!
//! Both integrate the same equations: RotorPy to 1e-11 relative, the plant by RK4 at 1 ms with
//! commands held. The differences are the plant's truncation error, of order h^4, and the golden
//! file's ten digits, which the tumbling flight amplifies; 1e-6 is far above both and far below the
//! effect of any wrong sign, frame or coefficient.

use serde::Deserialize;
use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::frame::{Attitude, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;

#[derive(Deserialize)]
struct Golden {
    hold_s: f64,
    flights: Vec<Flight>,
}

#[derive(Deserialize)]
struct Flight {
    name: String,
    vehicle: VehicleParams,
    samples: Vec<Sample>,
}

#[derive(Deserialize)]
struct Sample {
    command: [f64; 4],
    position: [f64; 3],
    velocity: [f64; 3],
    attitude: [f64; 4],
    body_rate: [f64; 3],
    rotors: [f64; 4],
}

impl Sample {
    fn state(&self) -> State {
        let [w, x, y, z] = self.attitude;
        State {
            position: self.position.into(),
            velocity: self.velocity.into(),
            attitude: Attitude { w, x, y, z },
            body_rate: self.body_rate.into(),
        }
    }
}

#[test]
fn plant_matches_rotorpy() {
    let golden: Golden = serde_json::from_str(include_str!("golden/rotorpy.json")).unwrap();
    let steps = (golden.hold_s / Plant::STEP).round() as usize;
    assert_eq!(golden.flights.len(), 2);
    for Flight { name, vehicle, samples } in golden.flights {
        let vehicle = vehicle.checked().unwrap();
        let setup = Setup { floor_down_m: 1000.0, ..Setup::default() };
        let mut plant = Plant::new(&vehicle, &EffectSet::new(), &setup, 0).unwrap();
        plant.set_state(samples[0].state());
        plant.set_rotor_states(samples[0].rotors);
        let mut worst = [0.0_f64; 5];
        for pair in samples.windows(2) {
            for _ in 0..steps {
                plant.step(pair[0].command);
            }
            let (found, expected) = (plant.state(), pair[1].state());
            let rotors = plant.rotor_states().into_iter().zip(pair[1].rotors);
            let errors = [
                (found.position - expected.position).norm(),
                (found.velocity - expected.velocity).norm(),
                found.attitude.angle_to(expected.attitude),
                (found.body_rate - expected.body_rate).norm(),
                rotors.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
            ];
            worst = std::array::from_fn(|i| worst[i].max(errors[i]));
        }
        println!("{name}: worst errors in m, m/s, rad, rad/s, rotor state: {worst:?}");
        assert!(worst.iter().all(|&error| error < 1e-6), "{name}: {worst:?}");
        // The flights must move: agreement at rest would prove nothing.
        let travelled = plant.state().position - Ned::from(samples[0].position);
        assert!(travelled.norm() > 1.0, "{name}");
    }
}
