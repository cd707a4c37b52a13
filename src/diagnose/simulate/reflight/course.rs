//! References to track when a flight is flown again.

use std::ops::Range;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Euler, Frd, Ned, wrap_angle};

use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::series::Series;
use crate::diagnose::simulate::flight_simulator::GroundControl;
use crate::log::import::Flight;
use crate::setpoint::{Reference, Setpoint};

/// Least length of a part that is flown again, s.
const SECONDS_MIN: f64 = 3.0;
/// Longest pause within a part, s.
const PAUSE_MAX_S: f64 = 0.1;
/// Period of the controller's ticks where the log has none, s.
const TICK_S: f64 = 0.01;
/// Time to each side over which reported motion is averaged, s. Its acceleration is the slope of
/// the velocity over the same time. The flight's own commands had no such noise, and noisy
/// feed-forward would shake the vehicle.
const SMOOTHING_S: f64 = 0.1;
/// As above where setpoints are the feed-forward, s: only feedback uses the motion.
const SENT_SMOOTHING_S: f64 = 0.03;
/// Rounds of learning the reference of a reported motion.
const ROUNDS: usize = 3;
/// Ticks to each side over which a tracking error is averaged for learning.
const LASTING_TICKS: usize = 20;

/// The source of a flight's reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ReferenceOrigin {
    /// The log holds the tracked reference.
    Logged,
    /// The logged setpoints as feed-forward, with the reported motion. Whatever controller made
    /// them, feedback adds only the corrections that a vehicle other than the real one needs.
    Setpoints,
    /// The reported motion alone. Flying the reference repeatedly corrects it until the flight
    /// follows the motion.
    Reported,
}

/// The controller's ticks over an unbroken part of a flight.
#[derive(Clone)]
pub(super) struct Course {
    pub origin: ReferenceOrigin,
    /// At least two, with ascending times of the vehicle's clock.
    pub ticks: Vec<(f64, Reference)>,
}

impl Course {
    /// Time of the first tick, s.
    pub fn start(&self) -> f64 {
        self.ticks[0].0
    }

    /// Time from the first tick to the last, s.
    pub fn seconds(&self) -> f64 {
        self.ticks[self.ticks.len() - 1].0 - self.ticks[0].0
    }

    /// Number of learning flights before the one that is compared.
    pub fn rounds(&self) -> usize {
        if self.origin == ReferenceOrigin::Reported { ROUNDS } else { 0 }
    }

    /// The next reference of a vehicle that flew `flown` under `commanded`: `commanded` plus its
    /// lasting errors relative to this course.
    pub fn learned(&self, commanded: &Self, flown: &Flight) -> Self {
        let position = Series::<3>::of(&flown.position, |p| p.to_array());
        let missed: Vec<Ned> = self
            .ticks
            .iter()
            .map(|(time, wanted)| wanted.position - Ned::from(position.at(*time)))
            .collect();
        let mut next = commanded.clone();
        for (k, (_, reference)) in next.ticks.iter_mut().enumerate() {
            let end = (k + LASTING_TICKS + 1).min(missed.len());
            let near = &missed[k.saturating_sub(LASTING_TICKS)..end];
            let sum = near.iter().fold(Ned::zero(), |sum, missed| sum + *missed);
            reference.position += sum * (1.0 / near.len() as f64);
        }
        next
    }
}

/// The parts of `flight` that can be flown again; none without position, velocity, attitude and
/// body rate.
pub(super) fn courses(flight: &PreparedFlight, control: &GroundControl) -> Vec<Course> {
    let channels = &flight.channels;
    if !(channels.velocity && channels.attitude && channels.body_rate) || flight.position.is_empty()
    {
        return Vec::new();
    }
    let spans = flight.spans.iter();
    let courses: Vec<Course> = if !flight.reference.is_empty() {
        let ticks = |span| flight.reference.iter().filter(within(span)).map(|(t, r)| (t, *r));
        spans.flat_map(|span| parts(ReferenceOrigin::Logged, ticks(span))).collect()
    } else if channels.setpoint {
        spans
            .flat_map(|span| parts(ReferenceOrigin::Setpoints, as_sent(flight, span, control)))
            .collect()
    } else {
        spans.map(|span| reported(flight, span, control)).collect()
    };
    let is_long = |course: &Course| course.ticks.len() > 1 && course.seconds() >= SECONDS_MIN;
    courses.into_iter().filter(is_long).collect()
}

/// Whether a sample's time is within a span.
fn within<T>(span: &Range<f64>) -> impl Fn(&(f64, T)) -> bool {
    move |(time, _)| span.contains(time)
}

/// Splits ticks into parts at pauses.
fn parts(origin: ReferenceOrigin, ticks: impl Iterator<Item = (f64, Reference)>) -> Vec<Course> {
    let mut parts: Vec<Course> = Vec::new();
    for (time, reference) in ticks {
        let last = parts
            .last_mut()
            .filter(|part| part.ticks.last().is_some_and(|(last, _)| time - last <= PAUSE_MAX_S));
        match last {
            Some(part) => part.ticks.push((time, reference)),
            None => parts.push(Course { origin, ticks: vec![(time, reference)] }),
        }
    }
    parts
}

/// The setpoints sent over a span, each with the motion reported at the time.
fn as_sent<'a>(
    flight: &'a PreparedFlight,
    span: &'a Range<f64>,
    control: &'a GroundControl,
) -> impl Iterator<Item = (f64, Reference)> + 'a {
    flight.setpoint.iter().filter(within(span)).filter_map(|(time, sent)| {
        let attitude = flight.attitude.attitude_at(time).euler();
        let feedforward = Setpoint {
            thrust_n: control.vehicle().thrust.thrust_n(sent.thrust?),
            attitude: sent.attitude?.euler(),
            body_rate: sent.body_rate.unwrap_or(Frd::zero()),
        };
        let reference = Reference {
            position: smoothed(&flight.position, time, SENT_SMOOTHING_S),
            velocity: smoothed(&flight.velocity, time, SENT_SMOOTHING_S),
            attitude,
            body_rate: flight.body_rate.at(time).into(),
            feedforward,
        };
        Some((time, reference))
    })
}

/// The reported motion over a span as a reference. Thrust and tilt are those that a vehicle without
/// drag needs for its acceleration; feedback adds the rest.
fn reported(flight: &PreparedFlight, span: &Range<f64>, control: &GroundControl) -> Course {
    let hover = control.vehicle().hover;
    let count = ((span.end - span.start - 2.0 * SMOOTHING_S) / TICK_S) as usize;
    let at = |k: usize| span.start + SMOOTHING_S + k as f64 * TICK_S;
    let forces: Vec<Ned> = (0..=count)
        .map(|k| {
            let gained = smoothed(&flight.velocity, at(k) + SMOOTHING_S, SMOOTHING_S)
                - smoothed(&flight.velocity, at(k) - SMOOTHING_S, SMOOTHING_S);
            gained * (0.5 / SMOOTHING_S) - Ned::new(0.0, 0.0, hover.gravity)
        })
        .collect();
    let attitudes: Vec<Euler> = forces
        .iter()
        .enumerate()
        .map(|(k, force)| along(*force, flight.attitude.attitude_at(at(k)).yaw()))
        .collect();
    let ticks = (0..count)
        .map(|k| {
            let (attitude, next) = (attitudes[k], attitudes[k + 1]);
            let body_rate: Frd = attitude.body_rate([
                (next.roll - attitude.roll) / TICK_S,
                (next.pitch - attitude.pitch) / TICK_S,
                wrap_angle(next.yaw - attitude.yaw) / TICK_S,
            ]);
            let thrust_n = hover.mass_kg * forces[k].norm();
            let reference = Reference {
                position: smoothed(&flight.position, at(k), SMOOTHING_S),
                velocity: smoothed(&flight.velocity, at(k), SMOOTHING_S),
                attitude,
                body_rate,
                feedforward: Setpoint { thrust_n, attitude, body_rate },
            };
            (at(k), reference)
        })
        .collect();
    Course { origin: ReferenceOrigin::Reported, ticks }
}

/// The mean of a series over `half` a window to each side of a time.
fn smoothed(series: &Series<3>, time: f64, half: f64) -> Ned {
    series.mean_about(time, half).into()
}

/// Roll and pitch that point the thrust along the specific force `force`, at a yaw.
fn along(force: Ned, yaw: f64) -> Euler {
    let (sin, cos) = yaw.sin_cos();
    // In axes rotated by yaw; thrust is along -z of the body.
    let front = cos * force.north() + sin * force.east();
    let right = cos * force.east() - sin * force.north();
    let up = -force.down();
    let pitch = (-front).atan2(up);
    let roll = right.atan2(front.hypot(up));
    Euler { roll, pitch, yaw }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thrust_points_along_the_force_at_any_yaw() {
        for (force, yaw) in [
            (Ned::new(1.0, 2.0, -9.0), 0.0),
            (Ned::new(-3.0, 0.5, -12.0), 2.0),
            (Ned::new(0.0, -4.0, -7.0), -1.2),
        ] {
            let attitude = along(force, yaw);
            let thrust = attitude.attitude().to_world(Frd::new(0.0, 0.0, -force.norm()));
            assert!((thrust - force).norm() < 1e-9, "{thrust:?}");
            assert!((attitude.yaw - yaw).abs() < 1e-12);
        }
    }

    #[test]
    fn reference_pause_splits_the_course() {
        let times = [0.0, 0.01, 0.02, 0.5, 0.51];
        let found = parts(
            ReferenceOrigin::Logged,
            times.into_iter().map(|time| (time, Reference::default())),
        );
        let counts: Vec<usize> = found.iter().map(|part| part.ticks.len()).collect();
        assert_eq!(counts, [3, 2]);
    }
}
