//! Draws from the standard normal distribution.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;

/// Median of a squared standard normal number.
pub(in crate::diagnose) const CHI_SQUARED_MEDIAN: f64 = 0.455;

/// Draws of the standard normal distribution.
pub(in crate::diagnose) fn standard_normals<const N: usize>(rng: &mut Pcg64Mcg) -> [f64; N] {
    std::array::from_fn(|_| StandardNormal.sample(rng))
}
