//! One flight of a comparison: its errors along an axis that flights share, and its numbers.

use std::collections::BTreeMap;
use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Ned, wrap_angle};

use crate::report::flight::{FlightReport, Row};
use crate::report::recording::Recording;

/// What flights are laid side by side along.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// Time since the trajectory's start, or since take-off where the log knows no trajectory.
    #[default]
    Time,
    /// Way along the desired path, or along the flown one where none is known.
    Position,
    /// Share of the time between start and end.
    Phase,
}

impl Alignment {
    /// Name and unit.
    pub(super) fn label(self) -> &'static str {
        match self {
            Self::Time => "time since the start of the trajectory (s)",
            Self::Position => "distance along the path (m)",
            Self::Phase => "phase of the trajectory (0..1)",
        }
    }
}

/// A number of a flight that flights are compared by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Metric {
    /// The order of the tables; the first that all flights have decides.
    pub order: u8,
    pub name: &'static str,
    pub unit: &'static str,
    /// Whether more is worse; `None` where it is only other.
    pub more_is_worse: Option<bool>,
}

const fn error(order: u8, name: &'static str, unit: &'static str) -> Metric {
    Metric { order, name, unit, more_is_worse: Some(true) }
}

const POSITION: Metric = error(0, "position error, 3D, RMS", "m");
const TILT: Metric = error(1, "tilt error, RMS", "rad");
const RATE: Metric = error(2, "body rate error, RMS", "rad/s");
const POSITION_MAX: Metric = error(3, "position error, 3D, greatest", "m");
/// Root mean squares along single axes, by the names of [`Signal`]s.
const AXES: [(&str, Metric); 10] = [
    ("position north", error(4, "position error, north, RMS", "m")),
    ("position east", error(5, "position error, east, RMS", "m")),
    ("position down", error(6, "position error, down, RMS", "m")),
    ("yaw", error(7, "yaw error, RMS", "rad")),
    ("attitude roll", error(8, "roll error, RMS", "rad")),
    ("attitude pitch", error(9, "pitch error, RMS", "rad")),
    ("attitude yaw", error(10, "yaw error, RMS", "rad")),
    ("body rate roll", error(11, "roll rate error, RMS", "rad/s")),
    ("body rate pitch", error(12, "pitch rate error, RMS", "rad/s")),
    ("body rate yaw", error(13, "yaw rate error, RMS", "rad/s")),
];
const HOVER: Metric =
    Metric { order: 20, name: "output in hover", unit: "0..1", more_is_worse: None };
const HEADROOM: Metric =
    Metric { order: 21, name: "least headroom", unit: "0..1", more_is_worse: Some(false) };
const VIBRATION: Metric = error(22, "vibration, RMS", "m/s\u{b2}");
const VOLTAGE: Metric = Metric { order: 23, name: "least voltage", unit: "V", more_is_worse: None };

/// A signed error over time.
#[derive(Clone, Debug)]
pub(super) struct Signal {
    pub axis: &'static str,
    pub unit: &'static str,
    /// Since the flight's start, s.
    pub time: Vec<f64>,
    pub error: Vec<f64>,
}

/// A tick along a trajectory.
struct Point {
    time_s: f64,
    flown: Ned,
    desired: Ned,
    yaw_error_rad: f64,
}

impl Point {
    fn of(row: &Row) -> Option<Self> {
        let reference = row.followed().filter(|r| r.trajectory_time_s.is_finite())?;
        let state = &row.state;
        let point = Self {
            time_s: reference.trajectory_time_s,
            flown: Ned::new(state.p_n_m, state.p_e_m, state.p_d_m),
            desired: Ned::new(reference.p_n_m, reference.p_e_m, reference.p_d_m),
            yaw_error_rad: wrap_angle(state.yaw_rad - reference.yaw_rad),
        };
        (point.error().is_finite() && point.yaw_error_rad.is_finite()).then_some(point)
    }

    fn error(&self) -> Ned {
        self.flown - self.desired
    }
}

/// One flight of a comparison.
#[derive(Clone, Debug)]
pub struct Entry {
    /// The log's path, as given.
    pub log: String,
    /// Its name on the page: the file name without extension, or the end of the path if another
    /// flight has that name.
    pub name: String,
    /// What is known of vehicle, settings and versions.
    pub facts: BTreeMap<String, String>,
    pub(super) signals: Vec<Signal>,
    pub(super) metrics: BTreeMap<Metric, f64>,
    /// Positions over time since the start, and those that were wanted.
    pub(super) flown: Vec<(f64, Ned)>,
    pub(super) desired: Vec<(f64, Ned)>,
    /// Length of what is compared, s.
    pub(super) duration_s: f64,
}

impl Entry {
    /// A flight of this program along a trajectory; `None` if none was followed.
    pub fn own(
        log: &Path,
        report: &FlightReport,
        recording: Option<&Recording>,
        facts: BTreeMap<String, String>,
    ) -> Option<Self> {
        let points: Vec<Point> = report.rows.iter().filter_map(Point::of).collect();
        let start = points.first()?.time_s;
        let time: Vec<f64> = points.iter().map(|point| point.time_s - start).collect();
        let signal = |axis, unit, error: fn(&Point) -> f64| Signal {
            axis,
            unit,
            time: time.clone(),
            error: points.iter().map(error).collect(),
        };
        let signals = vec![
            signal("position north", "m", |point| point.error().north()),
            signal("position east", "m", |point| point.error().east()),
            signal("position down", "m", |point| point.error().down()),
            signal("yaw", "rad", |point| point.yaw_error_rad),
        ];
        let place = |which: fn(&Point) -> Ned| {
            points.iter().zip(&time).map(|(point, time)| (*time, which(point))).collect()
        };
        let mut entry = Self {
            signals,
            flown: place(|point| point.flown),
            desired: place(|point| point.desired),
            duration_s: time.last().copied().unwrap_or(0.0),
            ..Self::of(log, facts)
        };
        entry.measure(recording);
        Some(entry)
    }

    /// A flight of any log, from when it is in the air, as far as the log says.
    pub fn recorded(log: &Path, recording: &Recording, facts: BTreeMap<String, String>) -> Self {
        let flight = &recording.flight;
        let mut up = flight.in_air.iter().filter(|(_, is_up)| **is_up).map(|(time, _)| time);
        let (start, end) = match up.next() {
            Some(first) => (first, up.last().unwrap_or(recording.span.1)),
            None => recording.span,
        };
        let inside = |time: f64| time >= start && time <= end;
        let signals = recording.tracked().into_iter().map(|tracked| {
            let errors = tracked.errors();
            let kept = tracked.time.iter().zip(errors).filter(|(time, _)| inside(**time));
            let (time, error) = kept.map(|(time, error)| (time - start, error)).unzip();
            Signal { axis: tracked.axis, unit: tracked.unit, time, error }
        });
        let position = flight.position.iter().filter(|(time, _)| inside(*time));
        let references = flight.reference.iter().filter(|(time, _)| inside(*time));
        let mut entry = Self {
            signals: signals.collect(),
            flown: position.map(|(time, p)| (time - start, *p)).collect(),
            desired: references.map(|(time, r)| (time - start, r.position)).collect(),
            duration_s: end - start,
            ..Self::of(log, facts)
        };
        entry.measure(Some(recording));
        entry
    }

    /// A flight of which nothing but the facts is known.
    fn of(log: &Path, facts: BTreeMap<String, String>) -> Self {
        Self {
            log: log.display().to_string(),
            name: log.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            facts,
            signals: Vec::new(),
            metrics: BTreeMap::new(),
            flown: Vec::new(),
            desired: Vec::new(),
            duration_s: 0.0,
        }
    }

    fn measure(&mut self, recording: Option<&Recording>) {
        let mut metrics = BTreeMap::new();
        for (axis, metric) in AXES {
            if let Some(value) = self.rms(&[axis]) {
                metrics.insert(metric, value);
            }
        }
        let together = [
            (POSITION, &["position north", "position east", "position down"][..]),
            (TILT, &["attitude roll", "attitude pitch"]),
            (RATE, &["body rate roll", "body rate pitch", "body rate yaw"]),
        ];
        for (metric, axes) in together {
            if let Some(value) = self.rms(axes) {
                metrics.insert(metric, value);
            }
        }
        let position: Vec<&Signal> =
            self.signals.iter().filter(|signal| signal.axis.starts_with("position")).collect();
        if let [north, east, down] = position.as_slice() {
            let errors = north.error.iter().zip(&east.error).zip(&down.error);
            let far =
                errors.map(|((n, e), d)| Ned::new(*n, *e, *d).norm()).filter(|d| d.is_finite());
            if let Some(most) = far.reduce(f64::max) {
                metrics.insert(POSITION_MAX, most);
            }
        }
        if let Some(summary) = recording.map(Recording::summary) {
            if let Some(motors) = &summary.motors {
                metrics.insert(HOVER, motors.hover);
                metrics.insert(HEADROOM, motors.headroom_min);
            }
            if let Some(shaken) = summary.vibration_m_s2 {
                metrics.insert(VIBRATION, shaken.iter().map(|v| v * v).sum::<f64>().sqrt());
            }
            if let Some(pack) = summary.battery {
                metrics.insert(VOLTAGE, pack.min_v);
            }
        }
        self.metrics = metrics;
    }

    /// Root mean square of the length of these axes' errors.
    fn rms(&self, axes: &[&str]) -> Option<f64> {
        let mut sum = 0.0;
        for axis in axes {
            let signal = self.signals.iter().find(|signal| signal.axis == *axis)?;
            let errors: Vec<f64> = signal.error.iter().copied().filter(|e| e.is_finite()).collect();
            if errors.is_empty() {
                return None;
            }
            sum += errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64;
        }
        Some(sum.sqrt())
    }

    /// Where on the shared axis each of these times is.
    pub(super) fn places(&self, alignment: Alignment, times: &[f64]) -> Vec<f64> {
        match alignment {
            Alignment::Time => times.to_vec(),
            Alignment::Phase => {
                let length = self.duration_s.max(f64::MIN_POSITIVE);
                times.iter().map(|time| time / length).collect()
            }
            Alignment::Position => {
                let path = if self.desired.is_empty() { &self.flown } else { &self.desired };
                let mut way = Vec::with_capacity(path.len());
                let mut length = 0.0;
                let mut last: Option<Ned> = None;
                for (time, point) in path {
                    length += last.map_or(0.0, |last| (*point - last).norm());
                    last = Some(*point);
                    way.push((*time, length));
                }
                times.iter().map(|time| at(&way, *time)).collect()
            }
        }
    }

    /// A signal's errors at places of the shared axis; NaN beyond its ends.
    pub(super) fn along(
        &self,
        axis: &str,
        alignment: Alignment,
        places: &[f64],
    ) -> Option<Vec<f64>> {
        let signal = self.signals.iter().find(|signal| signal.axis == axis)?;
        let own = self.places(alignment, &signal.time);
        let line: Vec<(f64, f64)> = own
            .into_iter()
            .zip(signal.error.iter().copied())
            .filter(|(place, error)| place.is_finite() && error.is_finite())
            .collect();
        Some(places.iter().map(|place| at(&line, *place)).collect())
    }

    /// How far the shared axis goes in this flight.
    pub(super) fn reach(&self, alignment: Alignment) -> f64 {
        let ends = self.places(alignment, &[self.duration_s]);
        ends.first().copied().filter(|end| end.is_finite()).unwrap_or(0.0)
    }
}

/// A line through points at `x`, NaN beyond its ends.
fn at(line: &[(f64, f64)], x: f64) -> f64 {
    let next = line.partition_point(|(place, _)| *place < x);
    match (next.checked_sub(1).and_then(|i| line.get(i)), line.get(next)) {
        (_, Some((place, value))) if *place == x => *value,
        (Some((a, from)), Some((b, to))) => from + (to - from) * (x - a) / (b - a),
        // Rounding must not lose the end.
        (Some((place, value)), None) if x - place <= 1e-6 * place.abs() => *value,
        _ => f64::NAN,
    }
}

#[cfg(test)]
impl Entry {
    /// A flight of ten seconds that stays this far north of where it should be.
    pub(super) fn constant(name: &str, error_m: f64, facts: BTreeMap<String, String>) -> Self {
        let time: Vec<f64> = (0..=100).map(|k| 0.1 * f64::from(k)).collect();
        let signal = |axis, error: f64| Signal {
            axis,
            unit: "m",
            time: time.clone(),
            error: vec![error; time.len()],
        };
        let signals = vec![
            signal("position north", error_m),
            signal("position east", 0.0),
            signal("position down", 0.0),
        ];
        let path = |north: f64| time.iter().map(|t| (*t, Ned::new(north, 2.0 * t, -1.0))).collect();
        let mut entry = Self {
            signals,
            flown: path(error_m),
            desired: path(0.0),
            duration_s: 10.0,
            ..Self::of(Path::new(name), facts)
        };
        entry.measure(None);
        entry
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_align_by_time_position_and_phase() {
        let mut entry = Entry::constant("a", 0.1, BTreeMap::new());
        for (time, error) in entry.signals[0].time.clone().iter().zip(&mut entry.signals[0].error) {
            *error = *time;
        }
        for (alignment, places) in [
            (Alignment::Time, [0.0, 5.0, 10.0]),
            (Alignment::Position, [0.0, 10.0, 20.0]),
            (Alignment::Phase, [0.0, 0.5, 1.0]),
        ] {
            let along = entry.along("position north", alignment, &places).expect("the axis");
            for (found, expected) in along.iter().zip([0.0, 5.0, 10.0]) {
                assert!((found - expected).abs() < 1e-6, "{alignment:?}: {along:?}");
            }
            assert!((entry.reach(alignment) - places[2]).abs() < 1e-6);
            let beyond =
                entry.along("position north", alignment, &[1.2 * places[2]]).expect("the axis");
            assert!(beyond[0].is_nan());
        }
        assert!(entry.along("yaw", Alignment::Time, &[0.0]).is_none());
    }
}
