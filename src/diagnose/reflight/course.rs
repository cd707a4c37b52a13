//! What a flight is given to track when it is flown again.

use std::ops::Range;

use serde::Serialize;
use sitl::frame::{Attitude, Euler, Frd, Ned, wrap_angle};

use super::super::flight_simulator::GroundControl;
use super::super::preparation::{PreparedFlight, Series};
use crate::setpoint::{Reference, Setpoint};

/// Shorter parts are left out, s.
const SECONDS_MIN: f64 = 3.0;
/// A logged reference with a longer pause is not one, s.
const PAUSE_MAX_S: f64 = 0.1;
/// Period of the ground's ticks where the log does not have them, s.
const TICK_S: f64 = 0.01;
/// Reported motion is averaged over this much to each side, and its acceleration is the slope of
/// the velocity over as much: what the vehicle was asked for has no noise, and feed-forward that
/// had would shake it, s.
const SMOOTHING_S: f64 = 0.1;
/// Samples of such an average.
const SMOOTHING_SAMPLES: usize = 21;

/// Where the reference of a flight comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ReferenceOrigin {
    /// The log holds what was tracked.
    Logged,
    /// The flight's own reported motion.
    Reported,
}

/// The ground's ticks over an unbroken part of a flight.
pub(super) struct Course {
    pub origin: ReferenceOrigin,
    /// At least two, with ascending times of the vehicle's clock.
    pub ticks: Vec<(f64, Reference)>,
}

impl Course {
    /// s
    pub fn start(&self) -> f64 {
        self.ticks[0].0
    }

    /// s
    pub fn seconds(&self) -> f64 {
        self.ticks[self.ticks.len() - 1].0 - self.ticks[0].0
    }
}

/// The parts of `flight` that can be flown again; none without position, velocity and attitude.
pub(super) fn courses(flight: &PreparedFlight, control: &GroundControl) -> Vec<Course> {
    let channels = &flight.channels;
    if !(channels.velocity && channels.attitude && channels.body_rate) || flight.position.is_empty()
    {
        return Vec::new();
    }
    let courses: Vec<Course> = if flight.reference.is_empty() {
        flight.spans.iter().map(|span| reported(flight, span, control)).collect()
    } else {
        flight.spans.iter().flat_map(|span| logged(flight, span)).collect()
    };
    let is_long = |course: &Course| course.ticks.len() > 1 && course.seconds() >= SECONDS_MIN;
    courses.into_iter().filter(is_long).collect()
}

/// The logged reference within a span, in parts without pauses.
fn logged(flight: &PreparedFlight, span: &Range<f64>) -> Vec<Course> {
    let mut parts: Vec<Course> = Vec::new();
    for (time, reference) in flight.reference.iter().filter(|(time, _)| span.contains(time)) {
        match parts.last_mut() {
            Some(part) if part.ticks.last().is_some_and(|(last, _)| time - last <= PAUSE_MAX_S) => {
                part.ticks.push((time, *reference));
            }
            _ => parts
                .push(Course { origin: ReferenceOrigin::Logged, ticks: vec![(time, *reference)] }),
        }
    }
    parts
}

/// The reported motion over a span as a reference: thrust and tilt are those that its acceleration
/// needs of a vehicle without drag, and feedback adds what is missing.
fn reported(flight: &PreparedFlight, span: &Range<f64>, control: &GroundControl) -> Course {
    let hover = control.vehicle().hover;
    let count = ((span.end - span.start - 2.0 * SMOOTHING_S) / TICK_S) as usize;
    let at = |k: usize| span.start + SMOOTHING_S + k as f64 * TICK_S;
    let forces: Vec<Ned> = (0..=count)
        .map(|k| {
            let gained = smoothed(&flight.velocity, at(k) + SMOOTHING_S)
                - smoothed(&flight.velocity, at(k) - SMOOTHING_S);
            gained * (0.5 / SMOOTHING_S) - Ned::new(0.0, 0.0, hover.gravity)
        })
        .collect();
    let attitudes: Vec<Euler> = forces
        .iter()
        .enumerate()
        .map(|(k, force)| {
            let [w, x, y, z] = flight.attitude.at(at(k));
            along(*force, Attitude { w, x, y, z }.normalized().yaw())
        })
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
                position: smoothed(&flight.position, at(k)),
                velocity: smoothed(&flight.velocity, at(k)),
                attitude,
                body_rate,
                feedforward: Setpoint { thrust_n, attitude, body_rate },
            };
            (at(k), reference)
        })
        .collect();
    Course { origin: ReferenceOrigin::Reported, ticks }
}

/// The mean of a series about `time`.
fn smoothed(series: &Series<3>, time: f64) -> Ned {
    let step = 2.0 * SMOOTHING_S / (SMOOTHING_SAMPLES - 1) as f64;
    let mut cursor = series.cursor();
    let mut sum = Ned::zero();
    for i in 0..SMOOTHING_SAMPLES {
        sum += Ned::from(cursor.at(time - SMOOTHING_S + i as f64 * step));
    }
    sum * (1.0 / SMOOTHING_SAMPLES as f64)
}

/// Roll and pitch that turn thrust along the specific force `force`, at a yaw.
fn along(force: Ned, yaw: f64) -> Euler {
    let (sin, cos) = yaw.sin_cos();
    // In axes turned by yaw; thrust is along -z body.
    let front = cos * force.north() + sin * force.east();
    let right = cos * force.east() - sin * force.north();
    let up = -force.down();
    let pitch = (-front).atan2(up);
    let roll = right.atan2(front.hypot(up));
    Euler { roll, pitch, yaw }
}
