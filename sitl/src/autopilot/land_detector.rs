//! Detects whether the vehicle is on the ground, from the autopilot's data only.

use vehicle::frame::{Frd, Ned};

/// Time without motion and with little thrust that counts as landed, us.
const STILL_US: u64 = 500_000;
/// Time with more than hover thrust that counts as flight, even without motion, us.
const LIFTING_US: u64 = 500_000;

/// The detector's inputs.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Body rate, rad/s.
    pub body_rate: Frd,
    /// Collective output over the one at hover; 0 while disarmed.
    pub thrust_over_hover: f64,
    /// Commanded tilt of the attitude loop, rad.
    pub requested_tilt: f64,
}

/// The land detector, with hysteresis.
#[derive(Clone, Debug)]
pub struct LandDetector {
    /// Whether it detects landings at all.
    works: bool,
    /// Largest commanded tilt of a landed vehicle, rad.
    lean_max: f64,
    landed: bool,
    since_us: Option<u64>,
}

impl LandDetector {
    /// Creates a detector that starts as `landed` or in the air. Without `works` it never detects a
    /// landing. It detects none while the commanded tilt exceeds `lean_max`, rad.
    pub fn new(landed: bool, works: bool, lean_max: f64) -> Self {
        Self { works, lean_max, landed, since_us: None }
    }

    /// Whether the vehicle is on the ground.
    pub fn landed(&self) -> bool {
        self.landed
    }

    /// Updates the state at `now_us` and returns whether it changed.
    pub fn update(&mut self, now_us: u64, motion: &Motion) -> bool {
        let speed = motion.velocity.norm();
        let suspected = if self.landed {
            // Climbing under thrust counts as flight at once; thrust without motion takes longer.
            if motion.thrust_over_hover > 0.3 && motion.velocity.down() < -0.2 {
                self.landed = false;
                self.since_us = None;
                return true;
            }
            motion.thrust_over_hover > 1.0
        } else {
            self.works
                && speed < 0.25
                && motion.body_rate.norm() < 0.7
                && motion.thrust_over_hover < 0.4
                && motion.requested_tilt <= self.lean_max
        };
        let hold_us = if self.landed { LIFTING_US } else { STILL_US };
        if !suspected {
            self.since_us = None;
            return false;
        }
        let since = *self.since_us.get_or_insert(now_us);
        if now_us.saturating_sub(since) < hold_us {
            return false;
        }
        self.landed = !self.landed;
        self.since_us = None;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn motion(down: f64, thrust_over_hover: f64) -> Motion {
        let velocity = Ned::new(0.0, 0.0, down);
        Motion { velocity, body_rate: Frd::zero(), thrust_over_hover, requested_tilt: 0.0 }
    }

    #[test]
    fn climb_means_flight_and_stillness_without_thrust_means_landed() {
        let mut detector = LandDetector::new(true, true, 0.3);
        assert!(!detector.update(0, &motion(0.0, 0.9)));
        assert!(detector.update(4000, &motion(-0.3, 1.1)));
        assert!(!detector.landed());
        assert!(!detector.update(8000, &motion(0.0, 0.1)));
        assert!(!detector.update(8000 + STILL_US - 1, &motion(0.0, 0.1)));
        assert!(detector.update(8000 + STILL_US, &motion(0.0, 0.1)));
        assert!(detector.landed());
    }

    #[test]
    fn hover_and_free_fall_are_not_landed() {
        let mut detector = LandDetector::new(false, true, 0.3);
        for tick in 0..1000 {
            assert!(!detector.update(tick * 4000, &motion(0.0, 1.0)));
        }
        for tick in 0..1000 {
            let now = 4_000_000 + tick * 4000;
            assert!(!detector.update(now, &motion(9.81 * tick as f64 * 0.004, 0.0)));
        }
    }

    #[test]
    fn commanded_lean_prevents_landing_detection() {
        let mut detector = LandDetector::new(false, true, 0.3);
        let leaning = Motion { requested_tilt: 0.4, ..motion(0.0, 0.1) };
        for tick in 0..1000 {
            assert!(!detector.update(tick * 4000, &leaning));
        }
        assert!(!detector.update(4_000_000, &motion(0.0, 0.1)));
        assert!(detector.update(4_000_000 + STILL_US, &motion(0.0, 0.1)));
    }
}
