//! The position of a vehicle that gets it from external poses only, as in a motion-capture room.
//!
//! The vehicle's sensed motion propagates the estimate; external poses correct it if they are close
//! enough. Without poses the estimate drifts, and after a time it becomes invalid.

use std::collections::VecDeque;

use rand::{Rng, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;
use vehicle::frame::Ned;

/// Gain of the correction by a pose.
const GAIN: f64 = 0.1;
/// Gate beyond which a pose is rejected, m: five standard deviations of PX4's EKF2_EVP_NOISE.
const GATE_M: f64 = 0.5;
/// Time without a pose after which the estimate drifts, us.
const COAST_US: u64 = 200_000;
/// Standard deviation of the drift's acceleration on each axis, m/s^2: a tilt of a few
/// milliradians.
const DRIFT_M_S2: f64 = 0.02;
/// Time constant of the velocity's error, s: without poses, a filter assumes that it is nearly at
/// rest.
const DRIFT_TIME_S: f64 = 4.0;
/// Age above which a time stamp must come from a different clock, us.
const AGE_MAX_US: u64 = 500_000;
/// Spacing of the stored positions, us.
const SPACING_US: u64 = 4_000;

/// An external pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutsidePose {
    /// Time stamp, us.
    pub stamp_us: u64,
    /// Position, m.
    pub position: Ned,
    /// Reset counter of the source of the poses.
    pub reset_count: u8,
}

/// The position estimate from external poses.
#[derive(Clone, Debug)]
pub struct Vision {
    lost_after_us: u64,
    drift: Ned,
    /// Estimate minus sensed value, m and m/s.
    offset: Ned,
    velocity: Ned,
    sensed: VecDeque<(u64, Ned)>,
    advanced_us: u64,
    fused_us: Option<u64>,
    reset_count: Option<u8>,
    /// Number of jumps of the estimate to a pose.
    resets: u8,
}

impl Vision {
    /// Creates an estimate that is invalid before the first pose and `lost_after_s` after the last.
    pub(super) fn new(lost_after_s: f64, seed: u64) -> Self {
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ 0x7669_7369);
        let [north, east]: [f64; 2] = std::array::from_fn(|_| rng.sample(StandardNormal));
        Self {
            lost_after_us: (lost_after_s * 1e6) as u64,
            // The barometer stabilises the height.
            drift: Ned::new(north, east, 0.0) * DRIFT_M_S2,
            offset: Ned::zero(),
            velocity: Ned::zero(),
            sensed: VecDeque::new(),
            advanced_us: 0,
            fused_us: None,
            reset_count: None,
            resets: 0,
        }
    }

    /// Whether the estimate is valid.
    pub fn is_known(&self, now_us: u64) -> bool {
        self.fused_us.is_some_and(|at| now_us.saturating_sub(at) <= self.lost_after_us)
    }

    /// Estimate minus sensed value, for position (m) and velocity (m/s).
    pub fn error(&self) -> [Ned; 2] {
        [self.offset, self.velocity]
    }

    /// Number of jumps of the estimate, modulo 256.
    pub fn resets(&self) -> u8 {
        self.resets
    }

    /// Advances to `now_us`, with the sensed position `sensed`.
    pub(super) fn advance(&mut self, now_us: u64, sensed: Ned) {
        let dt = now_us.saturating_sub(self.advanced_us) as f64 * 1e-6;
        self.advanced_us = now_us;
        match self.fused_us {
            // Before the first pose, the estimate is at the origin.
            None => self.offset = sensed * -1.0,
            Some(at) if now_us.saturating_sub(at) > COAST_US => {
                self.velocity += (self.drift - self.velocity * (1.0 / DRIFT_TIME_S)) * dt;
                self.offset += self.velocity * dt;
            }
            Some(_) => {}
        }
        if self.sensed.back().is_none_or(|(at, _)| now_us >= at + SPACING_US) {
            self.sensed.push_back((now_us, sensed));
        }
        while self.sensed.front().is_some_and(|(at, _)| at + AGE_MAX_US < now_us) {
            self.sensed.pop_front();
        }
    }

    /// Processes a pose received at `now_us`. A time stamp that is not recent comes from a
    /// different clock; the pose then counts from its arrival.
    pub(super) fn take(&mut self, now_us: u64, pose: &OutsidePose) {
        if !pose.position.is_finite() {
            return;
        }
        let is_of_late = (now_us.saturating_sub(AGE_MAX_US)..=now_us).contains(&pose.stamp_us);
        let at_us = if is_of_late { pose.stamp_us } else { now_us };
        let Some((_, sensed)) = self.sensed.iter().min_by_key(|(at, _)| at.abs_diff(at_us)) else {
            return;
        };
        let difference = pose.position - (*sensed + self.offset);
        let begins_anew = self.reset_count.replace(pose.reset_count) != Some(pose.reset_count);
        if begins_anew || !self.is_known(now_us) {
            self.offset += difference;
            // The first pose does not count as a jump.
            let is_jump = self.fused_us.is_some();
            self.resets = self.resets.wrapping_add(is_jump.into());
        } else if difference.norm() > GATE_M {
            return;
        } else {
            self.offset += difference * GAIN;
        }
        self.velocity = Ned::zero();
        self.fused_us = Some(now_us);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_US: u64 = 20_000;

    /// Sends poses at 50 Hz until `until_us`, with an error of `off`, for a vehicle at rest at (1,
    /// 2, -3).
    fn run(vision: &mut Vision, from_us: u64, until_us: u64, off: Option<Ned>) {
        let here = Ned::new(1.0, 2.0, -3.0);
        for now_us in (from_us..until_us).step_by(4_000) {
            vision.advance(now_us, here);
            if let Some(off) = off
                && now_us % RATE_US == 0
            {
                let pose = OutsidePose { stamp_us: now_us, position: here + off, reset_count: 0 };
                vision.take(now_us, &pose);
            }
        }
    }

    #[test]
    fn position_is_unknown_before_and_long_after_poses() {
        let mut vision = Vision::new(5.0, 1);
        run(&mut vision, 0, 1_000_000, None);
        assert!(!vision.is_known(1_000_000));
        assert!((vision.error()[0] + Ned::new(1.0, 2.0, -3.0)).norm() < 1e-9, "at the origin");
        run(&mut vision, 1_000_000, 3_000_000, Some(Ned::zero()));
        assert!(vision.is_known(3_000_000) && vision.error()[0].norm() < 1e-9);
        run(&mut vision, 3_000_000, 7_900_000, None);
        assert!(vision.is_known(7_900_000));
        let drift = vision.error()[0].norm();
        assert!((0.01..1.0).contains(&drift), "{drift}");
        run(&mut vision, 7_900_000, 8_100_000, None);
        assert!(!vision.is_known(8_100_000));
        // The position returns with a jump, which is counted.
        run(&mut vision, 8_100_000, 9_000_000, Some(Ned::zero()));
        assert!(vision.is_known(9_000_000) && vision.resets() == 1);
    }

    #[test]
    fn outlier_poses_are_rejected_until_the_position_is_lost() {
        let mut vision = Vision::new(5.0, 1);
        run(&mut vision, 0, 2_000_000, Some(Ned::zero()));
        run(&mut vision, 2_000_000, 4_000_000, Some(Ned::new(2.0, 0.0, 0.0)));
        assert!(vision.error()[0].north().abs() < 0.5);
        run(&mut vision, 4_000_000, 8_000_000, Some(Ned::new(2.0, 0.0, 0.0)));
        assert!(
            (vision.error()[0].north() - 2.0).abs() < 1e-6,
            "accepted once the position is lost"
        );
        assert_eq!(vision.resets(), 1);
    }
}
