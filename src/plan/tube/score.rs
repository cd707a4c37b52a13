//! The nonconformity score of a flight: its largest deviation from the plan relative to the scale.

use vehicle::frame::Ned;

use super::Shape;
use super::scale::PERIOD_S;

/// Longest flight that has a score, s.
const LENGTH_MAX_S: f64 = 7200.0;

/// One control tick along a plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlownPoint {
    /// Time along the plan, s.
    pub time_s: f64,
    /// Planned position, m.
    pub planned: Ned,
    /// Planned speed, m/s.
    pub speed_m_s: f64,
    /// Position of the vehicle, m.
    pub flown: Ned,
}

/// Resamples rows of time (s) and speed (m/s) on the grid of [`PERIOD_S`] from 0. Each value is
/// that of the last row at or before it.
pub(super) fn on_grid(rows: impl Iterator<Item = [f64; 2]>) -> Vec<f64> {
    let mut speeds: Vec<f64> = Vec::new();
    let mut held = None;
    for [time_s, speed_m_s] in rows {
        if !(0.0..=LENGTH_MAX_S).contains(&time_s) {
            continue;
        }
        let before = held.replace(speed_m_s).unwrap_or(speed_m_s);
        let until = (time_s / PERIOD_S + 1e-6).floor() as usize;
        if speeds.len() < until {
            speeds.resize(until, before);
        }
        if speeds.len() == until {
            speeds.push(speed_m_s);
        }
    }
    speeds
}

impl Shape {
    /// The largest ratio of the distance from the plan to the scale. `None` if the flight has no
    /// points, or if a ratio is not finite.
    pub fn score(&self, points: &[FlownPoint]) -> Option<f64> {
        let scale = self.scale(points.iter().map(|point| [point.time_s, point.speed_m_s]));
        let last = scale.len().checked_sub(1)?;
        let mut scores = points.iter().map(|point| {
            let index = ((point.time_s / PERIOD_S).max(0.0) as usize).min(last);
            (point.flown - point.planned).norm() / scale[index]
        });
        // A position that is not finite is not within the tube.
        scores.try_fold(0.0, |most: f64, score| score.is_finite().then(|| most.max(score)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::error::{AxisError, ModelError};
    use super::super::scale::TrackingLoop;
    use super::*;

    #[test]
    fn grid_holds_the_last_row() {
        let rows = [[0.0, 1.0], [0.01, 2.0], [0.025, 3.0], [0.06, 4.0], [f64::NAN, 9.0]];
        assert_eq!(on_grid(rows.into_iter()), [1.0, 2.0, 3.0, 3.0, 3.0, 3.0, 4.0]);
        assert!(on_grid(std::iter::empty()).is_empty());
        // The first row also fills the grid before it.
        assert_eq!(on_grid([[0.02, 5.0]].into_iter()), [5.0; 3]);
    }

    #[test]
    fn score_is_the_worst_scaled_instant() {
        let axis = AxisError { at_rest_m_s2: 0.4, per_speed_s: 0.0, correlation_s: 60.0 };
        let feedback =
            TrackingLoop { stiffness_s2: [8.0; 2], damping_s: [4.0; 2], rejection_s: None };
        let shape = Shape { feedback, error: ModelError { horizontal: axis, vertical: axis } };
        let point = |k: i32, off: f64| FlownPoint {
            time_s: 0.01 * f64::from(k),
            planned: Ned::new(1.0, 0.0, -1.0),
            speed_m_s: 0.0,
            flown: Ned::new(1.0 + off, 0.0, -1.0),
        };
        let points: Vec<FlownPoint> =
            (0..100).map(|k| point(k, if k == 40 { -0.2 } else { 0.1 })).collect();
        let scale = shape.scale(points.iter().map(|p| [p.time_s, p.speed_m_s]));
        let score = shape.score(&points).expect("a score");
        assert!((score - 0.2 / scale[40]).abs() < 1e-9);
        assert_eq!(shape.score(&[]), None);
        assert_eq!(shape.score(&[point(0, f64::NAN), point(1, 0.1)]), None);
    }
}
