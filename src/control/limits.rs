//! The last bounds on a setpoint before the supervisor.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::{Euler, Frd, wrap_angle};

use super::tilt::{down_at, tilt_of};
use crate::setpoint::Setpoint;

/// The bounds of a setpoint and of its rate of change.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Least collective thrust, as a fraction of the rotors' maximum. Above 0, because a stopped
    /// rotor has no control authority.
    pub thrust_min: f64,
    /// Largest collective thrust, as a fraction of the rotors' maximum. Below 1, so that the mixer
    /// keeps authority for moments.
    pub thrust_max: f64,
    /// Largest desired tilt, rad.
    pub tilt_max_rad: f64,
    /// Largest desired body rate about each axis, rad/s.
    pub body_rate_max_rad_s: f64,
    /// Largest difference between desired and present yaw, rad.
    pub yaw_error_max_rad: f64,
    /// Largest change of the collective thrust per second, as a fraction of the rotors' maximum.
    pub thrust_change_max_per_s: f64,
    /// Largest change of each desired angle per second, rad/s.
    pub attitude_change_max_rad_s: f64,
    /// Largest change of each desired body rate per second, rad/s^2.
    pub body_rate_change_max_rad_s2: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            thrust_min: 0.05,
            thrust_max: 0.9,
            tilt_max_rad: 0.61,
            body_rate_max_rad_s: 6.0,
            yaw_error_max_rad: 0.8,
            // The most that feedback at 100 Hz may change from one setpoint to the next.
            thrust_change_max_per_s: 50.0,
            attitude_change_max_rad_s: 100.0,
            body_rate_change_max_rad_s2: 1200.0,
        }
    }
}

/// The limits that a setpoint met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Saturation {
    /// The position error that the feedback sees was bounded.
    pub position_error: bool,
    /// Collective thrust.
    pub thrust: bool,
    /// Tilt.
    pub tilt: bool,
    /// Body rate.
    pub body_rate: bool,
    /// Difference between desired and present yaw.
    pub yaw_error: bool,
}

impl Saturation {
    /// One bit for each component of `u_hat` that a limit cut: thrust, roll, pitch, yaw, roll rate,
    /// pitch rate, yaw rate from bit 0; bit 7 is the position error.
    pub fn bits(&self) -> u32 {
        let bit = |met: bool, mask: u32| if met { mask } else { 0 };
        bit(self.thrust, 0x01)
            | bit(self.tilt, 0x06)
            | bit(self.yaw_error, 0x08)
            | bit(self.body_rate, 0x70)
            | bit(self.position_error, 0x80)
    }

    /// The inverse of [`bits`](Self::bits).
    pub fn from_bits(bits: u32) -> Self {
        Self {
            position_error: bits & 0x80 != 0,
            thrust: bits & 0x01 != 0,
            tilt: bits & 0x06 != 0,
            body_rate: bits & 0x70 != 0,
            yaw_error: bits & 0x08 != 0,
        }
    }

    /// The union of both.
    pub fn and(self, other: Self) -> Self {
        Self {
            position_error: self.position_error || other.position_error,
            thrust: self.thrust || other.thrust,
            tilt: self.tilt || other.tilt,
            body_rate: self.body_rate || other.body_rate,
            yaw_error: self.yaw_error || other.yaw_error,
        }
    }

    /// Whether any limit was met.
    pub fn any(&self) -> bool {
        self.position_error || self.thrust || self.tilt || self.body_rate || self.yaw_error
    }
}

impl Limits {
    /// `setpoint` within the limits, for a vehicle whose rotors together produce at most
    /// `thrust_full_n` and whose yaw is `yaw` rad; `None` if a component of the setpoint, or the
    /// yaw, is not finite.
    ///
    /// Tilt is reduced towards level in its own direction, which keeps the yaw.
    pub fn apply(
        &self,
        setpoint: Setpoint,
        thrust_full_n: f64,
        yaw: f64,
    ) -> Option<(Setpoint, Saturation)> {
        if !setpoint.is_finite() || !yaw.is_finite() {
            return None;
        }
        let mut met = Saturation::default();
        let clamp = |value: f64, low: f64, high: f64, met: &mut bool| {
            *met |= value < low || value > high;
            value.max(low).min(high)
        };
        let thrust_n = clamp(
            setpoint.thrust_n,
            self.thrust_min * thrust_full_n,
            self.thrust_max * thrust_full_n,
            &mut met.thrust,
        );
        let rate_max = self.body_rate_max_rad_s;
        let body_rate: Frd =
            setpoint.body_rate.map(|rate| clamp(rate, -rate_max, rate_max, &mut met.body_rate));
        let yaw_max = self.yaw_error_max_rad;
        let yaw_error = wrap_angle(setpoint.attitude.yaw - yaw);
        let yaw = wrap_angle(yaw + clamp(yaw_error, -yaw_max, yaw_max, &mut met.yaw_error));
        let [roll, pitch] = self.within_tilt(setpoint.attitude, &mut met.tilt);
        let attitude = Euler::new(roll, pitch, yaw);
        Some((Setpoint { thrust_n, attitude, body_rate }, met))
    }

    /// Roll and pitch with the body's down axis at most the tilt limit from the world's.
    fn within_tilt(&self, Euler { roll, pitch, .. }: Euler, met: &mut bool) -> [f64; 2] {
        let [x, y, z] = down_at(roll, pitch);
        let horizontal = (x * x + y * y).sqrt();
        if horizontal.atan2(z) <= self.tilt_max_rad {
            return [roll, pitch];
        }
        *met = true;
        if horizontal < 1e-9 {
            return [0.0, 0.0]; // upside down: no direction to keep
        }
        let (sin_max, cos_max) = self.tilt_max_rad.sin_cos();
        let scale = sin_max / horizontal;
        tilt_of([x * scale, y * scale, cos_max])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_component() -> impl Strategy<Value = f64> {
        prop_oneof![-10.0..10.0f64, prop::num::f64::ANY]
    }

    #[test]
    fn setpoint_within_the_limits_is_unchanged() {
        let setpoint = Setpoint {
            thrust_n: 3.0,
            attitude: Euler::new(0.1, -0.2, 1.0),
            body_rate: Frd::new(0.5, 0.0, -0.5),
        };
        let (limited, met) = Limits::default().apply(setpoint, 10.0, 0.9).expect("finite");
        assert!((limited.attitude.yaw - 1.0).abs() < 1e-12);
        assert_eq!((limited.thrust_n, limited.body_rate), (3.0, setpoint.body_rate));
        assert!(!met.any());
    }

    #[test]
    fn yaw_is_limited_along_the_shorter_way() {
        let setpoint =
            Setpoint { thrust_n: 3.0, attitude: Euler::new(0.0, 0.0, -3.0), ..Setpoint::default() };
        let (limited, met) = Limits::default().apply(setpoint, 10.0, 2.0).expect("finite");
        assert!(met.yaw_error && (limited.attitude.yaw - 2.8).abs() < 1e-12);
    }

    proptest! {
        #[test]
        fn output_is_always_finite_and_within_limits(
            thrust in any_component(), roll in any_component(), pitch in any_component(),
            yaw in any_component(), p in any_component(), q in any_component(), now in -3.0..3.0f64,
        ) {
            let limits = Limits::default();
            let setpoint = Setpoint {
                thrust_n: thrust,
                attitude: Euler::new(roll, pitch, yaw),
                body_rate: Frd::new(p, q, 0.0),
            };
            match limits.apply(setpoint, 10.0, now) {
                None => prop_assert!(!setpoint.is_finite()),
                Some((limited, _)) => {
                    prop_assert!(limited.is_finite());
                    prop_assert!((0.5..=9.0).contains(&limited.thrust_n));
                    prop_assert!(limited.attitude.attitude().tilt() <= limits.tilt_max_rad + 1e-6);
                    prop_assert!(limited.body_rate.to_array().iter().all(|r| r.abs() <= 6.0));
                    let off = wrap_angle(limited.attitude.yaw - now);
                    prop_assert!(off.abs() <= limits.yaw_error_max_rad + 1e-9);
                }
            }
        }

        #[test]
        fn limited_tilt_keeps_its_direction(roll in -1.2..1.2f64, pitch in -1.2..1.2f64) {
            let setpoint = Setpoint {
                thrust_n: 3.0, attitude: Euler::new(roll, pitch, 0.0), body_rate: Frd::zero(),
            };
            let (limited, _) = Limits::default().apply(setpoint, 10.0, 0.0).expect("finite");
            let down = |e: Euler| e.attitude().to_world(Frd::new(0.0, 0.0, 1.0));
            let (before, after) = (down(setpoint.attitude), down(limited.attitude));
            let cross = before.north() * after.east() - before.east() * after.north();
            prop_assert!(cross.abs() < 1e-9);
            prop_assert!(before.north() * after.north() + before.east() * after.east() >= 0.0);
        }
    }
}
