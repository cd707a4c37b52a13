//! The desired motion of a flight: legs between hovers, with exact derivatives.

use std::f64::consts::TAU;

use vehicle::frame::Ned;

use crate::plan::DesiredPoint;

/// North, east, down (m) and yaw (rad).
pub type Waypoint = [f64; 4];

/// Coordinates of a [`Waypoint`].
const AXES: usize = 4;
/// Ratio of a move's peak speed to its mean, and of its peak acceleration to distance / time^2.
const PEAK_SPEED: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.774;
/// Time in which a wave fades in and out, s.
const RAMP_S: f64 = 1.5;

/// A sinusoid along one coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tone {
    /// Index of the coordinate in a [`Waypoint`].
    pub axis: usize,
    /// Amplitude, m or rad.
    pub amplitude: f64,
    /// Period, s.
    pub period_s: f64,
    /// Phase at the start of the wave, rad.
    pub phase: f64,
}

/// A segment of a motion.
#[derive(Clone, Debug, PartialEq)]
enum Leg {
    /// A straight move with minimum jerk, from rest to rest; in no time, a jump.
    Move { from: Waypoint, to: Waypoint },
    /// Sinusoids about a place, which fade in and out.
    Wave { about: Waypoint, tones: Vec<Tone> },
}

/// A motion that starts in hover.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    start: Waypoint,
    /// The legs with the end time of each, s.
    legs: Vec<(f64, Leg)>,
    here: Waypoint,
    duration: f64,
}

impl Motion {
    /// A motion that starts in hover at a place.
    pub fn at(start: Waypoint) -> Self {
        Self { start, legs: Vec::new(), here: start, duration: 0.0 }
    }

    /// The place where it starts.
    pub fn start(&self) -> Waypoint {
        self.start
    }

    /// The place where it ends so far.
    pub fn end(&self) -> Waypoint {
        self.here
    }

    /// Its length so far, s.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    fn push(&mut self, seconds: f64, leg: Leg) {
        self.duration += seconds;
        self.legs.push((self.duration, leg));
    }

    /// Adds a hover at the present place.
    pub fn hold(&mut self, seconds: f64) {
        self.move_to(self.here, seconds);
    }

    /// Adds a move to a place in a given time.
    pub fn move_to(&mut self, to: Waypoint, seconds: f64) {
        let from = std::mem::replace(&mut self.here, to);
        self.push(seconds, Leg::Move { from, to });
    }

    /// Adds a move to a place as fast as a peak speed (m/s) and a peak acceleration (m/s^2) allow.
    /// Yaw turns with the move, at up to 2.5 rad/s.
    pub fn move_at_limits(&mut self, to: Waypoint, speed: f64, acceleration: f64) {
        let distance = (0..3).map(|i| (to[i] - self.here[i]).powi(2)).sum::<f64>().sqrt();
        let turn = (to[3] - self.here[3]).abs();
        let seconds = (PEAK_SPEED * distance / speed)
            .max((PEAK_ACCELERATION * distance / acceleration).sqrt())
            .max(PEAK_SPEED * turn / 2.5)
            .max(0.3);
        self.move_to(to, seconds);
    }

    /// Adds a jump to a place, and a hover there.
    pub fn jump_to(&mut self, to: Waypoint, seconds: f64) {
        self.here = to;
        self.hold(seconds);
    }

    /// Adds sinusoids about the present place.
    pub fn wave(&mut self, tones: Vec<Tone>, seconds: f64) {
        self.push(seconds, Leg::Wave { about: self.here, tones });
    }

    /// The desired point at a time; at rest before the start and after the end.
    pub fn sample(&self, time: f64) -> DesiredPoint {
        let index = self.legs.partition_point(|(end, _)| *end <= time);
        let begin = index.checked_sub(1).map_or(0.0, |before| self.legs[before].0);
        let values = match self.legs.get(index) {
            None => self.here.map(|x| [x, 0.0, 0.0]),
            Some(_) if time < 0.0 => self.start.map(|x| [x, 0.0, 0.0]),
            Some((end, leg)) => leg.sample(time - begin, end - begin),
        };
        let [north, east, down, yaw] = values;
        let of = |k: usize| Ned::new(north[k], east[k], down[k]);
        DesiredPoint {
            position: of(0),
            velocity: of(1),
            acceleration: of(2),
            yaw: yaw[0],
            yaw_rate: yaw[1],
        }
    }
}

impl Leg {
    /// Value, first and second derivative of each coordinate, `time` s into `seconds`.
    fn sample(&self, time: f64, seconds: f64) -> [[f64; 3]; AXES] {
        match self {
            Leg::Move { from, to } => {
                let [share, rate, acceleration] = smooth(time, seconds);
                std::array::from_fn(|i| {
                    let way = to[i] - from[i];
                    [from[i] + way * share, way * rate, way * acceleration]
                })
            }
            Leg::Wave { about, tones } => {
                let ramp = RAMP_S.min(0.5 * seconds);
                let [e, de, dde] = if time < ramp {
                    smooth(time, ramp)
                } else if seconds - time < ramp {
                    let [e, de, dde] = smooth(seconds - time, ramp);
                    [e, -de, dde]
                } else {
                    [1.0, 0.0, 0.0]
                };
                let mut values = about.map(|x| [x, 0.0, 0.0]);
                for tone in tones {
                    let omega = TAU / tone.period_s;
                    let (sin, cos) = (omega * time + tone.phase).sin_cos();
                    let a = tone.amplitude;
                    let [value, rate, acceleration] = &mut values[tone.axis];
                    *value += a * e * sin;
                    *rate += a * (e * omega * cos + de * sin);
                    *acceleration += a * (2.0 * de * omega * cos + (dde - e * omega * omega) * sin);
                }
                values
            }
        }
    }
}

/// Minimum-jerk profile from 0 to 1 within `seconds`, with its two derivatives.
fn smooth(time: f64, seconds: f64) -> [f64; 3] {
    let x = (time / seconds).clamp(0.0, 1.0);
    let (x2, x3) = (x * x, x * x * x);
    [
        x3 * (10.0 - 15.0 * x + 6.0 * x2),
        30.0 * x2 * (1.0 - 2.0 * x + x2) / seconds,
        60.0 * x * (1.0 - 3.0 * x + 2.0 * x2) / (seconds * seconds),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_derivatives_match_finite_differences() {
        let mut motion = Motion::at([0.0, 1.0, -2.0, 0.3]);
        motion.hold(1.0);
        motion.move_to([1.0, -1.0, -3.0, 2.0], 2.0);
        motion.wave(vec![Tone { axis: 1, amplitude: 0.7, period_s: 1.9, phase: 0.4 }], 5.0);
        assert_eq!(motion.duration(), 8.0);
        let h = 1e-5;
        for step in 1..80 {
            let t = 0.1 * f64::from(step) + 0.013;
            let (before, here, after) =
                (motion.sample(t - h), motion.sample(t), motion.sample(t + h));
            let rate = (after.position - before.position) * (0.5 / h);
            assert!((rate - here.velocity).norm() < 1e-6, "{t}");
            let rate = (after.velocity - before.velocity) * (0.5 / h);
            assert!((rate - here.acceleration).norm() < 1e-5, "{t}");
            assert!(((after.yaw - before.yaw) * (0.5 / h) - here.yaw_rate).abs() < 1e-6);
        }
        assert_eq!(motion.sample(-1.0).yaw, 0.3);
        assert_eq!(motion.sample(99.0).position, motion.sample(8.0).position);
    }
}
