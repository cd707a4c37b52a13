//! Puts the streams of a vehicle's flights on one clock before any fit.
//!
//! The gyro and the accelerometer show the motion when it happens. A pose may be late as a whole: that
//! is a property of the vehicle, its `estimator_latency`. A stream that is late by another time, or by
//! another time in each flight, was logged on another clock, and looks like a drag, a lag or a delay of
//! the vehicle. [`align`] removes that difference where the motion shows it.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

use super::{Agreement, Audit, Estimate, Kinematics};
use crate::log::import::{Flight, Stream};

/// Least delays that are removed and, of attitude and velocity, reported, s: a fit's own latency and
/// the errors of stamps cover less.
pub(super) const POSE_MIN_S: f64 = 0.004;
pub(super) const VELOCITY_MIN_S: f64 = 0.008;
/// Half width of a 95 % interval in standard deviations.
const DEVIATIONS: f64 = 1.96;

/// A stream whose times were shifted.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Shift {
    /// Name of the stream.
    pub stream: &'static str,
    /// How much later than the common latency the stream was logged, s; its times are now earlier by
    /// this much.
    pub late_s: f64,
    /// Half width of its 95 % interval, s.
    pub half_width_s: f64,
}

/// Shifts the streams of one vehicle's flights that are certainly later or earlier than the latency
/// that they have in common, and with them the unusable times of their audits, one for each flight.
/// `stated_s` is the latency that the vehicle's file states, s. Returns the shifts of each flight;
/// logs that a fault excludes have none.
pub fn align(flights: &mut [Flight], audits: &mut [Audit], stated_s: f64) -> Vec<Vec<Shift>> {
    let delays = |of: fn(&Kinematics) -> Option<Agreement>| {
        let sound = audits.iter().map(|audit| is_sound(audit).then_some(&audit.kinematics));
        pooled(&sound.map(|kinematics| Some(of(kinematics?)?.delay_s)).collect::<Vec<_>>())
    };
    let attitude = delays(|kinematics| kinematics.attitude);
    let velocity = delays(|kinematics| kinematics.velocity);
    let position = delays(|kinematics| kinematics.position);
    // The mean nearer to the stated latency; negative where filters delay the inertial unit.
    let means = [&attitude, &velocity].map(|pool| Some(pool.as_ref()?.mean.value));
    let off = |latency: &f64| (latency - stated_s).abs();
    let common = means.into_iter().flatten().min_by(|a, b| off(a).total_cmp(&off(b)));
    let common = common.unwrap_or(stated_s);
    let own = |pool: &Option<Pool>, flight: usize| Some(*pool.as_ref()?.each.get(flight)?);
    let pairs = flights.iter_mut().zip(audits).enumerate();
    pairs
        .map(|(index, (flight, audit))| {
            let delays = Delays {
                attitude: own(&attitude, index),
                velocity: own(&velocity, index),
                position_behind_velocity: own(&position, index),
            };
            let shifts = if is_sound(audit) { delays.shifts(common) } else { Vec::new() };
            for shift in &shifts {
                shift.apply(flight, audit);
            }
            shifts
        })
        .collect()
}

/// Whether no fault excludes the whole log.
fn is_sound(audit: &Audit) -> bool {
    audit.faults().next().is_none()
}

/// One delay in each of several flights, with what they have in common.
struct Pool {
    mean: Estimate,
    each: Vec<Estimate>,
}

/// The delays of flights whose true delays scatter about a mean: each measured one moves towards it by
/// its uncertainty, one that is not measured is the mean. The variance of the scatter is that of
/// DerSimonian and Laird (1986). `None` if no flight shows the delay.
fn pooled(measured: &[Option<Estimate>]) -> Option<Pool> {
    let variance = |delay: &Estimate| (delay.half_width / DEVIATIONS).powi(2);
    let sums = |scatter: f64| {
        let shown = measured.iter().flatten();
        shown.fold([0.0; 4], |[ones, weights, squares, values], delay| {
            let weight = (variance(delay) + scatter).recip();
            [ones + 1.0, weights + weight, squares + weight * weight, values + weight * delay.value]
        })
    };
    let [count, weights, squares, values] = sums(0.0);
    if count == 0.0 {
        return None;
    }
    let mean = values / weights;
    let off: f64 =
        measured.iter().flatten().map(|delay| (delay.value - mean).powi(2) / variance(delay)).sum();
    let scatter = match weights - squares / weights {
        free if count > 1.0 && free > 0.0 => ((off - (count - 1.0)) / free).max(0.0),
        _ => 0.0,
    };
    let [_, weights, _, values] = sums(scatter);
    let estimate =
        |value: f64, variance: f64| Estimate { value, half_width: DEVIATIONS * variance.sqrt() };
    let (mean, of_mean) = (values / weights, weights.recip());
    let each = measured.iter().map(|delay| {
        let Some(delay) = delay else { return estimate(mean, of_mean + scatter) };
        let own = scatter / (scatter + variance(delay));
        let value = mean + own * (delay.value - mean);
        estimate(value, own * variance(delay) + (1.0 - own).powi(2) * of_mean)
    });
    Some(Pool { mean: estimate(mean, of_mean), each: each.collect() })
}

/// The delays of a flight's streams.
struct Delays {
    /// Behind the gyro.
    attitude: Option<Estimate>,
    /// Behind the accelerometer.
    velocity: Option<Estimate>,
    position_behind_velocity: Option<Estimate>,
}

impl Delays {
    /// The shifts to the latency `common`, s. Of attitude and velocity, one without a measured delay
    /// follows the other. A position follows the velocity.
    fn shifts(&self, common: f64) -> Vec<Shift> {
        let behind = |delay: Estimate| Estimate { value: delay.value - common, ..delay };
        let certain = |delay: Option<Estimate>, least: f64| {
            delay.filter(|delay| delay.value.abs() > least && delay.differs_from_zero(1.0))
        };
        let attitude = certain(self.attitude.or(self.velocity).map(behind), POSE_MIN_S);
        let velocity = certain(self.velocity.or(self.attitude).map(behind), VELOCITY_MIN_S);
        let position = match (velocity, certain(self.position_behind_velocity, POSE_MIN_S)) {
            (Some(a), Some(b)) => Some(Estimate {
                value: a.value + b.value,
                half_width: a.half_width.hypot(b.half_width),
            }),
            (one, other) => one.or(other),
        };
        let streams = [("attitude", attitude), ("velocity", velocity), ("position", position)];
        let shift = |(stream, delay): (&'static str, Option<Estimate>)| {
            let Estimate { value, half_width } = delay?;
            Some(Shift { stream, late_s: value, half_width_s: half_width })
        };
        streams.into_iter().filter_map(shift).collect()
    }
}

impl fmt::Display for Shift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { stream, late_s, half_width_s } = self;
        write!(f, "{stream} by {:+.1} +- {:.1} ms", -1e3 * late_s, 1e3 * half_width_s)
    }
}

impl Shift {
    fn apply(&self, flight: &mut Flight, audit: &mut Audit) {
        fn shift<T>(stream: &mut Stream<T>, by: f64) {
            *stream = std::mem::take(stream).shifted(by);
        }
        let by = -self.late_s;
        match self.stream {
            "attitude" => shift(&mut flight.attitude, by),
            "velocity" => shift(&mut flight.velocity, by),
            _ => shift(&mut flight.position, by),
        }
        for span in audit.unusable.iter_mut().filter(|span| span.stream == self.stream) {
            (span.from_s, span.to_s) = (span.from_s + by, span.to_s + by);
        }
    }
}
