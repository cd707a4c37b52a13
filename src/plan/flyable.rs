//! Whether a plan may be flown: the violations that its search reports, and the consistency of its
//! states.

use super::discretisation::coasted;
use super::iterate::{Violation, entry};
use super::keep_out::{KeepOut, position};
use super::problem::{ANGLE, RATE, StateVector};
use super::scp::{Outcome, Status};

/// Largest defect and overrun of a plan that may be flown.
const DEFECT_MAX: f64 = 1e-4;
const OVERRUN_MAX: f64 = 1e-2;
/// Largest depth of a position in forbidden space, m.
const TRESPASS_MAX_M: f64 = 1e-3;

/// Largest bulge of the path between two states, relative to the bend from the accelerations around
/// it: twice a parabola's eighth.
const BULGE: f64 = 0.25;

/// Why a plan is not flown.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotFlyable {
    /// Its search failed.
    #[error("the search of this plan failed; change the trajectory or [plan] in the configuration")]
    Failed,
    /// It violates the dynamics or a bound.
    #[error(
        "the plan violates its dynamics by {defect:.1e} (at most {DEFECT_MAX:.0e}) and its bounds \
         by {overrun:.1e} (at most {OVERRUN_MAX:.0e}); change the trajectory, or [plan] in the \
         configuration"
    )]
    Violated {
        /// Largest defect of the dynamics.
        defect: f64,
        /// Largest overrun of a state's bounds (m, rad, rad/s).
        overrun: f64,
    },
    /// It enters forbidden space.
    #[error(
        "the plan goes {trespass_m:.4} m into a keep_out region, or out of box_m (at most \
         {TRESPASS_MAX_M} m): change the trajectory, or [plan] in the configuration"
    )]
    Trespass {
        /// Largest depth, m.
        trespass_m: f64,
    },
    /// Its states are not consistent with each other.
    #[error(
        "the plan's position or attitude jumps by {jump:.1e} m or rad at {at_s:.2} s, which its \
         velocity or body rate does not explain (at most {DEFECT_MAX:.0e}): the file was changed; \
         plan it again"
    )]
    Torn {
        /// The first jump found, m or rad.
        jump: f64,
        /// Its time, s.
        at_s: f64,
    },
}

/// Whether the outcome of a search may be flown. A failed search, or one that ended with states
/// that no input connects, gives no such plan.
///
/// # Errors
/// What the plan violates.
pub(super) fn check_violation(status: Status, violation: &Violation) -> Result<(), NotFlyable> {
    let Violation { defect, overrun, trespass_m } = *violation;
    if status == Status::Failed {
        return Err(NotFlyable::Failed);
    }
    if !(defect <= DEFECT_MAX && overrun <= OVERRUN_MAX) {
        return Err(NotFlyable::Violated { defect, overrun });
    }
    if trespass_m.is_nan() || trespass_m > TRESPASS_MAX_M {
        return Err(NotFlyable::Trespass { trespass_m });
    }
    Ok(())
}

/// As [`check_violation`], for a plan that starts at the state of a flying vehicle. That may be
/// slightly inside a region to avoid, or outside the box, and the vehicle must still get a plan
/// there: each region counts from where the plan has left it, and the box counts like any other
/// bound.
pub(super) fn check_in_flight(
    outcome: &Outcome<7>,
    regions: impl Iterator<Item = KeepOut>,
) -> Result<(), NotFlyable> {
    let states = &outcome.iterate.states;
    let entries = regions.map(|region| entry_once_out(states, &region, TRESPASS_MAX_M));
    let trespass_m = entries.fold(0.0, f64::max);
    check_violation(outcome.status, &Violation { trespass_m, ..outcome.violation })
}

/// Largest depth of the path in a region, m, from the first state on that is at most `most_m` deep
/// in it: a vehicle inside must be led out.
fn entry_once_out(states: &[StateVector], region: &KeepOut, most_m: f64) -> f64 {
    let out = states.iter().position(|state| region.depth(position(state)).0 <= most_m);
    out.map_or(0.0, |out| entry(&states[out..], region))
}

/// Whether velocity and body rate lead from each state to the next, `period_s` seconds later,
/// independently of any model: the step must match the rates at the state, those at the next, or a
/// value between. Where the rates reverse within a period, the step may exceed both by no more than
/// the periods around it indicate.
///
/// # Errors
/// The first jump.
pub(super) fn check_led(states: &[StateVector], period_s: f64) -> Result<(), NotFlyable> {
    let ways: Vec<[StateVector; 2]> = states
        .windows(2)
        .map(|pair| {
            let [state, next] = [pair[0], pair[1]];
            let (led, reached) = (coasted(&state, period_s), coasted(&next, -period_s));
            [
                std::array::from_fn(|i| led[i] - state[i]),
                std::array::from_fn(|i| next[i] - reached[i]),
            ]
        })
        .collect();
    for (n, pair) in states.windows(2).enumerate() {
        let about = &ways[n.saturating_sub(1)..ways.len().min(n + 2)];
        let kinematic = (0..3).chain(ANGLE..RATE);
        let mut jumps = kinematic.map(|i| {
            let (step, [led, reached]) = (pair[1][i] - pair[0][i], ways[n]);
            let outside = (led[i].min(reached[i]) - step).max(step - led[i].max(reached[i]));
            let bends = about.iter().map(|[led, reached]| (reached[i] - led[i]).abs());
            if step.is_nan() { step } else { outside - BULGE * bends.fold(0.0, f64::max) }
        });
        if let Some(jump) = jumps.find(|jump| jump.is_nan() || *jump > DEFECT_MAX) {
            return Err(NotFlyable::Torn { jump, at_s: n as f64 * period_s });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use vehicle::frame::Ned;

    use super::*;
    use crate::plan::iterate::Iterate;
    use crate::plan::problem::STATES;

    /// An outcome whose states are at these positions north, m.
    fn outcome(north: &[f64], violation: Violation) -> Outcome<7> {
        let state = |north: &f64| {
            let mut state = [0.0; STATES];
            state[0] = *north;
            state
        };
        let states: Vec<StateVector> = north.iter().map(state).collect();
        let inputs = vec![[0.0; 7]; states.len() - 1];
        let iterate = Iterate { states, inputs };
        let status = Status::Converged;
        Outcome { status, iterate, cost: 0.0, violation, records: Vec::new() }
    }

    #[test]
    fn region_binds_once_the_plan_has_left_it() {
        let regions = [
            KeepOut::Sphere { centre: Ned::new(1.0, 0.0, 0.0), radius: 0.1 },
            // Thinner than the length of a step.
            KeepOut::Box { lower: Ned::new(-1.0, -1.0, -1.0), upper: Ned::new(-0.99, 1.0, 1.0) },
        ];
        let check = |north: &[f64]| {
            let violation = Violation { trespass_m: 0.006, ..Violation::default() };
            check_in_flight(&outcome(north, violation), regions.into_iter())
        };
        assert_eq!(check(&[0.0, 0.5, 0.9, 0.9005]), Ok(()));
        assert!(matches!(check(&[0.0, 0.5, 0.905]), Err(NotFlyable::Trespass { trespass_m })
            if (trespass_m - 0.005).abs() < 1e-12));
        assert!(matches!(check(&[-0.9, -1.1]), Err(NotFlyable::Trespass { .. })));
        // It starts inside and is led out, then must stay out.
        assert_eq!(check(&[0.906, 0.904, 0.901, 0.89, 0.5]), Ok(()));
        assert!(check(&[0.906, 0.904, 0.9005, 0.905]).is_err());
    }

    #[test]
    fn box_is_an_ordinary_bound_in_flight() {
        let check = |overrun| {
            let violation = Violation { overrun, trespass_m: overrun, ..Violation::default() };
            check_in_flight(&outcome(&[0.0, 1.0], violation), std::iter::empty())
        };
        assert_eq!(check(0.009), Ok(()));
        assert!(matches!(check(0.011), Err(NotFlyable::Violated { .. })));
        let violation = Violation { trespass_m: 0.009, ..Violation::default() };
        assert!(matches!(
            check_violation(Status::Converged, &violation),
            Err(NotFlyable::Trespass { .. })
        ));
    }
}
