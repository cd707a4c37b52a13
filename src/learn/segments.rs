//! Which parts of a flight are worth learning from.

use std::ops::Range;

use serde::Serialize;

use crate::log::import::{Flight, Stream, UnitUnknown};

/// A gap of this many periods ends a segment.
const GAP_PERIODS: f64 = 4.0;
/// And so does one of this many seconds, whatever the rate.
const GAP_MAX_S: f64 = 0.2;
/// Shorter pieces do not hold a window and what follows it, s.
const SEGMENT_MIN_S: f64 = 1.0;
/// Left out after take-off and before landing, s: the floor acts, and the stated time is rough.
const EDGE_S: f64 = 0.5;
/// Without a word from the vehicle, in the air means a mean output above this.
const OUTPUT_IN_AIR: f64 = 0.15;
/// And higher than this, m.
const HEIGHT_IN_AIR: f64 = 0.1;

/// Time left out of a flight and why.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Exclusion {
    /// Why.
    pub reason: String,
    /// For how long, s.
    pub seconds: f64,
}

/// Why nothing of a flight can be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unusable {
    /// A stream that is needed is missing.
    #[error("the log has no {0}")]
    Missing(&'static str),
    /// Its motor outputs mean nothing.
    #[error(transparent)]
    Unit(#[from] UnitUnknown),
    /// Nothing is left.
    #[error("only {usable_s:.1} s of {total_s:.1} s are usable; at least {needed_s} s are needed")]
    TooShort {
        /// What is left, s.
        usable_s: f64,
        /// How long the log is, s.
        total_s: f64,
        /// What would do, s.
        needed_s: f64,
    },
}

/// The usable parts of a flight.
#[derive(Clone, Debug, Default)]
pub struct Segments {
    /// In the air, without gaps: start to end, s.
    pub spans: Vec<Range<f64>>,
    /// What was left out.
    pub excluded: Vec<Exclusion>,
}

impl Segments {
    /// Least length of what is used of a flight, s.
    pub const USABLE_MIN_S: f64 = 3.0;

    /// The flight's usable parts.
    ///
    /// # Errors
    /// [`Unusable`].
    pub fn of(flight: &Flight) -> Result<Self, Unusable> {
        let whole = span(&flight.attitude).ok_or(Unusable::Missing("attitude"))?;
        for (stream, name) in [
            (span(&flight.velocity), "velocity"),
            (span(&flight.body_rate), "body rate"),
            (
                span(&flight.setpoint).or(span(&flight.outputs)).or(span(&flight.rotor_speed)),
                "attitude setpoint, motor output or rotor speed",
            ),
        ] {
            stream.ok_or(Unusable::Missing(name))?;
        }
        let total_s = whole.end - whole.start;
        let mut segments = Self { spans: vec![whole], excluded: Vec::new() };

        let in_air = in_air(flight);
        segments.keep(&in_air, "on the ground, taking off or landing");
        for (name, spans) in [
            ("attitude", unbroken(&flight.attitude)),
            ("velocity", unbroken(&flight.velocity)),
            ("body rate", unbroken(&flight.body_rate)),
        ] {
            segments.keep(&spans, &format!("gap in the {name}"));
        }
        let commands = [unbroken(&flight.setpoint), unbroken(&flight.outputs)].concat();
        if !commands.is_empty() {
            segments.keep(&merged(commands), "no setpoint and no motor output");
        }
        let (long, short): (Vec<_>, Vec<_>) =
            segments.spans.iter().cloned().partition(|span| span.end - span.start >= SEGMENT_MIN_S);
        segments.spans = long;
        segments.exclude("pieces of less than a second", length(&short));

        let usable_s = length(&segments.spans);
        if usable_s < Self::USABLE_MIN_S {
            return Err(Unusable::TooShort { usable_s, total_s, needed_s: Self::USABLE_MIN_S });
        }
        Ok(segments)
    }

    /// Keeps what lies in `spans` too.
    fn keep(&mut self, spans: &[Range<f64>], reason: &str) {
        let before = length(&self.spans);
        let mut kept = Vec::new();
        for a in &self.spans {
            for b in spans {
                let both = a.start.max(b.start)..a.end.min(b.end);
                if both.start < both.end {
                    kept.push(both);
                }
            }
        }
        self.spans = kept;
        self.exclude(reason, before - length(&self.spans));
    }

    /// Notes that `seconds` were left out.
    pub fn exclude(&mut self, reason: &str, seconds: f64) {
        if seconds > 1e-9 {
            self.excluded.push(Exclusion { reason: reason.to_owned(), seconds });
        }
    }

    /// Length of the usable parts, s.
    pub fn seconds(&self) -> f64 {
        length(&self.spans)
    }
}

fn length(spans: &[Range<f64>]) -> f64 {
    spans.iter().map(|span| span.end - span.start).sum()
}

fn span<T>(stream: &Stream<T>) -> Option<Range<f64>> {
    Some(*stream.times().first()?..*stream.times().last()?)
}

/// Parts of a stream between its gaps.
fn unbroken<T>(stream: &Stream<T>) -> Vec<Range<f64>> {
    let Some(period) = stream.period() else { return Vec::new() };
    let limit = (GAP_PERIODS * period).min(GAP_MAX_S).max(1.5 * period);
    let mut spans = Vec::new();
    let mut start = stream.times()[0];
    for pair in stream.times().windows(2) {
        if pair[1] - pair[0] > limit {
            spans.push(start..pair[0]);
            start = pair[1];
        }
    }
    spans.push(start..stream.times()[stream.len() - 1]);
    spans
}

/// The union of spans, in order.
fn merged(mut spans: Vec<Range<f64>>) -> Vec<Range<f64>> {
    spans.sort_by(|a, b| a.start.total_cmp(&b.start));
    let mut union: Vec<Range<f64>> = Vec::new();
    for span in spans {
        match union.last_mut() {
            Some(last) if span.start <= last.end => last.end = last.end.max(span.end),
            _ => union.push(span),
        }
    }
    union
}

/// When the vehicle flew, without the edges. What it says itself wins.
fn in_air(flight: &Flight) -> Vec<Range<f64>> {
    let lowest = flight.position.values().iter().map(|p| -p.down()).fold(f64::INFINITY, f64::min);
    let mut said: Vec<(f64, bool)> = flight.in_air.iter().map(|(t, air)| (t, *air)).collect();
    let mut edge = EDGE_S;
    if said.is_empty() {
        // Logs that were cut to their flight have no ground to leave out.
        edge = 0.0;
        said = if flight.outputs.is_empty() {
            flight.position.iter().map(|(t, p)| (t, -p.down() > HEIGHT_IN_AIR)).collect()
        } else {
            let height = |time| flight.position.held_at(time).map(|p| -p.down());
            let high =
                |time| lowest > HEIGHT_IN_AIR || height(time).is_none_or(|h| h > HEIGHT_IN_AIR);
            let lifts = |u: &[f64; 4]| u.iter().sum::<f64>() > 4.0 * OUTPUT_IN_AIR;
            flight.outputs.iter().map(|(t, u)| (t, lifts(u) && high(t))).collect()
        };
    }
    let mut spans = Vec::new();
    let mut since: Option<f64> = None;
    for (time, air) in &said {
        match (since, air) {
            (None, true) => since = Some(*time),
            (Some(start), false) => {
                spans.push(start + edge..time - edge);
                since = None;
            }
            _ => {}
        }
    }
    if let (Some(start), Some(end)) = (since, flight.attitude.times().last()) {
        spans.push(start + edge..*end);
    }
    spans.retain(|span| span.start < span.end);
    spans
}
