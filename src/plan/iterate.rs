//! Iterates of a search: states and inputs over the horizon, and their violations.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::discretisation::Dynamics;
use super::keep_out::{KeepOut, position};
use super::problem::{Problem, StateVector};

/// States and inputs over the horizon.
#[derive(Clone, Debug, PartialEq)]
pub struct Iterate<const INPUTS: usize> {
    /// `s_0 .. s_N`.
    pub states: Vec<StateVector>,
    /// `u_0 .. u_{N-1}`.
    pub inputs: Vec<[f64; INPUTS]>,
}

/// The violations of an iterate.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Violation {
    /// Largest defect of the dynamics in any component of a state.
    pub defect: f64,
    /// Largest overrun of a state, summed over its bounds (m, rad, rad/s).
    pub overrun: f64,
    /// Largest depth in forbidden space of a state after the start, or of the path between two
    /// states, both ends included, m.
    pub trespass_m: f64,
}

/// By how much the states of an iterate exceed their bounds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Overrun {
    /// Sum over the horizon (m, rad, rad/s).
    pub sum: f64,
    /// The largest of a state, summed over its bounds (m, rad, rad/s).
    pub most: f64,
    /// Largest depth in forbidden space of a position after the start, m.
    trespass_m: f64,
}

impl<const INPUTS: usize> Iterate<INPUTS> {
    /// The desired states with one constant input.
    pub fn desired(problem: &Problem<INPUTS>, input: [f64; INPUTS]) -> Self {
        let mut states = vec![problem.start];
        states.extend_from_slice(&problem.desired);
        Self { states, inputs: vec![input; problem.horizon()] }
    }

    /// The problem's cost of this iterate.
    pub(super) fn cost(&self, problem: &Problem<INPUTS>) -> f64 {
        (0..self.inputs.len()).map(|n| problem.cost(n, &self.states[n + 1], &self.inputs[n])).sum()
    }

    /// By how much the states exceed their bounds.
    pub(super) fn overrun(&self, problem: &Problem<INPUTS>) -> Overrun {
        let states = self.states.iter().skip(1).enumerate();
        let each = states.map(|(n, state)| problem.excess(n, state));
        each.fold(Overrun::default(), |all, one| Overrun {
            sum: all.sum + one.sum,
            most: all.most.max(one.sum),
            trespass_m: all.trespass_m.max(one.trespass_m),
        })
    }

    /// The violations, given the largest defect.
    pub(super) fn violation(&self, problem: &Problem<INPUTS>, defect: f64) -> Violation {
        let Overrun { most, trespass_m, .. } = self.overrun(problem);
        // The states' own bounds cover the steps after them; the step from the start is checked
        // here.
        let first = self.states.get(..2).unwrap_or_default();
        let margin_m = problem.margin_of_step(0);
        let entered =
            problem.keep_out.iter().map(|region| entry(first, &region.inflated(margin_m)));
        Violation { defect, overrun: most, trespass_m: entered.fold(trespass_m, f64::max) }
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

/// Largest depth of the path between states in a region, m.
pub(super) fn entry(states: &[StateVector], region: &KeepOut) -> f64 {
    let ways = states.windows(2);
    let depths = ways.map(|way| region.depth_between(position(&way[0]), position(&way[1])));
    depths.fold(0.0, f64::max)
}
