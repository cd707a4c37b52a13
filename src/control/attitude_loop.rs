//! The attitude loop between the setpoint and the vehicle's angular acceleration.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::AttitudePd;
use vehicle::frame::{Euler, Frd, wrap_angle};
use vehicle::scalar::Scalar;

use super::tilt::tilt_of;
use crate::setpoint::Setpoint;

/// The loop that tracks the attitude, and the parts of the setpoint that it uses. The LQR's model
/// contains the loop that the vehicle has; each triple is roll, pitch, yaw.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum AttitudeLoop {
    /// On board, honouring attitude, rates and thrust together:
    /// `M = kp (zeta_des - zeta) + kd (omega_des - omega)` (Bansal et al., eq. 14).
    Pd {
        /// N m/rad.
        kp: [f64; 3],
        /// N m s/rad.
        kd: [f64; 3],
    },
    /// The same on board a vehicle that takes attitude and thrust: its rate reference is zero,
    /// `M = kp (zeta_des - zeta) - kd omega`.
    AttitudePd {
        /// N m/rad.
        kp: [f64; 3],
        /// N m s/rad.
        kd: [f64; 3],
    },
    /// The rate part of the same, on board a vehicle that takes rates and thrust, under the
    /// daemon's attitude loop (the link's encoder closes it, with the same gain):
    /// `M = kd (omega_des + gain (zeta_des - zeta) - omega)`.
    RatePd {
        /// rad/s per rad.
        gain: [f64; 3],
        /// N m s/rad.
        kd: [f64; 3],
    },
    /// An autopilot's own loop, which takes attitude and thrust only; its measured response is
    /// second order: `d omega/dt = wn^2 (zeta_des - zeta) - 2 damping wn omega`.
    Attitude {
        /// `wn`, rad/s.
        natural_frequency: [f64; 3],
        /// Damping ratio.
        damping: [f64; 3],
    },
    /// Closed by the daemon over an autopilot's own rate loop, as measured:
    /// `omega_cmd = omega_des + gain (zeta_des - zeta)`, `d omega/dt = (omega_cmd - omega) / tau`.
    Rates {
        /// rad/s per rad.
        gain: [f64; 3],
        /// Time constant tau of the on-board rate loop, s.
        time_constant_s: [f64; 3],
    },
}

/// Largest roll and pitch that are converted to a direction, rad; limits apply afterwards.
const ANGLE_MAX_RAD: f64 = 1.2;

/// The attitude error that an on-board loop acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AttitudeError {
    /// The differences of roll, pitch and yaw, as in the paper's loop.
    Angles,
    /// The rotation from the vehicle's to the desired attitude, in body axes, as in PX4 and
    /// ArduCopter: a setpoint's roll and pitch are then about its own heading.
    Rotation,
}

impl AttitudeError {
    /// The error `desired - actual` about roll, pitch and yaw, rad.
    pub(super) fn between(self, desired: Euler, actual: Euler) -> [f64; 3] {
        match self {
            Self::Angles => angle_error(desired, actual),
            Self::Rotation => {
                actual.attitude().rotation_to(desired.attitude().normalized()).to_array()
            }
        }
    }

    /// `setpoint`, whose roll and pitch are about the vehicle's heading `yaw`, in this loop's
    /// convention: the thrust keeps its direction in the world, whatever yaw the setpoint has.
    pub(super) fn addressed(self, setpoint: Setpoint, yaw: f64) -> Setpoint {
        let Euler { roll, pitch, yaw: heading } = setpoint.attitude;
        let attitude = match self {
            Self::Angles => return setpoint,
            Self::Rotation => {
                // Beyond a quarter turn, the angles of a large error are no direction.
                let most = roll.abs().max(pitch.abs());
                let cut = (ANGLE_MAX_RAD / most).min(1.0);
                let (roll, pitch) = (cut * roll, cut * pitch);
                let down = Euler::new(roll, pitch, wrap_angle(yaw - heading)).attitude();
                let [roll, pitch] = tilt_of(down.to_world(Frd::new(0.0, 0.0, 1.0)).to_array());
                Euler::new(roll, pitch, heading)
            }
        };
        Setpoint { attitude, ..setpoint }
    }
}

impl From<AttitudePd> for AttitudeLoop {
    fn from(pd: AttitudePd) -> Self {
        Self::Pd { kp: pd.kp, kd: pd.kd }
    }
}

impl AttitudeLoop {
    /// Measured natural frequencies of PX4's own attitude loop, rad/s. An 8 degree step reached 63
    /// % after 281 ms, like a critically damped response of wn = 2.146 / 0.281 s. Yaw is slower:
    /// PX4 weights it by MC_YAW_WEIGHT 0.4.
    pub const PX4_RAD_S: [f64; 3] = [7.6, 7.6, 3.1];

    /// The same for ArduCopter: 63 % after 209 ms.
    pub const ARDUCOPTER_RAD_S: [f64; 3] = [10.3, 10.3, 4.1];

    /// PX4's own attitude loop, as measured.
    pub const PX4: Self = Self::responding_at(Self::PX4_RAD_S);

    /// ArduCopter's own attitude loop, as measured.
    pub const ARDUCOPTER: Self = Self::responding_at(Self::ARDUCOPTER_RAD_S);

    /// A critically damped attitude loop with these natural frequencies, rad/s.
    pub const fn responding_at(natural_frequency: [f64; 3]) -> Self {
        Self::Attitude { natural_frequency, damping: [1.0; 3] }
    }

    /// The lead of the attitude that replaces a desired body rate which the loop does not take:
    /// `Kp^-1 Kd`, s. `None` for a loop that takes rates.
    fn rate_lead_s(&self) -> Option<[f64; 3]> {
        match self {
            Self::AttitudePd { kp, kd } => Some(std::array::from_fn(|i| kd[i] / kp[i])),
            Self::Attitude { natural_frequency, damping } => {
                Some(std::array::from_fn(|i| 2.0 * damping[i] / natural_frequency[i]))
            }
            Self::Pd { .. } | Self::RatePd { .. } | Self::Rates { .. } => None,
        }
    }

    /// `setpoint` with the rates that this loop does not take folded into the attitude by its own
    /// law: `kp (zeta_des + Kp^-1 Kd omega_des - zeta) - kd omega` is the moment of the loop that
    /// takes both.
    pub fn folded(&self, setpoint: Setpoint) -> Setpoint {
        let Some(lead) = self.rate_lead_s() else { return setpoint };
        let ahead = setpoint.body_rate.scale_by(lead).to_array();
        let Euler { roll, pitch, yaw } = setpoint.attitude;
        let attitude = Euler::new(roll + ahead[0], pitch + ahead[1], yaw + ahead[2]);
        Setpoint { attitude, body_rate: Frd::zero(), ..setpoint }
    }

    /// Whether the loop's gains produce moments that the rotors then follow with their lag. The
    /// other loops were measured from the setpoint to the vehicle's response, rotors included.
    pub(super) fn is_before_the_rotors(&self) -> bool {
        match self {
            Self::Pd { .. } | Self::AttitudePd { .. } | Self::RatePd { .. } => true,
            Self::Attitude { .. } | Self::Rates { .. } => false,
        }
    }

    /// Angular acceleration in body axes near hover, rad/s^2, of a body with principal moments
    /// `inertia` (kg m^2), from attitude error `zeta_des - zeta`, desired body rate and body rate.
    pub(super) fn angular_acceleration<T: Scalar>(
        &self,
        inertia: [f64; 3],
        attitude_error: [T; 3],
        rate_desired: [T; 3],
        rate: [T; 3],
    ) -> [T; 3] {
        std::array::from_fn(|i| {
            let (error, desired, rate) = (attitude_error[i], rate_desired[i], rate[i]);
            match self {
                Self::Pd { kp, kd } => {
                    (error * kp[i] + (desired - rate) * kd[i]) * (1.0 / inertia[i])
                }
                Self::AttitudePd { kp, kd } => (error * kp[i] - rate * kd[i]) * (1.0 / inertia[i]),
                Self::RatePd { gain, kd } => {
                    (desired + error * gain[i] - rate) * (kd[i] / inertia[i])
                }
                Self::Attitude { natural_frequency, damping } => {
                    let wn = natural_frequency[i];
                    error * (wn * wn) - rate * (2.0 * damping[i] * wn)
                }
                Self::Rates { gain, time_constant_s } => {
                    (desired + error * gain[i] - rate) * (1.0 / time_constant_s[i])
                }
            }
        })
    }
}

/// `desired - actual` of roll, pitch and yaw, each wrapped to [-pi, pi).
pub(super) fn angle_error(desired: Euler, actual: Euler) -> [f64; 3] {
    [
        wrap_angle(desired.roll - actual.roll),
        wrap_angle(desired.pitch - actual.pitch),
        wrap_angle(desired.yaw - actual.yaw),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const INERTIA: [f64; 3] = [0.0115, 0.0125, 0.021];
    const KP: [f64; 3] = [1.9, 2.1, 0.5];
    const KD: [f64; 3] = [0.27, 0.29, 0.19];

    proptest! {
        #[test]
        fn folded_rates_give_the_moments_of_a_rate_loop(
            desired in prop::array::uniform3(-0.5..0.5f64),
            rate_desired in prop::array::uniform3(-2.0..2.0f64),
            rate in prop::array::uniform3(-2.0..2.0f64),
        ) {
            let [roll, pitch, yaw] = desired;
            let setpoint = Setpoint {
                thrust_n: 9.0,
                attitude: Euler::new(roll, pitch, yaw),
                body_rate: rate_desired.into(),
            };
            let natural_frequency = std::array::from_fn(|i| (KP[i] / INERTIA[i]).sqrt());
            let damping =
                std::array::from_fn(|i| KD[i] / (2.0 * (KP[i] * INERTIA[i]).sqrt()));
            let full = AttitudeLoop::Pd { kp: KP, kd: KD };
            for part in [
                AttitudeLoop::AttitudePd { kp: KP, kd: KD },
                AttitudeLoop::Attitude { natural_frequency, damping },
            ] {
                let sent = part.folded(setpoint);
                prop_assert_eq!(sent.body_rate, Frd::zero());
                let error = |attitude: Euler| [attitude.roll, attitude.pitch, attitude.yaw];
                let turn = |it: &AttitudeLoop, sent: &Setpoint| {
                    let rates = sent.body_rate.to_array();
                    it.angular_acceleration(INERTIA, error(sent.attitude), rates, rate)
                };
                let (folded, both) = (turn(&part, &sent), turn(&full, &setpoint));
                for (folded, both) in folded.into_iter().zip(both) {
                    prop_assert!((folded - both).abs() < 1e-9 * (1.0 + both.abs()));
                }
            }
            prop_assert_eq!(full.folded(setpoint), setpoint);
        }

        #[test]
        fn rotation_error_loop_keeps_thrust_direction_at_any_heading(
            roll in -0.5..0.5f64, pitch in -0.5..0.5f64, yaw in -3.0..3.0f64, ahead in -0.8..0.8f64,
        ) {
            let heading = wrap_angle(yaw + ahead);
            let setpoint =
                Setpoint { attitude: Euler::new(roll, pitch, heading), ..Setpoint::default() };
            let sent = AttitudeError::Rotation.addressed(setpoint, yaw);
            let down = |attitude: Euler| attitude.attitude().to_world(Frd::new(0.0, 0.0, 1.0));
            let expected = down(Euler::new(roll, pitch, yaw));
            prop_assert!((down(sent.attitude) - expected).norm() < 1e-9);
            prop_assert!(wrap_angle(sent.attitude.yaw - heading).abs() < 1e-12);
        }
    }
}
