//! Selection of the usable parts of a flight.

use std::ops::Range;

use schemars::JsonSchema;
use serde::Serialize;

use super::commands::CommandSource;
use super::gaps::{PERIOD_MAX_S, intersection, length, unbroken};
use crate::log::import::{Flight, Stream, UnitUnknown};

/// Shorter pieces have no room for a window and a prediction, s.
const SEGMENT_MIN_S: f64 = 1.0;
/// Time left out after take-off and before landing, s: ground effect acts, and the reported time is
/// imprecise.
const EDGE_S: f64 = 0.5;
/// If the vehicle does not report whether it is in the air, it counts as flying above this fraction
/// of the mean hover output,
const HOVER_SHARE_IN_AIR: f64 = 0.25;
/// and above this height over the lowest point of the log, m.
const HEIGHT_IN_AIR: f64 = 0.1;
/// Windows extend this far beyond a time, s.
const CUT_MARGIN_S: f64 = 0.05;

/// Time left out of a flight, and the reason.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Exclusion {
    /// The reason.
    pub reason: String,
    /// Total time, s.
    pub seconds: f64,
}

/// A time that must not be used, whatever the other streams show.
#[derive(Clone, Debug, PartialEq)]
pub struct Cut {
    /// The invalid stream, as the audit names it.
    pub stream: &'static str,
    /// The defect.
    pub reason: &'static str,
    /// The times, s.
    pub times: Range<f64>,
}

impl Cut {
    /// Streams that matter only as the source of u, as the audit names them.
    const COMMANDS: [(&str, CommandSource); 3] = [
        ("setpoint", CommandSource::OnboardLaw),
        ("outputs", CommandSource::MotorOutputs),
        ("rotor_speed", CommandSource::RotorSpeeds),
    ];

    /// Whether this stream matters for a flight whose u comes from `source`.
    fn concerns(&self, source: CommandSource) -> bool {
        let commands = Self::COMMANDS.iter().find(|(stream, _)| *stream == self.stream);
        commands.is_none_or(|(_, of)| *of == source)
    }
}

/// Why a flight is not usable.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unusable {
    /// A required stream is missing.
    #[error("the log has no {0}")]
    Missing(&'static str),
    /// A stream is too slow.
    #[error(
        "its {stream} arrives every {period_s:.3} s, expected every {PERIOD_MAX_S} s or faster; \
         log it faster, or correct the unit of its times"
    )]
    Slow {
        /// The stream.
        stream: &'static str,
        /// Its median period, s.
        period_s: f64,
    },
    /// The unit of its motor outputs is unknown.
    #[error(transparent)]
    Unit(#[from] UnitUnknown),
    /// Too little is left.
    #[error(
        "only {usable_s:.1} s of {total_s:.1} s is usable; at least {needed_s} s is needed{}",
        most.as_ref().map_or(String::new(), |most| {
            format!(" (most excluded: {}, {:.1} s)", most.reason, most.seconds)
        })
    )]
    TooShort {
        /// Usable time, s.
        usable_s: f64,
        /// Length of the log, s.
        total_s: f64,
        /// Time required, s.
        needed_s: f64,
        /// The exclusion with the longest time.
        most: Option<Exclusion>,
    },
}

/// The usable parts of a flight.
#[derive(Clone, Debug, Default)]
pub struct Segments {
    /// In the air, without gaps: start to end, s.
    pub spans: Vec<Range<f64>>,
    /// The excluded times.
    pub excluded: Vec<Exclusion>,
}

impl Segments {
    /// Least usable time of a flight, s.
    const USABLE_MIN_S: f64 = 3.0;

    /// The flight's usable parts, where setpoints or motor outputs, if logged, have no gap. If the
    /// vehicle does not report when it flew, `hover` is the mean output that carries it.
    ///
    /// # Errors
    /// [`Unusable`].
    pub fn of(flight: &Flight, hover: f64) -> Result<Self, Unusable> {
        Self::check_streams(flight)?;
        let mut segments = Self::of_motion(flight, hover)?;
        let commands = [unbroken(&flight.setpoint), unbroken(&flight.outputs)].concat();
        if !commands.is_empty() {
            segments.keep(&merged(commands), "no setpoint and no motor output");
        }
        segments.checked(flight)
    }

    /// The usable parts of a flight whose u comes from `source`, without the times in `cuts`. The
    /// caller must have [checked](Self::check_streams) its streams.
    ///
    /// # Errors
    /// [`Unusable`].
    pub fn driven(
        flight: &Flight,
        hover: f64,
        source: CommandSource,
        cuts: &[Cut],
    ) -> Result<Self, Unusable> {
        let mut segments = Self::of_motion(flight, hover)?;
        segments.keep(&source.unbroken(flight), &format!("gap in the {}", source.stream()));
        for cut in cuts.iter().filter(|cut| cut.concerns(source)) {
            let (start, end) = (cut.times.start - CUT_MARGIN_S, cut.times.end + CUT_MARGIN_S);
            let rest = [f64::NEG_INFINITY..start, end..f64::INFINITY];
            segments.keep(&rest, &format!("{}: {}", cut.stream.replace('_', " "), cut.reason));
        }
        segments.checked(flight)
    }

    /// Checks that a flight has the required streams at sufficient rates.
    ///
    /// # Errors
    /// [`Unusable::Missing`] and [`Unusable::Slow`].
    pub fn check_streams(flight: &Flight) -> Result<(), Unusable> {
        let commands =
            span(&flight.setpoint).or(span(&flight.outputs)).or(span(&flight.rotor_speed));
        for (stream, name) in [
            (span(&flight.attitude), "attitude"),
            (span(&flight.velocity), "velocity"),
            (span(&flight.body_rate), "body rate"),
            (commands, "attitude setpoint, motor output or rotor speed"),
        ] {
            stream.ok_or(Unusable::Missing(name))?;
        }
        for (period, stream) in [
            (flight.attitude.period(), "attitude"),
            (flight.velocity.period(), "velocity"),
            (flight.body_rate.period(), "body rate"),
        ] {
            if let Some(period_s) = period.filter(|period| *period > PERIOD_MAX_S) {
                return Err(Unusable::Slow { stream, period_s });
            }
        }
        Ok(())
    }

    /// The times when the vehicle flew and every stream of its motion has no gap.
    fn of_motion(flight: &Flight, hover: f64) -> Result<Self, Unusable> {
        let full = span(&flight.attitude).ok_or(Unusable::Missing("attitude"))?;
        let mut segments = Self { spans: vec![full], excluded: Vec::new() };
        let in_air = in_air(flight, HOVER_SHARE_IN_AIR * hover);
        segments.keep(&in_air, "on the ground, taking off or landing");
        for (name, spans) in [
            ("attitude", unbroken(&flight.attitude)),
            ("velocity", unbroken(&flight.velocity)),
            ("body rate", unbroken(&flight.body_rate)),
        ] {
            segments.keep(&spans, &format!("gap in the {name}"));
        }
        Ok(segments)
    }

    /// Drops pieces that are too short, and checks that enough is left.
    fn checked(mut self, flight: &Flight) -> Result<Self, Unusable> {
        let (long, short): (Vec<_>, Vec<_>) =
            self.spans.iter().cloned().partition(|span| span.end - span.start >= SEGMENT_MIN_S);
        self.spans = long;
        self.exclude("pieces of less than a second", length(&short));
        let usable_s = length(&self.spans);
        if usable_s < Self::USABLE_MIN_S {
            let most = self.excluded.iter().max_by(|a, b| a.seconds.total_cmp(&b.seconds));
            return Err(Unusable::TooShort {
                usable_s,
                total_s: span(&flight.attitude).map_or(0.0, |full| full.end - full.start),
                needed_s: Self::USABLE_MIN_S,
                most: most.cloned(),
            });
        }
        Ok(self)
    }

    /// Keeps only the intersection with `spans`.
    fn keep(&mut self, spans: &[Range<f64>], reason: &str) {
        let before = length(&self.spans);
        self.spans = intersection(&self.spans, spans);
        self.exclude(reason, before - length(&self.spans));
    }

    /// Records that `seconds` were left out.
    pub fn exclude(&mut self, reason: &str, seconds: f64) {
        if seconds <= 1e-9 {
            return;
        }
        match self.excluded.iter_mut().find(|known| known.reason == reason) {
            Some(known) => known.seconds += seconds,
            None => self.excluded.push(Exclusion { reason: reason.to_owned(), seconds }),
        }
    }

    /// Total length of the usable parts, s.
    pub fn seconds(&self) -> f64 {
        length(&self.spans)
    }
}

fn span<T>(stream: &Stream<T>) -> Option<Range<f64>> {
    Some(*stream.times().first()?..*stream.times().last()?)
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

/// When the vehicle flew, without the edges. The vehicle's own report has priority; otherwise a
/// mean output above `lifts` counts, if outputs are logged.
pub(crate) fn in_air(flight: &Flight, lifts: f64) -> Vec<Range<f64>> {
    let mut states: Vec<(f64, bool)> = flight.in_air.iter().map(|(t, air)| (t, *air)).collect();
    let mut edge = EDGE_S;
    if states.is_empty() {
        // Logs that were cut to their flight contain no time on the ground.
        edge = 0.0;
        let heights = flight.position.values().iter().map(|p| -p.down());
        let lowest = heights.fold(f64::INFINITY, f64::min);
        // The world's origin need not be on the floor.
        let floor = if lowest > HEIGHT_IN_AIR { f64::NEG_INFINITY } else { lowest };
        let high = |height: f64| height > floor + HEIGHT_IN_AIR;
        states = if flight.outputs.is_empty() {
            flight.position.iter().map(|(t, p)| (t, high(-p.down()))).collect()
        } else {
            let height = |time| flight.position.held_at(time).map(|p| -p.down());
            let flies = |time, u: &[f64; 4]| {
                u.iter().sum::<f64>() > 4.0 * lifts && height(time).is_none_or(high)
            };
            flight.outputs.iter().map(|(t, u)| (t, flies(t, u))).collect()
        };
    }
    let mut spans = Vec::new();
    let mut since: Option<f64> = None;
    for (time, air) in &states {
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

#[cfg(test)]
mod tests {
    use vehicle::frame::{Attitude, Frd, Ned};

    use super::*;
    use crate::audit::Audit;
    use crate::log::import::AttitudeSetpoint;

    /// Mean output that hovers.
    const HOVER: f64 = 0.5;
    const LEVEL: Attitude = Attitude { w: 1.0, x: 0.0, y: 0.0, z: 0.0 };

    fn empty() -> Flight {
        Flight::in_memory("a", "csv")
    }

    /// A flight with a sample of every stream at each of `times`, at `height` (m).
    fn flight(times: impl Iterator<Item = f64>, height: f64) -> Flight {
        let mut flight = empty();
        let setpoint =
            AttitudeSetpoint { attitude: Some(LEVEL), body_rate: None, thrust: Some(HOVER) };
        for time in times {
            flight.attitude.push(time, LEVEL);
            flight.position.push(time, Ned::new(0.0, 0.0, -height));
            flight.velocity.push(time, Ned::zero());
            flight.body_rate.push(time, Frd::zero());
            flight.outputs.push(time, [HOVER; 4]);
            flight.setpoint.push(time, setpoint);
        }
        flight
    }

    fn every_10_ms(seconds: u32) -> impl Iterator<Item = f64> {
        (0..=100 * seconds).map(|k| f64::from(k) * 0.01)
    }

    fn driven(flight: &Flight, source: CommandSource) -> Result<Segments, Unusable> {
        Segments::check_streams(flight)?;
        Segments::driven(flight, HOVER, source, &[])
    }

    fn without<T: Clone>(stream: &Stream<T>, times: Range<f64>) -> Stream<T> {
        let mut kept = Stream::default();
        for (time, value) in stream.iter().filter(|(time, _)| !times.contains(time)) {
            kept.push(time, value.clone());
        }
        kept
    }

    #[test]
    fn gap_in_the_input_is_excluded_despite_other_commands() {
        for source in [CommandSource::OnboardLaw, CommandSource::MotorOutputs] {
            let mut flight = flight(every_10_ms(20), 1.0);
            match source {
                CommandSource::OnboardLaw => {
                    flight.setpoint = without(&flight.setpoint, 5.0..11.0);
                }
                _ => flight.outputs = without(&flight.outputs, 5.0..11.0),
            }
            let segments = driven(&flight, source).expect("enough");
            assert_eq!(segments.spans.len(), 2, "{segments:?}");
            assert!((segments.seconds() - 13.99).abs() < 0.03, "{segments:?}");
            assert!(segments.excluded[0].reason.contains(source.stream()), "{segments:?}");
            assert_eq!(Segments::of(&flight, HOVER).expect("enough").spans.len(), 1);
        }
    }

    #[test]
    fn setpoint_holds_until_it_is_too_old() {
        let mut flight = flight(every_10_ms(10), 1.0);
        flight.setpoint = without(&flight.setpoint, 5.005..5.075);
        let law = |flight: &Flight| driven(flight, CommandSource::OnboardLaw).expect("enough");
        assert_eq!(law(&flight).spans.len(), 1);
        flight.setpoint = without(&flight.setpoint, 5.005..5.115);
        assert_eq!(law(&flight).spans.len(), 2);
    }

    #[test]
    fn clock_jump_splits_a_flight_and_wrong_unit_is_named() {
        let jump = every_10_ms(20).map(|t| if t < 10.0 { t } else { t + 1e9 });
        let segments = driven(&flight(jump, 1.0), CommandSource::MotorOutputs).expect("enough");
        assert_eq!(segments.spans.len(), 2);
        assert!((segments.seconds() - 19.99).abs() < 0.01);
        let milliseconds = every_10_ms(20).map(|t| 1e3 * t);
        let error = driven(&flight(milliseconds, 1.0), CommandSource::MotorOutputs);
        let error = error.expect_err("too slow").to_string();
        assert!(error.contains("every 10.000 s") && error.contains("unit"), "{error}");
    }

    #[test]
    fn floor_height_need_not_be_zero() {
        let mut flight = flight(every_10_ms(10), 0.0);
        let heights = flight.position.times().to_vec();
        flight.position = Stream::default();
        for time in heights {
            let height = if time < 2.0 { -3.0 } else { -2.0 };
            flight.position.push(time, Ned::new(0.0, 0.0, -height));
        }
        let segments = driven(&flight, CommandSource::MotorOutputs).expect("enough");
        assert!((segments.seconds() - 8.0).abs() < 0.02, "{segments:?}");
    }

    #[test]
    fn strong_vehicle_counts_as_flying_at_low_outputs() {
        let mut flight = flight(every_10_ms(10), 1.0);
        flight.outputs = flight.outputs.map(|_| [0.12; 4]);
        let seconds = |hover| {
            let segments = Segments::driven(&flight, hover, CommandSource::MotorOutputs, &[]);
            segments.map(|segments| segments.seconds())
        };
        assert!((seconds(0.12).expect("enough") - 10.0).abs() < 0.01);
        let error = seconds(0.6).expect_err("on the ground").to_string();
        assert!(error.starts_with("only 0.0 s of 10.0 s"), "{error}");
        assert!(error.contains("on the ground, taking off or landing, 10.0 s"), "{error}");
    }

    #[test]
    fn cuts_apply_only_to_streams_in_use() {
        let flight = flight(every_10_ms(20), 1.0);
        let cut = |stream| Cut { stream, reason: "frozen", times: 5.0..8.0 };
        let seconds = |stream| {
            let source = CommandSource::OnboardLaw;
            let segments = Segments::driven(&flight, HOVER, source, &[cut(stream)]);
            let segments = segments.expect("enough");
            (segments.seconds(), segments.excluded)
        };
        let (left, excluded) = seconds("body_rate");
        assert!((left - (20.0 - 3.0 - 2.0 * CUT_MARGIN_S)).abs() < 0.01);
        assert_eq!(excluded[0].reason, "body rate: frozen");
        assert!((seconds("outputs").0 - 20.0).abs() < 0.01);
    }

    #[test]
    fn audit_and_cuts_use_the_same_stream_names() {
        let mut flight = flight(every_10_ms(20), 1.0);
        for time in every_10_ms(20) {
            flight.rotor_speed.push(time, [500.0; 4]);
        }
        let audit = Audit::of(&flight);
        for (name, source) in Cut::COMMANDS {
            assert!(audit.streams.iter().any(|timing| timing.stream == name), "{name}");
            let cut = Cut { stream: name, reason: "frozen", times: 5.0..8.0 };
            for other in Cut::COMMANDS.map(|(_, other)| other) {
                assert_eq!(cut.concerns(other), other == source, "{name}");
            }
        }
    }
}
