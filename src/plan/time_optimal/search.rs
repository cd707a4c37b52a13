//! The search from a guess to the minimum-time knots.
//!
//! Around an iterate, the dynamics are linear in states, thrusts and period lengths, so minimum
//! time is a convex problem; the search solves it with a price on the motion of the states. It uses
//! the solution as it is: states need not follow from one another until the search ends (multiple
//! shooting). Their defects count in the merit, and a step must improve on the worse of the last
//! two merits: with the last alone, the search would creep along the curved dynamics (the Maratos
//! effect; Grippo, Lampariello and Lucidi 1986).

use std::collections::VecDeque;

use super::bounds::Bounds;
use super::knots::{Knots, difference, moved};
use super::rotor_dynamics::{INPUTS, LENGTH, RotorDynamics};
use crate::plan::interior_point::InteriorPoint;
use crate::plan::iterate::Violation;
use crate::plan::scp::{Record, Status};
use crate::plan::state_vector::{STATES, StateVector};
use crate::plan::subproblem::{DynamicsForm, Solution, Stage, Subproblem, SubproblemSolver};

/// Weights of the defects of the dynamics, as metres beyond a bound.
const DEFECT: StateVector = [0.3, 0.3, 0.3, 0.1, 0.1, 0.1, 0.15, 0.15, 0.15, 0.015, 0.015, 0.015];
/// Factor on the penalty when it is raised, and the most raises.
const RAISE: f64 = 4.0;
const RAISES: usize = 6;
/// The highest penalty, s/m.
const PENALTY_MAX_S_M: f64 = 1e4;
/// Tolerated overrun of a bound at the end of a search, m.
const OVERRUN_MAX: f64 = 1e-4;
/// Price of motion: mostly on the attitude, in which the dynamics are curved.
const PROXIMITY: StateVector =
    [0.05, 0.05, 0.05, 0.05, 0.05, 0.05, 1.0, 1.0, 1.0, 0.05, 0.05, 0.05];
/// Price of a change of thrust share or relative period length, compared with a radian.
const INPUT_PRICE: f64 = 0.1;
/// Initial damping, and the bounds of it; the search gives up above the upper one.
const DAMPING: f64 = 100.0;
const DAMPING_MAX: f64 = 1e8;
const DAMPING_MIN: f64 = 1e-6;
/// Largest relative change of a period's length per step.
const STRETCH: f64 = 0.5;
/// Fractions of a step that are tried.
const SHARES: [f64; 3] = [1.0, 0.5, 0.25];
/// Number of past merits that a step is compared with.
const MEMORY: usize = 2;
/// Fraction of the promised improvement that suffices, and that is good.
const ENOUGH: f64 = 0.05;
const GOOD: f64 = 0.5;

/// Effort and end of a search.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effort {
    /// Most subproblems.
    pub subproblems_max: usize,
    /// Least and greatest length of a period, s.
    pub length_s: [f64; 2],
    /// The search ends when a subproblem promises less than this, s.
    pub tolerance_s: f64,
    /// Initial cost of a metre beyond a bound, s/m. It must exceed the value of a metre anywhere,
    /// but not by much: the higher it is, the shorter the steps.
    pub penalty_s_m: f64,
}

/// The merit of an iterate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Merit {
    pub duration_s: f64,
    /// Sums of the overruns of the bounds and of the defects of the dynamics, in metres.
    pub overrun: f64,
    pub defect: f64,
    /// The largest of each: of a bound, in metres, and of a state in its own unit.
    pub overrun_max: f64,
    pub defect_max: f64,
}

impl Merit {
    pub fn of(knots: &Knots, dynamics: &RotorDynamics, bounds: &Bounds<'_>) -> Self {
        let mut merit = Self { duration_s: knots.duration_s(), ..Self::default() };
        let passages = knots.passages();
        for (n, period) in knots.periods.iter().enumerate() {
            let missed = difference(&knots.states[n + 1], &dynamics.end(&knots.states[n], period));
            for (missed, weight) in missed.iter().zip(&DEFECT) {
                merit.defect += weight * missed.abs();
                merit.defect_max = merit.defect_max.max(missed.abs());
            }
            bounds.visit(&knots.states[n + 1], period, passages[n + 1], &mut |row| {
                merit.overrun += row.excess.max(0.0);
                merit.overrun_max = merit.overrun_max.max(row.excess);
            });
        }
        // `max` drops NaN.
        if !(merit.defect + merit.overrun).is_finite() {
            (merit.defect_max, merit.overrun_max) = (f64::INFINITY, f64::INFINITY);
        }
        merit
    }

    /// The merit in s, for a penalty in s/m.
    fn total(&self, penalty: f64) -> f64 {
        self.duration_s + penalty * (self.overrun + self.defect)
    }
}

/// A search with its workspace.
pub(super) struct Search<'a> {
    pub dynamics: &'a RotorDynamics,
    pub bounds: &'a Bounds<'a>,
    pub effort: Effort,
    pub knots: Knots,
    pub merit: Merit,
    pub records: Vec<Record>,
    damping: f64,
    penalty: f64,
    solver: InteriorPoint<INPUTS>,
    solution: Solution<INPUTS>,
    subproblem: Subproblem<INPUTS>,
}

impl<'a> Search<'a> {
    pub fn new(
        knots: Knots,
        dynamics: &'a RotorDynamics,
        bounds: &'a Bounds<'a>,
        effort: Effort,
    ) -> Self {
        Self {
            dynamics,
            bounds,
            effort,
            merit: Merit::of(&knots, dynamics, bounds),
            knots,
            records: Vec::new(),
            damping: DAMPING,
            penalty: effort.penalty_s_m,
            solver: InteriorPoint::default(),
            solution: Solution::default(),
            subproblem: Subproblem {
                stages: Vec::new(),
                state_weight: [0.0; STATES],
                knee: 1.0,
                row_penalty: 0.0,
                dynamics: DynamicsForm::Equations,
                tolerance: 0.0,
            },
        }
    }

    /// Searches until no subproblem promises an improvement, or `stop` returns true.
    pub fn run(&mut self, stop: &dyn Fn(&[Record]) -> bool) -> Status {
        let mut past = VecDeque::from([self.merit.total(self.penalty)]);
        let mut raises = 0;
        let mut is_new = true;
        let begun = self.records.len();
        while self.records.len() - begun < self.effort.subproblems_max {
            if stop(&self.records) {
                return Status::Stopped;
            }
            if is_new {
                self.linearize();
            }
            is_new = false;
            if !self.solve() {
                self.record(0.0, 0.0, 0.0);
                self.damping *= 8.0;
                if self.damping > DAMPING_MAX {
                    return Status::Failed;
                }
                continue;
            }
            let before = self.merit.total(self.penalty);
            let promised = before - self.promised_total();
            let reference = past.iter().copied().fold(f64::MIN, f64::max);
            let (mut found, mut taken) = (f64::MIN, 0.0);
            for share in SHARES {
                let (knots, merit) = self.best_step(share);
                found = before - merit.total(self.penalty);
                if reference - merit.total(self.penalty) > ENOUGH * share * promised.max(0.0) {
                    (self.knots, self.merit, taken, is_new) = (knots, merit, share, true);
                    past.push_back(merit.total(self.penalty));
                    past.drain(..past.len().saturating_sub(MEMORY));
                    break;
                }
            }
            self.record(promised, found, taken);
            // If closing the defects costs more than leaving them, the penalty is too low. The same
            // holds if the search ends with bounds exceeded.
            let may_rise = raises < RAISES;
            if may_rise && !is_new && promised < -self.effort.tolerance_s {
                raises += 1;
                past = self.raise();
                continue;
            }
            // After a rejected step, a small promise means convergence only if it is very small.
            let least = self.effort.tolerance_s * if is_new { 1.0 } else { 0.1 };
            let has_ended = promised.abs() < least;
            if has_ended || self.damping > DAMPING_MAX {
                if may_rise && self.merit.overrun_max > OVERRUN_MAX {
                    raises += 1;
                    past = self.raise();
                    self.damping = DAMPING;
                    continue;
                }
                return if has_ended { Status::Converged } else { Status::Stalled };
            }
            self.adapt_damping(promised, found, taken);
        }
        Status::SubproblemLimit
    }

    /// Adapts the damping to a step's promised and found improvement, s, and to the fraction taken.
    fn adapt_damping(&mut self, promised: f64, found: f64, taken: f64) {
        if taken == 1.0 && found > GOOD * promised {
            self.damping = (0.25 * self.damping).max(DAMPING_MIN);
        } else if taken < 0.5 {
            self.damping *= 6.0;
        } else if taken < 1.0 || found < 0.2 * promised {
            self.damping *= 2.0;
        }
    }

    /// Raises the penalty; returns the merit under it.
    fn raise(&mut self) -> VecDeque<f64> {
        self.penalty *= RAISE;
        VecDeque::from([self.merit.total(self.penalty)])
    }

    /// Continues with small steps, until states follow from one another to `defect` and the bounds
    /// hold to `overrun`, or `subproblems` subproblems were solved.
    pub fn close(
        &mut self,
        defect: f64,
        overrun: f64,
        subproblems: usize,
        stop: &dyn Fn(&[Record]) -> bool,
    ) {
        self.damping = self.damping.max(DAMPING);
        self.penalty *= RAISE;
        for _ in 0..subproblems {
            let is_closed = self.merit.defect_max <= defect && self.merit.overrun_max <= overrun;
            if is_closed || stop(&self.records) {
                return;
            }
            self.linearize();
            let before = self.merit.total(self.penalty);
            if self.solve() {
                let promised = before - self.promised_total();
                let knots = self.step(1.0);
                let merit = Merit::of(&knots, self.dynamics, self.bounds);
                let missed = |merit: &Merit| merit.defect + merit.overrun;
                let is_closer = missed(&merit) < missed(&self.merit);
                if is_closer {
                    (self.knots, self.merit) = (knots, merit);
                }
                self.record(
                    promised,
                    before - merit.total(self.penalty),
                    f64::from(u8::from(is_closer)),
                );
            } else {
                self.record(0.0, 0.0, 0.0);
            }
            self.damping = (4.0 * self.damping).min(DAMPING_MAX);
            if self.merit.overrun_max > overrun {
                self.penalty = (2.0 * self.penalty).min(PENALTY_MAX_S_M);
            }
        }
    }

    /// Linearises the subproblem around the iterate.
    fn linearize(&mut self) {
        let passages = self.knots.passages();
        let [shortest, longest] = self.effort.length_s;
        let [least, most] = self.bounds.limits.rotor;
        let stages = &mut self.subproblem.stages;
        stages.truncate(self.knots.periods.len());
        for (n, period) in self.knots.periods.iter().enumerate() {
            let (state, next) = (&self.knots.states[n], &self.knots.states[n + 1]);
            let step = self.dynamics.linearize(state, period, next);
            if stages.len() == n {
                stages.push(Stage {
                    step,
                    error: [0.0; STATES],
                    input_gradient: [0.0; INPUTS],
                    input_curvature: 0.0,
                    lower: [0.0; INPUTS],
                    upper: [0.0; INPUTS],
                    rows: Vec::new(),
                });
            }
            let stage = &mut stages[n];
            stage.step = step;
            // Lengths are relative to the present one.
            for row in &mut stage.step.input {
                row[LENGTH] *= period.length_s;
            }
            stage.input_gradient[LENGTH] = period.length_s;
            for (i, rotor) in period.rotors.iter().enumerate() {
                stage.lower[i] = (least - rotor).min(0.0);
                stage.upper[i] = (most - rotor).max(0.0);
            }
            stage.lower[LENGTH] = (shortest / period.length_s - 1.0).clamp(-STRETCH, 0.0);
            stage.upper[LENGTH] = (longest / period.length_s - 1.0).clamp(0.0, STRETCH);
            stage.rows.clear();
            self.bounds.visit(next, period, passages[n + 1], &mut |row| stage.rows.push(row));
        }
    }

    /// Solves the subproblem; returns whether that succeeded.
    fn solve(&mut self) -> bool {
        let price = self.damping / self.knots.periods.len() as f64;
        self.subproblem.state_weight = PROXIMITY.map(|weight| weight * price.sqrt());
        for stage in &mut self.subproblem.stages {
            stage.input_curvature = INPUT_PRICE * price;
        }
        self.subproblem.row_penalty = self.penalty;
        self.subproblem.tolerance = (0.02 * self.effort.tolerance_s).max(1e-6);
        self.solver.solve(&self.subproblem, &mut self.solution).is_ok()
    }

    /// The merit after the solution, according to the linear model.
    fn promised_total(&self) -> f64 {
        let Solution { states, inputs, .. } = &self.solution;
        let mut total = 0.0;
        for (stage, (d, w)) in self.subproblem.stages.iter().zip(states.iter().zip(inputs)) {
            total += stage.input_gradient[LENGTH] * (1.0 + w[LENGTH]);
            for row in &stage.rows {
                let slope: f64 = row.gradient.iter().zip(d).map(|(slope, d)| slope * d).sum();
                total += self.penalty * (row.excess + slope).max(0.0);
            }
        }
        total
    }

    /// The iterate after a fraction of the solution.
    fn step(&self, share: f64) -> Knots {
        let Solution { states, inputs, .. } = &self.solution;
        let [shortest, longest] = self.effort.length_s;
        let [least, most] = self.bounds.limits.rotor;
        let mut knots = self.knots.clone();
        for (state, d) in knots.states[1..].iter_mut().zip(states) {
            *state = moved(state, &d.map(|d| share * d));
        }
        for (period, w) in knots.periods.iter_mut().zip(inputs) {
            for (rotor, w) in period.rotors.iter_mut().zip(w) {
                *rotor = (*rotor + share * w).clamp(least, most);
            }
            period.length_s =
                (period.length_s * (1.0 + share * w[LENGTH])).clamp(shortest, longest);
        }
        knots
    }

    /// The better of two candidates: a fraction of the solution as it is, and rolled out.
    fn best_step(&self, share: f64) -> (Knots, Merit) {
        let of = |knots: Knots| {
            let merit = Merit::of(&knots, self.dynamics, self.bounds);
            (knots, merit)
        };
        let (shifted, rolled) = (of(self.step(share)), of(self.rolled_out(share)));
        if rolled.1.total(self.penalty) < shifted.1.total(self.penalty) { rolled } else { shifted }
    }

    /// The states that result from a fraction of the solution under its own feedback: they follow
    /// from one another, and the feedback keeps them within the bounds.
    fn rolled_out(&self, share: f64) -> Knots {
        let Solution { states, inputs, gains, .. } = &self.solution;
        let [shortest, longest] = self.effort.length_s;
        let [least, most] = self.bounds.limits.rotor;
        let mut knots = self.knots.clone();
        let mut off = [0.0; STATES];
        for (n, ((d, planned), gains)) in states.iter().zip(inputs).zip(gains).enumerate() {
            let w: [f64; INPUTS] = std::array::from_fn(|i| {
                let fed_back: f64 = gains[i].iter().zip(&off).map(|(k, off)| k * off).sum();
                share * planned[i] + fed_back
            });
            let period = &mut knots.periods[n];
            for (rotor, w) in period.rotors.iter_mut().zip(&w) {
                *rotor = (*rotor + w).clamp(least, most);
            }
            period.length_s = (period.length_s * (1.0 + w[LENGTH].clamp(-STRETCH, STRETCH)))
                .clamp(shortest, longest);
            let end = self.dynamics.end(&knots.states[n], &knots.periods[n]);
            let moved_state = moved(&self.knots.states[n + 1], &d.map(|d| share * d));
            off = difference(&moved_state, &end);
            knots.states[n + 1] = end;
        }
        knots
    }

    fn record(&mut self, promised: f64, found: f64, share: f64) {
        let Merit { defect_max: defect, overrun_max: overrun, .. } = self.merit;
        self.records.push(Record {
            cost: self.merit.duration_s,
            violation: Violation { defect, overrun, trespass_m: 0.0 },
            trust: 1.0 / self.damping,
            promised,
            found,
            share,
            solver_iterations: self.solution.iterations,
        });
    }
}
