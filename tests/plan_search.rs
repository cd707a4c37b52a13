//! Whole searches: solvers agree, plans satisfy their model and bounds, and rotate with the world.

use std::sync::Arc;

use crate::planning::{
    attitude_pd, hasty, hybrid, physics, plan, planned_vehicle, planner, rest, turning, vehicle,
};
use downwash::control::Limits;
use downwash::model::Model;
use downwash::model::features::Features;
use downwash::model::physics::{PhysicsModel, PhysicsParameters};
use downwash::plan::conic::Conic;
use downwash::plan::desire::Desire;
use downwash::plan::discretisation::{CommandedDynamics, Dynamics, WrenchDynamics};
use downwash::plan::interior_point::InteriorPoint;
use downwash::plan::iterate::Iterate;
use downwash::plan::planner::{
    PlanSettings, PlannedVehicle, Planner, RecedingSettings, SolverChoice,
};
use downwash::plan::problem::{InputBounds, Problem, STATES, StateLimits, StateVector};
use downwash::plan::scp::{Outcome, ScpSettings, Status, search};
use downwash::plan::subproblem::SubproblemSolver;

const PERIOD: f64 = 0.01;
/// Of a turn of 1 m in 5 s, m/s.
const SPEED: f64 = std::f64::consts::TAU / 5.0;

/// One second of the sinusoid with yaw, without attitude in the desired states.
fn wrench_problem() -> Problem<4> {
    let point = |n: usize| -> StateVector {
        let (sin, cos) = (SPEED * n as f64 * PERIOD).sin_cos();
        let mut state = [0.0; STATES];
        state[..6].copy_from_slice(&[sin, 1.0 - cos, -1.0, SPEED * cos, SPEED * sin, 0.0]);
        (state[8], state[11]) = (0.6 * n as f64 * PERIOD, 0.6);
        state
    };
    let vehicle = planned_vehicle();
    let hover = vehicle.body.mass_kg * vehicle.body.gravity;
    Problem {
        period_s: PERIOD,
        start: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        desired: (1..=100).map(point).collect(),
        state_weight: [1.0; STATES],
        knee: 0.0,
        // Within what the rotors provide together, so that none saturates.
        inputs: InputBounds {
            lower: [0.1, -0.001, -0.001, -0.0002],
            upper: [0.45, 0.001, 0.001, 0.0002],
            scale: [hover, 0.001, 0.001, 0.0002],
        },
        preference: None,
        limits: StateLimits::default(),
        keep_out: vec![],
        margin_m: vec![],
    }
}

fn searched(
    problem: &Problem<4>,
    model: &dyn Model,
    solver: &mut dyn SubproblemSolver<4>,
) -> Outcome<4> {
    let vehicle = planned_vehicle();
    let dynamics = WrenchDynamics::new(model, PERIOD);
    let settings = ScpSettings { progress: 1e-7, tolerance: 1e-7, ..ScpSettings::default() };
    let hover = [vehicle.body.mass_kg * vehicle.body.gravity, 0.0, 0.0, 0.0];
    search(problem, &dynamics, solver, &settings, Iterate::desired(problem, hover), &|_| false)
}

#[test]
fn all_solvers_reach_the_same_cost_through_physics() {
    let (problem, model) = (wrench_problem(), physics());
    let ours = searched(&problem, &model, &mut InteriorPoint::default());
    assert_eq!(ours.status, Status::Converged);
    for mut solver in [Conic::equations(), Conic::penalised()] {
        let theirs = searched(&problem, &model, &mut solver);
        assert!(theirs.violation.defect < 1e-6, "{:?}", theirs.violation);
        let apart = (ours.cost - theirs.cost).abs() / theirs.cost;
        assert!(apart < 1e-5, "{} against {} ({:?})", ours.cost, theirs.cost, theirs.status);
    }
}

#[test]
fn all_solvers_agree_for_the_vehicle_with_its_loop() {
    let costs = [SolverChoice::InteriorPoint, SolverChoice::Clarabel, SolverChoice::Penalty].map(
        |solver| {
            let settings = PlanSettings { solver, progress: 1e-7, ..PlanSettings::default() };
            let outcome = plan(&turning(), &settings);
            assert!(outcome.violation.defect < 1e-6, "{solver:?} {:?}", outcome.violation);
            outcome.cost
        },
    );
    for cost in costs {
        assert!((cost - costs[0]).abs() < 1e-3 * costs[0], "{costs:?}");
    }
}

#[test]
fn inputs_for_an_autopilot_loop_are_smooth() {
    let settings = PlanSettings::default();
    let mut parameters = PhysicsParameters::default();
    let trim = "attitude_trim:roll_rad=0.014,pitch_rad=-0.009";
    parameters.effects.insert_argument(trim).expect("an effect");
    let model = PhysicsModel::new(&vehicle(), &parameters).expect("a model");
    let plain = planner(Arc::new(model), &settings);
    let cautious = plain.clone().cautious(&RecedingSettings::default().for_loop(true));
    let trajectory = hasty(6.0);
    // Root mean square of the second differences of the desired roll rate, rad/s.
    let [jumps, smooth] = [plain, cautious].map(|planner| {
        let desire = planner.desire(&trajectory).expect("desired states");
        let start = planner.at_rest(&desire.states[0]);
        let outcome = planner.plan(&desire, start, None, &|_| false);
        let bends = outcome.iterate.inputs.windows(3).map(|w| w[0][4] - 2.0 * w[1][4] + w[2][4]);
        let (sum, count) = bends.fold((0.0, 0.0), |(sum, n), bend| (sum + bend * bend, n + 1.0));
        f64::sqrt(sum / count)
    });
    assert!(smooth < 0.7 * jumps, "{smooth} and {jumps} rad/s");
}

#[test]
fn plan_states_follow_from_its_model_and_inputs() {
    let settings = PlanSettings::default();
    let models: [(&str, Arc<dyn Model>); 3] = [
        ("physics", Arc::new(physics())),
        ("hybrid", Arc::new(hybrid(Features::World, 1))),
        ("hybrid, heading", Arc::new(hybrid(Features::Heading, 2))),
    ];
    for (name, model) in models {
        let planner = planner(Arc::clone(&model), &settings);
        let desire = planner.desire(&turning()).expect("desired states");
        let start = rest(&desire.states[0]);
        let outcome = planner.plan(&desire, start, None, &|_| false);
        let problem = planner.problem(&desire, start);
        let dynamics = CommandedDynamics::new(model.as_ref(), attitude_pd(), planner.period_s());
        let Iterate { states, inputs } = &outcome.iterate;
        assert_eq!((states.len(), inputs.len()), (desire.states.len(), desire.inputs.len()));
        assert_eq!(states[0], start, "{name}");
        for (pair, input) in states.windows(2).zip(inputs) {
            let next = dynamics.step(&pair[0], input);
            for (next, planned) in next.iter().zip(&pair[1]) {
                assert!((next - planned).abs() <= 1e-6, "{name}: {next} {planned}");
            }
            assert_eq!(problem.inputs.clamp(*input), *input, "{name}");
        }
        // The first state that may move is the second; the search has followed the rest.
        let guess = Iterate { states: desire.states.clone(), inputs: desire.inputs.clone() };
        let open: f64 = {
            let mut state = start;
            let costs = guess.inputs.iter().enumerate().map(|(n, input)| {
                state = dynamics.step(&state, input);
                problem.cost(n, &state, input)
            });
            costs.sum()
        };
        assert!(outcome.cost < open, "{name}: {} and {open} unplanned", outcome.cost);
        assert!(matches!(outcome.status, Status::Converged | Status::Stalled), "{name}");
    }
}

/// A state seen from a world rotated about down.
fn turned(state: &StateVector, angle: f64) -> StateVector {
    let (sin, cos) = angle.sin_cos();
    let mut turned = *state;
    for first in [0, 3] {
        let (n, e) = (state[first], state[first + 1]);
        (turned[first], turned[first + 1]) = (cos * n - sin * e, sin * n + cos * e);
    }
    turned[8] += angle;
    turned
}

#[test]
fn rotating_the_world_rotates_the_plan() {
    let settings = PlanSettings::default();
    let models: [(&str, Arc<dyn Model>); 2] =
        [("physics", Arc::new(physics())), ("hybrid", Arc::new(hybrid(Features::Heading, 4)))];
    for (name, model) in models {
        let planner = planner(Arc::clone(&model), &settings);
        let desire = planner.desire(&turning()).expect("desired states");
        let start = rest(&desire.states[0]);
        let straight = planner.plan(&desire, start, None, &|_| false);
        for angle in [0.7, -2.3, 4.0] {
            let around = Desire {
                states: desire.states.iter().map(|state| turned(state, angle)).collect(),
                inputs: desire
                    .inputs
                    .iter()
                    .map(|input| {
                        let mut input = *input;
                        input[3] += angle;
                        input
                    })
                    .collect(),
            };
            let plan = planner.plan(&around, turned(&start, angle), None, &|_| false);
            assert_eq!(plan.records.len(), straight.records.len(), "{name} by {angle}");
            assert!((plan.cost - straight.cost).abs() < 1e-6 * straight.cost, "{name} by {angle}");
            for (found, state) in plan.iterate.states.iter().zip(&straight.iterate.states) {
                for (found, expected) in found.iter().zip(turned(state, angle)) {
                    assert!(
                        (found - expected).abs() < 1e-4,
                        "{name} by {angle}: {found} {expected}"
                    );
                }
            }
        }
    }
}

#[test]
fn tilt_rate_and_box_limits_are_respected() {
    let limits = Limits { tilt_max_rad: 0.15, body_rate_max_rad_s: 1.0, ..Limits::default() };
    let settings = PlanSettings {
        box_m: Some([[-0.05, -0.2, -1.2], [0.25, 0.2, -0.8]]),
        ..PlanSettings::default()
    };
    let vehicle = PlannedVehicle { limits, ..planned_vehicle() };
    let planner = Planner::new(Arc::new(physics()), vehicle, settings).expect("a planner");
    let desire = planner.desire(&hasty(1.5)).expect("desired states");
    let outcome = planner.plan(&desire, rest(&desire.states[0]), None, &|_| false);
    assert!(outcome.violation.overrun <= 1e-4, "{:?} {:?}", outcome.status, outcome.violation);
    assert!(outcome.violation.defect <= 1e-6);
    let (mut tilt, mut rate, mut north) = (0.0_f64, 0.0_f64, 0.0_f64);
    for state in &outcome.iterate.states {
        tilt = tilt.max((state[6].cos() * state[7].cos()).acos());
        rate = state[9..].iter().fold(rate, |most, rate| most.max(rate.abs()));
        north = north.max(state[0]);
    }
    assert!(tilt <= 0.1502 && rate <= 1.0002 && north <= 0.2502, "{tilt} {rate} {north}");
    // The limits are active.
    assert!(tilt > 0.14 && north > 0.24, "{tilt} {rate} {north}");
}

#[test]
fn longer_search_is_never_worse() {
    let model: Arc<dyn Model> = Arc::new(hybrid(Features::World, 9));
    let mut last = f64::INFINITY;
    for subproblems_max in [1, 2, 4, 8, 16, 32] {
        let settings = PlanSettings { subproblems_max, ..PlanSettings::default() };
        let planner = planner(Arc::clone(&model), &settings);
        let desire = planner.desire(&turning()).expect("desired states");
        let outcome = planner.plan(&desire, rest(&desire.states[0]), None, &|_| false);
        assert!(outcome.records.len() <= subproblems_max);
        assert!(outcome.cost <= last + 1e-12, "{} after {last}", outcome.cost);
        last = outcome.cost;
    }
}

#[test]
fn plan_starts_in_the_hover_of_its_model() {
    let mut parameters = PhysicsParameters::default();
    for effect in [
        "rotor_drag:d_xy=0.012,d_z=0.006",
        "wind:north_m_s=2,east_m_s=-1.5",
        "com_offset:x_m=0.003,y_m=-0.002",
    ] {
        parameters.effects.insert_argument(effect).expect("an effect");
    }
    let model = PhysicsModel::new(&vehicle(), &parameters).expect("a model");
    let planner = planner(Arc::new(model), &PlanSettings::default());
    let desire = planner.desire(&turning()).expect("desired states");
    let start = planner.at_rest(&desire.states[0]);
    let outcome = planner.plan(&desire, start, None, &|_| false);
    assert_eq!(outcome.status, Status::Converged);
    let hover_n = planner.hover_thrust_n();
    let Iterate { states, inputs } = &outcome.iterate;
    for ((state, desired), input) in states.iter().zip(&desire.states).zip(inputs).take(20) {
        let off = (0..3).map(|i| (state[i] - desired[i]).powi(2)).sum::<f64>().sqrt();
        assert!(off < 2e-3, "{off} m at {state:?}");
        assert!((input[0] / hover_n - 1.0).abs() < 0.1, "{input:?}");
    }
}
