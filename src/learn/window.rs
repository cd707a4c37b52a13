//! Local averages and slopes of a sampled signal, in place of differentiation.
//!
//! The slope of the least-squares line through a window of half width W equals the average of the
//! true derivative over that window, weighted by the parabola `1 - (s / W)^2`: this is the weak
//! form of the derivative with that parabola as test function. The average, with the same weights,
//! of a quantity that the derivative depends on (the input, the specific force) is therefore
//! comparable with it for any W. Its -3 dB bandwidth is 0.288 / W (14 Hz at 20 ms).

use std::ops::Range;

use crate::log::import::Stream;

/// -3 dB bandwidth of a window's average times its half width.
pub(super) const BANDWIDTH: f64 = 0.288;

/// A signal's samples as arrays, for sliding windows.
pub(super) trait Signal<const N: usize> {
    fn times(&self) -> &[f64];
    fn value(&self, index: usize) -> [f64; N];
}

/// A stream of vectors.
impl<const N: usize, V: Copy + Into<[f64; N]>> Signal<N> for Stream<V> {
    fn times(&self) -> &[f64] {
        Stream::times(self)
    }

    fn value(&self, index: usize) -> [f64; N] {
        self.values()[index].into()
    }
}

/// A window that slides forwards over a signal.
pub(super) struct Sliding<'a, const N: usize, S> {
    signal: &'a S,
    half: f64,
    range: Range<usize>,
}

impl<'a, const N: usize, S: Signal<N>> Sliding<'a, N, S> {
    /// A window of half width `half` (s).
    pub fn new(signal: &'a S, half: f64) -> Self {
        Self { signal, half, range: 0..0 }
    }

    /// Moves to `centre`, which must never decrease.
    fn move_to(&mut self, centre: f64) {
        let times = self.signal.times();
        while self.range.start < times.len() && times[self.range.start] <= centre - self.half {
            self.range.start += 1;
        }
        self.range.end = self.range.end.max(self.range.start);
        while self.range.end < times.len() && times[self.range.end] < centre + self.half {
            self.range.end += 1;
        }
    }

    /// The average around `centre`, weighted by the parabola; `None` without samples on both sides.
    pub fn mean(&mut self, centre: f64) -> Option<[f64; N]> {
        self.move_to(centre);
        let times = self.signal.times();
        let (mut sum, mut total, mut moment) = ([0.0; N], 0.0, 0.0);
        for index in self.range.clone() {
            let s = (times[index] - centre) / self.half;
            let weight = 1.0 - s * s;
            total += weight;
            moment += weight * s;
            for (sum, value) in sum.iter_mut().zip(self.signal.value(index)) {
                *sum += weight * value;
            }
        }
        // The average of an asymmetric window is not at its centre.
        (total > 0.0 && moment.abs() < 0.25 * total).then(|| sum.map(|sum| sum / total))
    }

    /// Value and slope at `centre` of the least-squares line through the window; `None` with fewer
    /// than three samples or with samples too unevenly placed.
    pub fn line(&mut self, centre: f64) -> Option<([f64; N], [f64; N])> {
        self.move_to(centre);
        let times = &self.signal.times()[self.range.clone()];
        let count = times.len() as f64;
        if times.len() < 3 {
            return None;
        }
        let mean_time = times.iter().map(|t| t - centre).sum::<f64>() / count;
        if mean_time.abs() > 0.3 * self.half {
            return None;
        }
        let spread: f64 = times.iter().map(|t| (t - centre - mean_time).powi(2)).sum();
        let (mut mean, mut slope) = ([0.0; N], [0.0; N]);
        for index in self.range.clone() {
            let lever = (self.signal.times()[index] - centre - mean_time) / spread;
            for (i, value) in self.signal.value(index).into_iter().enumerate() {
                mean[i] += value / count;
                slope[i] += lever * value;
            }
        }
        let value = std::array::from_fn(|i| mean[i] - slope[i] * mean_time);
        Some((value, slope))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(f: impl Fn(f64) -> f64) -> Stream<[f64; 1]> {
        let mut stream = Stream::default();
        for k in 0..1000 {
            let t = f64::from(k) * 0.001;
            stream.push(t, [f(t)]);
        }
        stream
    }

    #[test]
    fn linear_signal_keeps_its_value_and_slope() {
        let stream = sampled(|t| 3.0 + 2.0 * t);
        let ([value], [slope]) = Sliding::new(&stream, 0.02).line(0.5).expect("a window");
        assert!((value - 4.0).abs() < 1e-12 && (slope - 2.0).abs() < 1e-9);
    }

    #[test]
    fn fitted_slope_is_the_parabola_weighted_mean_derivative() {
        let omega = 2.0 * std::f64::consts::PI * 7.0;
        let stream = sampled(|t| (omega * t).sin());
        let derivative = sampled(|t| omega * (omega * t).cos());
        let (_, [slope]) = Sliding::new(&stream, 0.04).line(0.5).expect("a window");
        let [mean] = Sliding::new(&derivative, 0.04).mean(0.5).expect("a window");
        assert!((slope - mean).abs() < 1e-2 * omega, "{slope} {mean}");
    }

    #[test]
    fn half_power_falls_at_the_stated_bandwidth() {
        let half = 0.04;
        let omega = 2.0 * std::f64::consts::PI * BANDWIDTH / half;
        let stream = sampled(|t| (omega * (t - 0.5)).cos());
        let [mean] = Sliding::new(&stream, half).mean(0.5).expect("a window");
        assert!((mean - 0.5_f64.sqrt()).abs() < 0.02, "{mean}");
    }

    #[test]
    fn window_across_a_gap_or_end_gives_nothing() {
        let stream = sampled(|t| t);
        assert!(Sliding::new(&stream, 0.02).line(-0.015).is_none());
        assert!(Sliding::new(&stream, 0.02).line(0.0).is_none());
    }
}
