//! The optimal gain on the measured states of a model that has further states.

use nalgebra::{Complex, ComplexField, DMatrix, DVector, SMatrix};

/// A linear model, a quadratic cost, and the covariance of the initial errors. The measured states
/// come first.
pub(super) struct OutputFeedback<const X: usize, const M: usize> {
    /// `A`.
    pub state: SMatrix<f64, X, X>,
    /// `B`.
    pub input: SMatrix<f64, X, M>,
    /// `Q`.
    pub state_weight: SMatrix<f64, X, X>,
    /// `R`.
    pub input_weight: SMatrix<f64, M, M>,
    /// Covariance of the initial state: the errors over which the cost is averaged. With every
    /// state measured, the optimal gain does not depend on it.
    pub errors: SMatrix<f64, X, X>,
}

/// Each doubling squares the closed loop's decay.
const DOUBLINGS_MAX: usize = 32;
/// Norm of the power at which a sum counts as complete, and at which it counts as divergent.
const DECAYED: f64 = 1e-9;
const DIVERGED: f64 = 1e12;
const STEPS_MAX: usize = 60;
/// Relative gain in cost below which a step is the last.
const GAIN_MIN: f64 = 1e-6;
/// Smallest fraction of a step that is tried.
const PART_MIN: f64 = 1e-3;
/// Lowest frequency at which the margin is computed, rad per sample, and the number of steps from
/// it to half the sampling rate: the range in which a vehicle moves.
const MARGIN_FROM: f64 = 2e-3;
const MARGIN_STEPS: usize = 60;

/// The loop under one gain.
struct Evaluation<const X: usize> {
    closed_loop: SMatrix<f64, X, X>,
    /// Cost to go.
    cost_to_go: SMatrix<f64, X, X>,
    cost: f64,
}

impl<const X: usize, const M: usize> OutputFeedback<X, M> {
    /// Improves `gain` of `u = gain y`, `y` the first `N` states, until the cost
    /// `sum x' Q x + u' R u`, expected over the errors at the start, is at a minimum
    /// (Moerder and Calise, "Convergence of a numerical algorithm for calculating optimal output
    /// feedback gains", IEEE TAC 30, 1985). `None` if `gain` does not settle the loop.
    pub fn improve<const N: usize>(
        &self,
        mut gain: SMatrix<f64, M, N>,
    ) -> Option<SMatrix<f64, M, N>> {
        let mut now = self.evaluate(&gain)?;
        for _ in 0..STEPS_MAX {
            let Some(step) = self.step(&gain, &now) else { break };
            let mut part = 1.0;
            let better = loop {
                let candidate = gain + step * part;
                match self.evaluate(&candidate) {
                    Some(next) if next.cost < now.cost => break Some((candidate, next)),
                    _ if part < PART_MIN => break None,
                    _ => part *= 0.5,
                }
            };
            let Some((candidate, next)) = better else { break };
            let is_last = now.cost - next.cost < GAIN_MIN * now.cost;
            (gain, now) = (candidate, next);
            if is_last {
                break;
            }
        }
        Some(gain)
    }

    /// The least distance of the loop under `gain`, opened at input `at`, from -1 over all
    /// frequencies: the reciprocal of the largest sensitivity. The loop tolerates gain factors from
    /// `1 / (1 + margin)` to `1 / (1 - margin)`.
    pub fn margin<const N: usize>(&self, gain: &SMatrix<f64, M, N>, at: usize) -> f64 {
        let mut rest = *gain;
        rest.row_mut(at).fill(0.0);
        let mut others_closed = self.state;
        let mut columns = others_closed.fixed_view_mut::<X, N>(0, 0);
        columns += self.input * rest;
        let entry = |row, column| Complex::from(-others_closed[(row, column)]);
        let negative = DMatrix::from_fn(X, X, entry);
        let input = DVector::from_fn(X, |row, _| Complex::from(self.input[(row, at)]));
        let span = (std::f64::consts::PI / MARGIN_FROM).ln();
        (0..=MARGIN_STEPS)
            .filter_map(|step| {
                let turn = MARGIN_FROM * (span * step as f64 / MARGIN_STEPS as f64).exp();
                let mut shifted = negative.clone();
                for i in 0..X {
                    shifted[(i, i)] += Complex::from_polar(1.0, turn);
                }
                let answer = shifted.lu().solve(&input)?;
                let fed_back: Complex<f64> = (0..N).map(|i| answer[i] * gain[(at, i)]).sum();
                Some((Complex::from(1.0) - fed_back).modulus())
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// The step to the gain that would be optimal if cost to go and covariance stayed fixed.
    fn step<const N: usize>(
        &self,
        gain: &SMatrix<f64, M, N>,
        now: &Evaluation<X>,
    ) -> Option<SMatrix<f64, M, N>> {
        let covariance = summed(&now.closed_loop.transpose(), &self.errors)?;
        let pb = now.cost_to_go * self.input;
        let weight = (self.input_weight + self.input.transpose() * pb).cholesky()?;
        let measured = covariance.fixed_view::<N, N>(0, 0).into_owned().cholesky()?;
        let seen = covariance.fixed_view::<X, N>(0, 0);
        let projected = weight.solve(&(pb.transpose() * self.state * seen));
        Some(-measured.solve(&projected.transpose()).transpose() - gain)
    }

    fn evaluate<const N: usize>(&self, gain: &SMatrix<f64, M, N>) -> Option<Evaluation<X>> {
        let mut closed_loop = self.state;
        let mut columns = closed_loop.fixed_view_mut::<X, N>(0, 0);
        columns += self.input * gain;
        let mut weight = self.state_weight;
        let mut corner = weight.fixed_view_mut::<N, N>(0, 0);
        corner += gain.transpose() * self.input_weight * gain;
        let cost_to_go = summed(&closed_loop, &weight)?;
        let cost = (cost_to_go * self.errors).trace();
        cost.is_finite().then_some(Evaluation { closed_loop, cost_to_go, cost })
    }
}

/// `sum over k of (A')^k W A^k`, by doubling; `None` unless `A` decays.
fn summed<const X: usize>(
    a: &SMatrix<f64, X, X>,
    w: &SMatrix<f64, X, X>,
) -> Option<SMatrix<f64, X, X>> {
    let (mut power, mut sum) = (*a, *w);
    for _ in 0..DOUBLINGS_MAX {
        sum += power.transpose() * sum * power;
        sum = (sum + sum.transpose()) * 0.5;
        power *= power;
        let left = power.norm();
        if left < DECAYED {
            return Some(sum);
        }
        if left.is_nan() || left > DIVERGED {
            return None;
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::solve_dare;
    use nalgebra::{Matrix1, Matrix1x2, Matrix2, Matrix2x1};

    /// A double integrator at 10 Hz.
    fn problem() -> OutputFeedback<2, 1> {
        OutputFeedback {
            state: Matrix2::new(1.0, 0.1, 0.0, 1.0),
            input: Matrix2x1::new(0.005, 0.1),
            state_weight: Matrix2::new(4.0, 0.0, 0.0, 1.0),
            input_weight: Matrix1::new(0.5),
            errors: Matrix2::new(1.0, 0.2, 0.2, 3.0),
        }
    }

    #[test]
    fn full_state_output_feedback_recovers_the_lqr_gain() {
        let problem = problem();
        let OutputFeedback { state, input, state_weight, input_weight, .. } = problem;
        let best = solve_dare(&state, &input, &state_weight, &input_weight).expect("a gain").gain;
        let found = problem.improve(Matrix1x2::new(-0.5, -1.5)).expect("a gain");
        assert!((found + best).norm() < 1e-2 * best.norm(), "{found} for {best}");
        let kept = problem.improve(-best).expect("a gain");
        assert!((kept + best).norm() < 1e-6 * best.norm());
    }

    #[test]
    fn destabilising_initial_gain_is_refused() {
        assert!(problem().improve(Matrix1x2::new(0.5, 0.0)).is_none());
    }

    #[test]
    fn integrator_margin_matches_its_peak_sensitivity() {
        let (one, gain) = (Matrix1::new(1.0), 0.5);
        let integrator = OutputFeedback {
            state: one,
            input: one,
            state_weight: one,
            input_weight: one,
            errors: one,
        };
        // L = k / (z - 1) comes nearest to -1 at z = -1: |1 + L| = 1 - k/2.
        let margin = integrator.margin(&Matrix1::new(-gain), 0);
        assert!((margin - (1.0 - gain / 2.0)).abs() < 1e-9, "{margin}");
        let strong = integrator.margin(&Matrix1::new(-2.0 * gain), 0);
        assert!((strong - (1.0 - gain)).abs() < 1e-9, "{strong}");
    }

    #[test]
    fn scalar_lyapunov_sum_is_the_geometric_series() {
        let sum = summed(&Matrix1::new(0.9), &Matrix1::new(2.0)).expect("it decays");
        assert!((sum[0] - 2.0 / (1.0 - 0.81)).abs() < 1e-9);
        assert!(summed(&Matrix1::new(1.0), &Matrix1::new(2.0)).is_none());
    }
}
