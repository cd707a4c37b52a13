//! Rates at which streams bring new values, whatever rate they are logged at.
//!
//! A logger that is faster than its source repeats values or interpolates between them. Neither
//! adds information, and changes faster than half of the source's rate alias to lower frequencies.

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Attitude, Frd, Ned};

use super::weak::median;
use crate::log::import::{Flight, Stream};

/// Pauses of more than this many periods do not count for the rate.
const PAUSE_PERIODS: f64 = 3.0;
/// A sample is on the line between its neighbours if it is off by less than this share of the
/// stream's range; single precision rounds by less.
const ON_LINE: f64 = 1e-5;
/// A stream is interpolated if more than this share of its samples is on lines.
const INTERPOLATED_SHARE_MIN: f64 = 0.5;
/// Fewest new values for a rate.
const VALUES_MIN: usize = 20;

/// New values per second while they come, Hz; `None` for a stream that is not logged or never
/// changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct Rates {
    /// Attitude.
    pub attitude_hz: Option<f64>,
    /// Position.
    pub position_hz: Option<f64>,
    /// Velocity.
    pub velocity_hz: Option<f64>,
    /// Body rate.
    pub body_rate_hz: Option<f64>,
    /// Specific force.
    pub specific_force_hz: Option<f64>,
    /// Motor outputs: they do not show dynamics faster than half of this.
    pub outputs_hz: Option<f64>,
    /// Rotor speeds.
    pub rotor_speed_hz: Option<f64>,
    /// Setpoints.
    pub setpoint_hz: Option<f64>,
    /// Smallest change of a motor output, in the outputs' unit: their resolution.
    pub outputs_step: Option<f64>,
}

impl Rates {
    /// Measures the rates of a flight.
    pub fn of(flight: &Flight) -> Self {
        let attitude = |q: &Attitude| [q.w, q.x, q.y, q.z];
        let ned = |v: &Ned| v.to_array();
        let frd = |v: &Frd| v.to_array();
        let setpoint = flight.setpoint.map(|s| {
            let q = s.attitude.map_or([0.0; 4], |q| attitude(&q));
            let rate = s.body_rate.map_or([0.0; 3], |rate| rate.to_array());
            let thrust = s.thrust.unwrap_or(0.0);
            [q[0], q[1], q[2], q[3], rate[0], rate[1], rate[2], thrust]
        });
        Self {
            attitude_hz: rate(&flight.attitude, attitude),
            position_hz: rate(&flight.position, ned),
            velocity_hz: rate(&flight.velocity, ned),
            body_rate_hz: rate(&flight.body_rate, frd),
            specific_force_hz: rate(&flight.specific_force, frd),
            outputs_hz: rate(&flight.outputs, |u| *u),
            rotor_speed_hz: rate(&flight.rotor_speed, |u| *u),
            setpoint_hz: rate(&setpoint, |s| *s),
            outputs_step: step(&flight.outputs),
        }
    }
}

/// New values per second, without interpolated ones.
fn rate<T, const N: usize>(stream: &Stream<T>, value: impl Fn(&T) -> [f64; N]) -> Option<f64> {
    let mut news: Vec<(f64, [f64; N])> = Vec::new();
    for (time, new) in stream.iter() {
        let new = value(new);
        if news.last().is_none_or(|(_, last)| *last != new) {
            news.push((time, new));
        }
    }
    let range: [f64; N] = std::array::from_fn(|i| {
        let values = || news.iter().map(|(_, value)| value[i]);
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    });
    let is_drawn = |triple: &[(f64, [f64; N])]| {
        let [(t0, a), (t1, b), (t2, c)] = triple else { return false };
        let share = (t1 - t0) / (t2 - t0);
        (0..N).all(|i| (a[i] + (c[i] - a[i]) * share - b[i]).abs() <= ON_LINE * range[i])
    };
    let knots: Vec<f64> =
        news.windows(3).filter(|triple| !is_drawn(triple)).map(|triple| triple[1].0).collect();
    let drawn = 1.0 - knots.len() as f64 / news.len().saturating_sub(2).max(1) as f64;
    let times = if drawn > INTERPOLATED_SHARE_MIN {
        knots
    } else {
        news.iter().map(|(time, _)| *time).collect()
    };
    if times.len() < VALUES_MIN {
        return None;
    }
    let intervals = || times.windows(2).map(|pair| pair[1] - pair[0]);
    let longest = PAUSE_PERIODS * median(intervals().collect());
    let (count, sum) = intervals()
        .filter(|interval| *interval <= longest)
        .fold((0.0, 0.0), |(count, sum), interval| (count + 1.0, sum + interval));
    (sum > 0.0).then(|| count / sum)
}

/// The smallest change of any of four outputs.
fn step(outputs: &Stream<[f64; 4]>) -> Option<f64> {
    let changes = outputs.values().windows(2).flat_map(|pair| {
        let (a, b) = (pair[0], pair[1]);
        (0..4).map(move |i| (b[i] - a[i]).abs())
    });
    changes.filter(|change| *change > 0.0).reduce(f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples at 100 Hz of a source at 10 Hz, with the given values between its samples.
    fn logged(between: impl Fn(f64, f64, f64) -> f64) -> Stream<[f64; 4]> {
        let source = |k: f64, i: usize| (k * (1.3 + i as f64)).sin();
        let mut stream = Stream::default();
        for k in 0..2000_u32 {
            let at = f64::from(k / 10);
            let share = 0.1 * f64::from(k % 10);
            let value = |i| between(source(at, i), source(at + 1.0, i), share);
            stream.push(0.01 * f64::from(k), std::array::from_fn(value));
        }
        stream
    }

    #[test]
    fn repeats_and_interpolation_do_not_raise_the_rate() {
        let held = rate(&logged(|a, _, _| a), |u| *u);
        let drawn = rate(&logged(|a, b, share| a + (b - a) * share), |u| *u);
        let own = rate(&logged(|a, _, share| a + (7.0 * share).sin()), |u| *u);
        for (found, expected) in [(held, 10.0), (drawn, 10.0), (own, 100.0)] {
            let found = found.expect("it changes");
            assert!((found - expected).abs() < 0.02 * expected, "{found} for {expected}");
        }
        assert_eq!(rate(&logged(|_, _, _| 1.0), |u| *u), None);
    }

    #[test]
    fn pauses_do_not_lower_the_rate() {
        let mut number = 0;
        let paused = logged(|a, _, share| a + (7.0 * share).sin()).filter_map(|u| {
            number += 1;
            (number % 500 > 100).then_some(*u)
        });
        let found = rate(&paused, |u| *u).expect("it changes");
        assert!((found - 100.0).abs() < 1.0, "{found}");
    }

    #[test]
    fn quantisation_step_of_outputs_is_found() {
        let rounded = logged(|a, _, _| (100.0 * a).round() / 100.0);
        assert!((step(&rounded).expect("it changes") - 0.01).abs() < 1e-9);
    }
}
