//! Series: samples of a stream as plain numbers, with linear interpolation.

use vehicle::frame::Attitude;

pub(in crate::diagnose) use crate::audit::median;
use crate::log::import::Stream;

/// Faster streams are first averaged over [`SMOOTHING_S`], Hz: frequencies above the bands would
/// alias into them.
const RATE_MAX_HZ: f64 = 260.0;
const SMOOTHING_S: f64 = 0.005;
/// Samples that a cursor advances over one by one before it searches.
const STEPS_MAX: usize = 8;

/// Samples of N numbers over time, with linear interpolation.
#[derive(Clone, Debug, Default)]
pub struct Series<const N: usize> {
    times: Vec<f64>,
    values: Vec<[f64; N]>,
}

impl<const N: usize> Series<N> {
    /// Samples with as many `times` as `values`.
    pub(in crate::diagnose) fn new(times: Vec<f64>, values: Vec<[f64; N]>) -> Self {
        debug_assert_eq!(times.len(), values.len());
        Self { times, values }
    }

    /// The values of a stream as numbers; a fast stream is averaged.
    pub(in crate::diagnose) fn of<T>(stream: &Stream<T>, value: impl Fn(&T) -> [f64; N]) -> Self {
        Self { times: stream.times().to_vec(), values: stream.values().iter().map(value).collect() }
            .smoothed(stream.rate())
    }

    /// Moving average over [`SMOOTHING_S`] of a stream above the rate limit.
    fn smoothed(self, rate: f64) -> Self {
        if rate <= RATE_MAX_HZ {
            return self;
        }
        let half = ((0.5 * SMOOTHING_S * rate).round() as usize).max(1);
        let n = self.values.len();
        let values = (0..n)
            .map(|i| {
                let window = &self.values[i.saturating_sub(half)..(i + half + 1).min(n)];
                let count = window.len() as f64;
                std::array::from_fn(|c| window.iter().map(|v| v[c]).sum::<f64>() / count)
            })
            .collect();
        Self { values, ..self }
    }

    /// Whether there are no samples.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Samples per second.
    pub fn rate(&self) -> f64 {
        match self.times.as_slice() {
            [first, .., last] => (self.times.len() - 1) as f64 / (last - first),
            _ => 0.0,
        }
    }

    /// Times, s.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Values, one for each time.
    pub fn values(&self) -> &[[f64; N]] {
        &self.values
    }

    /// Values, to change in place.
    pub fn values_mut(&mut self) -> &mut [[f64; N]] {
        &mut self.values
    }

    /// A reader for ascending times.
    pub fn cursor(&self) -> Cursor<'_, N> {
        Cursor { series: self, index: 0 }
    }

    /// The value at `time`, interpolated; beyond the ends, the nearest sample's.
    pub fn at(&self, time: f64) -> [f64; N] {
        let index = self.times.partition_point(|t| *t <= time).saturating_sub(1);
        self.between(index, time)
    }

    /// Standard deviation of white noise in an interpolated value at `time`, relative to a
    /// sample's: between two samples, the value is their weighted mean.
    pub(in crate::diagnose) fn noise_share(&self, time: f64) -> f64 {
        let next = self.times.partition_point(|t| *t <= time);
        let pair = next.checked_sub(1).zip(self.times.get(next));
        let Some((before, after)) = pair.map(|(i, after)| (self.times[i], *after)) else {
            return 1.0;
        };
        let share = (time - before) / (after - before);
        share.hypot(1.0 - share)
    }

    /// The integral mean over `half` seconds to each side of `time`. Readings synchronous with the
    /// samples would mistake the fastest noise for motion.
    pub(in crate::diagnose) fn mean_about(&self, time: f64, half: f64) -> [f64; N] {
        let (start, end) = (time - half, time + half);
        let within = self.times.partition_point(|t| *t <= start)..;
        let samples = self.times[within.clone()].iter().zip(&self.values[within]);
        let samples = samples.map(|(t, value)| (*t, *value)).take_while(|(t, _)| *t < end);
        let mut last = (start, self.at(start));
        let mut mean = [0.0; N];
        for (t, value) in samples.chain(std::iter::once((end, self.at(end)))) {
            let share = 0.5 * (t - last.0) / (end - start);
            let ends = last.1.into_iter().zip(value);
            mean.iter_mut().zip(ends).for_each(|(mean, (a, b))| *mean += share * (a + b));
            last = (t, value);
        }
        mean
    }

    /// The value at `time` on the line from sample `index` to the next; beyond either, that sample's.
    fn between(&self, index: usize, time: f64) -> [f64; N] {
        let Some(before) = self.values.get(index) else { return [0.0; N] };
        let Some(after) = self.values.get(index + 1) else { return *before };
        let (t0, t1) = (self.times[index], self.times[index + 1]);
        let share = ((time - t0) / (t1 - t0)).clamp(0.0, 1.0);
        std::array::from_fn(|i| before[i] + share * (after[i] - before[i]))
    }
}

/// The attitude of a quaternion w, x, y, z of nearly unit norm.
pub(in crate::diagnose) fn attitude([w, x, y, z]: [f64; 4]) -> Attitude {
    Attitude { w, x, y, z }.normalized()
}

/// `q` or its negative, which is the same attitude: whichever is nearer to `last`, so that
/// interpolation takes the short way.
pub(in crate::diagnose) fn next_to(last: Option<[f64; 4]>, q: [f64; 4]) -> [f64; 4] {
    let is_far = last.is_some_and(|l| l.iter().zip(q).map(|(a, b)| a * b).sum::<f64>() < 0.0);
    if is_far { q.map(|c| -c) } else { q }
}

impl Series<4> {
    /// The attitude at `time`, from a series of quaternions.
    pub(in crate::diagnose) fn attitude_at(&self, time: f64) -> Attitude {
        attitude(self.at(time))
    }
}

impl Cursor<'_, 4> {
    /// As [`Series::attitude_at`].
    pub(in crate::diagnose) fn attitude_at(&mut self, time: f64) -> Attitude {
        attitude(self.at(time))
    }
}

/// Interpolates a [`Series`] at mostly ascending times, without a search.
#[derive(Clone, Debug)]
pub struct Cursor<'a, const N: usize> {
    series: &'a Series<N>,
    index: usize,
}

impl<const N: usize> Cursor<'_, N> {
    /// The value at `time`, interpolated; beyond the ends, the nearest sample's.
    pub fn at(&mut self, time: f64) -> [f64; N] {
        let times = &self.series.times;
        let is_behind = self.index > 0 && times[self.index] > time;
        let is_far_ahead = times.get(self.index + STEPS_MAX).is_some_and(|t| *t <= time);
        if is_behind || is_far_ahead {
            self.index = times.partition_point(|t| *t <= time).saturating_sub(1);
        }
        while self.index + 1 < times.len() && times[self.index + 1] <= time {
            self.index += 1;
        }
        self.series.between(self.index, time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windowed_mean_integrates_the_interpolated_series() {
        let series = Series { times: vec![0.0, 1.0, 2.0], values: vec![[0.0], [3.0], [6.0]] };
        for (time, half, expected) in [(0.9, 0.4, 2.7), (0.5, 0.1, 1.5), (2.0, 1.0, 5.25)] {
            let [mean] = series.mean_about(time, half);
            assert!((mean - expected).abs() < 1e-12, "{mean}");
        }
        // Noise of alternating sign, at every multiple of its period.
        let times: Vec<f64> = (0..100).map(|k| 0.01 * f64::from(k)).collect();
        let values = (0..100).map(|k| [if k % 2 == 0 { 1.0 } else { -1.0 }]).collect();
        let series = Series { times, values };
        for time in [0.4, 0.41, 0.5, 0.503] {
            assert!(series.mean_about(time, 0.12)[0].abs() < 0.02);
        }
    }

    #[test]
    fn interpolation_averages_noise_between_samples() {
        let series = Series { times: vec![0.0, 1.0], values: vec![[0.0], [0.0]] };
        let shares = [-0.5, 0.0, 0.5, 1.0].map(|time| series.noise_share(time));
        assert_eq!(shares, [1.0, 1.0, 0.5_f64.sqrt(), 1.0]);
    }

    #[test]
    fn cursor_reads_the_same_values_as_search() {
        let series = Series { times: vec![0.0, 1.0, 3.0], values: vec![[0.0], [2.0], [0.0]] };
        let mut cursor = series.cursor();
        for time in [-1.0, 0.5, 1.0, 2.0, 2.9, 5.0, 0.25] {
            assert_eq!(cursor.at(time), series.at(time), "{time}");
        }
        assert_eq!(series.at(2.0), [1.0]);
    }
}
