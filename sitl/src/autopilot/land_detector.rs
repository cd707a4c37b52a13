//! Whether the vehicle stands on the ground, judged from what the autopilot itself knows.

use vehicle::frame::{Frd, Ned};

/// Still for this long, with little thrust, is landed, us.
const STILL_US: u64 = 500_000;
/// Thrust above hover's for this long is flight, even if nothing moves, us.
const LIFTING_US: u64 = 500_000;

/// What the detector looks at.
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// Velocity, m/s.
    pub velocity: Ned,
    /// Body rate, rad/s.
    pub body_rate: Frd,
    /// Collective output over hover's; 0 while disarmed.
    pub thrust_over_hover: f64,
    /// Tilt that the attitude loop is to hold, rad.
    pub lean_asked: f64,
}

/// Landed or not, with hysteresis.
#[derive(Clone, Debug)]
pub struct LandDetector {
    /// Whether a landing is ever noticed.
    works: bool,
    /// Largest tilt that the attitude loop may ask for of a vehicle that has landed, rad.
    lean_max: f64,
    landed: bool,
    since_us: Option<u64>,
}

impl LandDetector {
    /// A vehicle that stands on the ground, or one that starts in the air; one that does not work
    /// never notices a landing, and none does while the loop asks for more tilt than `lean_max`, rad.
    pub fn new(landed: bool, works: bool, lean_max: f64) -> Self {
        Self { works, lean_max, landed, since_us: None }
    }

    /// Whether the vehicle stands on the ground.
    pub fn landed(&self) -> bool {
        self.landed
    }

    /// One look at `now_us`; returns whether the judgement changed.
    pub fn update(&mut self, now_us: u64, motion: &Motion) -> bool {
        let speed = motion.velocity.norm();
        let suspected = if self.landed {
            // Rising under thrust is flight at once; thrust without motion takes longer to believe.
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
                && motion.lean_asked <= self.lean_max
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
        Motion { velocity, body_rate: Frd::zero(), thrust_over_hover, lean_asked: 0.0 }
    }

    #[test]
    fn rising_is_flight_and_stillness_without_thrust_is_landed() {
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
    fn a_vehicle_that_is_to_lean_on_the_ground_has_not_landed() {
        let mut detector = LandDetector::new(false, true, 0.3);
        let leaning = Motion { lean_asked: 0.4, ..motion(0.0, 0.1) };
        for tick in 0..1000 {
            assert!(!detector.update(tick * 4000, &leaning));
        }
        assert!(!detector.update(4_000_000, &motion(0.0, 0.1)));
        assert!(detector.update(4_000_000 + STILL_US, &motion(0.0, 0.1)));
    }
}
