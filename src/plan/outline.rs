//! A tube's outline for plots: a helix around the path at the tube's radius.

use std::f64::consts::TAU;

use vehicle::frame::Ned;

/// Number of points of the line, and of each turn.
const POINTS: usize = 1400;
const TURN: usize = 20;
/// Shortest distance between two points that gives a direction, m.
const WAY_MIN_M: f64 = 1e-9;

/// The helix around a path (m) with a radius (m) at each point; empty for fewer than two points.
pub fn outline(path: &[Ned], radius_m: &[f64]) -> Vec<Ned> {
    let Some(last) = path.len().min(radius_m.len()).checked_sub(1).filter(|last| *last > 0) else {
        return Vec::new();
    };
    let (north, down) = (Ned::new(1.0, 0.0, 0.0), Ned::new(0.0, 0.0, 1.0));
    let mut along = north;
    (0..POINTS)
        .map(|point| {
            let at = point as f64 / (POINTS - 1) as f64 * last as f64;
            let before = (at as usize).min(last - 1);
            let share = at - before as f64;
            let way = path[before + 1] - path[before];
            if way.norm() > WAY_MIN_M {
                along = way * (1.0 / way.norm());
            }
            // Along a vertical path, down has no perpendicular part.
            let reference = if along.down().abs() > 0.9 { north } else { down };
            let side = along.cross(reference);
            let side = side * (1.0 / side.norm());
            let (sin, cos) = (TAU * point as f64 / TURN as f64).sin_cos();
            let radius = radius_m[before] + share * (radius_m[before + 1] - radius_m[before]);
            path[before] + way * share + (side * cos + along.cross(side) * sin) * radius
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outline_is_at_the_radius_from_the_path() {
        let path: Vec<Ned> = (0..50).map(|k| Ned::new(0.1 * f64::from(k), 0.0, -1.0)).collect();
        let radius: Vec<f64> = (0..50).map(|k| 0.1 + 0.01 * f64::from(k)).collect();
        let line = outline(&path, &radius);
        assert_eq!(line.len(), POINTS);
        for point in line {
            let expected = 0.1 + 0.1 * point.north();
            let off = point.east().hypot(point.down() + 1.0);
            assert!((off - expected).abs() < 1e-9, "{point:?}");
        }
    }

    #[test]
    fn stationary_and_vertical_paths_have_finite_outlines() {
        let up: Vec<Ned> = (0..3).map(|k| Ned::new(0.0, 0.0, -f64::from(k))).collect();
        for path in [up, vec![Ned::zero(); 3]] {
            assert!(outline(&path, &[0.2; 3]).iter().all(|point| point.is_finite()));
        }
        assert!(outline(&[], &[]).is_empty());
        assert!(outline(&[Ned::zero()], &[0.1]).is_empty());
    }
}
