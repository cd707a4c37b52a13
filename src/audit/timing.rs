//! Checks rates, gaps, jitter and clocks.

use schemars::JsonSchema;
use serde::Serialize;

use super::{Audit, Finding, Severity, UnusableSpan};
use crate::log::import::{Flight, Stream};

/// Name of the check of what the importer left out.
pub const LEFT_OUT: &str = "left_out";
/// Reason for an unusable time between two samples.
pub const NO_SAMPLES: &str = "no samples";

/// Periods between samples above which there is a gap.
const GAP_PERIODS: f64 = 3.0;
/// Length of a gap that cannot be bridged, s.
const GAP_LONG: f64 = 0.5;
/// Share of lost samples that is reported as a note, and as a flaw of the measurement.
const LOST_NOTE: f64 = 0.01;
const LOST_FLAW: f64 = 0.05;
/// Half of the range of nine tenths of the intervals, in periods, above which stamps are uneven.
const JITTER_MAX: f64 = 0.35;
/// Relative rate error of the ground's clock that is reported; ordinary quartz stays below 1e-4.
const SKEW_MAX: f64 = 1e-3;
/// Least period of a stream, s: inertial units sample at up to 32 kHz.
const PERIOD_MIN_S: f64 = 25e-6;
/// Largest period of a measured stream, s: slow telemetry comes about once a second.
const PERIOD_MAX_S: f64 = 5.0;
/// Share of samples left out as damaged above which the log supports no conclusion.
const DAMAGED_MAX: f64 = 0.1;

/// Timing of a stream's samples.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct StreamTiming {
    /// Name of the stream.
    pub stream: &'static str,
    /// Number of samples.
    pub samples: usize,
    /// Samples per second over the whole span.
    pub rate_hz: f64,
    /// Median interval, s.
    pub period_s: Option<f64>,
    /// Half of the range that holds nine tenths of the intervals, s.
    pub jitter_s: Option<f64>,
    /// Number of intervals longer than three periods.
    pub gaps: usize,
    /// The longest interval, s.
    pub longest_gap_s: Option<f64>,
    /// Samples missing in the gaps, as a share of those expected.
    pub lost: f64,
}

/// Streams that are sampled at a rate, with their times. Others, such as the voltage, may come only
/// when they change.
fn sampled(flight: &Flight) -> [(&'static str, &[f64]); 8] {
    [
        ("attitude", flight.attitude.times()),
        ("position", flight.position.times()),
        ("velocity", flight.velocity.times()),
        ("body_rate", flight.body_rate.times()),
        ("specific_force", flight.specific_force.times()),
        ("outputs", flight.outputs.times()),
        ("rotor_speed", flight.rotor_speed.times()),
        ("setpoint", flight.setpoint.times()),
    ]
}

/// The timing of every logged stream.
pub(super) fn streams(flight: &Flight) -> Vec<StreamTiming> {
    let all = sampled(flight).into_iter().chain([("voltage", flight.voltage.times())]);
    all.filter(|(_, times)| !times.is_empty()).map(|(name, times)| timing(name, times)).collect()
}

fn timing(stream: &'static str, times: &[f64]) -> StreamTiming {
    let mut intervals: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    intervals.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let last = intervals.len().checked_sub(1)?;
        intervals.get((share * last as f64).round() as usize).copied()
    };
    let period = quantile(0.5);
    let mut beyond = Vec::new();
    if let Some(period) = period {
        beyond.extend(intervals.iter().copied().filter(|gap| *gap > GAP_PERIODS * period));
    }
    let missing = beyond.iter().fold(0.0, |sum, gap| sum + gap / period.unwrap_or(*gap) - 1.0);
    let span = intervals.iter().sum::<f64>();
    StreamTiming {
        stream,
        samples: times.len(),
        rate_hz: if span > 0.0 { intervals.len() as f64 / span } else { 0.0 },
        period_s: period,
        jitter_s: quantile(0.95).zip(quantile(0.05)).map(|(high, low)| 0.5 * (high - low)),
        gaps: beyond.len(),
        longest_gap_s: intervals.last().copied(),
        lost: missing / (missing + times.len() as f64),
    }
}

pub(super) fn check(flight: &Flight, audit: &mut Audit) {
    for (name, times) in sampled(flight) {
        let Some(timing) = audit.streams.iter().find(|timing| timing.stream == name).cloned()
        else {
            continue;
        };
        check_gaps(name, times, &timing, audit);
        check_jitter(&timing, audit);
        check_unit(&timing, audit);
    }
    check_clocks(flight, audit);
    check_left_out(flight, audit);
}

fn check_gaps(name: &'static str, times: &[f64], timing: &StreamTiming, audit: &mut Audit) {
    let (Some(period), Some(longest)) = (timing.period_s, timing.longest_gap_s) else { return };
    let limit = GAP_LONG.max(GAP_PERIODS * period);
    for pair in times.windows(2).filter(|pair| pair[1] - pair[0] > limit) {
        audit.unusable.push(UnusableSpan {
            stream: name,
            from_s: pair[0],
            to_s: pair[1],
            reason: NO_SAMPLES,
        });
    }
    let StreamTiming { gaps, lost, .. } = *timing;
    if gaps == 0 || lost < LOST_NOTE && longest <= limit {
        return;
    }
    let is_flaw = lost > LOST_FLAW || longest > limit;
    audit.findings.push(Finding {
        severity: if is_flaw { Severity::Measurement } else { Severity::Note },
        check: "gap",
        stream: Some(name),
        found: longest,
        expected: period,
        unit: "s",
        what: format!(
            "{gaps} gaps, the longest {longest:.3} s at a period of {:.4} s; {:.1} % of the samples are missing",
            period,
            100.0 * lost
        ),
        advice: "windows over long gaps are excluded; look for what stalled the logger or the link",
    });
}

fn check_jitter(timing: &StreamTiming, audit: &mut Audit) {
    let (Some(period), Some(jitter)) = (timing.period_s, timing.jitter_s) else { return };
    if jitter <= JITTER_MAX * period || timing.samples < 50 {
        return;
    }
    audit.findings.push(Finding {
        severity: Severity::Note,
        check: "jitter",
        stream: Some(timing.stream),
        found: jitter,
        expected: JITTER_MAX * period,
        unit: "s",
        what: format!(
            "samples are unevenly spaced: {:.1} ms about a period of {:.1} ms",
            1e3 * jitter,
            1e3 * period
        ),
        advice: "timestamps are used as logged, never a nominal rate",
    });
}

/// No logger of a vehicle is this fast or this slow: the times are in another unit.
fn check_unit(timing: &StreamTiming, audit: &mut Audit) {
    let Some(period) = timing.period_s else { return };
    // The ground may send setpoints only when they change.
    let most = if timing.stream == "setpoint" { f64::INFINITY } else { PERIOD_MAX_S };
    if (PERIOD_MIN_S..=most).contains(&period) || timing.samples < 50 {
        return;
    }
    audit.findings.push(Finding {
        severity: Severity::Fault,
        check: "unit",
        stream: Some(timing.stream),
        found: period,
        expected: if period < PERIOD_MIN_S { PERIOD_MIN_S } else { most },
        unit: "s",
        what: format!(
            "its samples are {:.3} ms apart: are its times in another unit?",
            1e3 * period
        ),
        advice: "check the unit of time stated for the log",
    });
}

fn check_clocks(flight: &Flight, audit: &mut Audit) {
    let Some(skew) = flight.ground_skew.filter(|skew| skew.abs() > SKEW_MAX) else { return };
    audit.findings.push(Finding {
        severity: Severity::Measurement,
        check: "clock_skew",
        stream: None,
        found: skew,
        expected: 0.0,
        unit: "",
        what: format!(
            "the ground's clock ran {:.2} % {} than the vehicle's",
            100.0 * skew.abs(),
            if skew > 0.0 { "faster" } else { "slower" }
        ),
        advice: "all times are the vehicle's; times that only the ground stamped are mapped \
                 piecewise",
    });
}

/// Reports damage that the importer found.
fn check_left_out(flight: &Flight, audit: &mut Audit) {
    let samples: usize = audit.streams.iter().map(|timing| timing.samples).sum();
    // Data of another vehicle or another sensor are not lost.
    let is_foreign = |reason: &str| {
        [
            "of instance",
            "another vehicle",
            "another run of the vehicle's clock",
            "another boot of the vehicle",
            "in units that only",
            "setpoint from",
            "by its own flags",
            "duplicated frame",
            "duplicated row",
        ]
        .iter()
        .any(|words| reason.contains(words))
    };
    for (reason, count) in &flight.left_out {
        let share = *count as f64 / (samples as f64 + *count as f64).max(1.0);
        // Counts of bytes are not counts of samples.
        let is_much = share > DAMAGED_MAX && !reason.contains("byte");
        audit.findings.push(Finding {
            severity: match (is_foreign(reason), is_much) {
                (true, _) => Severity::Note,
                (false, false) => Severity::Measurement,
                (false, true) => Severity::Fault,
            },
            check: LEFT_OUT,
            stream: None,
            found: *count as f64,
            expected: 0.0,
            unit: "",
            what: format!("{count} x {reason}"),
            advice: if is_foreign(reason) {
                "the importer left them out: they are not part of this flight"
            } else {
                "the importer left them out; copy the log again if the file was damaged in transit"
            },
        });
    }
}

/// Fewest samples for a check of a stream.
const SAMPLES_MIN: usize = 20;

/// Whether a stream has enough samples for a check.
pub(super) fn is_logged<T>(stream: &Stream<T>) -> bool {
    stream.len() >= SAMPLES_MIN
}

#[cfg(test)]
mod tests {
    use vehicle::frame::Ned;

    use super::*;

    /// A flight of one stream with `samples` samples, `period` s apart.
    fn flight(samples: u32, period: f64) -> Flight {
        let mut flight = Flight::in_memory("memory", "csv");
        for sample in 0..samples {
            let t = f64::from(sample);
            flight.position.push(period * t, Ned::new(t.sin(), t.cos(), -1.0));
        }
        flight
    }

    #[test]
    fn times_in_another_unit_are_found() {
        let is_found = |period: f64| {
            let findings = Audit::of(&flight(100, period)).findings;
            findings.iter().any(|f| f.check == "unit" && f.severity == Severity::Fault)
        };
        // Read as s: the ms and the us of 100 Hz; the s of slow telemetry, of a usual and a fast rate.
        assert_eq!([10.0, 1e4, 1.0, 0.01, 1e-3].map(is_found), [true, true, false, false, false]);
        assert!(is_found(1e-5));
    }

    #[test]
    fn identical_rows_are_no_loss() {
        let severities = |reason: &str| {
            let mut flight = flight(100, 0.01);
            flight.left_out.push((reason.to_owned(), 100));
            let findings = Audit::of(&flight).findings;
            let left_out = findings.into_iter().filter(|finding| finding.check == LEFT_OUT);
            left_out.map(|finding| finding.severity).collect::<Vec<_>>()
        };
        let duplicated = "duplicated row, with the time of the row before";
        assert_eq!(severities(duplicated), [Severity::Note]);
        assert_eq!(severities("row with the time of the row before"), [Severity::Fault]);
    }
}
