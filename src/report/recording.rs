//! What a recorded flight shows beside its path, whoever recorded it: motors, pack, vibration, jumps
//! of the estimate, rates of the streams, and errors against the desired motion.

mod jumps;
pub(super) mod vibration;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;
use vehicle::frame::wrap_angle;

pub use self::jumps::Jump;
use super::histogram::quantile;
use crate::log::import::{Flight, MotorUnit, Stream};

/// A motor at more than this share of full is at its limit.
const FULL: f64 = 0.98;
/// Samples further apart than this many periods are not compared.
const PAUSE: f64 = 3.0;
/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.80665;

/// The numbers of a recorded flight, and the JSON beside its report.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct RecordingSummary {
    /// `downwash.report.recording`.
    pub schema: &'static str,
    /// Version of this JSON.
    pub schema_version: u32,
    /// Name of the log without its extension.
    pub run: String,
    /// `mcap`, `tlog`, `ulog`, `dataflash`, `csv`.
    pub format: &'static str,
    /// SHA-256 of the log.
    pub sha256: String,
    /// From the first sample to the last, s.
    pub duration_s: f64,
    /// The streams that the log holds.
    pub streams: Vec<StreamSummary>,
    /// Errors against the desired motion, where the log holds it.
    pub errors: Vec<AxisError>,
    /// Motor outputs, where their range is known.
    pub motors: Option<MotorSummary>,
    /// The pack's voltage, if it was logged.
    pub battery: Option<VoltageSummary>,
    /// Root mean square of the specific force faster than 10 Hz: front, right, down, m/s^2.
    pub vibration_m_s2: Option<[f64; 3]>,
    /// And of the body rate: roll, pitch, yaw, rad/s.
    pub vibration_rad_s: Option<[f64; 3]>,
    /// Steps of the estimate that no motion explains.
    pub jumps: Vec<Jump>,
}

/// A stream of the log.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct StreamSummary {
    /// What it is of.
    pub stream: &'static str,
    /// Number of samples.
    pub samples: usize,
    /// Samples per second over its span.
    pub rate_hz: f64,
    /// Longest time between two samples, s.
    pub longest_gap_s: f64,
}

/// How far one axis was from its desired value.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct AxisError {
    /// `position north`, `attitude roll`, `body rate pitch` and so on.
    pub axis: &'static str,
    /// `m`, `rad` or `rad/s`.
    pub unit: &'static str,
    /// Mean of the measured less the desired value: the bias.
    pub mean: f64,
    /// Root mean square.
    pub rms: f64,
    /// Greatest magnitude.
    pub max: f64,
}

/// Motor outputs as shares of full thrust.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct MotorSummary {
    /// Mean of each motor.
    pub mean: [f64; 4],
    /// Greatest of each motor.
    pub max: [f64; 4],
    /// Least room between the strongest motor and full.
    pub headroom_min: f64,
    /// Share of the time in which any motor is above 98 % of full.
    pub full_share: f64,
    /// Median over the flight of the mean over the motors: hover, in most flights.
    pub hover: f64,
}

/// The pack's voltage.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct VoltageSummary {
    /// At the start, V.
    pub first_v: f64,
    /// At the end, V.
    pub last_v: f64,
    /// Least, V.
    pub min_v: f64,
}

/// A flight with outputs in one unit and times from its first sample on.
#[derive(Clone, Debug)]
pub struct Recording {
    pub(super) flight: Flight,
    /// The vehicle file inside the log.
    pub(super) vehicle: Option<VehicleParams>,
    /// Whether outputs are shares of full thrust; else they are as they were logged.
    pub(super) has_range: bool,
    /// First and last time of any stream on the vehicle's clock, s.
    pub(super) span: (f64, f64),
    summary: RecordingSummary,
}

/// A signal and its setpoint, on the signal's times.
#[derive(Clone, Debug)]
pub(super) struct Tracked {
    pub axis: &'static str,
    pub unit: &'static str,
    pub time: Vec<f64>,
    pub flown: Vec<f64>,
    /// NaN where nothing was desired.
    pub desired: Vec<f64>,
}

impl Tracked {
    /// Flown less desired, where a value was desired.
    pub fn errors(&self) -> Vec<f64> {
        let is_angle = self.unit == "rad";
        let error = |(flown, desired): (&f64, &f64)| match is_angle {
            true => wrap_angle(flown - desired),
            false => flown - desired,
        };
        self.flown.iter().zip(&self.desired).map(error).collect()
    }

    fn summary(&self) -> Option<AxisError> {
        let errors: Vec<f64> = self.errors().into_iter().filter(|e| e.is_finite()).collect();
        let n = errors.len() as f64;
        (!errors.is_empty()).then(|| AxisError {
            axis: self.axis,
            unit: self.unit,
            mean: errors.iter().sum::<f64>() / n,
            rms: (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
            max: errors.iter().fold(0.0, |most, e| e.abs().max(most)),
        })
    }
}

impl Recording {
    /// What `flight` shows.
    pub fn new(mut flight: Flight) -> Self {
        let vehicle = flight.vehicle_file.as_ref().and_then(|text| {
            let is_json = text.trim_start().starts_with('{');
            let read =
                if is_json { VehicleParams::from_json_str } else { VehicleParams::from_toml_str };
            read(text).ok()
        });
        let has_range = match (&vehicle, flight.facts.output_ranges, flight.motor_unit) {
            (Some(vehicle), ..) => flight.normalise_outputs(vehicle).is_ok(),
            (None, Some(ranges), MotorUnit::VehicleFile) => {
                flight.scale_outputs(ranges);
                true
            }
            (None, _, unit) => unit == MotorUnit::ThrustFraction,
        } && !flight.outputs.is_empty();
        let spans = streams(&flight)
            .into_iter()
            .filter_map(|(_, times)| Some((*times.first()?, *times.last()?)));
        let span =
            spans.reduce(|(a, b), (from, to)| (a.min(from), b.max(to))).unwrap_or((0.0, 0.0));
        let summary = RecordingSummary {
            schema: "downwash.report.recording",
            schema_version: 1,
            run: flight.origin.run.clone(),
            format: flight.origin.format,
            sha256: flight.origin.sha256.clone(),
            duration_s: span.1 - span.0,
            streams: stream_summaries(&flight),
            errors: tracked(&flight).iter().filter_map(Tracked::summary).collect(),
            motors: if has_range { motors(&flight.outputs) } else { None },
            battery: battery(&flight.voltage),
            vibration_m_s2: vibration::rms(&flight.specific_force.map(|f| f.to_array())),
            vibration_rad_s: vibration::rms(&flight.body_rate.map(|w| w.to_array())),
            jumps: jumps::jumps(&flight, span.0),
        };
        Self { flight, vehicle, has_range, span, summary }
    }

    /// The numbers.
    pub fn summary(&self) -> &RecordingSummary {
        &self.summary
    }

    /// The motion and the desired one, axis by axis.
    pub(super) fn tracked(&self) -> Vec<Tracked> {
        tracked(&self.flight)
    }
}

/// The streams that are there: names and times.
pub(super) fn streams(flight: &Flight) -> Vec<(&'static str, &[f64])> {
    let all = [
        ("position", flight.position.times()),
        ("velocity", flight.velocity.times()),
        ("attitude", flight.attitude.times()),
        ("body rate", flight.body_rate.times()),
        ("specific force", flight.specific_force.times()),
        ("motor outputs", flight.outputs.times()),
        ("rotor speeds", flight.rotor_speed.times()),
        ("setpoints", flight.setpoint.times()),
        ("voltage", flight.voltage.times()),
    ];
    all.into_iter().filter(|(_, times)| !times.is_empty()).collect()
}

fn stream_summaries(flight: &Flight) -> Vec<StreamSummary> {
    let summary = |(stream, times): (&'static str, &[f64])| {
        let length = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
        let samples = times.len();
        let rate_hz = if length > 0.0 { (samples - 1) as f64 / length } else { 0.0 };
        let longest_gap_s = times.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
        StreamSummary { stream, samples, rate_hz, longest_gap_s }
    };
    streams(flight).into_iter().map(summary).collect()
}

/// A signal against what held at its times.
fn against<T, A>(
    signal: &Stream<T>,
    desired: &Stream<A>,
    names: [(&'static str, &'static str); 3],
    flown: impl Fn(&T) -> [f64; 3],
    axes_of: impl Fn(&A) -> Option<[f64; 3]>,
) -> Vec<Tracked> {
    // A desired value holds for so long.
    let hold = PAUSE * desired.period().unwrap_or(0.1).max(0.05);
    let held: Vec<Option<[f64; 3]>> = signal
        .times()
        .iter()
        .map(|time| {
            let at = desired.index_at(*time)?;
            if time - desired.times().get(at)? > hold {
                return None;
            }
            axes_of(desired.values().get(at)?)
        })
        .collect();
    if held.iter().all(Option::is_none) {
        return Vec::new();
    }
    let tracked = |(axis, (name, unit)): (usize, (&'static str, &'static str))| Tracked {
        axis: name,
        unit,
        time: signal.times().to_vec(),
        flown: signal.values().iter().map(|value| flown(value)[axis]).collect(),
        desired: held.iter().map(|held| held.map_or(f64::NAN, |held| held[axis])).collect(),
    };
    names.into_iter().enumerate().map(tracked).collect()
}

fn tracked(flight: &Flight) -> Vec<Tracked> {
    let euler = |q: &vehicle::frame::Attitude| {
        let angles = q.euler();
        [angles.roll, angles.pitch, angles.yaw]
    };
    let mut all = against(
        &flight.position,
        &flight.reference,
        [("position north", "m"), ("position east", "m"), ("position down", "m")],
        |p| p.to_array(),
        |r| Some(r.position.to_array()),
    );
    all.extend(against(
        &flight.attitude,
        &flight.setpoint,
        [("attitude roll", "rad"), ("attitude pitch", "rad"), ("attitude yaw", "rad")],
        euler,
        |s| s.attitude.as_ref().map(euler),
    ));
    all.extend(against(
        &flight.body_rate,
        &flight.setpoint,
        [("body rate roll", "rad/s"), ("body rate pitch", "rad/s"), ("body rate yaw", "rad/s")],
        |w| w.to_array(),
        |s| s.body_rate.map(|w| w.to_array()),
    ));
    all
}

fn motors(outputs: &Stream<[f64; 4]>) -> Option<MotorSummary> {
    // On the ground motors stand or idle.
    let flying: Vec<&[f64; 4]> =
        outputs.values().iter().filter(|u| u.iter().sum::<f64>() > 0.2).collect();
    let n = flying.len() as f64;
    let strongest = |u: &[f64; 4]| u.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut means: Vec<f64> = flying.iter().map(|u| u.iter().sum::<f64>() / 4.0).collect();
    means.sort_by(f64::total_cmp);
    let hover = quantile(&means, 0.5)?;
    let column = |i: usize| flying.iter().map(move |u| u[i]);
    Some(MotorSummary {
        mean: std::array::from_fn(|i| column(i).sum::<f64>() / n),
        max: std::array::from_fn(|i| column(i).fold(0.0, f64::max)),
        headroom_min: flying.iter().map(|u| 1.0 - strongest(u)).fold(1.0, f64::min),
        full_share: flying.iter().filter(|u| strongest(u) > FULL).count() as f64 / n,
        hover,
    })
}

fn battery(voltage: &Stream<f64>) -> Option<VoltageSummary> {
    let (first, last) = voltage.values().first().zip(voltage.values().last())?;
    let min_v = voltage.values().iter().copied().fold(f64::INFINITY, f64::min);
    Some(VoltageSummary { first_v: *first, last_v: *last, min_v })
}

/// The accelerometer's thrust over weight: 1 in hover.
pub(super) fn load_factor(flight: &Flight) -> (Vec<f64>, Vec<f64>) {
    let force = &flight.specific_force;
    let load = force.values().iter().map(|f| -f.down() / GRAVITY).collect();
    (force.times().to_vec(), load)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;
    use crate::log::import::{Clock, Origin};

    pub(super) fn empty() -> Flight {
        let (path, run) = (PathBuf::from("a.tlog"), "a".to_owned());
        let origin = Origin { path, run, sha256: String::new(), format: "tlog" };
        Flight::empty(origin, Clock::Single)
    }

    #[test]
    fn headroom_is_that_of_the_most_loaded_motor() {
        let mut flight = empty();
        for k in 0..100 {
            let most = if k == 50 { 0.99 } else { 0.6 };
            flight.outputs.push(0.01 * f64::from(k), [0.5, 0.4, most, 0.5]);
        }
        let motors = Recording::new(flight).summary().motors.clone().expect("motors");
        assert!(
            (motors.headroom_min - 0.01).abs() < 1e-9 && (motors.full_share - 0.01).abs() < 1e-9
        );
        assert!((motors.hover - 0.5).abs() < 1e-9 && motors.max[2] == 0.99);
    }
}
