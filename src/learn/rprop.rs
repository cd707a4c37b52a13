//! Resilient backpropagation (Riedmiller and Braun 1993), improved and without weight backtracking:
//! where a derivative changes its sign, the step shrinks and is skipped, and the next step keeps
//! its size (iRprop-, Igel and Huesken 2000).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Initial step of every parameter.
const FIRST_STEP: f32 = 1e-2;
/// Growth factor of a step while the derivative keeps its sign.
const GROWTH: f32 = 1.2;
/// Factor on a step when the derivative changes its sign.
const SHRINKAGE: f32 = 0.5;
/// Bounds of a step.
const STEPS: std::ops::RangeInclusive<f32> = 1e-6..=50.0;

/// The optimiser's state: the gradient determines only the direction, each parameter has its own
/// step size.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub(super) struct Rprop {
    steps: Vec<f32>,
    /// The last gradient; 0 where its sign changed, so that the next step keeps its size.
    last: Vec<f32>,
}

impl Rprop {
    pub fn new(parameters: usize) -> Self {
        Self { steps: vec![FIRST_STEP; parameters], last: vec![0.0; parameters] }
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.steps.len().min(self.last.len())
    }

    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f64]) {
        let memory = self.steps.iter_mut().zip(&mut self.last);
        for ((parameter, &derivative), (step, last)) in
            parameters.iter_mut().zip(gradient).zip(memory)
        {
            let derivative = derivative as f32;
            let turned = derivative.signum() * last.signum();
            let known = derivative != 0.0 && *last != 0.0;
            if known && turned < 0.0 {
                *step = (*step * SHRINKAGE).max(*STEPS.start());
                *last = 0.0;
                continue;
            }
            if known {
                *step = (*step * GROWTH).min(*STEPS.end());
            }
            if derivative != 0.0 {
                *parameter -= step.copysign(derivative);
            }
            *last = derivative;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rprop_step_grows_shrinks_and_pauses() {
        let mut rprop = Rprop::new(1);
        let mut parameter = [0.0];
        rprop.step(&mut parameter, &[-1.0]);
        assert_eq!(parameter, [FIRST_STEP]);
        rprop.step(&mut parameter, &[-1e-3]);
        assert_eq!(parameter, [FIRST_STEP + FIRST_STEP * GROWTH]);
        let before = parameter;
        rprop.step(&mut parameter, &[1.0]);
        assert_eq!(parameter, before, "no step after a sign change");
        rprop.step(&mut parameter, &[1.0]);
        assert_eq!(parameter, [before[0] - FIRST_STEP * GROWTH * SHRINKAGE]);
    }

    #[test]
    fn rprop_minimises_a_badly_scaled_quadratic() {
        let mut rprop = Rprop::new(2);
        let mut at = [3.0_f32, -2.0];
        for _ in 0..200 {
            let gradient = [1e4 * f64::from(at[0]), 1e-4 * f64::from(at[1])];
            rprop.step(&mut at, &gradient);
        }
        assert!(at.iter().all(|value| value.abs() < 1e-4), "{at:?}");
    }
}
