//! What a recorded flight shows beside its path, whoever recorded it: motors, pack, vibration, jumps
//! of the estimate, rates of the streams, and errors against what was asked.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::VehicleParams;
use vehicle::frame::{Ned, wrap_angle};

use super::histogram::quantile;
use crate::log::import::{Flight, MotorUnit, Stream};

/// A motor at more than this share of full is at its limit.
const FULL: f64 = 0.98;
/// What is slower than this is motion, what is faster is vibration: length of a mean, s.
const MOTION_S: f64 = 0.1;
/// Vibration is averaged over so long, s.
const VIBRATION_WINDOW_S: f64 = 0.5;
/// A step of the estimate beyond so many usual ones, and beyond what any vehicle does, is a jump.
const JUMP_FACTOR: f64 = 12.0;
const JUMP_POSITION_M: f64 = 0.08;
const JUMP_ATTITUDE_RAD: f64 = 0.07;
/// Jumps that are this close are one, s.
const JUMP_APART_S: f64 = 0.3;
/// Samples further apart than so many periods say nothing of each other.
const PAUSE: f64 = 3.0;
/// The summary names a pause from this many periods on.
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
    /// Errors against what was asked, where the log holds it.
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

/// How far one axis was from what was asked.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct AxisError {
    /// `position north`, `attitude roll`, `body rate pitch` and so on.
    pub axis: &'static str,
    /// `m`, `rad` or `rad/s`.
    pub unit: &'static str,
    /// Mean of what was less what was asked: the bias.
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

/// A step of the estimate that no motion explains.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Jump {
    /// When, s after the log's first sample.
    pub time_s: f64,
    /// `position` or `attitude`.
    pub of: &'static str,
    /// How far, m or rad.
    pub size: f64,
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
                for outputs in flight.outputs.values_mut() {
                    *outputs = std::array::from_fn(|i| ranges[i].fraction(outputs[i]));
                }
                flight.motor_unit = MotorUnit::ThrustFraction;
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
            vibration_m_s2: vibration(&flight.specific_force.map(|f| f.to_array())),
            vibration_rad_s: vibration(&flight.body_rate.map(|w| w.to_array())),
            jumps: jumps(&flight, span.0),
        };
        Self { flight, vehicle, has_range, span, summary }
    }

    /// The numbers.
    pub fn summary(&self) -> &RecordingSummary {
        &self.summary
    }

    /// What was flown against what was asked, axis by axis.
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

/// What is faster than motion: each sample less the mean around it.
fn fast(stream: &Stream<[f64; 3]>) -> Vec<[f64; 3]> {
    let (times, values) = (stream.times(), stream.values());
    let (mut from, mut to) = (0, 0);
    let mut sum = [0.0; 3];
    let add = |sum: &mut [f64; 3], value: &[f64; 3], sign: f64| {
        for (s, v) in sum.iter_mut().zip(value) {
            *s += sign * v;
        }
    };
    let mut out = Vec::with_capacity(times.len());
    for (time, value) in times.iter().zip(values) {
        while to < times.len() && times[to] <= time + MOTION_S / 2.0 {
            add(&mut sum, &values[to], 1.0);
            to += 1;
        }
        while from < to && times[from] < time - MOTION_S / 2.0 {
            add(&mut sum, &values[from], -1.0);
            from += 1;
        }
        let n = (to - from).max(1) as f64;
        out.push(std::array::from_fn(|i| value[i] - sum[i] / n));
    }
    out
}

/// Whether a stream is fast enough to show vibration at all.
fn shows_vibration(stream: &Stream<[f64; 3]>) -> bool {
    stream.period().is_some_and(|period| period < MOTION_S / 4.0)
}

fn vibration(stream: &Stream<[f64; 3]>) -> Option<[f64; 3]> {
    if !shows_vibration(stream) {
        return None;
    }
    let fast = fast(stream);
    let n = fast.len() as f64;
    Some([0, 1, 2].map(|i| (fast.iter().map(|v| v[i] * v[i]).sum::<f64>() / n).sqrt()))
}

/// Vibration over time: middles of windows, and the root mean square of each axis.
pub(super) fn vibration_over_time(stream: &Stream<[f64; 3]>) -> (Vec<f64>, [Vec<f64>; 3]) {
    let (mut middles, mut rms) = (Vec::new(), [const { Vec::new() }; 3]);
    if !shows_vibration(stream) {
        return (middles, rms);
    }
    let (times, fast) = (stream.times(), fast(stream));
    let mut from = 0;
    while let Some(start) = times.get(from).copied() {
        let to = times.partition_point(|time| *time < start + VIBRATION_WINDOW_S).max(from + 1);
        let window = &fast[from..to];
        middles.push(start + VIBRATION_WINDOW_S / 2.0);
        for (axis, rms) in rms.iter_mut().enumerate() {
            let square: f64 = window.iter().map(|v| v[axis] * v[axis]).sum();
            rms.push((square / window.len() as f64).sqrt());
        }
        from = to;
    }
    (middles, rms)
}

/// Steps between samples less what the rates say, with their times.
fn steps<T>(stream: &Stream<T>, surprise: impl Fn(f64, &T, f64, &T) -> f64) -> Vec<(f64, f64)> {
    let limit = PAUSE * stream.period().unwrap_or(0.0);
    let samples: Vec<(f64, &T)> = stream.iter().collect();
    let near = samples.windows(2).filter(|pair| pair[1].0 - pair[0].0 <= limit);
    near.map(|pair| (pair[1].0, surprise(pair[0].0, pair[0].1, pair[1].0, pair[1].1)))
        .filter(|(_, step)| step.is_finite())
        .collect()
}

fn jumps(flight: &Flight, start: f64) -> Vec<Jump> {
    let velocity = |time: f64| flight.velocity.held_at(time).copied();
    let position = steps(&flight.position, |from, a: &Ned, to, b: &Ned| {
        let Some((before, after)) = velocity(from).zip(velocity(to)) else { return f64::NAN };
        (*b - *a - (before + after) * (0.5 * (to - from))).norm()
    });
    let attitude = steps(&flight.attitude, |from, a, to, b| {
        let rate = |time| flight.body_rate.held_at(time).map(|w| w.norm());
        let Some((before, after)) = rate(from).zip(rate(to)) else { return f64::NAN };
        // A turn in a step is at most as long as its fastest rate makes it.
        (a.angle_to(*b) - before.max(after) * (to - from)).max(0.0)
    });
    let found = |steps: Vec<(f64, f64)>, of: &'static str, least: f64| {
        let mut sizes: Vec<f64> = steps.iter().map(|(_, size)| *size).collect();
        sizes.sort_by(f64::total_cmp);
        let limit = least.max(JUMP_FACTOR * quantile(&sizes, 0.5).unwrap_or(0.0));
        let mut jumps: Vec<Jump> = Vec::new();
        for (time, size) in steps.into_iter().filter(|(_, size)| *size > limit) {
            let time_s = time - start;
            match jumps.last_mut().filter(|last| time_s - last.time_s < JUMP_APART_S) {
                Some(last) => last.size = last.size.max(size),
                None => jumps.push(Jump { time_s, of, size }),
            }
        }
        jumps
    };
    let mut all = found(position, "position", JUMP_POSITION_M);
    all.extend(found(attitude, "attitude", JUMP_ATTITUDE_RAD));
    all.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    all
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

    use vehicle::frame::{Attitude, Frd};

    use super::*;
    use crate::log::import::{Clock, Origin};

    fn empty() -> Flight {
        let (path, run) = (PathBuf::from("a.tlog"), "a".to_owned());
        let origin = Origin { path, run, sha256: String::new(), format: "tlog" };
        Flight::empty(origin, Clock::Single)
    }

    #[test]
    fn estimate_jump_is_found_but_fast_flight_is_not() {
        let mut flight = empty();
        for k in 0..1000 {
            let time = 0.02 * f64::from(k);
            // 8 m/s, with a step of 0.5 m at 10 s.
            let step = if k >= 500 { 0.5 } else { 0.0 };
            flight.position.push(time, Ned::new(8.0 * time + step, 0.0, -1.0));
            flight.velocity.push(time, Ned::new(8.0, 0.0, 0.0));
            flight.attitude.push(time, Attitude::default());
            flight.body_rate.push(time, Frd::new(0.0, 0.0, 0.0));
        }
        let recording = Recording::new(flight);
        let jumps = &recording.summary().jumps;
        assert_eq!(jumps.len(), 1, "{jumps:?}");
        assert!((jumps[0].time_s - 10.0).abs() < 1e-9 && (jumps[0].size - 0.5).abs() < 1e-6);
    }

    #[test]
    fn vibration_excludes_slow_motion() {
        let mut flight = empty();
        for k in 0..2000 {
            let time = 0.002 * f64::from(k);
            let slow = 3.0 * (2.0 * time).sin();
            let fast = 2.0 * (2.0 * std::f64::consts::PI * 100.0 * time).sin();
            flight.specific_force.push(time, Frd::new(slow, slow + fast, -9.8));
        }
        let recording = Recording::new(flight);
        let [front, right, down] = recording.summary().vibration_m_s2.expect("fast enough");
        assert!(
            front < 0.02 && down < 1e-9 && (right - 2_f64.sqrt()).abs() < 0.05,
            "{front} {right}"
        );
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
