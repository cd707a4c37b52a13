//! Speed of planning: whole searches along the sinusoid with yaw, one subproblem, one
//! linearisation; through physics, and through networks of typical size fitted to it.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use criterion::{BatchSize, BenchmarkId, Criterion, criterion_group, criterion_main};
use downwash::control::Limits;
use downwash::model::features::{FEATURES_MAX, Features, Head, OUTPUTS};
use downwash::model::learned::{Network, NetworkModel};
use downwash::model::net::{Mlp, Normalization};
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::model::{Model, Point, VARIABLES};
use downwash::plan::Trajectory;
use downwash::plan::discretisation::{CommandedDynamics, Dynamics, LinearStep};
use downwash::plan::interior_point::InteriorPoint;
use downwash::plan::planned::PlannedBody;
use downwash::plan::planner::{PlanSettings, PlannedVehicle, Planner};
use downwash::plan::problem::STATES;
use downwash::plan::subproblem::{DynamicsForm, Solution, Stage, Subproblem, SubproblemSolver};
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::VehicleParams;

const HIDDEN: usize = 100;
/// Range of the fit's points about zero: v, omega, zeta, u of a nano quadrotor.
const SIZE: [f64; VARIABLES] =
    [2.0, 2.0, 2.0, 4.0, 4.0, 4.0, 0.6, 0.6, 3.2, 0.25, 1e-3, 1e-3, 5e-4];

fn vehicle() -> VehicleParams {
    VehicleParams::from_toml_str(include_str!("../config/vehicles/crazyflie.toml"))
        .expect("a vehicle")
}

fn planned(vehicle: &VehicleParams) -> PlannedVehicle {
    PlannedVehicle {
        body: PlannedBody {
            mass_kg: vehicle.mass,
            inertia: vehicle.inertia,
            gravity: vehicle.gravity,
            thrust_full_n: vehicle.thrust_full_n(),
        },
        attitude_pd: vehicle.attitude_pd.expect("an attitude loop"),
        limits: Limits::default(),
    }
}

/// Networks with random hidden units, and output weights fitted to the physics by least squares: as
/// many kinks as in a trained network, at the cost of a small linear system.
fn fitted(physics: &PhysicsModel) -> NetworkModel {
    const ROWS: usize = 3000;
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let points: Vec<[f64; VARIABLES]> = (0..ROWS)
        .map(|_| {
            let mut at = SIZE.map(|size| random.random_range(-size..size));
            at[9] += 0.3; // the weight
            at
        })
        .collect();
    let [linear, angular] = Head::BOTH.map(|head| {
        let mut row = [0.0; FEATURES_MAX];
        let inputs = Features::World.extract(head, &points[0], &mut row);
        let mut deviation = vec![1.0; inputs];
        let mut mean = vec![0.0; inputs];
        deviation[..3].fill(1.2);
        deviation[3..6].fill(2.3);
        match head {
            Head::Linear => (mean[12], deviation[12]) = (0.3, 0.15),
            Head::Angular => deviation[12..].fill(5e-4),
        }
        let mut draw = |count: usize| -> Vec<f32> {
            (0..count).map(|_| random.random_range(-0.5..0.5)).collect()
        };
        let mut network = Network {
            inputs: Normalization { mean, deviation },
            outputs: Normalization { mean: vec![0.0; OUTPUTS], deviation: vec![10.0; OUTPUTS] },
            mlp: Mlp {
                inputs,
                hidden: HIDDEN,
                outputs: OUTPUTS,
                hidden_weights: draw(inputs * HIDDEN),
                hidden_biases: draw(HIDDEN),
                output_weights: vec![0.0; OUTPUTS * HIDDEN],
                output_biases: vec![0.0; OUTPUTS],
            },
        };
        let units = DMatrix::from_fn(ROWS, HIDDEN, |n, unit| {
            Features::World.extract(head, &points[n], &mut row);
            let weights = &network.mlp.hidden_weights[unit * inputs..];
            let sum: f64 = (0..inputs)
                .map(|i| {
                    let Normalization { mean, deviation } = &network.inputs;
                    f64::from(weights[i]) * (row[i] - mean[i]) / deviation[i]
                })
                .sum();
            (sum + f64::from(network.mlp.hidden_biases[unit])).max(0.0)
        });
        let normal = units.tr_mul(&units) + DMatrix::identity(HIDDEN, HIDDEN);
        let factor = normal.cholesky().expect("a positive definite system");
        for (output, index) in head.rows().enumerate() {
            let targets = DVector::from_fn(ROWS, |n, _| {
                physics.accelerations(&Point::from_array(&points[n]))[index] / 10.0
            });
            let weights = factor.solve(&units.tr_mul(&targets));
            let fitted = &mut network.mlp.output_weights[output * HIDDEN..][..HIDDEN];
            for (fitted, weight) in fitted.iter_mut().zip(weights.iter()) {
                *fitted = *weight as f32;
            }
        }
        network
    });
    NetworkModel { features: Features::World, linear, angular }
}

fn sinusoid(periods: usize) -> Trajectory {
    let text = format!(
        "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = {}\namplitude_m = 1\n\
         period_s = 5\nyaw_period_s = 10\nramp_s = 0.5",
        periods as f64 / 100.0
    );
    Trajectory::parse(&text, Path::new("sinusoid")).expect("a trajectory")
}

fn searches(c: &mut Criterion) {
    let vehicle = vehicle();
    let physics = PhysicsModel::new(&vehicle, &PhysicsParameters::default()).expect("physics");
    let networks = fitted(&physics);
    let models: [(&str, Arc<dyn Model>); 2] =
        [("physics", Arc::new(physics)), ("networks", Arc::new(networks))];
    let mut group = c.benchmark_group("plan");
    group.sample_size(10);
    for (name, model) in models {
        let planner = Planner::new(model, planned(&vehicle), PlanSettings::default());
        let planner = planner.expect("a planner");
        for periods in [100, 300, 1000] {
            let desire = planner.desire(&sinusoid(periods)).expect("desired states");
            let start = desire.states[0];
            group.bench_function(BenchmarkId::new(name, periods), |b| {
                b.iter(|| planner.plan(black_box(&desire), start, None, &|_| false));
            });
        }
        let desire = planner.desire(&sinusoid(100)).expect("desired states");
        let start = desire.states[0];
        let found = planner.plan(&desire, start, None, &|_| false).iterate;
        let mut moved = start;
        (moved[0], moved[4], moved[6]) = (moved[0] + 0.02, moved[4] + 0.05, moved[6] + 0.02);
        group.bench_function(BenchmarkId::new(format!("{name}, again"), 100), |b| {
            b.iter_batched(
                || Some(found.clone()),
                |guess| planner.plan(black_box(&desire), moved, guess, &|_| false),
                BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

/// A subproblem around the desired states themselves.
fn subproblem(dynamics: &CommandedDynamics<'_>, planner: &Planner) -> Subproblem<7> {
    let desire = planner.desire(&sinusoid(300)).expect("desired states");
    let problem = planner.problem(&desire, desire.states[0]);
    let stages = desire.inputs.iter().enumerate().map(|(n, input)| {
        let mut step: LinearStep<7> = dynamics.linearize(&desire.states[n], input);
        for i in 0..STATES {
            step.next[i] -= desire.states[n + 1][i];
            for (entry, scale) in step.input[i].iter_mut().zip(&problem.inputs.scale) {
                *entry *= scale;
            }
        }
        Stage {
            step,
            error: [0.01; STATES],
            input_gradient: [0.0; 7],
            input_curvature: 1e-3,
            lower: [-0.2; 7],
            upper: [0.2; 7],
            rows: vec![],
        }
    });
    Subproblem {
        stages: stages.collect(),
        state_weight: problem.state_weight,
        knee: problem.knee,
        row_penalty: 10.0,
        dynamics: DynamicsForm::Equations,
        tolerance: 1e-6,
    }
}

fn parts(c: &mut Criterion) {
    let vehicle = vehicle();
    let physics = PhysicsModel::new(&vehicle, &PhysicsParameters::default()).expect("physics");
    let networks = fitted(&physics);
    let vehicle = planned(&vehicle);
    let model: Arc<dyn Model> = Arc::new(physics.clone());
    let planner = Planner::new(model, vehicle, PlanSettings::default()).expect("a planner");
    let dynamics = CommandedDynamics::new(&physics, vehicle.attitude_pd, planner.period_s());
    let problem = subproblem(&dynamics, &planner);
    let (mut solver, mut solution) = (InteriorPoint::default(), Solution::default());
    c.bench_function("subproblem_300_stages_7_inputs", |b| {
        b.iter(|| solver.solve(black_box(&problem), &mut solution));
    });
    let desire = planner.desire(&sinusoid(100)).expect("desired states");
    let models: [(&str, &dyn Model); 2] = [("physics", &physics), ("networks", &networks)];
    for (name, model) in models {
        let dynamics = CommandedDynamics::new(model, vehicle.attitude_pd, planner.period_s());
        let (state, input) = (desire.states[50], desire.inputs[50]);
        c.bench_function(&format!("linearize_a_step_{name}"), |b| {
            b.iter(|| dynamics.linearize(black_box(&state), &input));
        });
        c.bench_function(&format!("step_{name}"), |b| {
            b.iter(|| dynamics.step(black_box(&state), &input));
        });
    }
}

criterion_group!(benches, searches, parts);
criterion_main!(benches);
