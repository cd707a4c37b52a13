//! Planning with the tube's radius as the margin to keep-out regions.

use super::super::desire::Desire;
use super::super::planner::Planner;
use super::super::problem::StateVector;
use super::super::scp::{Outcome, Record};
use super::Radius;

/// Largest number of searches: the radius depends on the plan's speed, and the plan on the radius.
const SEARCHES: usize = 5;
/// Excess of the margin over the radius, m, for the tolerated violation of a region and for the
/// curvature of the path between two states.
const ROOM_M: f64 = 2e-3;

/// A tube's radii at two confidences.
#[derive(Clone, Copy, Debug)]
pub struct Radii<'a> {
    /// Radius of the plan's tube.
    pub tube: Radius<'a>,
    /// Margin to keep-out regions and position bounds, at the same or a higher confidence.
    pub margin: Radius<'a>,
}

/// The outcome of a search, and its tube.
#[derive(Clone, Debug)]
pub struct Tubed {
    /// The last search. Its violations include the margin at this plan's speeds, even if the
    /// searches ended before plan and margin agreed.
    pub outcome: Outcome<7>,
    /// The tube's radius at each state, m.
    pub radius_m: Vec<f64>,
}

/// Searches as [`Planner::plan`] does, with the margin to the regions and to the box. The first
/// margin is the radius at the desired speeds. Each further search raises it where the last plan
/// needs more, so the margin never shrinks.
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
