//! A plan that keeps its whole tube out of the regions to avoid.

use super::super::desire::Desire;
use super::super::planner::Planner;
use super::super::problem::StateVector;
use super::super::scp::{Outcome, Record};
use super::Radius;

/// Most searches. The radius depends on the plan's speed, and the plan on the radius.
const SEARCHES: usize = 5;
/// What the margin exceeds the radius by, m: what a plan may be inside of a region, and the bulge
/// of the path between two states.
const ROOM_M: f64 = 2e-3;

/// Two radii of a tube.
#[derive(Clone, Copy, Debug)]
pub struct Radii<'a> {
    /// That of the plan's tube.
    pub tube: Radius<'a>,
    /// That which is kept away from what the plan avoids, at a confidence that is higher or the same.
    pub margin: Radius<'a>,
}

/// A plan and its tube.
#[derive(Clone, Debug)]
pub struct Tubed {
    /// How its search ended. Its violations are those of the regions with the margin's radius at this
    /// plan's speeds, also where the searches ended before the two agreed.
    pub outcome: Outcome<7>,
    /// The tube's radius at each state, m.
    pub radius_m: Vec<f64>,
}

/// Searches as [`Planner::plan`] for a plan that stays the margin's radius out of the regions and
/// within the box. That is the radius of the desired speeds first, then the larger of it and the last plan's: it
/// only grows, so the searches end.
pub fn plan_within(
    planner: &Planner,
    desire: &Desire,
    start: StateVector,
    radii: &Radii<'_>,
    stop: &dyn Fn(&[Record]) -> bool,
) -> Tubed {
    let period_s = planner.period_s();
    let with_room = |radii: &[f64]| radii.iter().map(|r| r + ROOM_M).collect::<Vec<f64>>();
    let mut margin = with_room(&radii.margin.along(period_s, &desire.states));
    let mut guess = None;
    let mut number = 0;
    loop {
        number += 1;
        let mut outcome = planner.clone().within(margin.clone()).plan(desire, start, guess, stop);
        let needed_m = radii.margin.along(period_s, &outcome.iterate.states);
        let holds = needed_m.iter().zip(&margin).all(|(needed, margin)| needed <= margin);
        if holds || number == SEARCHES || stop(&outcome.records) {
            let radius_m = radii.tube.along(period_s, &outcome.iterate.states);
            let problem = planner.clone().within(needed_m).problem(desire, start);
            outcome.violation = outcome.iterate.violation(&problem, outcome.violation.defect);
            return Tubed { outcome, radius_m };
        }
        for (margin, needed) in margin.iter_mut().zip(with_room(&needed_m)) {
            *margin = margin.max(needed);
        }
        guess = Some(outcome.iterate);
    }
}
