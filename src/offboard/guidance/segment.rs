//! A straight path between two places, for take-off and the approach.

use vehicle::frame::{Ned, wrap_angle};

use crate::plan::trajectory::DesiredPoint;

/// Shortest duration of a segment, s.
const DURATION_MIN_S: f64 = 1.0;
/// Peak slope of the minimum-jerk profile.
const PEAK_SLOPE: f64 = 15.0 / 8.0;

/// A place and a heading (rad).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Waypoint {
    pub position: Ned,
    pub yaw: f64,
}

/// The highest speeds along a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Speeds {
    pub speed_m_s: f64,
    pub yaw_rate_rad_s: f64,
}

/// A straight path from rest to rest with a minimum-jerk profile; yaw turns the shorter way.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Segment {
    from: Waypoint,
    to: Ned,
    yaw_step: f64,
    duration_s: f64,
}

impl Segment {
    pub fn between(from: Waypoint, to: Waypoint, most: Speeds) -> Self {
        let yaw_step = wrap_angle(to.yaw - from.yaw);
        let by_speed = PEAK_SLOPE * (to.position - from.position).norm() / most.speed_m_s;
        let by_yaw = PEAK_SLOPE * yaw_step.abs() / most.yaw_rate_rad_s;
        let duration_s = by_speed.max(by_yaw).max(DURATION_MIN_S);
        Self { from, to: to.position, yaw_step, duration_s }
    }

    pub fn from(&self) -> Ned {
        self.from.position
    }

    pub fn to(&self) -> Ned {
        self.to
    }

    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    pub fn step(&self) -> Ned {
        self.to - self.from.position
    }

    /// The share of the path behind it `t` seconds after the start.
    pub fn share(&self, t: f64) -> f64 {
        let x = self.passed(t);
        x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)
    }

    fn passed(&self, t: f64) -> f64 {
        (t / self.duration_s).clamp(0.0, 1.0)
    }

    /// The motion `t` seconds after the start; at rest from the end on. The acceleration is zero:
    /// feedback provides it.
    pub fn at(&self, t: f64) -> DesiredPoint {
        let (x, value) = (self.passed(t), self.share(t));
        let slope = 30.0 * (x * (1.0 - x)).powi(2) / self.duration_s;
        DesiredPoint {
            position: self.from.position + self.step() * value,
            velocity: self.step() * slope,
            acceleration: Ned::zero(),
            yaw: self.from.yaw + self.yaw_step * value,
            yaw_rate: self.yaw_step * slope,
        }
    }
}
