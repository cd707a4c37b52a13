//! A desired trajectory: position and yaw over time, relative to its anchor.

use super::curve::{Envelope, HarmonicCurve};
pub use super::desired_point::DesiredPoint;
use super::path::MinimumJerkPath;
use super::table::Table;

/// A desired trajectory from time 0 to [`Trajectory::duration`].
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    name: String,
    shape: Shape,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shape {
    /// Harmonics in each axis, run through an envelope: they start and end at rest.
    Harmonic { curve: HarmonicCurve, envelope: Envelope },
    /// Rest-to-rest segments between waypoints.
    Path(MinimumJerkPath),
    /// Position jumps, for step responses.
    Steps { points: Vec<DesiredPoint>, dwell_s: f64 },
    /// Rows of a file.
    Table(Table),
    /// Another trajectory, repeated; its yaw advances by `turned_rad` per lap.
    Laps { lap: Box<Trajectory>, count: u32, turned_rad: f64 },
}

/// The trajectory is not closed, so it has no laps.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "trajectory {name} is not closed: its start and end differ by {position_m:.3} m, \
     {velocity_m_s:.3} m/s and {yaw_rad:.3} rad of yaw; laps need a closed course"
)]
pub struct NotClosed {
    name: String,
    position_m: f64,
    velocity_m_s: f64,
    yaw_rad: f64,
}

/// Largest difference between start and end of a closed course, m, m/s and rad.
const CLOSED: f64 = 1e-3;

impl Trajectory {
    pub(super) fn new(name: impl Into<String>, shape: Shape) -> Self {
        Self { name: name.into(), shape }
    }

    /// Repeats the trajectory `count` times (at least once) without a pause.
    ///
    /// # Errors
    /// [`NotClosed`].
    pub fn laps(self, count: u32) -> Result<Self, NotClosed> {
        let (from, to) = (self.sample(0.0), self.sample(self.duration()));
        let turned_rad = to.yaw - from.yaw;
        let full_turns = (turned_rad / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        let apart = [
            (to.position - from.position).norm(),
            (to.velocity - from.velocity).norm(),
            (turned_rad - full_turns).abs(),
        ];
        if !apart.iter().all(|apart| *apart <= CLOSED) {
            let [position_m, velocity_m_s, yaw_rad] = apart;
            return Err(NotClosed { name: self.name, position_m, velocity_m_s, yaw_rad });
        }
        let (name, count) = (self.name.clone(), count.max(1));
        Ok(Self { name, shape: Shape::Laps { lap: Box::new(self), count, turned_rad: full_turns } })
    }

    /// Its name in logs and reports.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Length in s.
    pub fn duration(&self) -> f64 {
        match &self.shape {
            Shape::Harmonic { envelope, .. } => envelope.duration(),
            Shape::Path(path) => path.duration(),
            Shape::Steps { points, dwell_s } => points.len() as f64 * dwell_s,
            Shape::Table(table) => table.duration(),
            Shape::Laps { lap, count, .. } => lap.duration() * f64::from(*count),
        }
    }

    /// The desired point at `t` seconds, held at the ends outside 0..duration.
    pub fn sample(&self, t: f64) -> DesiredPoint {
        let t = t.clamp(0.0, self.duration());
        match &self.shape {
            Shape::Harmonic { curve, envelope } => curve.sample(envelope.phase(t)),
            Shape::Path(path) => path.sample(t),
            Shape::Steps { points, dwell_s } => {
                let index = ((t / dwell_s) as usize).min(points.len() - 1);
                points[index]
            }
            Shape::Table(table) => table.sample(t),
            Shape::Laps { lap, count, turned_rad } => {
                let flown = (t / lap.duration()).floor().clamp(0.0, f64::from(count - 1));
                let mut point = lap.sample(t - flown * lap.duration());
                point.yaw += flown * turned_rad;
                point
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    fn parsed(text: &str) -> Trajectory {
        Trajectory::parse(text, Path::new("test")).expect("a trajectory")
    }

    #[test]
    fn laps_join_without_a_jump() {
        let circle = "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = 10\namplitude_m = 1\n\
                      period_s = 5\nyaw_period_s = 10\nramp_s = 1";
        let one = parsed(circle);
        let lap_s = one.duration();
        let three = one.clone().laps(3).expect("closed");
        assert!((three.duration() - 3.0 * lap_s).abs() < 1e-9);
        let steps = (three.duration() * 100.0) as usize;
        for step in 0..steps {
            let (a, b) =
                (three.sample(step as f64 * 0.01), three.sample(step as f64 * 0.01 + 0.01));
            assert!((b.position - a.position).norm() < 0.03, "{step}");
            assert!((b.yaw - a.yaw).abs() < 0.02, "{step}");
        }
        let (first, third) = (one.sample(3.0), three.sample(3.0 + 2.0 * lap_s));
        assert!((first.position - third.position).norm() < 1e-9);
        assert_eq!(one.laps(1).expect("closed").sample(2.5), parsed(circle).sample(2.5));
    }

    #[test]
    fn open_course_has_no_laps() {
        let open = "family = 'waypoints'\npoints = [{ north_m = 0, east_m = 0, altitude_m = 1 },\n\
                    { north_m = 1, east_m = 0, altitude_m = 1 }]";
        let found = parsed(open).laps(2).expect_err("open");
        assert!(found.to_string().contains("1.000 m"), "{found}");
    }
}
