//! Gaps of one stream: its unbroken parts, and the times at which its samples determine a value.
//! Spans are in seconds.

use std::ops::Range;

use crate::log::import::Stream;

/// A gap of this many periods ends a segment.
const GAP_PERIODS: f64 = 4.0;
/// A gap of this many seconds does too, at any rate.
const GAP_MAX_S: f64 = 0.2;
/// A gap of fewer periods than this does not.
const GAP_PERIODS_MIN: f64 = 1.5;
/// Streams with longer periods do not resolve a quadrotor's motion, s.
pub(super) const PERIOD_MAX_S: f64 = 0.2;
/// Longest time between two samples that interpolation may bridge, s.
const BRIDGE_MAX_S: f64 = GAP_PERIODS_MIN * PERIOD_MAX_S;

/// Parts of a stream between its gaps. Within a part, consecutive samples are close enough to
/// bridge.
pub(super) fn unbroken<T>(stream: &Stream<T>) -> Vec<Range<f64>> {
    unbroken_over(stream, 0.0)
}

/// The same, where a gap of up to `least` seconds does not count.
pub(super) fn unbroken_over<T>(stream: &Stream<T>, least: f64) -> Vec<Range<f64>> {
    let Some((&first, &last)) = stream.times().first().zip(stream.times().last()) else {
        return Vec::new();
    };
    let Some(period) = spacing(stream.times()) else { return Vec::new() };
    let limit = (GAP_PERIODS * period)
        .min(GAP_MAX_S)
        .max(GAP_PERIODS_MIN * period)
        .max(least)
        .min(BRIDGE_MAX_S);
    let mut spans = Vec::new();
    let mut start = first;
    for pair in stream.times().windows(2) {
        if pair[1] - pair[0] > limit {
            spans.push(start..pair[0]);
            start = pair[1];
        }
    }
    spans.push(start..last);
    spans
}

/// The intersection of two lists of spans, each in time order.
pub fn intersection(ones: &[Range<f64>], others: &[Range<f64>]) -> Vec<Range<f64>> {
    let both = |a: &Range<f64>, b: &Range<f64>| a.start.max(b.start)..a.end.min(b.end);
    let pairs = ones.iter().flat_map(|a| others.iter().map(move |b| both(a, b)));
    pairs.filter(|both| both.start < both.end).collect()
}

/// Total length of spans, s.
pub fn length(spans: &[Range<f64>]) -> f64 {
    spans.iter().fold(0.0, |sum, span| sum + span.end - span.start)
}

/// Spacing of samples: half of the total time is in gaps at least this long. For stamps in bursts,
/// this is the time between bursts, otherwise the period. Pauses do not count.
fn spacing(times: &[f64]) -> Option<f64> {
    let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    gaps.sort_by(f64::total_cmp);
    let pauses = gaps.partition_point(|gap| *gap <= GAP_MAX_S);
    let gaps = if pauses > 0 { &gaps[..pauses] } else { &gaps[..] };
    let half = 0.5 * gaps.iter().sum::<f64>();
    let mut passed = 0.0;
    let mut beyond = gaps.iter().copied().skip_while(|gap| {
        passed += gap;
        passed < half
    });
    beyond.next()
}

/// Whether the samples around `time` determine a value.
pub(super) fn is_bridged<T>(stream: &Stream<T>, time: f64) -> bool {
    let times = stream.times();
    stream.index_at(time).is_some_and(|index| {
        let next = times.get(index + 1);
        times[index] == time || next.is_some_and(|next| next - times[index] <= BRIDGE_MAX_S)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stream(times: impl Iterator<Item = f64>) -> Stream<()> {
        let mut stream = Stream::default();
        for time in times {
            stream.push(time, ());
        }
        stream
    }

    #[test]
    fn bursty_timestamps_are_not_gaps() {
        let bursts = (0..300).flat_map(|k| [0.0, 0.001, 0.002].map(|at| f64::from(k) * 0.03 + at));
        assert_eq!(unbroken(&stream(bursts)).len(), 1);
    }

    #[test]
    fn unbroken_spans_can_be_interpolated_throughout() {
        // From 100 Hz down to the longest admissible period, with one pause.
        for period in [0.01, 0.05, 0.2] {
            let times = (0..100).map(|k| f64::from(k) * period);
            let stream = stream(times.map(|time| if time < 2.0 { time } else { time + 1.0 }));
            let spans = unbroken(&stream);
            assert_eq!(spans.len(), 1 + usize::from(100.0 * period > 2.0), "{spans:?}");
            for span in spans {
                let within = (0..=100).map(|k| f64::from(k) / 100.0);
                let times = within.map(|share| span.start + share * (span.end - span.start));
                assert!(times.into_iter().all(|time| is_bridged(&stream, time)), "{span:?}");
            }
            assert!(!is_bridged(&stream, 2.5));
        }
    }
}
