//! Waypoints joined by rest-to-rest minimum-jerk segments.

use std::f64::consts::PI;

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use vehicle::frame::{Ned, wrap_angle};

use super::desired_point::DesiredPoint;

/// A point to reach, and the time to stay there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Waypoint {
    pub position: Ned,
    /// rad
    pub yaw: f64,
    pub hold_s: f64,
}

/// Limits on the speed of a segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pace {
    /// m/s
    pub speed: f64,
    /// m/s^2
    pub acceleration: f64,
    /// rad/s
    pub yaw_rate: f64,
}

/// Straight segments, each position(x) = a + (b - a)(10 x^3 - 15 x^4 + 6 x^5), x = t / duration,
/// the minimum-jerk profile between two points at rest (Flash and Hogan, 1985, eq. 3). Yaw has the
/// same profile and turns the shorter way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct MinimumJerkPath {
    /// Never empty.
    segments: Vec<Segment>,
    duration: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Segment {
    start_s: f64,
    duration_s: f64,
    from: Ned,
    step: Ned,
    yaw_from: f64,
    yaw_step: f64,
}

impl MinimumJerkPath {
    /// A path through the waypoints in order; `None` without any.
    pub fn through(waypoints: &[Waypoint], pace: Pace) -> Option<Self> {
        let first = *waypoints.first()?;
        let (mut segments, mut clock) = (Vec::new(), 0.0);
        let (mut position, mut yaw) = (first.position, first.yaw);
        for waypoint in waypoints {
            let step = waypoint.position - position;
            let yaw_step = wrap_angle(waypoint.yaw - yaw);
            // The profile's largest slope is 15/8, its largest curvature 10/sqrt(3).
            let by_speed = 15.0 / 8.0 * step.norm() / pace.speed;
            let by_acceleration = (10.0 / 3f64.sqrt() * step.norm() / pace.acceleration).sqrt();
            let by_yaw = 15.0 / 8.0 * yaw_step.abs() / pace.yaw_rate;
            let duration_s = by_speed.max(by_acceleration).max(by_yaw);
            segments.push(Segment {
                start_s: clock,
                duration_s,
                from: position,
                step,
                yaw_from: yaw,
                yaw_step,
            });
            clock += duration_s + waypoint.hold_s;
            (position, yaw) = (waypoint.position, yaw + yaw_step);
        }
        Some(Self { segments, duration: clock })
    }

    /// A path through `count` waypoints drawn uniformly from a box around `centre`, starting and
    /// ending at the centre.
    pub fn random(
        seed: u64,
        count: usize,
        centre: Ned,
        half_size: [f64; 3],
        hold_s: f64,
        pace: Pace,
    ) -> Option<Self> {
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let still = Waypoint { position: centre, yaw: 0.0, hold_s };
        let mut waypoints = vec![still];
        for _ in 0..count {
            let offset = half_size.map(|half| half * rng.random_range(-1.0..=1.0));
            waypoints.push(Waypoint {
                position: centre + Ned::from(offset),
                yaw: rng.random_range(-PI..PI),
                hold_s,
            });
        }
        waypoints.push(still);
        Self::through(&waypoints, pace)
    }

    /// Length in s.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// The point at `t` within the duration.
    pub fn sample(&self, t: f64) -> DesiredPoint {
        let index = self.segments.partition_point(|segment| segment.start_s <= t);
        let segment = &self.segments[index.saturating_sub(1)];
        let since = t - segment.start_s;
        let (value, slope, curvature) = if since < segment.duration_s {
            let (x, length) = (since / segment.duration_s, segment.duration_s);
            (
                x.powi(3) * (10.0 - 15.0 * x + 6.0 * x * x),
                30.0 * (x * (1.0 - x)).powi(2) / length,
                60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (length * length),
            )
        } else {
            (1.0, 0.0, 0.0)
        };
        DesiredPoint {
            position: segment.from + segment.step * value,
            velocity: segment.step * slope,
            acceleration: segment.step * curvature,
            yaw: segment.yaw_from + segment.yaw_step * value,
            yaw_rate: segment.yaw_step * slope,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PACE: Pace = Pace { speed: 1.0, acceleration: 2.0, yaw_rate: 1.0 };

    #[test]
    fn path_respects_pace_and_reaches_every_waypoint() {
        let path =
            MinimumJerkPath::random(7, 6, Ned::new(0.0, 0.0, -1.0), [2.0, 2.0, 0.5], 0.3, PACE)
                .expect("a path");
        let samples =
            (0..(path.duration() * 1000.0) as usize).map(|i| path.sample(i as f64 * 1e-3));
        let (mut speed, mut acceleration) = (0.0f64, 0.0f64);
        for point in samples {
            speed = speed.max(point.velocity.norm());
            acceleration = acceleration.max(point.acceleration.norm());
        }
        assert!(speed <= PACE.speed + 1e-9 && speed > 0.8 * PACE.speed);
        assert!(acceleration <= PACE.acceleration + 1e-9);
        assert!((path.sample(path.duration()).position - Ned::new(0.0, 0.0, -1.0)).norm() < 1e-9);
    }

    #[test]
    fn same_seed_gives_the_same_path() {
        let draw = |seed| {
            MinimumJerkPath::random(seed, 3, Ned::zero(), [1.0; 3], 0.0, PACE)
                .map(|path| path.sample(2.0))
        };
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }

    #[test]
    fn yaw_wraps_the_shorter_way() {
        let waypoint = |yaw| Waypoint { position: Ned::zero(), yaw, hold_s: 0.0 };
        let path = MinimumJerkPath::through(&[waypoint(3.0), waypoint(-3.0)], PACE).expect("path");
        assert!((path.sample(path.duration()).yaw - (2.0 * PI - 3.0)).abs() < 1e-12);
    }
}
