//! Residuals by frequency: cosine modulating functions over blocks of a flight, and the bands that
//! their power is summed in.
//!
//! A block's residual is multiplied by cosines and summed (orthonormal DCT-II). For a residual of
//! increments, `(y(t + h) - y(t)) / h - f`, the sum telescopes: the derivative acts on the cosine,
//! and numerical differentiation adds only the noise of the block's two ends (modulating functions;
//! Shinbrot 1957, Pearson 1992). The coefficients of stationary noise are nearly independent, so
//! each band's count is its effective sample size.

/// Cells of the longest block, a power of two.
pub const BLOCK_MAX: usize = 1024;
/// Cells of the shortest block, a power of two.
pub const BLOCK_MIN: usize = 128;
/// Length of a cell, s.
pub const CELL_S: f64 = 0.01;
/// Upper ends of the bands, Hz. The first holds each block's mean and trend.
pub const BANDS: [f64; 14] =
    [0.1, 0.2, 0.35, 0.6, 1.0, 1.5, 2.2, 3.2, 4.5, 6.3, 8.5, 11.5, 15.0, 20.0];

/// The band of a frequency; `None` above the last.
pub fn band(frequency_hz: f64) -> Option<usize> {
    BANDS.iter().position(|upper| frequency_hz < *upper)
}

/// Lower and upper end of a band, Hz.
pub fn edges(band: usize) -> [f64; 2] {
    let lower = if band == 0 { 0.0 } else { BANDS[band - 1] };
    [lower, BANDS[band]]
}

/// Ratio of a signal's mean square in a band to its coefficients' mean square there: the band's
/// share of the frequencies that cells resolve.
pub fn mean_square_share(band: usize) -> f64 {
    let [lower, upper] = edges(band);
    2.0 * CELL_S * (upper - lower)
}

/// Frequency of coefficient `index` of a block of `cells`, Hz.
pub fn frequency(index: usize, cells: usize) -> f64 {
    index as f64 / (2.0 * cells as f64 * CELL_S)
}

/// The orthonormal DCT-II for blocks of any power of two up to [`BLOCK_MAX`], by Lee's recursion
/// (1984).
#[derive(Clone, Debug)]
pub struct CosineTransform {
    /// 1 / (2 cos((i + 1/2) pi / n)) for n = 2, 4, ..., one after another.
    secants: Vec<f64>,
}

impl Default for CosineTransform {
    fn default() -> Self {
        let mut secants = Vec::with_capacity(BLOCK_MAX);
        let mut n = 2;
        while n <= BLOCK_MAX {
            let angle = std::f64::consts::PI / n as f64;
            secants.extend((0..n / 2).map(|i| 0.5 / ((i as f64 + 0.5) * angle).cos()));
            n *= 2;
        }
        Self { secants }
    }
}

impl CosineTransform {
    /// Transforms `block` in place. Its length must be a power of two of at most [`BLOCK_MAX`].
    pub fn apply(&self, block: &mut [f64], scratch: &mut Vec<f64>) {
        let n = block.len();
        debug_assert!(n.is_power_of_two() && n <= BLOCK_MAX);
        scratch.clear();
        scratch.resize(n, 0.0);
        self.recurse(block, scratch);
        let scale = (2.0 / n as f64).sqrt();
        block.iter_mut().for_each(|x| *x *= scale);
        block[0] *= std::f64::consts::FRAC_1_SQRT_2;
    }

    /// Lee's recursion, without the scale. `scratch` has the length of `v`.
    fn recurse(&self, v: &mut [f64], scratch: &mut [f64]) {
        let n = v.len();
        let half = n / 2;
        match v {
            [] | [_] => return,
            // Recursing to single numbers would take longer than the sums.
            [a, b] => {
                (*a, *b) = (*a + *b, (*a - *b) * self.secants[0]);
                return;
            }
            [a, b, c, d] => {
                let ([x, y], [u, w]) = ([*a + *d, *b + *c], [*a - *d, *b - *c]);
                let (u, w) = (u * self.secants[1], w * self.secants[2]);
                let odd = (u - w) * self.secants[0];
                (*a, *b, *c, *d) = (x + y, u + w + odd, (x - y) * self.secants[0], odd);
                return;
            }
            _ => {}
        }
        // The tables before this one hold 1 + 2 + ... + half / 2 numbers.
        let secants = &self.secants[half - 1..n - 1];
        for i in 0..half {
            let (x, y) = (v[i], v[n - 1 - i]);
            scratch[i] = x + y;
            scratch[half + i] = (x - y) * secants[i];
        }
        let (even, odd) = scratch.split_at_mut(half);
        let (a, b) = v.split_at_mut(half);
        self.recurse(even, a);
        self.recurse(odd, b);
        let sums = odd.iter().zip(odd[1..].iter().chain(&[0.0]));
        for (pair, (even, (odd, next))) in v.chunks_exact_mut(2).zip(even.iter().zip(sums)) {
            pair[0] = *even;
            pair[1] = odd + next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transform_matches_the_cosine_sum() {
        let n = 16;
        let series: Vec<f64> = (0..n).map(|i| ((i * i) as f64 * 0.37).sin()).collect();
        let mut fast = series.clone();
        CosineTransform::default().apply(&mut fast, &mut Vec::new());
        for (k, found) in fast.iter().enumerate() {
            let sum: f64 = series
                .iter()
                .enumerate()
                .map(|(i, x)| {
                    x * (std::f64::consts::PI * (i as f64 + 0.5) * k as f64 / n as f64).cos()
                })
                .sum();
            let scale = if k == 0 { (1.0 / n as f64).sqrt() } else { (2.0 / n as f64).sqrt() };
            assert!((found - sum * scale).abs() < 1e-12, "{k}");
        }
    }

    #[test]
    fn transform_preserves_the_energy_of_the_longest_block() {
        let mut block: Vec<f64> = (0..BLOCK_MAX).map(|i| (i as f64 * 1.7).sin() + 0.3).collect();
        let energy: f64 = block.iter().map(|x| x * x).sum();
        CosineTransform::default().apply(&mut block, &mut Vec::new());
        let after: f64 = block.iter().map(|x| x * x).sum();
        assert!((after / energy - 1.0).abs() < 1e-10);
    }

    #[test]
    fn bands_cover_all_lower_frequencies() {
        assert_eq!(band(0.0), Some(0));
        assert_eq!(band(0.1), Some(1));
        assert_eq!(band(19.9), Some(BANDS.len() - 1));
        assert_eq!(band(20.0), None);
    }
}
