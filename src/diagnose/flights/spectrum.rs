//! Residuals by frequency: cosine modulating functions over blocks of a flight, and the bands that
//! their power is summed in.
//!
//! A block's residual is multiplied by cosines and summed (orthonormal DCT-II). For a residual of
//! increments, `(y(t + h) - y(t)) / h - f`, the sum telescopes: the derivative acts on the cosine,
//! and numerical differentiation adds only the noise of the block's two ends (modulating functions;
//! Shinbrot 1957, Pearson 1992). The coefficients of stationary noise are nearly independent, so
//! each band's count is its effective sample size.

use std::f64::consts::FRAC_PI_2;
use std::fmt;
use std::sync::Arc;

use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};

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

/// The orthonormal DCT-II for blocks of any power of two from [`BLOCK_MIN`] to [`BLOCK_MAX`].
#[derive(Clone, Debug)]
pub struct CosineTransform {
    /// For each length, the shortest first.
    lengths: Vec<Length>,
}

/// A Fourier transform of one length.
#[derive(Clone)]
struct Length {
    fourier: Arc<dyn Fft<f64>>,
    /// Half of the scale of each coefficient, turned by `-pi k / 2 n`.
    turns: Vec<Complex<f64>>,
}

impl fmt::Debug for Length {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Length").field("cells", &self.turns.len()).finish_non_exhaustive()
    }
}

impl Default for CosineTransform {
    fn default() -> Self {
        let mut planner = FftPlanner::new();
        let cells = std::iter::successors(Some(BLOCK_MIN), |cells| Some(2 * cells));
        let length = |n: usize| {
            let scale =
                |k: usize| if k == 0 { (1.0 / n as f64).sqrt() } else { (2.0 / n as f64).sqrt() };
            let turn =
                |k: usize| Complex::from_polar(0.5 * scale(k), -FRAC_PI_2 * k as f64 / n as f64);
            Length { fourier: planner.plan_fft_forward(n), turns: (0..n).map(turn).collect() }
        };
        Self { lengths: cells.take_while(|n| *n <= BLOCK_MAX).map(length).collect() }
    }
}

impl CosineTransform {
    /// Transforms series of one length in place.
    ///
    /// A complex Fourier transform of the samples, the even ones first, then the odd ones backwards,
    /// gives the cosine transforms of its real and its imaginary part (Makhoul 1980).
    ///
    /// # Panics
    /// On a length that is no power of two from [`BLOCK_MIN`] to [`BLOCK_MAX`].
    pub fn apply(&self, series: &mut [&mut [f64]]) {
        let Some(n) = series.first().map(|first| first.len()) else { return };
        let of_length = self.lengths.iter().find(|length| length.turns.len() == n);
        let Length { fourier, turns } = of_length.expect("a block's length");
        let mut points = vec![Complex::default(); n];
        let mut scratch = vec![Complex::default(); fourier.get_inplace_scratch_len()];
        for pair in series.chunks_mut(2) {
            let at = |i: usize| Complex::new(pair[0][i], pair.get(1).map_or(0.0, |other| other[i]));
            for i in 0..n / 2 {
                points[i] = at(2 * i);
                points[n - 1 - i] = at(2 * i + 1);
            }
            fourier.process_with_scratch(&mut points, &mut scratch);
            for (k, turn) in turns.iter().enumerate() {
                let (point, mirrored) = (points[k], points[(n - k) % n].conj());
                pair[0][k] = (turn * (point + mirrored)).re;
                if let Some(other) = pair.get_mut(1) {
                    other[k] = (turn * (point - mirrored)).im;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    fn cosine_sum(series: &[f64], k: usize) -> f64 {
        let n = series.len() as f64;
        let scale = if k == 0 { (1.0 / n).sqrt() } else { (2.0 / n).sqrt() };
        let terms = series.iter().enumerate();
        scale * terms.map(|(i, x)| x * (PI * (i as f64 + 0.5) * k as f64 / n).cos()).sum::<f64>()
    }

    #[test]
    fn transform_matches_the_cosine_sum() {
        let first: Vec<f64> = (0..BLOCK_MIN).map(|i| ((i * i) as f64 * 0.37).sin()).collect();
        let series = [first.clone(), first.iter().map(|x| x.exp()).collect(), vec![1.0; BLOCK_MIN]];
        for count in 0..=series.len() {
            let mut fast = series[..count].to_vec();
            let mut slices: Vec<&mut [f64]> = fast.iter_mut().map(Vec::as_mut_slice).collect();
            CosineTransform::default().apply(&mut slices);
            for (series, fast) in series.iter().zip(&fast) {
                for (k, found) in fast.iter().enumerate() {
                    assert!((found - cosine_sum(series, k)).abs() < 1e-12, "{count} {k}");
                }
            }
        }
    }

    #[test]
    fn transform_preserves_the_energy_of_the_longest_block() {
        let mut block: Vec<f64> = (0..BLOCK_MAX).map(|i| (i as f64 * 1.7).sin() + 0.3).collect();
        let energy: f64 = block.iter().map(|x| x * x).sum();
        CosineTransform::default().apply(&mut [&mut block]);
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
