//! The spectrum of a stream: Welch's mean of windowed periodograms.

use std::f64::consts::PI;

use crate::log::import::Stream;

/// Samples of a window.
const WINDOW: usize = 256;
/// Windows that are enough: a long flight is sampled evenly.
const WINDOWS_MAX: usize = 400;
/// A stream slower than this shows no vibration, Hz.
const RATE_MIN_HZ: f64 = 40.0;
/// A window must be even: no time between samples over so many periods.
const UNEVEN: f64 = 1.8;

/// Density of each axis over frequency, one-sided: the square of the stream's unit per Hz.
#[derive(Clone, Debug)]
pub(super) struct Spectrum {
    pub frequency_hz: Vec<f64>,
    pub density: [Vec<f64>; 3],
}

impl Spectrum {
    /// Of a stream that is fast and even enough for one.
    pub fn of(stream: &Stream<[f64; 3]>) -> Option<Self> {
        let period = stream.period().filter(|period| *period < 1.0 / RATE_MIN_HZ)?;
        let (times, values) = (stream.times(), stream.values());
        let starts: Vec<usize> = (0..times.len().saturating_sub(WINDOW))
            .step_by(WINDOW / 2)
            .filter(|from| {
                let window = &times[*from..from + WINDOW];
                window.windows(2).all(|pair| pair[1] - pair[0] < UNEVEN * period)
            })
            .collect();
        let every = starts.len().div_ceil(WINDOWS_MAX).max(1);
        let starts: Vec<usize> = starts.into_iter().step_by(every).collect();
        if starts.is_empty() {
            return None;
        }
        let turn = |k: usize| 2.0 * PI * k as f64 / WINDOW as f64;
        let hann: Vec<f64> = (0..WINDOW).map(|n| 0.5 - 0.5 * turn(n).cos()).collect();
        let wave: Vec<(f64, f64)> = (0..WINDOW).map(|n| turn(n).sin_cos()).collect();
        let rate = 1.0 / period;
        let scale = 2.0 / (rate * hann.iter().map(|w| w * w).sum::<f64>() * starts.len() as f64);
        let density = [0, 1, 2].map(|axis| {
            let mut power = vec![0.0; WINDOW / 2];
            for from in &starts {
                let window = &values[*from..from + WINDOW];
                let mean = window.iter().map(|v| v[axis]).sum::<f64>() / WINDOW as f64;
                let windowed: Vec<f64> =
                    window.iter().zip(&hann).map(|(v, w)| (v[axis] - mean) * w).collect();
                for (k, power) in power.iter_mut().enumerate().skip(1) {
                    let (mut re, mut im) = (0.0, 0.0);
                    for (n, x) in windowed.iter().enumerate() {
                        let (sin, cos) = wave[(k * n) % WINDOW];
                        re += x * cos;
                        im += x * sin;
                    }
                    *power += scale * (re * re + im * im);
                }
            }
            power[1..].to_vec()
        });
        let frequency_hz = (1..WINDOW / 2).map(|k| k as f64 * rate / WINDOW as f64).collect();
        Some(Self { frequency_hz, density })
    }

    /// The frequency at which an axis is strongest above `from_hz`, Hz, and how many times the
    /// median density it is there.
    pub fn peak(&self, axis: usize, from_hz: f64) -> Option<(f64, f64)> {
        let from = self.frequency_hz.partition_point(|f| *f < from_hz);
        let density = self.density.get(axis)?.get(from..)?;
        let mut sorted = density.to_vec();
        sorted.sort_by(f64::total_cmp);
        let median = super::histogram::quantile(&sorted, 0.5)?;
        let (at, most) = density.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        (median > 0.0).then(|| (self.frequency_hz[from + at], most / median))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tone_appears_at_its_frequency_with_its_power() {
        let mut stream = Stream::default();
        for k in 0..4096 {
            let time = 0.002 * f64::from(k);
            let tone = 3.0 * (2.0 * PI * 80.0 * time).sin();
            stream.push(time, [tone, 0.0, 1.0]);
        }
        let spectrum = Spectrum::of(&stream).expect("fast enough");
        let (peak, _) = spectrum.peak(0, 5.0).expect("a peak");
        assert!((peak - 80.0).abs() < 2.0, "{peak}");
        let width = spectrum.frequency_hz[1] - spectrum.frequency_hz[0];
        let power: f64 = spectrum.density[0].iter().sum::<f64>() * width;
        assert!((power - 4.5).abs() < 0.1, "{power}");
        assert!(spectrum.density[2].iter().all(|p| *p < 1e-20));
    }
}
