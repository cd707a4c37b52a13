//! The attitude loop of PX4 and ArduCopter: a proportional attitude loop around a PID rate loop.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::AttitudePd;

/// An on-board cascade in physical units. Each triple is roll, pitch, yaw in body axes:
///
/// ```text
/// omega_sp = clip(angle_p * e, rate_max) + omega_ff         e: attitude error, rad
/// M = rate_p (omega_sp - omega) + integral - rate_d d omega/dt + rate_ff omega_sp
/// d integral/dt = rate_i (omega_sp - omega), |integral| <= integral_max
/// ```
///
/// `omega` is the gyro behind a low-pass at `gyro_cutoff_hz`; its derivative passes another at
/// `derivative_cutoff_hz`. An autopilot's gains act on normalised torques: multiply them by the
/// moment of a unit torque at the mixer to get these units.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AttitudeCascade {
    /// Gain from attitude error to body rate setpoint, 1/s.
    pub angle_p_per_s: [f64; 3],
    /// Largest body rate that the attitude loop commands, rad/s.
    pub rate_max_rad_s: [f64; 3],
    /// Gain from rate error to moment, N m s/rad.
    #[serde(rename = "rate_p_Nms")]
    pub rate_p_nms: [f64; 3],
    /// Gain from the integral of the rate error to moment, N m/rad.
    #[serde(rename = "rate_i_Nm")]
    pub rate_i_nm: [f64; 3],
    /// Gain from angular acceleration to moment, N m s^2/rad.
    #[serde(rename = "rate_d_Nms2")]
    pub rate_d_nms2: [f64; 3],
    /// Gain from rate setpoint to moment, N m s/rad.
    #[serde(rename = "rate_ff_Nms", default)]
    pub rate_ff_nms: [f64; 3],
    /// Bound on the integral's moment, N m.
    #[serde(rename = "integral_max_Nm")]
    pub integral_max_nm: [f64; 3],
    /// Cutoff of the gyro's low-pass, Hz.
    pub gyro_cutoff_hz: f64,
    /// Cutoff of the derivative's low-pass, Hz.
    pub derivative_cutoff_hz: f64,
    /// Time constant of the input shaping on the attitude setpoint, s (ArduCopter's ATC_INPUT_TC);
    /// missing where the setpoint acts at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub input_time_constant_s: Option<f64>,
    /// Rate of the loop, Hz.
    pub rate_hz: f64,
}

impl AttitudeCascade {
    /// The PD law `M = kp (zeta_des - zeta) + kd (omega_des - omega)` with the cascade's response
    /// near hover and within its bounds, without integral, derivative and filters: `kp = angle_p
    /// (rate_p + rate_ff)`, `kd = rate_p`.
    ///
    /// With input shaping, the loop follows the shaped setpoint with its rate fed forward. The
    /// remaining lag `kd / kp` is then the shaping's time constant: `kp = (rate_p + rate_ff) /
    /// input_time_constant`.
    pub fn as_pd(&self) -> AttitudePd {
        let (p, ff) = (self.rate_p_nms, self.rate_ff_nms);
        let shaped = self.input_time_constant_s.filter(|tc| *tc > 0.0);
        let angle_p = shaped.map_or(self.angle_p_per_s, |tc| [1.0 / tc; 3]);
        AttitudePd {
            kp: std::array::from_fn(|i| angle_p[i] * (p[i] + ff[i])),
            kd: p,
            rate_hz: self.rate_hz,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A cascade of a 1 kg quadrotor, with an integral and a derivative.
    pub(crate) fn cascade() -> AttitudeCascade {
        AttitudeCascade {
            angle_p_per_s: [6.5, 6.5, 2.8],
            rate_max_rad_s: [3.8, 3.8, 3.5],
            rate_p_nms: [0.25, 0.25, 0.12],
            rate_i_nm: [0.3, 0.3, 0.06],
            rate_d_nms2: [0.005, 0.005, 0.0],
            rate_ff_nms: [0.0; 3],
            integral_max_nm: [0.5, 0.5, 0.2],
            gyro_cutoff_hz: 40.0,
            derivative_cutoff_hz: 30.0,
            input_time_constant_s: None,
            rate_hz: 400.0,
        }
    }

    #[test]
    fn equivalent_pd_gains_are_products_of_cascade_gains() {
        let pd = cascade().as_pd();
        assert_eq!(pd.kp, [6.5 * 0.25, 6.5 * 0.25, 2.8 * 0.12]);
        assert_eq!(pd.kd, [0.25, 0.25, 0.12]);
        assert_eq!(pd.rate_hz, 400.0);
    }

    #[test]
    fn shaped_setpoint_is_followed_with_its_time_constant() {
        let pd = AttitudeCascade { input_time_constant_s: Some(0.2), ..cascade() }.as_pd();
        assert_eq!((pd.kp[0], pd.kd[0]), (0.25 / 0.2, 0.25));
    }
}
