//! The offset by which a viewer moves the goal, and its motion towards the requested value.

use vehicle::frame::Ned;

use crate::clock::VehicleTime;

/// Limits on the offset's motion, m/s and m/s^2.
const SPEED_MAX_M_S: f64 = 0.5;
const ACCELERATION_MAX_M_S2: f64 = 0.5;
/// Speed over the remaining distance, 1/s: from 0.5 m/s it decelerates at 0.5 m/s^2.
const RATE_PER_S: f64 = 1.0;
/// Distance and speed below which the offset counts as reached, m and m/s.
const THERE_M: f64 = 1e-3;
/// Longest step of the motion; the rest of a longer gap between samples is skipped, s.
const STEP_MAX_S: f64 = 0.1;

/// An offset that moves to the requested one with a continuous velocity.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct GoalOffset {
    requested: Ned,
    at: Ned,
    velocity: Ned,
    last: Option<VehicleTime>,
}

impl GoalOffset {
    /// The requested offset, m.
    pub fn requested(&self) -> Ned {
        self.requested
    }

    /// The present offset, m.
    pub fn at(&self) -> Ned {
        self.at
    }

    /// Velocity of the offset, m/s.
    pub fn velocity(&self) -> Ned {
        self.velocity
    }

    /// Requests another offset.
    pub fn lead_to(&mut self, offset: Ned) {
        self.requested = offset;
    }

    /// Jumps to the requested offset, as on the ground.
    pub fn arrive(&mut self) {
        (self.at, self.velocity) = (self.requested, Ned::zero());
    }

    /// Stops at the present offset.
    pub fn stay(&mut self) {
        (self.requested, self.velocity) = (self.at, Ned::zero());
    }

    /// Advances to the time of a sample.
    pub fn step(&mut self, now: VehicleTime) {
        let dt = self.last.replace(now).map_or(0.0, |last| now.seconds_since(last));
        let dt = dt.clamp(0.0, STEP_MAX_S);
        let left = self.requested - self.at;
        if left.norm() < THERE_M && self.velocity.norm() < THERE_M {
            return self.arrive();
        }
        let target = within(left * RATE_PER_S, SPEED_MAX_M_S);
        self.velocity += within(target - self.velocity, ACCELERATION_MAX_M_S2 * dt);
        self.at += self.velocity * dt;
    }
}

fn within(vector: Ned, most: f64) -> Ned {
    let length = vector.norm();
    if length > most { vector * (most / length) } else { vector }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goal_offset_moves_slowly_and_smoothly_to_its_target() {
        let mut offset = GoalOffset::default();
        offset.lead_to(Ned::new(2.0, -1.0, 0.5));
        let (mut speed, mut before, mut acceleration) = (0.0_f64, Ned::zero(), 0.0_f64);
        for tick in 0..1500 {
            // Another goal is requested on the way.
            if tick == 300 {
                offset.lead_to(Ned::new(-1.0, 0.0, 0.0));
            }
            offset.step(VehicleTime::from_us(tick * 10_000));
            speed = speed.max(offset.velocity().norm());
            acceleration = acceleration.max((offset.velocity() - before).norm() / 0.01);
            before = offset.velocity();
        }
        assert!(speed <= SPEED_MAX_M_S * 1.001 && speed > 0.4, "{speed} m/s");
        assert!(acceleration <= ACCELERATION_MAX_M_S2 * 1.01, "{acceleration} m/s^2");
        assert_eq!((offset.at(), offset.velocity()), (Ned::new(-1.0, 0.0, 0.0), Ned::zero()));
    }

    #[test]
    fn goal_offset_does_not_catch_up_after_a_gap() {
        let mut offset = GoalOffset::default();
        offset.lead_to(Ned::new(3.0, 0.0, 0.0));
        offset.step(VehicleTime::from_us(0));
        offset.step(VehicleTime::from_us(60_000_000));
        assert!(offset.at().norm() < 0.01, "{:?}", offset.at());
    }
}
