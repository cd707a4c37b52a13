//! A cubic spline through places at given times.

use vehicle::frame::Ned;

/// Twice continuously differentiable, with given velocities at its ends.
#[derive(Clone, Debug)]
pub(super) struct Spline {
    times: Vec<f64>,
    places: Vec<Ned>,
    velocities: Vec<Ned>,
}

/// Position (m), velocity (m/s) and acceleration (m/s^2).
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    pub position: Ned,
    pub velocity: Ned,
    pub acceleration: Ned,
}

impl Spline {
    /// A spline through `places`, where `ways` holds the duration of each segment, s, with
    /// velocities `from` and `to` at its ends.
    pub fn new(places: Vec<Ned>, ways: &[f64], [from, to]: [Ned; 2]) -> Self {
        let mut times = vec![0.0];
        let mut time = 0.0;
        times.extend(ways.iter().map(|way| {
            time += way;
            time
        }));
        let mut velocities = vec![from; places.len()];
        if let Some(last) = velocities.last_mut() {
            *last = to;
        }
        // Equal accelerations on both sides of a place: tridiagonal in the velocities.
        let mut factors = vec![0.0; places.len()];
        for i in 1..places.len().saturating_sub(1) {
            let (before, after) = (ways[i - 1], ways[i]);
            let right = (places[i] - places[i - 1]) * (3.0 / (before * before))
                + (places[i + 1] - places[i]) * (3.0 / (after * after));
            let pivot = 2.0 / before + 2.0 / after - factors[i - 1] / before;
            factors[i] = 1.0 / (after * pivot);
            velocities[i] = (right - velocities[i - 1] * (1.0 / before)) * (1.0 / pivot);
        }
        for i in (1..places.len().saturating_sub(1)).rev() {
            velocities[i] = velocities[i] - velocities[i + 1] * factors[i];
        }
        Self { times, places, velocities }
    }

    /// Number of segments.
    pub fn ways(&self) -> usize {
        self.times.len() - 1
    }

    /// Duration of a segment, s.
    pub fn length_s(&self, way: usize) -> f64 {
        self.times[way + 1] - self.times[way]
    }

    /// The moment at a fraction of a segment.
    pub fn at(&self, way: usize, share: f64) -> Moment {
        let (length, s) = (self.length_s(way), share);
        let rise = self.places[way + 1] - self.places[way];
        let (v, w) = (self.velocities[way], self.velocities[way + 1]);
        Moment {
            position: self.places[way]
                + rise * (s * s * (3.0 - 2.0 * s))
                + v * (length * s * (1.0 - s) * (1.0 - s))
                - w * (length * s * s * (1.0 - s)),
            velocity: rise * (6.0 * s * (1.0 - s) / length)
                + v * (1.0 - 4.0 * s + 3.0 * s * s)
                + w * (3.0 * s * s - 2.0 * s),
            acceleration: rise * ((6.0 - 12.0 * s) / (length * length))
                + v * ((6.0 * s - 4.0) / length)
                + w * ((6.0 * s - 2.0) / length),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spline_passes_places_with_continuous_acceleration() {
        let places =
            vec![Ned::zero(), Ned::new(1.0, 2.0, -1.0), Ned::new(3.0, 0.0, 0.5), Ned::zero()];
        let ends = [Ned::new(0.5, 0.0, 0.0), Ned::zero()];
        let spline = Spline::new(places.clone(), &[1.0, 0.7, 2.0], ends);
        for way in 0..3 {
            assert!((spline.at(way, 1.0).position - places[way + 1]).norm() < 1e-12);
        }
        for way in 0..2 {
            let (before, after) = (spline.at(way, 1.0), spline.at(way + 1, 0.0));
            assert!((before.velocity - after.velocity).norm() < 1e-12);
            assert!((before.acceleration - after.acceleration).norm() < 1e-9);
        }
        assert!((spline.at(0, 0.0).velocity - ends[0]).norm() < 1e-12);
        assert!(spline.at(2, 1.0).velocity.norm() < 1e-12);
    }
}
