//! Position and attitude between messages: what motion explains, and what only a jump of the
//! estimate does.

use vehicle::frame::{Attitude, Frd, Ned};

use super::{TelemetryFault, TelemetrySettings};
use crate::clock::VehicleTime;

/// Largest accelerations that motion explains, m/s^2, and rad/s^2 for rotation.
const ACCELERATION_MAX: f64 = 40.0;
const ANGULAR_ACCELERATION_MAX: f64 = 200.0;
/// Time constant for which a departure of position from velocity is remembered, s.
const SLIDE_TIME_S: f64 = 0.5;
/// After a slide was found, it continues while this share of the threshold is exceeded again. The
/// remainder is then no larger than a step of jump size.
const CONTINUED_SHARE: f64 = 0.25;
/// After a longer gap between messages, the motion during the gap is unknown, s.
const SLIDE_GAP_MAX_S: f64 = 0.1;

#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    pub stamp: VehicleTime,
    pub position: Ned,
    pub velocity: Ned,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    pub stamp: VehicleTime,
    pub attitude: Attitude,
    pub body_rate: Frd,
}

impl Pose {
    /// Whether all values except the stamps are equal.
    pub fn is_like(&self, other: &Self) -> bool {
        (self.position, self.velocity) == (other.position, other.velocity)
    }

    /// Distance of `now` from where the mean of both velocities leads, m.
    fn beside(&self, now: &Self) -> Ned {
        let dt = now.stamp.seconds_since(self.stamp);
        now.position - self.position - (self.velocity + now.velocity) * (0.5 * dt)
    }

    /// Checks the step to `now`.
    ///
    /// # Errors
    /// A step that no acceleration of a quadrotor explains.
    pub fn jump(&self, now: &Self, limits: &TelemetrySettings) -> Result<(), TelemetryFault> {
        let dt = now.stamp.seconds_since(self.stamp);
        let metres = self.beside(now).norm();
        let metres_per_s = (now.velocity - self.velocity).norm();
        if metres > limits.position_jump_m + 0.5 * ACCELERATION_MAX * dt * dt
            || metres_per_s > limits.velocity_jump_m_s + ACCELERATION_MAX * dt
        {
            return Err(TelemetryFault::PositionJump { metres, metres_per_s });
        }
        Ok(())
    }
}

impl Turn {
    /// Whether all values except the stamps are equal.
    pub fn is_like(&self, other: &Self) -> bool {
        (self.attitude, self.body_rate) == (other.attitude, other.body_rate)
    }

    /// Checks the rotation to `now`.
    ///
    /// # Errors
    /// A step of more than `limit` rad that no angular acceleration of a quadrotor explains.
    pub fn jump(&self, now: &Self, limit: f64) -> Result<(), TelemetryFault> {
        let dt = now.stamp.seconds_since(self.stamp);
        let mean = (self.body_rate + now.body_rate) * 0.5;
        let radians = carried(self.attitude, mean, dt).angle_to(now.attitude);
        if radians > limit + 0.5 * ANGULAR_ACCELERATION_MAX * dt * dt {
            return Err(TelemetryFault::AttitudeJump { radians });
        }
        Ok(())
    }
}

/// `attitude` after a rotation at constant `body_rate`, rad/s, for `dt` seconds.
pub(super) fn carried(attitude: Attitude, body_rate: Frd, dt: f64) -> Attitude {
    let angle = body_rate.norm() * dt;
    if angle == 0.0 {
        return attitude;
    }
    let (sin, cos) = (0.5 * angle).sin_cos();
    let [x, y, z] = (body_rate * (dt * sin / angle)).to_array();
    attitude.compose(Attitude { w: cos, x, y, z }).normalized()
}

/// Recent departure of the position from its own velocity, m: the sum of the steps that velocity
/// does not explain, each decaying with [`SLIDE_TIME_S`]. A velocity error `e` adds up to
/// `e * SLIDE_TIME_S`. So does an estimate that slides to another place at `e`, in steps too small
/// for a jump.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Slide {
    beside: Ned,
    /// When a slide was last found.
    found: Option<VehicleTime>,
}

impl Slide {
    /// Adds the step from `before` to `now`.
    ///
    /// # Errors
    /// A slide faster than `limits` allow; the sum then restarts at zero.
    pub fn advance(
        &mut self,
        before: &Pose,
        now: &Pose,
        limits: &TelemetrySettings,
    ) -> Result<(), TelemetryFault> {
        let dt = now.stamp.seconds_since(before.stamp);
        if dt > SLIDE_GAP_MAX_S {
            *self = Self::default();
            return Ok(());
        }
        self.beside = self.beside * (-dt / SLIDE_TIME_S).exp() + before.beside(now);
        let continues =
            self.found.is_some_and(|found| now.stamp.seconds_since(found) < SLIDE_TIME_S);
        let share = if continues { CONTINUED_SHARE } else { 1.0 };
        let metres = self.beside.norm();
        if metres > share * limits.position_slide_m_s * SLIDE_TIME_S {
            *self = Self { beside: Ned::zero(), found: Some(now.stamp) };
            return Err(TelemetryFault::PositionSlide { metres });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times, s, at which a slide is found in an estimate whose true motion is `speed` m/s, and
    /// whose reported velocity is `speed - error`, at `rate_hz`.
    fn found(rate_hz: f64, seconds: f64, error: impl Fn(f64) -> f64) -> Vec<f64> {
        let (speed, limits) = (3.0, TelemetrySettings::default());
        let (mut slide, mut before, mut east, mut found) =
            (Slide::default(), None, 0.0, Vec::new());
        for k in 0..(seconds * rate_hz) as u64 {
            let t = k as f64 / rate_hz;
            east += (speed + error(t)) / rate_hz;
            let stamp = VehicleTime::from_us((t * 1e6).round() as u64);
            let position = Ned::new(0.0, east, -1.0);
            let now = Pose { stamp, position, velocity: Ned::new(0.0, speed, 0.0) };
            if let Some(before) = before.replace(now)
                && before.jump(&now, &limits).and(slide.advance(&before, &now, &limits)).is_err()
            {
                found.push(t);
            }
        }
        found
    }

    #[test]
    fn sliding_estimate_is_detected_at_every_rate() {
        for rate_hz in [20.0, 50.0, 100.0, 250.0] {
            let slides = |t: f64| if (2.0..2.5).contains(&t) { 10.0 } else { 0.0 };
            let times = found(rate_hz, 5.0, slides);
            assert!((2.0..2.2).contains(&times[0]), "{rate_hz} Hz: {times:?}");
            // The slide continues until the position stands still; the last report marks its end.
            let last = times[times.len() - 1];
            assert!((2.45..2.7).contains(&last), "{rate_hz} Hz: {times:?}");
        }
    }

    #[test]
    fn normal_velocity_error_is_not_a_slide() {
        // As large as in PX4's simulation over half a second.
        for rate_hz in [20.0, 100.0, 250.0] {
            let wander = |t: f64| 1.2 * (2.0 * std::f64::consts::PI * 0.2 * t).sin();
            assert!(found(rate_hz, 20.0, wander).is_empty(), "{rate_hz} Hz");
        }
    }

    #[test]
    fn message_pause_is_not_a_slide() {
        let limits = TelemetrySettings::default();
        let at = |us, east| Pose {
            stamp: VehicleTime::from_us(us),
            position: Ned::new(0.0, east, 0.0),
            velocity: Ned::zero(),
        };
        let mut slide = Slide::default();
        assert!(slide.advance(&at(0, 0.0), &at(500_000, 3.0), &limits).is_ok());
        assert!(slide.advance(&at(500_000, 3.0), &at(510_000, 3.0), &limits).is_ok());
    }
}
