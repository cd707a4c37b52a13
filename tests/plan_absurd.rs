//! Impossible requests: a status with the best available plan, or an error that says what is wrong.

use std::cell::Cell;
use std::sync::Arc;

use crate::planning::{hasty, physics, plan, planned_vehicle, planner, rest, straight, trajectory};
use downwash::model::{ACCELERATIONS, Jacobian, Model, Point, VARIABLES};
use downwash::plan::desire::Desire;
use downwash::plan::planner::{KeepOutSetting, PlanSettings, Planner, PlannerError, SolverChoice};
use downwash::plan::scp::{Outcome, Status};
use proptest::prelude::*;

/// What holds for every outcome, whatever the request.
fn sound(outcome: &Outcome<7>, settings: &PlanSettings) {
    assert!(outcome.records.len() <= settings.subproblems_max);
    assert!(outcome.iterate.states.iter().flatten().all(|value| value.is_finite()));
    assert!(outcome.iterate.inputs.iter().flatten().all(|value| value.is_finite()));
    assert!(outcome.cost.is_finite());
}

fn short() -> PlanSettings {
    PlanSettings { rate_hz: 50.0, ..PlanSettings::default() }
}

#[test]
fn fifty_g_turns_give_the_nearest_flyable_plan() {
    let fast = trajectory(
        "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = 2\namplitude_m = 5\n\
         period_s = 0.6\nyaw_period_s = 1\nramp_s = 0.2",
    );
    let outcome = plan(&fast, &short());
    sound(&outcome, &short());
    assert!(outcome.violation.defect <= 1e-6, "{:?} {:?}", outcome.status, outcome.violation);
    assert!(outcome.violation.overrun <= 1e-2, "{:?} {:?}", outcome.status, outcome.violation);
}

#[test]
fn reference_jumps_are_smoothed() {
    let jumps = trajectory(
        "family = 'steps'\naltitude_m = 1\ndwell_s = 1.0\n\
         offsets = [[0, 0, 0, 0], [3, 0, 0, 170], [-3, 2, 1, -170]]",
    );
    let outcome = plan(&jumps, &short());
    sound(&outcome, &short());
    assert!(outcome.violation.defect <= 1e-6, "{:?} {:?}", outcome.status, outcome.violation);
}

#[test]
fn non_finite_numbers_are_named_with_their_time() {
    let settings = short();
    let planner = planner(Arc::new(physics()), &settings);
    let good = planner.desire(&hasty(0.4)).expect("desired states");
    let start = rest(&good.states[0]);
    // Even past every check, the search must end.
    let damages: [fn(&mut Desire); 3] = [
        |desire| desire.states[7][1] = f64::NAN,
        |desire| desire.inputs[3][2] = f64::NAN,
        |desire| desire.states[7][4] = f64::INFINITY,
    ];
    for damage in damages {
        let mut desire = good.clone();
        damage(&mut desire);
        let outcome = planner.plan(&desire, start, None, &|_| false);
        assert!(matches!(outcome.status, Status::Failed), "{:?}", outcome.status);
        assert!(outcome.records.len() <= settings.subproblems_max);
    }
    let mut nowhere = start;
    nowhere[4] = f64::NAN;
    assert_eq!(planner.plan(&good, nowhere, None, &|_| false).status, Status::Failed);
}

#[test]
fn absurd_trajectory_gives_a_planner_error() {
    let planner = planner(Arc::new(physics()), &PlanSettings::default());
    let long = trajectory("family = 'hover'\naltitude_m = 1\nduration_s = 2000");
    let error = planner.desire(&long).expect_err("refused");
    assert!(matches!(error, PlannerError::TooLong { .. }), "{error}");
    assert!(error.to_string().contains("2000 s"), "{error}");
    assert!(!error.to_string().contains("--time-limit"), "no time is enough: {error}");
    let slow = trajectory("family = 'hover'\naltitude_m = 1\nduration_s = 300");
    let error = planner.desire(&slow).expect_err("refused").to_string();
    assert!(error.contains("at most 100 s") && error.contains("search 24 s"), "{error}");
    let patient = PlanSettings { time_limit_s: 24.0, ..PlanSettings::default() };
    assert!(crate::planning::planner(Arc::new(physics()), &patient).desire(&slow).is_ok());
    let vast = trajectory(
        "family = 'sinusoid-xy'\naltitude_m = 1\nduration_s = 1\namplitude_m = [1e308, 1]\n\
         period_s = [1e-3, 1]",
    );
    let error = planner.desire(&vast).expect_err("refused").to_string();
    assert!(error.contains("not finite") && error.contains(" s"), "{error}");
}

#[test]
fn single_sample_trajectory_converges() {
    let still = trajectory("family = 'hover'\naltitude_m = 1\nduration_s = 0.001");
    let outcome = plan(&still, &short());
    sound(&outcome, &short());
    assert_eq!(outcome.iterate.inputs.len(), 1);
    assert_eq!(outcome.status, Status::Converged);
    assert!(outcome.violation.defect <= 1e-6);
}

#[test]
fn path_through_the_box_floor_stays_on_it() {
    let dive = trajectory(
        "family = 'waypoints'\npace = { speed_m_s = 1.5, acceleration_m_s2 = 3.0 }\n\
         points = [{ north_m = 0, east_m = 0, altitude_m = 1 }, \
         { north_m = 0.5, east_m = 0, altitude_m = 0.01 }, \
         { north_m = 1, east_m = 0, altitude_m = 1 }]",
    );
    let settings = PlanSettings { box_m: Some([[-3.0, -3.0, -3.0], [3.0, 3.0, -0.2]]), ..short() };
    let outcome = plan(&dive, &settings);
    sound(&outcome, &settings);
    let text = format!("{:?} {:?}", outcome.status, outcome.violation);
    assert!(outcome.violation.overrun <= 1e-4 && outcome.violation.defect <= 1e-6, "{text}");
    let low = outcome.iterate.states.iter().map(|state| state[2]).fold(f64::MIN, f64::max);
    assert!((-0.25..=-0.199).contains(&low), "down to {low}; {text}");
}

#[test]
fn start_that_breaks_every_limit_ends_soundly() {
    let settings = PlanSettings { box_m: Some([[-1.0; 3], [1.0; 3]]), ..short() };
    let planner = planner(Arc::new(physics()), &settings);
    let desire = planner.desire(&hasty(0.6)).expect("desired states");
    let starts = [
        [5.0, 5.0, -5.0, 9.0, 0.0, 0.0, 1.2, -1.0, 0.0, 12.0, -12.0, 9.0],
        [0.0, 0.0, -1.0, 0.0, 0.0, 60.0, 3.1, 0.0, 0.0, 0.0, 0.0, 0.0],
        // Pitch of 90 degrees, the singularity of the Euler angles.
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, std::f64::consts::FRAC_PI_2, 0.0, 3.0, 3.0, 3.0],
    ];
    for start in starts {
        let outcome = planner.plan(&desire, start, None, &|_| false);
        assert!(outcome.records.len() <= settings.subproblems_max);
        assert_eq!(outcome.iterate.states[0], start);
    }
}

#[test]
fn immediate_stop_returns_the_guess() {
    let settings = short();
    let planner = planner(Arc::new(physics()), &settings);
    let desire = planner.desire(&hasty(0.6)).expect("desired states");
    let start = rest(&desire.states[0]);
    let outcome = planner.plan(&desire, start, None, &|_| true);
    assert_eq!((outcome.status, outcome.records.len()), (Status::Stopped, 0));
    sound(&outcome, &settings);
    assert_eq!(outcome.iterate.states[1..], desire.states[1..]);
    // It is not a plan, and its violation says so.
    assert!(outcome.violation.defect > 1e-3);

    let seen = Cell::new(0);
    let outcome = planner.plan(&desire, start, None, &|records| {
        seen.set(records.len());
        records.len() == 2
    });
    assert_eq!((outcome.status, outcome.records.len(), seen.get()), (Status::Stopped, 2, 2));
    assert!(outcome.violation.defect <= 1e-6);
}

#[test]
fn impossible_settings_are_refused_by_name() {
    let model: Arc<dyn Model> = Arc::new(physics());
    let good = PlanSettings::default();
    let nan = f64::NAN;
    let settings = [
        ("rate_hz", PlanSettings { rate_hz: 0.0, ..good.clone() }),
        ("rate_hz", PlanSettings { rate_hz: nan, ..good.clone() }),
        ("weight", PlanSettings { weight: [0.0; 4], ..good.clone() }),
        ("weight", PlanSettings { weight: [1.0, -1.0, 0.0, 0.0], ..good.clone() }),
        ("input_weight", PlanSettings { input_weight: 0.0, ..good.clone() }),
        ("trust", PlanSettings { trust: nan, ..good.clone() }),
        ("time_limit_s", PlanSettings { time_limit_s: -1.0, ..good.clone() }),
        ("box_m", PlanSettings { box_m: Some([[1.0; 3], [0.0; 3]]), ..good.clone() }),
        ("box_m", PlanSettings { box_m: Some([[nan; 3], [1.0; 3]]), ..good.clone() }),
        (
            "sphere",
            PlanSettings {
                keep_out: vec![KeepOutSetting::Sphere { centre_m: [0.0, nan, 0.0], radius_m: 1.0 }],
                ..good.clone()
            },
        ),
        (
            "box",
            PlanSettings {
                keep_out: vec![KeepOutSetting::Box {
                    lower_m: [0.0; 3],
                    upper_m: [1.0, -1.0, 1.0],
                }],
                ..good
            },
        ),
    ];
    for (field, settings) in settings {
        let error = Planner::new(Arc::clone(&model), planned_vehicle(), settings);
        let error = error.err().expect("refused");
        assert!(error.to_string().contains(field), "{field}: {error}");
    }
}

/// A model that fails beyond a speed.
struct Broken;

impl Model for Broken {
    fn accelerations(&self, at: &Point) -> [f64; ACCELERATIONS] {
        let speed = at.velocity.norm();
        [if speed > 0.2 { f64::NAN } else { 0.5 }; ACCELERATIONS]
    }

    fn linearize(&self, at: &Point) -> ([f64; ACCELERATIONS], Jacobian) {
        (self.accelerations(at), [[0.1; VARIABLES]; ACCELERATIONS])
    }
}

#[test]
fn non_finite_model_ends_the_search() {
    for solver in [SolverChoice::InteriorPoint, SolverChoice::Clarabel, SolverChoice::Penalty] {
        let settings = PlanSettings { solver, ..short() };
        let planner = planner(Arc::new(Broken), &settings);
        let desire = planner.desire(&straight()).expect("desired states");
        let outcome = planner.plan(&desire, rest(&desire.states[0]), None, &|_| false);
        assert!(outcome.records.len() <= settings.subproblems_max, "{solver:?}");
        assert_eq!(outcome.status, Status::Failed, "{solver:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Every request ends within the bounds of the inputs.
    #[test]
    fn every_search_terminates_within_input_bounds(
        amplitude in 0.01_f64..30.0,
        period in 0.05_f64..5.0,
        yaw_period in 0.1_f64..10.0,
        radius in 0.0_f64..3.0,
        centre in prop::array::uniform3(-2.0_f64..2.0),
        weight in prop::array::uniform4(1e-3_f64..1e3),
    ) {
        let wild = trajectory(&format!(
            "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = 0.6\namplitude_m = {amplitude}\n\
             period_s = {period}\nyaw_period_s = {yaw_period}\nramp_s = 0.1"
        ));
        let settings = PlanSettings {
            weight,
            keep_out: vec![KeepOutSetting::Sphere { centre_m: centre, radius_m: radius }],
            ..short()
        };
        let outcome = plan(&wild, &settings);
        sound(&outcome, &settings);
        let planner = planner(Arc::new(physics()), &settings);
        let desire = planner.desire(&wild).expect("desired states");
        let bounds = planner.problem(&desire, desire.states[0]).inputs;
        for input in &outcome.iterate.inputs {
            prop_assert_eq!(bounds.clamp(*input), *input);
        }
    }
}
