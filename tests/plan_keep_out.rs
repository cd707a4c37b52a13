//! Keep-out regions: the plan avoids them, or comes as near to its goal as it can.

use std::sync::Arc;

use crate::planning::{physics, plan, planner, rest, straight};
use downwash::plan::planner::{KeepOutSetting, PlanSettings};
use downwash::plan::scp::{Outcome, Status};

fn settings(regions: &[KeepOutSetting]) -> PlanSettings {
    PlanSettings { keep_out: regions.to_vec(), rate_hz: 50.0, ..PlanSettings::default() }
}

fn ball(centre_m: [f64; 3], radius_m: f64) -> KeepOutSetting {
    KeepOutSetting::Sphere { centre_m, radius_m }
}

fn block(lower_m: [f64; 3], upper_m: [f64; 3]) -> KeepOutSetting {
    KeepOutSetting::Box { lower_m, upper_m }
}

/// Depth inside a region, negative outside, by the definition.
fn depth(region: &KeepOutSetting, [x, y, z]: [f64; 3]) -> f64 {
    match region {
        KeepOutSetting::Sphere { centre_m: [a, b, c], radius_m } => {
            radius_m - ((x - a).powi(2) + (y - b).powi(2) + (z - c).powi(2)).sqrt()
        }
        KeepOutSetting::Box { lower_m, upper_m } => [x, y, z]
            .into_iter()
            .zip(lower_m.iter().zip(upper_m))
            .map(|(p, (lower, upper))| (p - lower).min(upper - p))
            .fold(f64::INFINITY, f64::min),
    }
}

fn plan_around(regions: &[KeepOutSetting]) -> Outcome<7> {
    let outcome = plan(&straight(), &settings(regions));
    let text = format!("{regions:?}: {:?} {:?}", outcome.status, outcome.violation);
    assert_ne!(outcome.status, Status::Failed, "{text}");
    // Between two states a corner is cut by less than the flyable tolerance.
    assert!(outcome.violation.overrun <= 5e-4 && outcome.violation.defect <= 1e-6, "{text}");
    for state in &outcome.iterate.states {
        for region in regions {
            assert!(depth(region, [state[0], state[1], state[2]]) <= 1e-4, "{text}");
        }
    }
    let last = outcome.iterate.states.last().expect("a state");
    let miss = ((last[0] - 2.0).powi(2) + last[1].powi(2) + (last[2] + 1.0).powi(2)).sqrt();
    assert!(miss < 0.15, "{text}: ends {miss} m from the goal");
    outcome
}

#[test]
fn sphere_beside_the_path_is_avoided() {
    plan_around(&[ball([1.0, 0.1, -1.0], 0.3)]);
}

#[test]
fn sphere_on_the_path_is_avoided() {
    plan_around(&[ball([1.0, 0.0, -1.0], 0.3)]);
}

#[test]
fn box_beside_the_path_is_avoided() {
    plan_around(&[block([0.8, -0.1, -2.0], [1.2, 0.4, -0.2])]);
}

#[test]
fn box_on_the_path_is_avoided() {
    plan_around(&[block([0.9, -0.3, -2.0], [1.1, 0.3, 0.0])]);
}

/// A step is longer than the wall is thick: a plan through the wall reports that, with the depth.
#[test]
fn thin_wall_violation_is_reported_with_its_depth() {
    let wall = block([1.0, -0.3, -2.0], [1.004, 0.3, 0.0]);
    let outcome = plan(&straight(), &settings(&[wall]));
    let ways = outcome.iterate.states.windows(2).flat_map(|pair| {
        (0..=200).map(|k| {
            let share = f64::from(k) / 200.0;
            depth(&wall, std::array::from_fn(|i| pair[0][i] + share * (pair[1][i] - pair[0][i])))
        })
    });
    let deepest = ways.fold(0.0, f64::max);
    let reported = outcome.violation.trespass_m;
    assert!((reported - deepest).abs() < 2e-4, "{reported} reported, {deepest} found");
}

#[test]
fn path_leads_through_a_gate() {
    let outcome = plan_around(&[
        block([0.9, -2.0, -3.0], [1.1, 0.1, 1.0]),
        block([0.9, 0.6, -3.0], [1.1, 2.0, 1.0]),
    ]);
    let through = outcome.iterate.states.iter().find(|state| state[0] > 1.0).expect("passes");
    assert!((0.1..=0.6).contains(&through[1]), "east {} in the gate", through[1]);
}

#[test]
fn distant_region_changes_nothing() {
    let free = plan(&straight(), &settings(&[]));
    let far = plan(&straight(), &settings(&[ball([1.0, 8.0, -1.0], 1.0)]));
    assert!((free.cost - far.cost).abs() < 1e-3 * free.cost, "{} and {}", free.cost, far.cost);
}

#[test]
fn goal_inside_a_region_is_approached() {
    let region = ball([2.0, 0.0, -1.0], 0.4);
    let outcome = plan(&straight(), &settings(&[region]));
    let text = format!("{:?} {:?}", outcome.status, outcome.violation);
    assert!(outcome.violation.overrun <= 1e-4 && outcome.violation.defect <= 1e-6, "{text}");
    let last = outcome.iterate.states.last().expect("a state");
    let depth = depth(&region, [last[0], last[1], last[2]]);
    assert!((-0.1..=1e-4).contains(&depth), "{depth} m inside at the end; {text}");
}

/// An impossible start is left as soon as the vehicle can, and reported.
#[test]
fn start_inside_a_region_is_left() {
    let region = ball([0.0, 0.0, -1.0], 0.3);
    let outcome = plan(&straight(), &settings(&[region]));
    let text = format!("{:?} {:?}", outcome.status, outcome.violation);
    assert!(outcome.violation.defect <= 1e-6, "{text}");
    assert!(outcome.violation.overrun > 0.1, "{text}");
    let inside = outcome
        .iterate
        .states
        .iter()
        .filter(|state| depth(&region, [state[0], state[1], state[2]]) > 1e-3)
        .count();
    assert!(inside < 50, "{inside} of {} states inside; {text}", outcome.iterate.states.len());
}

#[test]
fn previous_plan_warm_starts_a_slightly_moved_problem() {
    let settings = settings(&[ball([1.0, 0.1, -1.0], 0.3)]);
    let planner = planner(Arc::new(physics()), &settings);
    let desire = planner.desire(&straight()).expect("desired states");
    let start = rest(&desire.states[0]);
    let first = planner.plan(&desire, start, None, &|_| false);
    let mut moved = start;
    moved[0] += 0.02;
    moved[4] += 0.05;
    let again = planner.plan(&desire, moved, Some(first.iterate), &|_| false);
    assert!(again.violation.overrun <= 1e-4 && again.violation.defect <= 1e-6);
    assert!(again.records.len() <= first.records.len());
}
