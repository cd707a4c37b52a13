//! Iterates of a search: states and inputs over the horizon, and what they miss.

use serde::{Deserialize, Serialize};

use super::discretisation::Dynamics;
use super::problem::{Problem, StateVector};

/// States and inputs over the horizon.
#[derive(Clone, Debug, PartialEq)]
pub struct Iterate<const INPUTS: usize> {
    /// `s_0 .. s_N`.
    pub states: Vec<StateVector>,
    /// `u_0 .. u_{N-1}`.
    pub inputs: Vec<[f64; INPUTS]>,
}

/// What an iterate misses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Violation {
    /// Largest defect of the dynamics in any state.
    pub defect: f64,
    /// Largest overrun of the state's bounds, summed over a state's bounds (m, rad, rad/s).
    pub overrun: f64,
    /// How far a position, of a state or between two, is at most where it must not be, m.
    #[serde(default)]
    pub trespass_m: f64,
}

impl<const INPUTS: usize> Iterate<INPUTS> {
    /// The desired states with one input throughout.
    pub fn desired(problem: &Problem<INPUTS>, input: [f64; INPUTS]) -> Self {
        let mut states = vec![problem.start];
        states.extend_from_slice(&problem.desired);
        Self { states, inputs: vec![input; problem.horizon()] }
    }

    /// The problem's cost of the plan.
    pub(super) fn cost(&self, problem: &Problem<INPUTS>) -> f64 {
        (0..self.inputs.len()).map(|n| problem.cost(n, &self.states[n + 1], &self.inputs[n])).sum()
    }

    /// Sum over the horizon and largest of what states overrun their bounds by.
    pub(super) fn overrun(&self, problem: &Problem<INPUTS>) -> (f64, f64) {
        let states = self.states.iter().skip(1).enumerate();
        let each = states.map(|(n, state)| problem.excess(n, state));
        each.fold((0.0, 0.0), |(sum, most), one| (sum + one, f64::max(most, one)))
    }

    /// What the iterate misses.
    pub(super) fn violation(&self, problem: &Problem<INPUTS>, defect: f64) -> Violation {
        let (_, overrun) = self.overrun(problem);
        let states = self.states.iter().skip(1).enumerate();
        let each = states.map(|(n, state)| problem.trespass(n, state));
        Violation { defect, overrun, trespass_m: each.fold(0.0, f64::max) }
    }

    /// Sum and largest of the defects' components.
    pub(super) fn defect(&self, dynamics: &impl Dynamics<INPUTS>) -> (f64, f64) {
        let (mut sum, mut most) = (0.0, 0.0_f64);
        for (pair, input) in self.states.windows(2).zip(&self.inputs) {
            let next = dynamics.step(&pair[0], input);
            for (next, state) in next.iter().zip(&pair[1]) {
                let defect = (next - state).abs();
                sum += defect;
                most = if defect.is_nan() { f64::NAN } else { most.max(defect) };
            }
        }
        (sum, most)
    }
}
