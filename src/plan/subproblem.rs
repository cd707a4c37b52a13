//! The convex subproblem around an iterate, and the interface of its solvers.

use super::discretisation::LinearStep;
use super::problem::{STATES, StateRow, StateVector};

/// One period, in deviations from the iterate: `d` of the states, `w` of the inputs in units of
/// their scales.
#[derive(Clone, Debug)]
pub struct Stage<const INPUTS: usize> {
    /// `d+ = A d + B w + c`; `next` holds c, and B is per scaled input.
    pub step: LinearStep<INPUTS>,
    /// `W (s_bar - s_d)` at the end of the period.
    pub error: StateVector,
    /// Gradient of the cost with respect to each scaled input.
    pub input_gradient: [f64; INPUTS],
    /// Curvature of the cost with respect to each scaled input.
    pub input_curvature: f64,
    /// Least `w`: the trust region within the bounds. At most 0.
    pub lower: [f64; INPUTS],
    /// Greatest `w`. At least 0.
    pub upper: [f64; INPUTS],
    /// Bounds of the state at the end of the period: `excess + gradient . d <= 0`.
    pub rows: Vec<StateRow>,
}

/// How the dynamics enter the subproblem.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DynamicsForm {
    /// As equality constraints.
    Equations,
    /// With slacks of either sign at this cost per unit, and states in a box around the iterate of
    /// this size times [`TRUST_SHAPE`] (Schulman et al. 2013).
    Penalised {
        /// Cost of a unit of defect.
        penalty: f64,
        /// Size of the trust region.
        trust: f64,
    },
}

/// Size of each state's trust region relative to that of the scaled inputs.
pub const TRUST_SHAPE: StateVector = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 0.5, 0.5, 0.5, 5.0, 5.0, 5.0];

/// The subproblem: minimise
/// `sum sqrt(|error + W d|^2 + knee^2) + input_gradient . w + input_curvature/2 |w|^2 +
/// row_penalty sum max(0, rows)`.
#[derive(Clone, Debug)]
pub struct Subproblem<const INPUTS: usize> {
    /// One per period.
    pub stages: Vec<Stage<INPUTS>>,
    /// The diagonal of W.
    pub state_weight: StateVector,
    /// The knee of the distance.
    pub knee: f64,
    /// Cost of a unit by which a bound of the state is exceeded.
    pub row_penalty: f64,
    /// How the dynamics enter.
    pub dynamics: DynamicsForm,
    /// Largest distance of a solution from the optimum, in units of the cost.
    pub tolerance: f64,
}

/// A solution of a subproblem.
#[derive(Clone, Debug, Default)]
pub struct Solution<const INPUTS: usize> {
    /// `d` at the end of each period.
    pub states: Vec<StateVector>,
    /// `w` of each period.
    pub inputs: Vec<[f64; INPUTS]>,
    /// Optimal change of `w` per change of `d` at the period's start. Empty if the solver provides
    /// none.
    pub gains: Vec<[StateVector; INPUTS]>,
    /// Iterations of the solver.
    pub iterations: usize,
}

/// Why a subproblem has no solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SubproblemError {
    /// Inputs or results that are not finite.
    #[error("the subproblem's numbers are not finite")]
    NotFinite,
    /// The solver gave up.
    #[error("the solver stopped with {0}")]
    Solver(String),
    /// The solver does not support this form.
    #[error("this solver supports the dynamics as equations only")]
    Form,
}

/// A solver of successive subproblems of the same size.
pub trait SubproblemSolver<const INPUTS: usize> {
    /// Solves `problem` and writes the result to `solution`.
    ///
    /// # Errors
    /// [`SubproblemError`]; `solution` is then meaningless.
    fn solve(
        &mut self,
        problem: &Subproblem<INPUTS>,
        solution: &mut Solution<INPUTS>,
    ) -> Result<(), SubproblemError>;

    /// The form of the dynamics that the solver takes, for a penalty and a trust region.
    fn dynamics(&self, penalty: f64, trust: f64) -> DynamicsForm;
}

/// Least knee; below it, the norm is approximated by the parabola with the same curvature: a
/// millimetre, a milliradian.
const KINK: f64 = 1e-3;
/// Curvature along the error, where a norm has none; it keeps the quadratic program bounded.
const LEAST_CURVATURE: f64 = 1e-6;

/// The distance to second order: `gradient . d + d' (diag(diagonal) - ray ray') d / 2`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QuadraticNorm {
    /// Gradient with respect to `d`.
    pub gradient: StateVector,
    /// Curvature of the norm across the error.
    pub diagonal: StateVector,
    /// Removes the curvature along the error.
    pub ray: StateVector,
}

impl QuadraticNorm {
    /// Expands `sqrt(|error + W d|^2 + knee^2)` about `d = 0`.
    pub fn new(error: &StateVector, weight: &StateVector, knee: f64) -> Self {
        let square: f64 = error.iter().map(|e| e * e).sum();
        let distance = (square + knee.max(KINK).powi(2)).sqrt();
        let mut norm = Self::default();
        for i in 0..STATES {
            norm.gradient[i] = weight[i] * error[i] / distance;
            norm.diagonal[i] = weight[i] * weight[i] * (1.0 / distance + LEAST_CURVATURE);
            norm.ray[i] = norm.gradient[i] / distance.sqrt();
        }
        norm
    }
}

impl<const INPUTS: usize> Subproblem<INPUTS> {
    /// The objective at a solution less that at zero deviation, without defects.
    pub fn change(&self, solution: &Solution<INPUTS>) -> f64 {
        let mut change = 0.0;
        for ((stage, d), w) in self.stages.iter().zip(&solution.states).zip(&solution.inputs) {
            let square = |scale: f64| {
                let squares = (0..STATES)
                    .map(|i| (stage.error[i] + scale * self.state_weight[i] * d[i]).powi(2));
                squares.sum::<f64>()
            };
            let distance = |scale: f64| (square(scale) + self.knee * self.knee).sqrt();
            change += distance(1.0) - distance(0.0);
            for (w, gradient) in w.iter().zip(&stage.input_gradient) {
                change += w * (gradient + 0.5 * stage.input_curvature * w);
            }
            for row in &stage.rows {
                let slope: f64 = (0..STATES).map(|i| row.gradient[i] * d[i]).sum();
                change += self.row_penalty * ((row.excess + slope).max(0.0) - row.excess.max(0.0));
            }
        }
        change
    }

    /// Sum of a solution's defects of the linear dynamics.
    pub fn defect(&self, solution: &Solution<INPUTS>) -> f64 {
        let mut sum = 0.0;
        let mut before = &[0.0; STATES];
        for ((stage, d), w) in self.stages.iter().zip(&solution.states).zip(&solution.inputs) {
            let step = &stage.step;
            for i in 0..STATES {
                let by_state: f64 = step.state[i].iter().zip(before).map(|(a, d)| a * d).sum();
                let by_input: f64 = step.input[i].iter().zip(w).map(|(b, w)| b * w).sum();
                sum += (by_state + by_input + step.next[i] - d[i]).abs();
            }
            before = d;
        }
        sum
    }
}
