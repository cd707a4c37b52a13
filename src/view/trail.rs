//! The vehicle's recent path, thinned.

use std::collections::VecDeque;
use std::time::Duration;

use vehicle::frame::Ned;

use crate::clock::HostTime;

/// The last two minutes of the path.
#[derive(Debug, Default)]
pub(super) struct Trail {
    points: VecDeque<Ned>,
    next: HostTime,
}

impl Trail {
    /// Time between two points.
    pub const PERIOD: Duration = Duration::from_millis(100);
    /// Number of points kept.
    pub const POINTS: usize = 1200;

    /// Adds the vehicle's position, unless the last point is too recent.
    pub fn add(&mut self, time: HostTime, position: Ned) {
        if time >= self.next {
            self.next = time + Self::PERIOD;
            if self.points.len() == Self::POINTS {
                self.points.pop_front();
            }
            self.points.push_back(position);
        }
    }

    /// The points, the oldest first.
    pub fn points(&self) -> impl Iterator<Item = Ned> {
        self.points.iter().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trail_is_thinned_and_drops_old_points() {
        let mut trail = Trail::default();
        let begin = HostTime::from_ns(1_000_000_000);
        for tick in 0..30_000_u32 {
            let time = begin + Duration::from_millis(10) * tick;
            trail.add(time, Ned::new(f64::from(tick), 0.0, 0.0));
        }
        let north: Vec<f64> = trail.points().map(|point| point.north()).collect();
        assert_eq!(north.len(), Trail::POINTS);
        assert_eq!((north[0], north[1], north[Trail::POINTS - 1]), (18_000.0, 18_010.0, 29_990.0));
    }
}
