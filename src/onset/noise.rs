//! The spectrum of an equation's residual as an autoregression: the part of a cell that the earlier
//! cells predict, and the variance of the rest.

use super::cells::EQUATIONS;

/// Order of the prediction, in cells: velocity noise and slow model errors are correlated over
/// several tenths of a second.
pub const ORDER: usize = 12;
/// Memory of the spectrum: about the last minute, s.
const MEMORY_S: f64 = 60.0;
/// Values beyond this many standard deviations are clipped.
const CLIP: f64 = 4.0;
/// Fraction of the power that is taken as white, against a spectrum with holes.
const WHITE: f64 = 1e-3;

/// Correlation length of a law's error: the duration of a motion, in cells.
pub(super) const COHERENT: usize = 10;
/// Prior relative error of forces and moments: a vehicle file states moments less accurately. And
/// the weight of this prior, in stretches of motion.
const SHARE: [f64; 3] = [0.03, 0.03, 0.1];
const STRETCHES: f64 = 6.0;
/// Least relative error of a law.
const SHARE_MIN: f64 = 0.002;
/// Decay of the weight of earlier stretches: they cover the last minutes.
const STRETCH_DECAY: f64 = 0.995;

/// The autoregression of one equation's noise.
#[derive(Clone, Copy, Debug)]
pub struct Autoregression {
    /// Coefficient of the value j + 1 cells before.
    pub coefficients: [f64; ORDER],
    /// Variance of the prediction error.
    pub variance: f64,
}

/// Accumulates autocovariances of the equations, weighted towards the newest.
#[derive(Clone, Debug)]
pub struct Spectrum {
    sums: [[f64; ORDER + 1]; EQUATIONS],
    counts: [f64; EQUATIONS],
    recent: [[f64; ORDER]; EQUATIONS],
    /// Number of recent values without a pause.
    unbroken: [usize; EQUATIONS],
    decay: f64,
}

impl Spectrum {
    /// An empty estimate for cells of `cell_s` seconds.
    pub fn new(cell_s: f64) -> Self {
        Self {
            sums: [[0.0; ORDER + 1]; EQUATIONS],
            counts: [0.0; EQUATIONS],
            recent: [[0.0; ORDER]; EQUATIONS],
            unbroken: [0; EQUATIONS],
            decay: (-cell_s / MEMORY_S).exp(),
        }
    }

    /// Adds a cell's residuals; NaN for those that are missing.
    pub fn add(&mut self, residual: &[f64; EQUATIONS]) {
        for (equation, value) in residual.iter().enumerate() {
            if !value.is_finite() {
                self.unbroken[equation] = 0;
                continue;
            }
            let sums = &mut self.sums[equation];
            let count = &mut self.counts[equation];
            let limit = CLIP * (sums[0] / *count).sqrt();
            let value = if *count > ORDER as f64 { value.clamp(-limit, limit) } else { *value };
            let recent = &mut self.recent[equation];
            let unbroken = &mut self.unbroken[equation];
            if *unbroken == ORDER {
                sums.iter_mut().for_each(|sum| *sum *= self.decay);
                *count = *count * self.decay + 1.0;
                sums[0] += value * value;
                for (sum, before) in sums[1..].iter_mut().zip(recent.iter()) {
                    *sum += value * before;
                }
            } else {
                *unbroken += 1;
            }
            recent.rotate_right(1);
            recent[0] = value;
        }
    }

    /// Interrupts the history, after a pause.
    pub fn pause(&mut self) {
        self.unbroken = [0; EQUATIONS];
    }

    /// The autoregression of an equation by Levinson's recursion (Durbin 1960); `None` without
    /// enough residuals.
    ///
    /// `least` is a lower bound on the white variance, which no law and no sensor falls below.
    pub fn autoregression(&self, equation: usize, least: f64) -> Option<Autoregression> {
        let sums = &self.sums[equation];
        if self.counts[equation] < 2.0 * ORDER as f64 || sums[0].is_nan() || sums[0] <= 0.0 {
            return None;
        }
        let covariance: [f64; ORDER + 1] =
            std::array::from_fn(|lag| sums[lag] / self.counts[equation]);
        let mut variance = covariance[0] * (1.0 + WHITE) + least;
        let mut coefficients = [0.0; ORDER];
        for order in 0..ORDER {
            let foretold: f64 = (0..order).map(|j| coefficients[j] * covariance[order - j]).sum();
            let reflection = ((covariance[order + 1] - foretold) / variance).clamp(-0.999, 0.999);
            let before = coefficients;
            coefficients[order] = reflection;
            for j in 0..order {
                coefficients[j] = before[j] - reflection * before[order - 1 - j];
            }
            variance *= 1.0 - reflection * reflection;
        }
        Some(Autoregression { coefficients, variance })
    }
}

/// Noise of all equations.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// The filter of each equation; `None` if it is not reported.
    pub filters: [Option<Autoregression>; EQUATIONS],
    /// Variance that an error of the law adds to each cell, over the square of the law's value: a
    /// relative error that persists for some cells, expressed as independent errors of each cell.
    pub law: [f64; EQUATIONS],
}

impl Noise {
    /// The noise before any data.
    pub const NONE: Self = Self { filters: [None; EQUATIONS], law: [0.0; EQUATIONS] };
}

/// Estimates the relative errors of the laws from stretches of motion: with e and m the sums of the
/// residual and of the law's value over a stretch, both whitened, E(e^2) is the noise's variance
/// plus (share m)^2.
#[derive(Clone, Debug)]
pub struct LawErrors {
    /// Sums over the present stretch, and its number of cells.
    stretch: [[f64; 2]; EQUATIONS],
    cells: [usize; EQUATIONS],
    /// Weighted sums of (e^2 - variance) m^2 and of m^4.
    sums: [[f64; 2]; EQUATIONS],
}

impl LawErrors {
    /// The prior, without data.
    pub fn new() -> Self {
        Self {
            stretch: [[0.0; 2]; EQUATIONS],
            cells: [0; EQUATIONS],
            sums: std::array::from_fn(|equation| {
                // Each stretch of motion alone has the weight 1 / (2 share^4).
                let share = SHARE[equation / 3].powi(2);
                let weight = STRETCHES / (2.0 * share * share);
                [weight * share, weight]
            }),
        }
    }

    /// Adds a cell's residual, the law's value, and the noise's variance.
    pub fn add(&mut self, equation: usize, residual: f64, model: f64, variance: f64) {
        let [e, m] = &mut self.stretch[equation];
        *e += residual;
        *m += model;
        self.cells[equation] += 1;
        if self.cells[equation] < COHERENT {
            return;
        }
        let (e2, m2) = (*e * *e, *m * *m);
        (*e, *m) = (0.0, 0.0);
        self.cells[equation] = 0;
        let noise = COHERENT as f64 * variance;
        let expected = noise + SHARE[equation / 3].powi(2) * m2;
        let weight = 0.5 / (expected * expected);
        // A single stretch, such as a jump of the estimate, must not dominate.
        let beyond = (e2 - noise).min(CLIP * CLIP * expected);
        let [top, bottom] = &mut self.sums[equation];
        *top = *top * STRETCH_DECAY + weight * beyond * m2;
        *bottom = *bottom * STRETCH_DECAY + weight * m2 * m2;
    }

    /// Variance over the square of the law's value, for each cell.
    pub fn variance(&self, equation: usize) -> f64 {
        let [top, bottom] = self.sums[equation];
        COHERENT as f64 * (top / bottom).max(SHARE_MIN * SHARE_MIN)
    }
}

impl Default for LawErrors {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn known_autoregression_is_recovered_despite_outliers() {
        let mut rng = Pcg64Mcg::seed_from_u64(5);
        let mut spectrum = Spectrum::new(0.05);
        let (mut a, mut b) = (0.0, 0.0);
        for k in 0..6000 {
            let z: f64 = StandardNormal.sample(&mut rng);
            let next = 1.2 * a - 0.5 * b + 0.3 * z;
            (b, a) = (a, next);
            let seen = if k % 2000 == 1999 { 1e3 } else { next };
            spectrum.add(&std::array::from_fn(|i| if i == 0 { seen } else { f64::NAN }));
        }
        let found = spectrum.autoregression(0, 0.0).expect("a spectrum");
        assert!((found.coefficients[0] - 1.2).abs() < 0.15, "{found:?}");
        assert!((found.coefficients[1] + 0.5).abs() < 0.2, "{found:?}");
        assert!((found.variance.sqrt() - 0.3).abs() < 0.04, "{found:?}");
        assert!(spectrum.autoregression(1, 0.0).is_none());
    }
}
