//! Sequential convex programming: a feasible plan near a desired trajectory, through a model.
//!
//! Around an iterate, the dynamics are linear and the subproblem is convex. The search tries its
//! solution, and a trust region grows or shrinks with the accuracy of the prediction (Schulman et
//! al. 2013, "Finding locally optimal, collision-free trajectories with sequential convex
//! optimization"). There are two ways to try a solution:
//!
//! - if the solver provides feedback gains, the inputs are rolled out through the model under that
//!   feedback: every iterate obeys the dynamics to rounding, even if the vehicle is unstable in
//!   open loop;
//! - otherwise, states and inputs are used as they are, and their defects of the dynamics cost an
//!   l1 penalty, which is raised until they vanish: the paper's form.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::discretisation::Dynamics;
use super::iterate::{Iterate, Violation};
use super::problem::{Problem, STATES, StateVector};
use super::subproblem::{
    DynamicsForm, Solution, Stage, Subproblem, SubproblemError, SubproblemSolver, TRUST_SHAPE,
};

/// Settings of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScpSettings {
    /// Largest number of subproblems.
    pub subproblems_max: usize,
    /// Size of the first trust region, in scaled inputs.
    pub trust: f64,
    /// Cost of the square of a scaled input's step. It keeps steps small in place of the trust
    /// region: a solution without active bounds takes one sweep.
    pub damping: f64,
    /// The search ends when a subproblem promises less than this fraction of the cost,
    pub tolerance: f64,
    /// or when four subproblems together improve it by less than this fraction.
    pub progress: f64,
    /// Largest defect of the dynamics, in any state, of a feasible plan.
    pub defect_max: f64,
    /// Largest overrun of a bound of the state (m, rad, rad/s) of a feasible plan.
    pub overrun_max: f64,
}

impl Default for ScpSettings {
    fn default() -> Self {
        Self {
            subproblems_max: 60,
            trust: 0.5,
            damping: 0.0,
            tolerance: 1e-6,
            progress: 1e-3,
            defect_max: 1e-6,
            overrun_max: 1e-4,
        }
    }
}

/// How a search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// No subproblem promises to improve the plan.
    Converged,
    /// No step improves the plan, though the subproblem promises it: the best that this search
    /// finds. Plans through networks end this way, at the kinks of their units.
    Stalled,
    /// The limit on subproblems was reached.
    SubproblemLimit,
    /// The caller stopped it.
    Stopped,
    /// A subproblem could not be solved.
    Failed,
}

impl Status {
    /// A description for people.
    pub fn text(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Stalled => "no further improvement found",
            Self::SubproblemLimit => "best within the allowed subproblems",
            Self::Stopped => "best before the search was stopped",
            Self::Failed => "failed",
        }
    }
}

/// One subproblem of a search.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Record {
    /// Cost after it.
    pub cost: f64,
    /// Violation after it.
    pub violation: Violation,
    /// Trust region of the subproblem.
    pub trust: f64,
    /// Improvement that the subproblem promised, penalties included.
    pub promised: f64,
    /// Actual improvement, penalties included.
    pub found: f64,
    /// Fraction of the step that was taken; 0 if it was rejected.
    pub share: f64,
    /// Iterations of the subproblem's solver.
    pub solver_iterations: usize,
}

/// The result of a search; a failed search is an outcome too, not an error.
#[derive(Clone, Debug)]
pub struct Outcome<const INPUTS: usize> {
    /// Why it ended.
    pub status: Status,
    /// The best iterate.
    pub iterate: Iterate<INPUTS>,
    /// Its cost.
    pub cost: f64,
    /// Its violation.
    pub violation: Violation,
    /// The subproblems, in order.
    pub records: Vec<Record>,
}

/// Fractions of a step that are tried under feedback.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.1];
/// A step is good from this fraction of the promised improvement on.
const GOOD: f64 = 0.5;
/// A step is accepted from this fraction of the promised improvement on.
const ENOUGH: f64 = 1e-2;
/// Weight of the last slopes where they predicted poorly: at the kink of a network's unit, the
/// slopes of one side promise what the mean of both does not (the idea of bundle methods).
const MEMORY: f64 = 0.5;
/// Number of subproblems whose improvements are judged together.
const PATIENCE: usize = 4;
/// Factor on the trust region when a step is rejected.
const SHRINK: f64 = 0.25;
/// The search ends when the trust region is smaller.
const TRUST_MIN: f64 = 1e-6;
const TRUST_MAX: f64 = 1e3;
/// Trust region below which a subproblem that cannot be solved ends the search.
const GIVE_UP: f64 = 1e-3;
/// Least trust region after the penalties are raised.
const AFRESH: f64 = 1e-2;
/// Initial cost of a unit of overrun; it is raised until it reaches the maximum below.
const ROW_PENALTY: f64 = 10.0;
/// The same with regions to avoid: cutting through a thin one must cost more than going around it.
const REGION_PENALTY: f64 = 100.0;
const ROW_PENALTY_MAX: f64 = 1e5;

/// The search's state.
struct Search<'a, const INPUTS: usize, D> {
    problem: &'a Problem<INPUTS>,
    dynamics: &'a D,
    iterate: Iterate<INPUTS>,
    cost: f64,
    /// Sums of overruns and of defects, without their penalties.
    overrun: f64,
    defect: f64,
    row_penalty: f64,
    defect_penalty: f64,
}

/// Searches for a plan, starting from `guess`.
///
/// `stop` sees the subproblems so far before each new one; if it returns true, the search ends.
pub fn search<const INPUTS: usize, D: Dynamics<INPUTS>>(
    problem: &Problem<INPUTS>,
    dynamics: &D,
    solver: &mut dyn SubproblemSolver<INPUTS>,
    settings: &ScpSettings,
    guess: Iterate<INPUTS>,
    stop: &dyn Fn(&[Record]) -> bool,
) -> Outcome<INPUTS> {
    let mut search = Search::new(problem, dynamics, guess);
    let mut subproblem = search.subproblem();
    let mut solution = Solution::default();
    let mut records: Vec<Record> = Vec::new();
    let mut trust = settings.trust;
    let mut status = Status::SubproblemLimit;
    let (mut moved, mut memory) = (true, 0.0);
    // Number of subproblems before the penalties were last raised.
    let mut earlier = 0;
    while records.len() < settings.subproblems_max {
        if stop(&records) {
            status = Status::Stopped;
            break;
        }
        if moved {
            search.linearize(&mut subproblem, memory, settings.damping);
        }
        let last = records.last().map_or(0.0, |record| record.found);
        search.bound(&mut subproblem, trust, solver, settings.tolerance, last);
        if let Err(error) = solver.solve(&subproblem, &mut solution) {
            records.push(search.record(trust, Attempt::default(), 0));
            if trust < GIVE_UP || error == SubproblemError::Form {
                status = Status::Failed;
                break;
            }
            (trust, moved) = (SHRINK * trust, false);
            continue;
        }
        let step = size(&solution);
        let tried = search.attempt(&subproblem, &solution);
        records.push(search.record(trust, tried, solution.iterations));
        moved = tried.share > 0.0;
        memory = if tried.is_good() || records.len() < PATIENCE { 0.0 } else { MEMORY };
        trust = tried.next_trust(trust, step);
        let unit = 1.0 + search.cost;
        let done = tried.promised.abs() < settings.tolerance * unit
            || slow(&records[earlier..], settings.progress * unit);
        if done || trust < TRUST_MIN {
            if search.is_violated(settings) && search.raise() {
                (trust, moved, earlier) = (trust.max(AFRESH), true, records.len());
                continue;
            }
            status = if done { Status::Converged } else { Status::Stalled };
            break;
        }
    }
    let (_, defect) = search.iterate.defect(dynamics);
    Outcome {
        status,
        cost: search.cost,
        violation: search.iterate.violation(problem, defect),
        iterate: search.iterate,
        records,
    }
}

/// Whether the last subproblems together improved by less than `least`.
fn slow(records: &[Record], least: f64) -> bool {
    let taken = |record: &Record| if record.share > 0.0 { record.found } else { 0.0 };
    let last = records.len().checked_sub(PATIENCE).and_then(|first| records.get(first..));
    last.is_some_and(|last| last.iter().map(taken).sum::<f64>() < least)
}

/// The outcome of trying a subproblem's solution.
#[derive(Clone, Copy, Debug, Default)]
struct Attempt {
    /// Improvement of the merit that the subproblem promised.
    promised: f64,
    /// Actual improvement of the merit.
    found: f64,
    /// Fraction of the step that was taken; 0 if it was rejected.
    share: f64,
}

impl Attempt {
    /// Whether the step improved the merit about as much as promised.
    fn is_good(&self) -> bool {
        self.found > GOOD * self.promised
    }

    /// The trust region after a step of this size within `trust`.
    fn next_trust(&self, trust: f64, step: f64) -> f64 {
        if self.share <= 0.0 {
            SHRINK * step.min(trust)
        } else if self.share < 1.0 {
            trust.min(self.share * step)
        } else if self.is_good() && step > 0.9 * trust {
            (2.0 * trust).min(TRUST_MAX)
        } else {
            trust
        }
    }
}

impl<'a, const INPUTS: usize, D: Dynamics<INPUTS>> Search<'a, INPUTS, D> {
    fn new(problem: &'a Problem<INPUTS>, dynamics: &'a D, iterate: Iterate<INPUTS>) -> Self {
        let cost = iterate.cost(problem);
        let overrun = iterate.overrun(problem).sum;
        let (defect, _) = iterate.defect(dynamics);
        Self {
            problem,
            dynamics,
            iterate,
            cost,
            overrun,
            defect,
            row_penalty: if problem.keep_out.is_empty() { ROW_PENALTY } else { REGION_PENALTY },
            // Above the largest multiplier: every later step pays for a defect of the first.
            defect_penalty: 2.0 * problem.horizon() as f64,
        }
    }

    /// A subproblem of the right size.
    fn subproblem(&self) -> Subproblem<INPUTS> {
        let stage = Stage {
            step: self.dynamics.linearize(&self.iterate.states[0], &self.iterate.inputs[0]),
            error: [0.0; STATES],
            input_gradient: [0.0; INPUTS],
            input_curvature: 0.0,
            lower: [0.0; INPUTS],
            upper: [0.0; INPUTS],
            rows: Vec::new(),
        };
        Subproblem {
            stages: vec![stage; self.problem.horizon()],
            state_weight: self.problem.state_weight,
            knee: self.problem.knee,
            row_penalty: self.row_penalty,
            dynamics: DynamicsForm::Equations,
            tolerance: 0.0,
        }
    }

    /// Linearises the subproblem around the iterate. `memory` is the weight of the last slopes.
    fn linearize(&self, subproblem: &mut Subproblem<INPUTS>, memory: f64, damping: f64) {
        let Iterate { states, inputs } = &self.iterate;
        let scale = &self.problem.inputs.scale;
        for (n, stage) in subproblem.stages.iter_mut().enumerate() {
            let before = stage.step;
            let step = &mut stage.step;
            *step = self.dynamics.linearize(&states[n], &inputs[n]);
            let end = &states[n + 1];
            for (i, end) in end.iter().enumerate() {
                step.next[i] -= end;
                for (entry, scale) in step.input[i].iter_mut().zip(scale) {
                    *entry *= scale;
                }
                if memory > 0.0 {
                    blend(&mut step.state[i], &before.state[i], memory);
                    blend(&mut step.input[i], &before.input[i], memory);
                }
            }
            let desired = &self.problem.desired[n];
            stage.error =
                std::array::from_fn(|i| self.problem.state_weight[i] * (end[i] - desired[i]));
            stage.input_curvature = 0.0;
            if let Some(preference) = &self.problem.preference {
                stage.input_curvature = preference.weight;
                stage.input_gradient = std::array::from_fn(|i| {
                    preference.weight * (inputs[n][i] - preference.inputs[n][i]) / scale[i]
                });
            }
            stage.input_curvature += damping;
            self.problem.rows_near(n, end, &mut stage.rows);
        }
    }

    /// Sets the trust region and the penalties. `last` is the improvement of the last subproblem:
    /// the next need not be solved much more accurately.
    fn bound(
        &self,
        subproblem: &mut Subproblem<INPUTS>,
        trust: f64,
        solver: &dyn SubproblemSolver<INPUTS>,
        tolerance: f64,
        last: f64,
    ) {
        let bounds = &self.problem.inputs;
        for (stage, input) in subproblem.stages.iter_mut().zip(&self.iterate.inputs) {
            for (i, input) in input.iter().enumerate() {
                stage.lower[i] = ((bounds.lower[i] - input) / bounds.scale[i]).clamp(-trust, 0.0);
                stage.upper[i] = ((bounds.upper[i] - input) / bounds.scale[i]).clamp(0.0, trust);
            }
        }
        subproblem.row_penalty = self.row_penalty;
        subproblem.dynamics = solver.dynamics(self.defect_penalty, trust);
        subproblem.tolerance = 0.1 * (tolerance * (1.0 + self.cost)).max(0.1 * last);
    }

    fn merit(&self) -> f64 {
        self.cost + self.row_penalty * self.overrun + self.defect_penalty * self.defect
    }

    /// Tries a solution, and moves there if it improves the merit.
    fn attempt(&mut self, subproblem: &Subproblem<INPUTS>, solution: &Solution<INPUTS>) -> Attempt {
        let promised = self.defect_penalty * (self.defect - subproblem.defect(solution))
            - subproblem.change(solution);
        let has_feedback = !solution.gains.is_empty();
        let shares = if has_feedback { SHARES.as_slice() } else { &SHARES[..1] };
        let mut most = f64::NEG_INFINITY;
        for share in shares {
            let (iterate, defect) = if has_feedback {
                let Some(iterate) = self.rolled_out(solution, *share) else { continue };
                (iterate, 0.0)
            } else {
                let iterate = self.shifted(solution);
                let (defect, _) = iterate.defect(self.dynamics);
                (iterate, defect)
            };
            let candidate = Self {
                cost: iterate.cost(self.problem),
                overrun: iterate.overrun(self.problem).sum,
                defect,
                iterate,
                ..*self
            };
            let found = self.merit() - candidate.merit();
            most = most.max(found);
            // A promise below 0 is an error of the quadratic model: the achieved improvement then
            // decides.
            if found > ENOUGH * share * promised.max(0.0) && found.is_finite() {
                *self = candidate;
                return Attempt { promised, found, share: *share };
            }
        }
        Attempt { promised, found: most.max(f64::MIN), share: 0.0 }
    }

    /// The solution as it is, with inputs clamped to their bounds.
    fn shifted(&self, solution: &Solution<INPUTS>) -> Iterate<INPUTS> {
        let mut iterate = self.iterate.clone();
        for (state, d) in iterate.states[1..].iter_mut().zip(&solution.states) {
            for (state, d) in state.iter_mut().zip(d) {
                *state += d;
            }
        }
        let bounds = &self.problem.inputs;
        for (input, w) in iterate.inputs.iter_mut().zip(&solution.inputs) {
            *input = bounds.clamp(std::array::from_fn(|i| input[i] + bounds.scale[i] * w[i]));
        }
        iterate
    }

    /// The inputs of a fraction of the solution, rolled out through the dynamics under its
    /// feedback; `None` if the states diverge.
    fn rolled_out(&self, solution: &Solution<INPUTS>, share: f64) -> Option<Iterate<INPUTS>> {
        let bounds = &self.problem.inputs;
        let mut states = Vec::with_capacity(self.iterate.states.len());
        let mut inputs = Vec::with_capacity(self.iterate.inputs.len());
        let mut state = self.problem.start;
        states.push(state);
        for n in 0..self.iterate.inputs.len() {
            let ahead: StateVector = std::array::from_fn(|i| {
                let d = if n > 0 { solution.states[n - 1][i] } else { 0.0 };
                state[i] - self.iterate.states[n][i] - share * d
            });
            let input = std::array::from_fn(|i| {
                let fed_back: f64 =
                    solution.gains[n][i].iter().zip(&ahead).map(|(gain, ahead)| gain * ahead).sum();
                self.iterate.inputs[n][i]
                    + bounds.scale[i] * (share * solution.inputs[n][i] + fed_back)
            });
            let input = bounds.clamp(input);
            state = self.dynamics.step(&state, &input);
            if !state.iter().all(|value| value.abs() < BEYOND_MEASURE) {
                return None;
            }
            states.push(state);
            inputs.push(input);
        }
        Some(Iterate { states, inputs })
    }

    /// Whether the iterate is not yet feasible.
    fn is_violated(&self, settings: &ScpSettings) -> bool {
        let (_, defect) = self.iterate.defect(self.dynamics);
        let overrun = self.iterate.overrun(self.problem);
        defect > settings.defect_max || overrun.most > settings.overrun_max
    }

    /// Raises the penalties; false once they are at their maximum.
    fn raise(&mut self) -> bool {
        if self.row_penalty >= ROW_PENALTY_MAX {
            return false;
        }
        self.row_penalty *= 10.0;
        self.defect_penalty *= 10.0;
        true
    }

    fn record(&self, trust: f64, tried: Attempt, solver_iterations: usize) -> Record {
        let Attempt { promised, found, share } = tried;
        let violation = self.iterate.violation(self.problem, self.defect);
        Record { cost: self.cost, violation, trust, promised, found, share, solver_iterations }
    }
}

/// Moves values towards others by `share`.
fn blend<const N: usize>(values: &mut [f64; N], others: &[f64; N], share: f64) {
    for (value, other) in values.iter_mut().zip(others) {
        *value += share * (other - *value);
    }
}

/// A roll-out is abandoned if a state exceeds this (m, m/s, rad, rad/s).
const BEYOND_MEASURE: f64 = 1e4;

/// Size of a step, in units of the trust region.
fn size<const INPUTS: usize>(solution: &Solution<INPUTS>) -> f64 {
    let inputs = solution.inputs.iter().flatten().fold(0.0_f64, |most, w| most.max(w.abs()));
    if !solution.gains.is_empty() {
        return inputs; // the states follow from them
    }
    solution.states.iter().fold(inputs, |most, d| {
        d.iter().zip(&TRUST_SHAPE).fold(most, |most, (d, shape)| most.max(d.abs() / shape))
    })
}
