//! A nano quadrotor, its models and desired trajectories for the planning tests.

// Each test file uses a part of it.
use std::path::Path;
use std::sync::Arc;

use downwash::control::Limits;
use downwash::model::Model;
use downwash::model::features::{Features, Head, OUTPUTS};
use downwash::model::hybrid::Hybrid;
use downwash::model::learned::{Network, NetworkModel};
use downwash::model::net::{Mlp, Normalization};
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::offboard::EffectiveVehicle;
use downwash::plan::Trajectory;
use downwash::plan::planner::{PlanSettings, PlannedVehicle, Planner};
use downwash::plan::problem::StateVector;
use downwash::plan::scp::Outcome;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::{AttitudePd, VehicleParams};

pub fn vehicle() -> VehicleParams {
    VehicleParams::from_toml_str(include_str!("../../config/vehicles/crazyflie.toml"))
        .expect("a vehicle")
}

pub fn attitude_pd() -> AttitudePd {
    vehicle().attitude_pd.expect("an attitude loop")
}

pub fn planned_vehicle() -> PlannedVehicle {
    let vehicle = vehicle();
    PlannedVehicle {
        body: EffectiveVehicle::new(&vehicle).expect("a vehicle").body(),
        attitude_pd: attitude_pd(),
        limits: Limits::default(),
    }
}

pub fn physics() -> PhysicsModel {
    PhysicsModel::new(&vehicle(), &PhysicsParameters::default()).expect("physics")
}

/// Networks with small random accelerations, which bend at the kinks of their units.
pub fn residual(features: Features, seed: u64) -> NetworkModel {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let [linear, angular] = Head::BOTH.map(|head| {
        let names = features.names(head);
        let hidden = 20;
        let mut draw = |count: usize, size: f32| -> Vec<f32> {
            (0..count).map(|_| random.random_range(-size..size)).collect()
        };
        let deviation = names.iter().map(|name| match *name {
            "u1" => 0.05,
            "u2" | "u3" | "u4" => 2e-4,
            "p" | "q" | "r" => 3.0,
            _ => 1.0,
        });
        Network {
            inputs: Normalization {
                mean: names.iter().map(|name| if *name == "u1" { 0.3 } else { 0.0 }).collect(),
                deviation: deviation.collect(),
            },
            outputs: Normalization { mean: vec![0.0; OUTPUTS], deviation: vec![0.3; OUTPUTS] },
            mlp: Mlp {
                inputs: names.len(),
                hidden,
                outputs: OUTPUTS,
                hidden_weights: draw(names.len() * hidden, 0.5),
                hidden_biases: draw(hidden, 1.0),
                output_weights: draw(OUTPUTS * hidden, 0.5),
                output_biases: draw(OUTPUTS, 0.1),
            },
        }
    });
    NetworkModel { features, linear, angular }
}

/// Physics with [`residual`] networks.
pub fn hybrid(features: Features, seed: u64) -> Hybrid {
    Hybrid::new(physics(), residual(features, seed))
}

pub fn trajectory(text: &str) -> Trajectory {
    Trajectory::parse(text, Path::new("trajectory.toml")).expect("a trajectory")
}

/// A part of the sinusoid while turning, from rest to rest, that the vehicle can fly.
pub fn turning() -> Trajectory {
    trajectory(
        "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = 1.4\namplitude_m = 0.6\n\
         period_s = 4\nyaw_period_s = 8\nramp_s = 0.6",
    )
}

/// Faster than the vehicle can follow.
pub fn hasty(seconds: f64) -> Trajectory {
    trajectory(&format!(
        "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = {seconds}\namplitude_m = 1\n\
         period_s = 3\nyaw_period_s = 5\nramp_s = 0.3"
    ))
}

/// Two metres north at an altitude of one, from rest to rest.
pub fn straight() -> Trajectory {
    trajectory(
        "family = 'waypoints'\npace = { speed_m_s = 1.5, acceleration_m_s2 = 3.0 }\n\
         points = [{ north_m = 0, east_m = 0, altitude_m = 1 }, \
         { north_m = 2, east_m = 0, altitude_m = 1 }]",
    )
}

/// The first desired state at rest and level.
pub fn rest(first: &StateVector) -> StateVector {
    let [x, y, z, .., yaw, _, _, _] = *first;
    [x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0, yaw, 0.0, 0.0, 0.0]
}

pub fn planner(model: Arc<dyn Model>, settings: &PlanSettings) -> Planner {
    Planner::new(model, planned_vehicle(), settings.clone()).expect("a planner")
}

/// The plan along a trajectory from rest, through physics.
pub fn plan(trajectory: &Trajectory, settings: &PlanSettings) -> Outcome<7> {
    let planner = planner(Arc::new(physics()), settings);
    let desire = planner.desire(trajectory).expect("desired states");
    planner.plan(&desire, rest(&desire.states[0]), None, &|_| false)
}
