//! Jumps of the vehicle's estimate: steps that its own velocity and body rate do not explain.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::Ned;

use super::PAUSE;
use crate::log::import::{Flight, Stream};
use crate::report::histogram::quantile;

/// A jump is this many times the median unexplained step of its stream, and more than the least.
const FACTOR: f64 = 12.0;
const LEAST_POSITION_M: f64 = 0.08;
const LEAST_ATTITUDE_RAD: f64 = 0.07;
/// Jumps closer than this are one, s.
const APART_S: f64 = 0.3;

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

/// The time of each step between samples, and the part of it that the rates do not explain.
fn steps<T>(stream: &Stream<T>, unexplained: impl Fn(f64, &T, f64, &T) -> f64) -> Vec<(f64, f64)> {
    let limit = PAUSE * stream.period().unwrap_or(0.0);
    let samples: Vec<(f64, &T)> = stream.iter().collect();
    let near = samples.windows(2).filter(|pair| pair[1].0 - pair[0].0 <= limit);
    near.map(|pair| (pair[1].0, unexplained(pair[0].0, pair[0].1, pair[1].0, pair[1].1)))
        .filter(|(_, step)| step.is_finite())
        .collect()
}

/// The jumps of position and attitude in the order of time, timed from `start`.
pub(super) fn jumps(flight: &Flight, start: f64) -> Vec<Jump> {
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
        let limit = least.max(FACTOR * quantile(&sizes, 0.5).unwrap_or(0.0));
        let mut jumps: Vec<Jump> = Vec::new();
        for (time, size) in steps.into_iter().filter(|(_, size)| *size > limit) {
            let time_s = time - start;
            match jumps.last_mut().filter(|last| time_s - last.time_s < APART_S) {
                Some(last) => last.size = last.size.max(size),
                None => jumps.push(Jump { time_s, of, size }),
            }
        }
        jumps
    };
    let mut all = found(position, "position", LEAST_POSITION_M);
    all.extend(found(attitude, "attitude", LEAST_ATTITUDE_RAD));
    all.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    all
}

#[cfg(test)]
mod tests {
    use vehicle::frame::{Attitude, Frd};

    use super::super::tests::empty;
    use super::*;

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
        let jumps = jumps(&flight, 0.0);
        assert_eq!(jumps.len(), 1, "{jumps:?}");
        assert!((jumps[0].time_s - 10.0).abs() < 1e-9 && (jumps[0].size - 0.5).abs() < 1e-6);
    }
}
