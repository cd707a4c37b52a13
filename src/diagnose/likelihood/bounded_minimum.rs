//! The minimum of a convex quadratic within limits, and the factor of its matrix.

use nalgebra::{DMatrix, DVector};

/// The descent ends where one more step would lower the cost by less, nats.
const DESCENT_MIN: f64 = 1e-9;

/// The minimum within limits of x' N x / 2 + g' x, `normal` being N and `gradient` g.
///
/// An active-set method. From the feasible point `start` it steps to the minimum over the free
/// numbers, or to the first limit on the way, where that number becomes fixed. At a minimum it frees
/// the fixed number whose release lowers the cost most. No step raises the cost, which the
/// reweighting of `linearised` relies on. `None` for a matrix that is not
/// positive definite.
pub(super) fn bounded_minimum(
    normal: &DMatrix<f64>,
    gradient: &DVector<f64>,
    limits: &[[f64; 2]],
    start: &DVector<f64>,
) -> Option<DVector<f64>> {
    let n = gradient.len();
    let mut at = start.clone();
    let mut fixed: Vec<bool> =
        (0..n).map(|i| at[i] <= limits[i][0] || at[i] >= limits[i][1]).collect();
    // Each number is fixed or freed a few times at most.
    for _ in 0..8 * n + 8 {
        let slope = gradient + normal * &at;
        let free: Vec<usize> = (0..n).filter(|i| !fixed[*i]).collect();
        if !free.is_empty() {
            let matrix =
                DMatrix::from_fn(free.len(), free.len(), |a, b| normal[(free[a], free[b])]);
            let right = DVector::from_fn(free.len(), |a, _| -slope[free[a]]);
            let step = scaled_cholesky(&matrix)?.solve(&right);
            let reach = |(a, i): (usize, &usize)| {
                let limit = limits[*i][usize::from(step[a] > 0.0)];
                let share = (limit - at[*i]) / step[a];
                (share < 1.0).then_some((share.max(0.0), *i, limit))
            };
            let blocked = free.iter().enumerate().filter_map(reach);
            let first = blocked.min_by(|a, b| a.0.total_cmp(&b.0));
            let share = first.map_or(1.0, |(share, ..)| share);
            free.iter().enumerate().for_each(|(a, i)| at[*i] += share * step[a]);
            if let Some((_, i, limit)) = first {
                (at[i], fixed[i]) = (limit, true);
                continue;
            }
        }
        let slope = gradient + normal * &at;
        let descent = |i: usize| {
            let [low, high] = limits[i];
            let inwards = (slope[i] < 0.0 && at[i] < high) || (slope[i] > 0.0 && at[i] > low);
            if inwards { slope[i].powi(2) / normal[(i, i)] } else { 0.0 }
        };
        let releasable = (0..n).filter(|i| fixed[*i]).map(|i| (i, descent(i)));
        match releasable.max_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((i, gain)) if gain > DESCENT_MIN => fixed[i] = false,
            _ => return Some(at),
        }
    }
    Some(at)
}

/// A Cholesky factor of a matrix scaled to a unit diagonal.
pub(super) struct ScaledCholesky {
    factor: nalgebra::Cholesky<f64, nalgebra::Dyn>,
    scale: DVector<f64>,
}

/// The factor of a symmetric matrix; `None` if it is not positive definite.
pub(super) fn scaled_cholesky(matrix: &DMatrix<f64>) -> Option<ScaledCholesky> {
    let scale = matrix.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
    let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] * scale[i] * scale[j] + if i == j { 1e-12 } else { 0.0 }
    });
    Some(ScaledCholesky { factor: scaled.cholesky()?, scale })
}

impl ScaledCholesky {
    /// x of `matrix x = right`.
    pub fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        self.factor.solve(&right.component_mul(&self.scale)).component_mul(&self.scale)
    }

    /// The inverse of the matrix.
    pub fn inverse(&self) -> DMatrix<f64> {
        let inverse = self.factor.inverse();
        DMatrix::from_fn(inverse.nrows(), inverse.ncols(), |i, j| {
            inverse[(i, j)] * self.scale[i] * self.scale[j]
        })
    }

    /// The natural logarithm of the matrix' determinant.
    pub fn log_determinant(&self) -> f64 {
        let l = self.factor.l_dirty();
        (0..self.scale.len()).map(|i| 2.0 * (l[(i, i)].ln() - self.scale[i].ln())).sum()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn cost(normal: &DMatrix<f64>, gradient: &DVector<f64>, at: &DVector<f64>) -> f64 {
        0.5 * at.dot(&(normal * at)) + gradient.dot(at)
    }

    proptest! {
        #[test]
        fn no_single_number_improves_the_bounded_minimum(
            entries in prop::collection::vec(-1.0_f64..1.0, 36),
            slopes in prop::collection::vec(-5.0_f64..5.0, 6),
            lows in prop::collection::vec(-1.0_f64..0.0, 6),
            highs in prop::collection::vec(0.0_f64..1.0, 6),
            share in prop::collection::vec(0.0_f64..1.0, 6),
        ) {
            let root = DMatrix::from_vec(6, 6, entries);
            let normal = root.transpose() * &root + DMatrix::identity(6, 6) * 1e-3;
            let gradient = DVector::from_vec(slopes);
            let limits: Vec<[f64; 2]> = lows.into_iter().zip(highs).map(|(a, b)| [a, b]).collect();
            let start = DVector::from_fn(6, |i, _| {
                limits[i][0] + share[i] * (limits[i][1] - limits[i][0])
            });
            let least = bounded_minimum(&normal, &gradient, &limits, &start).expect("a minimum");
            let at_least = cost(&normal, &gradient, &least);
            prop_assert!(at_least <= cost(&normal, &gradient, &start) + 1e-9);
            // The cost is convex: where no single number leads down, nothing does.
            for i in 0..6 {
                for to in limits[i] {
                    for share in [1e-3, 0.1, 1.0] {
                        let mut moved = least.clone();
                        moved[i] += share * (to - least[i]);
                        prop_assert!(cost(&normal, &gradient, &moved) >= at_least - 1e-7);
                    }
                }
            }
        }
    }
}
