//! Latency of each stream relative to the gyro, from kinematics alone.
//!
//! The attitude changes by the integral of the body rate, the velocity by the integral of the
//! rotated specific force. No vehicle model is involved.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Attitude, Frd, Ned};

use crate::log::import::{Flight, Stream};

/// Range of latencies that are tried, s.
const LATENCY_RANGE: [f64; 2] = [-0.06, 0.12];
/// Step of the search before the parabolic refinement, s.
const LATENCY_STEP: f64 = 0.0025;
/// Interval over which changes are compared, s.
const SPAN: f64 = 0.06;
/// Least fraction of the change that the integral must explain for a latency to be accepted.
const EXPLAINED_MIN: f64 = 0.5;

/// Latency of a flight's streams relative to its gyro, s: a sample stamped t shows the state at
/// `t - latency`.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct Alignment {
    /// Of the attitude; `None` if the motion does not reveal it, and 0 is used.
    pub attitude_s: Option<f64>,
    /// Of position and velocity; `None` if the motion does not reveal it or the accelerometer is
    /// missing, and 0 is used.
    pub velocity_s: Option<f64>,
}

impl Alignment {
    /// Estimates the flight's latencies.
    pub fn of(flight: &Flight) -> Self {
        let turned = Integral::of(&flight.body_rate, |_, rate| Some(rate.to_array()));
        let turns = changes(&flight.attitude, |from: &Attitude, to: &Attitude| {
            let d = from.inverse().compose(*to).canonical();
            // The rotation vector of a small rotation.
            [2.0 * d.x, 2.0 * d.y, 2.0 * d.z]
        });
        let attitude_s = latency(&turns, &turned, Offset::None);
        let aligned = |time| interpolated(&flight.attitude, time + attitude_s.unwrap_or(0.0));
        let gained = Integral::of(&flight.specific_force, |time, force: &Frd| {
            Some(aligned(time)?.to_world(*force).to_array())
        });
        let gains = changes(&flight.velocity, |from: &Ned, to: &Ned| (*to - *from).to_array());
        Self { attitude_s, velocity_s: latency(&gains, &gained, Offset::Constant) }
    }
}

/// The attitude at `time`, interpolated; `None` outside the stream.
pub fn interpolated(stream: &Stream<Attitude>, time: f64) -> Option<Attitude> {
    let (before, after, share) = stream.around(time)?;
    Some(before.between(*after, share))
}

/// The running integral of a stream.
struct Integral {
    times: Vec<f64>,
    sums: Vec<[f64; 3]>,
}

impl Integral {
    fn of<V>(stream: &Stream<V>, value: impl Fn(f64, &V) -> Option<[f64; 3]>) -> Self {
        let mut integral = Self { times: Vec::new(), sums: Vec::new() };
        let mut last: Option<(f64, [f64; 3], [f64; 3])> = None;
        for (time, raw) in stream.iter() {
            let Some(value) = value(time, raw) else { continue };
            let sum = last.map_or([0.0; 3], |(before, old, sum)| {
                std::array::from_fn(|i| sum[i] + 0.5 * (old[i] + value[i]) * (time - before))
            });
            integral.times.push(time);
            integral.sums.push(sum);
            last = Some((time, value, sum));
        }
        integral
    }

    fn at(&self, time: f64) -> Option<[f64; 3]> {
        let index = self.times.partition_point(|t| *t <= time).checked_sub(1)?;
        let next = self.sums.get(index + 1)?;
        let step = self.times[index + 1] - self.times[index];
        let share = (time - self.times[index]) / step;
        Some(std::array::from_fn(|i| self.sums[index][i] + share * (next[i] - self.sums[index][i])))
    }
}

/// A change of a stream.
struct Change {
    /// s
    from: f64,
    /// s
    to: f64,
    by: [f64; 3],
}

/// An offset of the integrated rate, such as gravity or a bias.
#[derive(Clone, Copy, PartialEq)]
enum Offset {
    None,
    /// It adds in proportion to the interval.
    Constant,
}

fn changes<V>(stream: &Stream<V>, change: impl Fn(&V, &V) -> [f64; 3]) -> Vec<Change> {
    let times = stream.times();
    let mut next = 0;
    let mut found = Vec::new();
    for (index, time) in times.iter().enumerate() {
        while next < times.len() && times[next] < time + SPAN {
            next += 1;
        }
        if next < times.len() && times[next] - time < 2.0 * SPAN {
            let by = change(&stream.values()[index], &stream.values()[next]);
            found.push(Change { from: *time, to: times[next], by });
        }
    }
    found
}

/// The latency at which the integral explains the changes best.
fn latency(changes: &[Change], integral: &Integral, offset: Offset) -> Option<f64> {
    // A few thousand changes determine a delay; more only take time.
    let stride = (changes.len() / 4000).max(1);
    let unexplained = |latency: f64| -> Option<f64> {
        let (mut count, mut total, mut error) = (0.0, [[0.0; 2]; 3], [[0.0; 2]; 3]);
        for Change { from, to, by } in changes.iter().step_by(stride) {
            let (Some(a), Some(b)) = (integral.at(from - latency), integral.at(to - latency))
            else {
                continue;
            };
            count += 1.0;
            for i in 0..3 {
                let miss = by[i] - (b[i] - a[i]);
                let scale = if offset == Offset::Constant { to - from } else { 1.0 };
                error[i][0] += miss / scale;
                error[i][1] += (miss / scale).powi(2);
                total[i][0] += by[i] / scale;
                total[i][1] += (by[i] / scale).powi(2);
            }
        }
        let variance = |sums: [[f64; 2]; 3]| -> f64 {
            sums.iter().map(|[sum, square]| square - sum * sum / count).sum()
        };
        (count > 100.0).then(|| variance(error) / variance(total))
    };
    let [low, high] = LATENCY_RANGE;
    let steps = ((high - low) / LATENCY_STEP).round() as usize;
    let costs: Vec<f64> =
        (0..=steps).map(|k| unexplained(low + k as f64 * LATENCY_STEP)).collect::<Option<_>>()?;
    let best = (1..steps).min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
    let explained = 1.0 - costs[best];
    if explained.is_nan() || explained < EXPLAINED_MIN {
        return None;
    }
    let (left, middle, right) = (costs[best - 1], costs[best], costs[best + 1]);
    let curvature = left - 2.0 * middle + right;
    let shift = if curvature > 0.0 { 0.5 * (left - right) / curvature } else { 0.0 };
    Some(low + (best as f64 + shift.clamp(-1.0, 1.0)) * LATENCY_STEP)
}
