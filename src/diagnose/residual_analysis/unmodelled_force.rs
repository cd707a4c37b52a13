//! Residual force after the best explanation.
//!
//! Velocity and accelerometer measure the same force with independent noise. The mean product of
//! their residuals is the power of forces that no hypothesis has, without either noise.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::Frd;

use crate::diagnose::catalogue::candidate::Candidate;
use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::spectrum::{
    BANDS, CosineTransform, band, edges, frequency, mean_square_share,
};
use crate::diagnose::likelihood::channels::{FORCE, VELOCITY};
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::likelihood::residuals::{Evaluator, Groups};

/// Upper limit for comparing forces, Hz: above it, errors of rotors and delays appear.
pub(super) const FORCE_MAX_HZ: f64 = 4.5;
/// The noise that both sensors share is measured between that limit and this, Hz.
const NOISE_MAX_HZ: f64 = 11.5;
/// Shared noise may not be white: it may be this much stronger at low frequencies.
const SHARED_FACTOR: f64 = 3.0;
/// Lower limit for comparing forces, Hz: below it, the accelerometer's bias drifts.
pub(super) const FORCE_MIN_HZ: f64 = 0.1;

/// Residual force per mass on which velocity and accelerometer agree.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct UnmodelledForce {
    /// Mean square over 0.1 to 4.5 Hz, along north, east, down, m^2/s^4; negative only by chance.
    pub mean_square: [f64; 3],
    /// Standard error of the sum of the three, m^2/s^4.
    pub error: f64,
    /// Largest significance of the sum up to some band, in standard errors, where a slow force
    /// stands out.
    pub slow_significance: f64,
    /// The sum by band: from, to (Hz) and mean square [m^2/s^4].
    pub bands: Vec<[f64; 3]>,
}

impl UnmodelledForce {
    /// The sum over the axes, m^2/s^4.
    pub fn total(&self) -> f64 {
        self.mean_square.iter().sum()
    }

    /// Root mean square, m/s^2.
    pub fn rms(&self) -> f64 {
        self.total().max(0.0).sqrt()
    }

    /// Significance of the total, in standard errors.
    pub fn significance(&self) -> f64 {
        if self.error > 0.0 { self.total() / self.error } else { 0.0 }
    }
}

/// Residual force of `candidate`; `None` where the logs lack accelerometer or velocity.
pub fn unmodelled_force(
    observed: &Observed<'_>,
    evaluator: &Evaluator,
    candidate: &Candidate,
) -> Option<UnmodelledForce> {
    let blocks = observed.blocks(|_, layout| layout.has(VELOCITY) && layout.has(FORCE));
    if blocks.is_empty() {
        return None;
    }
    let transform = CosineTransform::default();
    let of_blocks: Vec<CrossPowers> = blocks
        .par_iter()
        .map(|(flight, layout, block)| {
            let series =
                evaluator.block(flight, layout, block).series(candidate, Groups::ALL).residuals;
            let [velocity, force] =
                [VELOCITY, FORCE].map(|first| [0, 1, 2].map(|axis| &series[first + axis]));
            let force = in_world(flight, block, candidate, force);
            let limit = layout.limit_hz(VELOCITY).min(layout.limit_hz(FORCE));
            CrossPowers::of(&transform, velocity.map(Vec::clone), force, limit)
        })
        .collect();
    Some(CrossPowers::sum(&of_blocks).force())
}

/// Residual of the accelerometer under the candidate, less its mean, rotated to world axes.
fn in_world(
    flight: &PreparedFlight,
    block: &Block,
    candidate: &Candidate,
    force: [&Vec<f64>; 3],
) -> [Vec<f64>; 3] {
    let n = block.cells;
    let mean = force.map(|axis| axis.iter().sum::<f64>() / n as f64);
    let mut world = [(); 3].map(|()| Vec::with_capacity(n));
    let mut attitude = flight.attitude.cursor();
    for k in 0..n {
        let force = Frd::from(std::array::from_fn(|i| force[i][k] - mean[i]));
        let seen = block.middle(k) + candidate.latency;
        let turned = attitude.attitude_at(seen).to_world(force).to_array();
        world.iter_mut().zip(turned).for_each(|(axis, value)| axis.push(value));
    }
    world
}

/// Sums over the coefficients of two sensors' residuals, for one axis in one band.
#[derive(Clone, Copy, Debug, Default)]
struct CrossPower {
    /// Sum of their products.
    product: f64,
    /// Sum of the squares of each.
    squares: [f64; 2],
    /// Number of coefficients.
    count: f64,
}

impl CrossPower {
    /// Of one coefficient of each sensor.
    fn of(a: f64, b: f64) -> Self {
        Self { product: a * b, squares: [a * a, b * b], count: 1.0 }
    }

    fn add(&mut self, other: &Self) {
        self.product += other.product;
        self.squares[0] += other.squares[0];
        self.squares[1] += other.squares[1];
        self.count += other.count;
    }
}

/// Powers by axis.
#[derive(Clone, Debug, Default)]
struct CrossPowers {
    /// By band, up to the frequency that the samples resolve.
    bands: [[CrossPower; 3]; BANDS.len()],
    /// Of the accelerometer with itself, above the forces' bands.
    accelerometer: [CrossPower; 3],
}

impl CrossPowers {
    /// Sums over one block, where the samples resolve forces up to `limit`, Hz.
    fn of(
        transform: &CosineTransform,
        mut velocity: [Vec<f64>; 3],
        mut force: [Vec<f64>; 3],
        limit: f64,
    ) -> Self {
        let mut sums = Self::default();
        for (axis, (v, f)) in velocity.iter_mut().zip(&mut force).enumerate() {
            transform.apply(&mut [v, f]);
            for (k, (a, b)) in v.iter().zip(&*f).enumerate() {
                let frequency = frequency(k, v.len());
                let is_used = (FORCE_MIN_HZ..NOISE_MAX_HZ).contains(&frequency);
                let Some(band) = band(frequency).filter(|_| is_used) else { continue };
                if frequency >= FORCE_MAX_HZ {
                    sums.accelerometer[axis].add(&CrossPower::of(*b, *b));
                }
                if frequency < limit {
                    sums.bands[band][axis].add(&CrossPower::of(*a, *b));
                }
            }
        }
        sums
    }

    fn sum(all: &[Self]) -> Self {
        let mut total = Self::default();
        for sums in all {
            let bands = total.bands.iter_mut().flatten().zip(sums.bands.iter().flatten());
            let own = total.accelerometer.iter_mut().zip(&sums.accelerometer);
            bands.chain(own).for_each(|(total, sum)| total.add(sum));
        }
        total
    }

    /// The force that both sensors agree on.
    fn force(&self) -> UnmodelledForce {
        let mut force = UnmodelledForce {
            mean_square: [0.0; 3],
            error: 0.0,
            slow_significance: 0.0,
            bands: Vec::new(),
        };
        let mut variance: f64 = 0.0;
        for (band, axes) in self.bands.iter().enumerate() {
            let [lower, upper] = edges(band);
            if lower >= FORCE_MAX_HZ {
                break;
            }
            let mut in_band = 0.0;
            for (axis, CrossPower { product, squares: [left, right], count }) in
                axes.iter().enumerate()
            {
                if *count < 1.0 {
                    continue;
                }
                let share = mean_square_share(band) / count;
                let noise = SHARED_FACTOR * count * self.shared_noise(axis);
                let power = (product - noise) * share;
                force.mean_square[axis] += power;
                in_band += power;
                variance += share * share * left * right / count;
            }
            if axes[0].count > 0.0 {
                force.bands.push([lower, upper, in_band]);
                let significance = force.total() / variance.sqrt().max(f64::MIN_POSITIVE);
                force.slow_significance = force.slow_significance.max(significance);
            }
        }
        force.error = variance.sqrt();
        force
    }

    /// Product of both per coefficient above the forces' bands: an estimator that integrates the
    /// accelerometer puts its white noise into the velocity too. Where the velocity's samples do not
    /// resolve these bands, it may contain all of that noise.
    fn shared_noise(&self, axis: usize) -> f64 {
        let mut above = CrossPower::default();
        for (band, axes) in self.bands.iter().enumerate() {
            if edges(band)[0] >= FORCE_MAX_HZ {
                above.add(&axes[axis]);
            }
        }
        if above.count == 0.0 {
            above = self.accelerometer[axis];
        }
        if above.count > 0.0 { (above.product / above.count).max(0.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::flights::normal_draws::standard_normals;
    use crate::diagnose::flights::spectrum::CELL_S;
    use rand::SeedableRng;
    use rand_pcg::Pcg64Mcg;

    /// The force of two sensors that share white noise and a force of `swing` m/s^2 at 0.6 Hz, where
    /// samples resolve up to `limit`, Hz.
    fn force(swing: f64, limit: f64) -> UnmodelledForce {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let shared: [Vec<f64>; 3] = std::array::from_fn(|_| {
            let sample = |k: usize| {
                let phase = std::f64::consts::TAU * 0.6 * k as f64 * CELL_S;
                0.2 * standard_normals::<1>(&mut rng)[0] + swing * phase.sin()
            };
            (0..1024).map(sample).collect()
        });
        CrossPowers::of(&CosineTransform::default(), shared.clone(), shared, limit).force()
    }

    #[test]
    fn shared_noise_is_no_force_however_slow_the_samples() {
        for limit in [30.0, 3.0] {
            let [still, swinging] = [0.0, 1.0].map(|swing| force(swing, limit));
            assert!(still.significance() < 3.0, "{limit}: {still:?}");
            assert!(swinging.significance() > 6.0, "{limit}: {swinging:?}");
            let top = still.bands.last().expect("bands")[0];
            assert!(top < limit.min(FORCE_MAX_HZ), "{limit}: {top}");
        }
    }
}
