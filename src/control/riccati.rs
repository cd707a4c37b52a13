//! The discrete-time algebraic Riccati equation, solved by structure-preserving doubling.

use nalgebra::SMatrix;

/// The stabilising solution of a discrete-time Riccati equation.
#[derive(Clone, Copy, Debug)]
pub struct RiccatiSolution<const N: usize, const M: usize> {
    /// Cost to go `P`: the least cost from state `s` is `s' P s`.
    pub cost: SMatrix<f64, N, N>,
    /// `K = (R + B' P B)^-1 B' P A`, as SciPy and MATLAB return it: the optimal input is `-K s`.
    pub gain: SMatrix<f64, M, N>,
    /// Largest modulus of the eigenvalues of `A - B K`, below 1.
    pub spectral_radius: f64,
    /// Frobenius norm of the equation's residual at `cost`, relative to `cost`.
    pub residual: f64,
    /// Number of doublings.
    pub iterations: usize,
}

/// Why a Riccati equation has no usable solution.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RiccatiError {
    /// An entry of A, B, Q or R is NaN or infinite.
    #[error("the Riccati equation's {matrix} has an entry that is not finite")]
    NonFinite {
        /// Which matrix.
        matrix: &'static str,
    },
    /// R is not positive definite.
    #[error("the input weight R is not positive definite; every input needs a positive weight")]
    InputWeight,
    /// No gain brings every eigenvalue inside the unit circle, or the state weight does not see an
    /// unstable mode.
    #[error(
        "no stabilising gain exists (spectral radius {spectral_radius:.6}): the model is not \
         stabilisable through its inputs, or Q leaves an unstable mode without weight"
    )]
    NotStabilisable {
        /// Of the best closed loop found; infinite if none was found.
        spectral_radius: f64,
    },
    /// The doubling did not converge.
    #[error("the Riccati equation did not converge: relative residual {residual:.1e}")]
    NotConverged {
        /// Relative residual at the end.
        residual: f64,
    },
}

/// Each doubling squares the convergence, so a mode of modulus 1 - 1e-12 needs about 45.
const DOUBLINGS_MAX: usize = 60;
/// Largest relative residual that counts as solved.
const RESIDUAL_MAX: f64 = 1e-8;
/// Squarings in the spectral radius: its relative error is about ln(condition) / 2^SQUARINGS.
const SQUARINGS: i32 = 48;

/// Solves `P = A' P A - A' P B (R + B' P B)^-1 B' P A + Q` for the stabilising `P`.
///
/// Structure-preserving doubling (Chu, Fan, Lin and Wang, "Structure-preserving algorithms for
/// periodic discrete-time algebraic Riccati equations", Int. J. Control 77, 2004): with
/// `W = I + G H`, from `A, G = B R^-1 B', H = Q`, `A <- A W^-1 A`, `G <- G + A W^-1 G A'`,
/// `H <- H + A' H W^-1 A`. `H` converges to `P` quadratically: each step equals twice as many steps
/// of the Riccati recursion as the one before.
///
/// # Errors
/// [`RiccatiError`]; a solution is returned only if its closed loop is stable.
pub fn solve_dare<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    q: &SMatrix<f64, N, N>,
    r: &SMatrix<f64, M, M>,
) -> Result<RiccatiSolution<N, M>, RiccatiError> {
    let inputs =
        [("A", a.as_slice()), ("B", b.as_slice()), ("Q", q.as_slice()), ("R", r.as_slice())];
    if let Some((matrix, _)) = inputs.iter().find(|(_, m)| m.iter().any(|x| !x.is_finite())) {
        return Err(RiccatiError::NonFinite { matrix });
    }
    let unsolvable = RiccatiError::NotStabilisable { spectral_radius: f64::INFINITY };
    let r_inverse = r.cholesky().ok_or(RiccatiError::InputWeight)?.inverse();
    let identity = SMatrix::<f64, N, N>::identity();
    let (mut a_k, mut g, mut h) = (*a, b * r_inverse * b.transpose(), *q);
    let mut iterations = 0;
    for _ in 0..DOUBLINGS_MAX {
        let w_inverse = (identity + g * h).try_inverse().ok_or(unsolvable)?;
        let a_w = a_k * w_inverse;
        let step = a_k.transpose() * h * w_inverse * a_k;
        g = symmetric(&(g + a_w * g * a_k.transpose()));
        h = symmetric(&(h + step));
        a_k = a_w * a_k;
        iterations += 1;
        let (change, size) = (step.norm(), h.norm());
        if !size.is_finite() {
            return Err(unsolvable);
        }
        if change <= f64::EPSILON * size {
            break;
        }
    }
    let pb = h * b;
    let weight = r + b.transpose() * pb;
    let gain = weight.cholesky().ok_or(unsolvable)?.solve(&(pb.transpose() * a));
    let closed_loop = a - b * gain;
    let remainder = a.transpose() * h * closed_loop + q - h;
    let residual = remainder.norm() / h.norm().max(f64::MIN_POSITIVE);
    let spectral_radius = spectral_radius(&closed_loop);
    if spectral_radius.is_nan() || spectral_radius >= 1.0 {
        Err(RiccatiError::NotStabilisable { spectral_radius })
    } else if residual.is_nan() || residual > RESIDUAL_MAX {
        Err(RiccatiError::NotConverged { residual })
    } else {
        Ok(RiccatiSolution { cost: h, gain, spectral_radius, residual, iterations })
    }
}

/// Rounding makes a symmetric product slightly unsymmetric, and doubling would amplify that.
fn symmetric<const N: usize>(m: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (m + m.transpose()) * 0.5
}

/// Largest modulus of the eigenvalues of `m`, by Gelfand's formula: the limit of `norm(m^k)^(1/k)`,
/// with k = 2^48 by repeated squaring. Unlike an eigenvalue iteration, this cannot fail to
/// converge.
pub(super) fn spectral_radius<const N: usize>(m: &SMatrix<f64, N, N>) -> f64 {
    let (mut power, mut logarithm) = (*m, 0.0);
    for k in 0..SQUARINGS {
        let norm = power.norm();
        if norm == 0.0 {
            return 0.0;
        }
        logarithm += norm.ln() * 0.5f64.powi(k);
        power /= norm;
        power *= power;
    }
    logarithm.exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix2, Matrix3, Vector2};
    use proptest::prelude::*;

    #[test]
    fn spectral_radius_is_the_largest_modulus() {
        let rotation = Matrix2::new(0.6, -0.7, 0.7, 0.6);
        assert!((spectral_radius(&rotation) - 0.85f64.sqrt()).abs() < 1e-12);
        let defective = Matrix3::new(0.9, 1.0, 0.0, 0.0, 0.9, 1.0, 0.0, 0.0, 0.9);
        assert!((spectral_radius(&defective) - 0.9).abs() < 1e-9);
        assert_eq!(spectral_radius(&Matrix2::new(0.0, 1.0, 0.0, 0.0)), 0.0);
    }

    /// The Riccati recursion in single steps; doubling runs 2^k of them at a time.
    #[test]
    fn double_integrator_agrees_with_value_iteration() {
        let (a, b) = (Matrix2::new(1.0, 0.1, 0.0, 1.0), Vector2::new(0.005, 0.1));
        let (q, r) = (Matrix2::from_diagonal(&Vector2::new(1.0, 0.1)), Matrix1::new(0.5));
        let solution = solve_dare(&a, &b, &q, &r).expect("a solution");
        let mut p = q;
        for _ in 0..20_000 {
            let gain = (b.transpose() * p * a) / (r + b.transpose() * p * b)[0];
            p = a.transpose() * p * (a - b * gain) + q;
        }
        assert!((solution.cost - p).norm() / p.norm() < 1e-11);
        assert!(solution.residual < 1e-13 && solution.iterations < 15);
    }

    #[test]
    fn unstabilisable_pair_is_refused() {
        let one = Matrix1::new(1.0);
        for a in [1.0, 1.5, -2.0] {
            let refused = solve_dare(&Matrix1::new(a), &Matrix1::new(0.0), &one, &one);
            assert!(matches!(refused, Err(RiccatiError::NotStabilisable { .. })), "{refused:?}");
        }
        let hidden = Matrix2::from_diagonal(&Vector2::new(2.0, 0.5));
        let refused = solve_dare(&hidden, &Vector2::new(0.0, 1.0), &Matrix2::identity(), &one);
        assert!(matches!(refused, Err(RiccatiError::NotStabilisable { .. })));
    }

    #[test]
    fn invalid_weights_and_nan_are_named() {
        let one = Matrix1::new(1.0);
        assert_eq!(
            solve_dare(&one, &one, &one, &Matrix1::new(0.0)).err(),
            Some(RiccatiError::InputWeight)
        );
        assert_eq!(
            solve_dare(&one, &Matrix1::new(f64::NAN), &one, &one).err(),
            Some(RiccatiError::NonFinite { matrix: "B" })
        );
    }

    proptest! {
        /// Scalar: b^2 p^2 + (r - a^2 r - q b^2) p - q r = 0, the positive root.
        #[test]
        fn scalar_equation_agrees_with_its_closed_form(a in -3.0..3.0f64, b in 0.1..3.0f64, q in 0.01..10.0f64, r in 0.01..10.0f64) {
            let solution = solve_dare(&Matrix1::new(a), &Matrix1::new(b), &Matrix1::new(q), &Matrix1::new(r));
            let solution = solution.expect("stabilisable");
            let half = 0.5 * (r - a * a * r - q * b * b) / (b * b);
            let p = -half + (half * half + q * r / (b * b)).sqrt();
            prop_assert!((solution.cost[0] - p).abs() < 1e-9 * p);
            let k = a * b * p / (r + b * b * p);
            prop_assert!((solution.gain[0] - k).abs() < 1e-9 * (1.0 + k.abs()));
            prop_assert!((solution.spectral_radius - (a - b * k).abs()).abs() < 1e-9);
        }
    }
}
