//! Nonlinear least squares with bounds: Levenberg-Marquardt, and the Huber loss.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Levenberg-Marquardt from `start`, with numeric derivatives over ten-thousandths of `scale`.
/// `residuals` clamps the parameters to their bounds and returns the residuals there, or `None` if
/// there are none.
pub(super) fn least_squares<const N: usize>(
    start: [f64; N],
    scale: &[f64; N],
    residuals: impl Fn(&[f64; N]) -> ([f64; N], Option<DVector<f64>>) + Sync,
) -> [f64; N] {
    let (mut best, Some(mut current)) = residuals(&start) else { return start };
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS_MAX {
        let columns: Option<Vec<DVector<f64>>> = (0..N)
            .into_par_iter()
            .map(|i| {
                let mut moved = best;
                moved[i] += 1e-4 * scale[i];
                let (moved, there) = residuals(&moved);
                let step = moved[i] - best[i];
                let column = (there? - &current) / if step == 0.0 { 1.0 } else { step };
                Some(column)
            })
            .collect();
        let Some(columns) = columns else { break };
        let jacobian = DMatrix::from_columns(&columns);
        let gram = jacobian.transpose() * &jacobian;
        let gradient = jacobian.transpose() * &current;
        let mut improved = false;
        for _ in 0..8 {
            let mut damped = gram.clone();
            for i in 0..N {
                // A parameter without effect, for example at a bound, stays unchanged.
                damped[(i, i)] = (damped[(i, i)] * (1.0 + damping)).max(f64::MIN_POSITIVE);
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else { break };
            let candidate = std::array::from_fn(|i| best[i] - step[i]);
            if let (candidate, Some(new)) = residuals(&candidate)
                && new.norm_squared() < current.norm_squared()
            {
                improved = new.norm_squared() < (1.0 - IMPROVEMENT_MIN) * current.norm_squared();
                (best, current) = (candidate, new);
                damping = (damping * 0.3).max(1e-9);
                break;
            }
            damping *= 4.0;
        }
        if !improved {
            break;
        }
    }
    best
}

/// Most iterations of Levenberg-Marquardt.
const ITERATIONS_MAX: usize = 25;
/// The iteration ends when a step lowers the sum of squares by a smaller fraction.
const IMPROVEMENT_MIN: f64 = 1e-4;

/// Residuals beyond this many deviations count linearly: a crash or a bump must not dominate.
const HUBER: f64 = 3.0;

/// The value whose square is the Huber loss of a residual.
pub(super) fn huber(residual: f64) -> f64 {
    let size = residual.abs();
    let root = if size > HUBER { (2.0 * HUBER * size - HUBER * HUBER).sqrt() } else { size };
    root.copysign(residual)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rosenbrock_valley_converges_to_its_minimum() {
        let found = least_squares([-1.2, 1.0], &[1.0, 1.0], |&[x, y]| {
            ([x, y], Some(DVector::from_vec(vec![10.0 * (y - x * x), 1.0 - x])))
        });
        assert!((found[0] - 1.0).abs() < 1e-3 && (found[1] - 1.0).abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn bounded_parameter_does_not_stop_the_others() {
        let found = least_squares([0.0, 0.0], &[1.0, 1.0], |&[x, y]| {
            let x = x.min(0.5);
            ([x, y], Some(DVector::from_vec(vec![x - 1.0, y - 2.0])))
        });
        assert!((found[0] - 0.5).abs() < 1e-6 && (found[1] - 2.0).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn huber_weight_limits_outlier_residuals() {
        assert_eq!(huber(2.0), 2.0);
        assert!(huber(-100.0) > -26.0 && huber(-100.0) < -24.0);
    }
}
