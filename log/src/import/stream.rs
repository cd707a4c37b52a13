//! Samples of one quantity on one clock.

/// A longer time without a sample is a pause of the logger, as on the ground between two flights,
/// s; also more than [`PAUSE_PERIODS`] periods.
const PAUSE_S: f64 = 5.0;
const PAUSE_PERIODS: f64 = 20.0;

/// Factor between two rates that lost samples and rounded stamps do not explain.
const CLEARLY_MORE: f64 = 1.05;

/// Least share of samples with the value before of a stream that repeats values.
const REPEATED_SHARE_MIN: f64 = 0.05;
/// Longest time over which a logger repeats a value, s.
const HELD_MAX_S: f64 = 0.15;

/// Samples of one quantity in order of time.
///
/// Times are in seconds on the vehicle's clock, finite and strictly increasing. The importer drops
/// samples that break the order and counts them in [`Flight::left_out`](super::Flight::left_out).
#[derive(Clone, Debug, PartialEq)]
pub struct Stream<T> {
    times: Vec<f64>,
    values: Vec<T>,
}

impl<T> Default for Stream<T> {
    fn default() -> Self {
        Self { times: Vec::new(), values: Vec::new() }
    }
}

impl<T> Stream<T> {
    /// Appends a sample. Drops it and returns `false` unless `time` is finite and later than the
    /// last.
    pub fn push(&mut self, time: f64, value: T) -> bool {
        let later = self.times.last().is_none_or(|last| time > *last);
        if !(time.is_finite() && later) {
            return false;
        }
        self.times.push(time);
        self.values.push(value);
        true
    }

    /// Times in s.
    pub fn times(&self) -> &[f64] {
        &self.times
    }

    /// Values, one for each time.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// Values, mutable in place.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// Returns the values without the times.
    pub fn into_values(self) -> Vec<T> {
        self.values
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.times.len()
    }

    /// Whether the stream has no samples.
    pub fn is_empty(&self) -> bool {
        self.times.is_empty()
    }

    /// Iterates over times and values.
    pub fn iter(&self) -> impl Iterator<Item = (f64, &T)> {
        self.times.iter().copied().zip(&self.values)
    }

    /// Index of the newest sample at or before `time`.
    pub fn index_at(&self, time: f64) -> Option<usize> {
        self.times.partition_point(|t| *t <= time).checked_sub(1)
    }

    /// The newest value at or before `time`, as a zero-order hold.
    pub fn held_at(&self, time: f64) -> Option<&T> {
        self.values.get(self.index_at(time)?)
    }

    /// The newest value at or before `time`, the next one, and the share of the way from one to the
    /// other, 0..1; `None` before the first sample and from the last one on.
    pub fn around(&self, time: f64) -> Option<(&T, &T, f64)> {
        let first = self.index_at(time)?;
        let (from, to) = (self.times.get(first)?, self.times.get(first + 1)?);
        let share = (time - from) / (to - from);
        Some((self.values.get(first)?, self.values.get(first + 1)?, share))
    }

    /// Mean samples per second over the stream's span, without pauses of the logger; 0 with fewer
    /// than two samples.
    pub fn rate(&self) -> f64 {
        let [first, .., last] = self.times.as_slice() else { return 0.0 };
        let gaps = || self.times.windows(2).map(|pair| pair[1] - pair[0]);
        let (mut count, mut span) = (self.times.len() - 1, last - first);
        if gaps().any(|gap| gap > PAUSE_S) {
            let pause = PAUSE_S.max(PAUSE_PERIODS * self.period().unwrap_or_default());
            for gap in gaps().filter(|gap| *gap > pause) {
                count -= 1;
                span -= gap;
            }
        }
        count as f64 / span
    }

    /// Whether it has a clearly higher rate than `other`, another source of the same quantity that
    /// is used otherwise.
    pub(super) fn is_more_frequent<U>(&self, other: &Stream<U>) -> bool {
        self.rate() > CLEARLY_MORE * other.rate()
    }

    /// Applies `value` to each value and keeps the times.
    pub fn map<U>(&self, value: impl FnMut(&T) -> U) -> Stream<U> {
        Stream { times: self.times.clone(), values: self.values.iter().map(value).collect() }
    }

    /// Applies `value` to each value and drops samples for which it returns `None`.
    pub fn filter_map<U>(&self, mut value: impl FnMut(&T) -> Option<U>) -> Stream<U> {
        let kept = self.iter().filter_map(|(time, old)| Some((time, value(old)?)));
        let (times, values) = kept.unzip();
        Stream { times, values }
    }

    /// The same times with new values; `values` must have one for each time.
    pub fn with_values(&self, values: Vec<T>) -> Self {
        debug_assert_eq!(values.len(), self.times.len());
        Self { times: self.times.clone(), values }
    }

    /// Shifts all times by `by` seconds.
    pub fn shifted(mut self, by: f64) -> Self {
        if by != 0.0 {
            self.times.iter_mut().for_each(|time| *time += by);
            // With a distant epoch, rounding may have merged neighbouring times.
            if self.times.windows(2).any(|pair| pair[1] <= pair[0]) {
                let mut rounded = Self::default();
                for (time, value) in self.times.into_iter().zip(self.values) {
                    rounded.push(time, value);
                }
                return rounded;
            }
        }
        self
    }

    /// The stream without samples that repeat the value before, as loggers write that are faster than
    /// their source; `None` if few do. A repeat every 0.15 s stays: a value may also be
    /// constant.
    pub fn without_repeats(&self) -> Option<Self>
    where
        T: PartialEq + Clone,
    {
        let repeats = self.values.windows(2).filter(|pair| pair[0] == pair[1]).count();
        if (repeats as f64) < REPEATED_SHARE_MIN * self.len() as f64 {
            return None;
        }
        let mut fresh = Self::default();
        for (time, value) in self.iter() {
            let is_held = fresh.times.last().is_some_and(|last| time - last < HELD_MAX_S);
            if !is_held || fresh.values.last() != Some(value) {
                fresh.push(time, value.clone());
            }
        }
        Some(fresh)
    }

    /// Median time between samples in s; `None` with fewer than two samples.
    pub fn period(&self) -> Option<f64> {
        let mut gaps: Vec<f64> = self.times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        if gaps.is_empty() {
            return None;
        }
        let middle = gaps.len() / 2;
        Some(*gaps.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeats_of_a_slow_source_are_dropped() {
        let held = |period: u32| {
            let mut stream = Stream::default();
            (0..400_u32).for_each(|k| assert!(stream.push(0.01 * f64::from(k), k / period)));
            stream
        };
        let fresh = held(10).without_repeats().expect("repeats");
        assert_eq!(fresh.len(), 40);
        assert!(fresh.iter().all(|(time, value)| (time - 0.1 * f64::from(*value)).abs() < 1e-9));
        assert_eq!(held(1).without_repeats(), None);
        // A constant value leaves no gap.
        let constant = held(400).without_repeats().expect("repeats");
        assert!(constant.times().windows(2).all(|pair| pair[1] - pair[0] < 0.161));
    }

    #[test]
    fn stream_keeps_only_later_finite_samples() {
        let mut stream = Stream::default();
        let kept = [(0.0, true), (0.1, true), (0.1, false), (f64::NAN, false), (0.05, false)];
        for (time, expected) in kept {
            assert_eq!(stream.push(time, time), expected);
        }
        assert_eq!(stream.times(), [0.0, 0.1]);
        assert_eq!(stream.held_at(-1.0), None);
        assert_eq!(stream.held_at(0.05), Some(&0.0));
        assert_eq!(stream.held_at(9.0), Some(&0.1));
    }

    #[test]
    fn a_pause_between_flights_does_not_lower_the_rate() {
        let mut stream = Stream::default();
        let flight = |from: f64| (0..1000).map(move |k| from + 0.01 * f64::from(k));
        for time in flight(5.0).chain(flight(400.0)) {
            stream.push(time, ());
        }
        assert!((stream.rate() - 100.0).abs() < 1e-6, "{}", stream.rate());
        // Rare samples are no pauses.
        let mut rare = Stream::default();
        for time in [0.0, 15.0, 120.0, 135.0] {
            rare.push(time, ());
        }
        assert!((rare.rate() - 3.0 / 135.0).abs() < 1e-9, "{}", rare.rate());
    }
}
