//! Vehicles and states that the tests share.
use std::path::PathBuf;

use vehicle::VehicleParams;
use vehicle::effects::EffectSet;
use vehicle::frame::{Euler, Frd, Ned};
use vehicle::plant::{Plant, Setup};
use vehicle::rigid_body::State;

pub fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The shipped 1.2 kg quadrotor without drag and without lag.
pub fn quad() -> VehicleParams {
    let mut vehicle = VehicleParams::load(root().join("config/vehicles/quad1200.toml")).unwrap();
    vehicle.modelled_effects = EffectSet::new();
    vehicle.motor_time_constant_s = 0.0;
    vehicle
}

pub fn effects(arguments: &[&str]) -> EffectSet {
    let mut set = EffectSet::new();
    for argument in arguments {
        set.insert_argument(argument).unwrap();
    }
    set
}

/// A plant high above the floor with a battery that does not sag.
pub fn airborne(vehicle: &VehicleParams, effects: &EffectSet) -> Plant {
    let mut setup = Setup::default();
    setup.battery.resistance_ohm = Some(0.0);
    setup.start.position_m = [0.0, 0.0, -100.0];
    Plant::new(vehicle, effects, &setup, 7).unwrap()
}

/// A state in which every effect acts.
pub fn moving() -> State {
    State {
        position: Ned::new(1.0, -2.0, -0.6),
        velocity: Ned::new(2.0, -1.0, 3.0),
        attitude: Euler::new(0.2, -0.3, 1.1).attitude(),
        body_rate: Frd::new(1.0, -0.7, 0.5),
    }
}

pub const ROTOR_STATES: [f64; 4] = [0.45, 0.5, 0.55, 0.52];

/// Folders of practice flights: `DOWNWASH_PRACTICE`, else `shared/` beside the repository.
pub fn practice_folders() -> Vec<PathBuf> {
    if let Some(folder) = std::env::var_os("DOWNWASH_PRACTICE") {
        return vec![folder.into()];
    }
    let shared = root().join("../shared");
    ["practice", "practice-autopilot", "practice-real"].map(|name| shared.join(name)).to_vec()
}
