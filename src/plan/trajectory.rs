//! A desired trajectory: position and yaw over time, relative to its anchor.

use super::curve::{Envelope, HarmonicCurve};
pub use super::desired_point::DesiredPoint;
use super::path::MinimumJerkPath;
use super::table::Table;

/// A desired trajectory from time 0 to [`Trajectory::duration`].
#[derive(Clone, Debug)]
pub struct Trajectory {
    name: String,
    shape: Shape,
}

#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// Harmonics in each axis, run through an envelope: they start and end at rest.
    Harmonic { curve: HarmonicCurve, envelope: Envelope },
    /// Rest-to-rest segments between waypoints.
    Path(MinimumJerkPath),
    /// Position jumps, for step responses.
    Steps { points: Vec<DesiredPoint>, dwell_s: f64 },
    /// Rows of a file.
    Table(Table),
}

impl Trajectory {
    pub(super) fn new(name: impl Into<String>, shape: Shape) -> Self {
        Self { name: name.into(), shape }
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
        }
    }
}
