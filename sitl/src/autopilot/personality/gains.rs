//! Maps a cascade to an autopilot's parameters and back with one table, so the parameters always
//! match the active loop.

use super::NoLoop;
use crate::autopilot::parameters::{Parameters, Spec, gain};
use vehicle::effects::PdGain;
use vehicle::{AttitudeCascade, AttitudePd, VehicleParams};

/// The unit of a parameter relative to the cascade's.
#[derive(Clone, Copy, Debug)]
pub(super) enum Unit {
    /// The cascade's unit.
    Same,
    /// Degrees instead of radians.
    Degrees,
    /// Normalised torque about this axis instead of N m.
    Torque(usize),
}

/// A parameter and its place in the cascade.
pub(super) struct Gain {
    pub name: &'static str,
    pub at: fn(&mut AttitudeCascade) -> &mut f64,
    pub unit: Unit,
}

/// The parts of an autopilot's loop that a PD law does not give, in the proportions of the
/// autopilot's defaults.
pub(super) struct Tuning {
    /// Integral over proportional gain of the rate loop, 1/s.
    pub integral_per_s: [f64; 3],
    /// Derivative over proportional gain of the rate loop, s.
    pub derivative_s: [f64; 3],
    /// Bound on the integral, normalised torque.
    pub integral_max: [f64; 3],
    /// Bound on the body rate, rad/s.
    pub rate_max_rad_s: [f64; 3],
    pub gyro_cutoff_hz: f64,
    pub derivative_cutoff_hz: f64,
    /// Whether the loop has input shaping.
    pub shapes_setpoints: bool,
    pub rate_hz: f64,
}

impl Tuning {
    /// The cascade of a vehicle file, or one that matches its PD law near hover. `moments` are the
    /// moments of a normalised torque of 1, N m.
    pub fn cascade(
        &self,
        vehicle: &VehicleParams,
        moments: [f64; 3],
    ) -> Result<AttitudeCascade, NoLoop> {
        if let Some(cascade) = vehicle.attitude_cascade {
            return Ok(cascade);
        }
        let AttitudePd { kp, kd, .. } = vehicle.attitude_pd.ok_or(NoLoop::Missing)?;
        let of = |triple: fn(&Self) -> [f64; 3], factor: [f64; 3]| {
            std::array::from_fn(|axis| triple(self)[axis] * factor[axis])
        };
        Ok(AttitudeCascade {
            // With a rate gain of 0 no cascade has the same PD law; a tiny gain avoids the division
            // by 0.
            angle_p_per_s: std::array::from_fn(|axis| kp[axis] / kd[axis].max(1e-9)),
            rate_max_rad_s: self.rate_max_rad_s,
            rate_p_nms: kd,
            rate_i_nm: of(|tuning| tuning.integral_per_s, kd),
            rate_d_nms2: of(|tuning| tuning.derivative_s, kd),
            rate_ff_nms: [0.0; 3],
            integral_max_nm: of(|tuning| tuning.integral_max, moments),
            gyro_cutoff_hz: self.gyro_cutoff_hz,
            derivative_cutoff_hz: self.derivative_cutoff_hz,
            // The loop follows a shaped setpoint with its time constant, which must equal the PD
            // law's lag.
            input_time_constant_s: self.shapes_setpoints.then(|| kd[0] / kp[0].max(1e-9)),
            rate_hz: self.rate_hz,
        })
    }
}

impl Unit {
    /// Factor from the parameter's unit to the cascade's.
    fn factor(self, moments: [f64; 3]) -> f64 {
        match self {
            Self::Same => 1.0,
            Self::Degrees => 1f64.to_radians(),
            Self::Torque(axis) => moments.get(axis).copied().unwrap_or(1.0),
        }
    }
}

/// The parameters for `cascade`.
pub(super) fn specs(
    gains: &'static [Gain],
    mut cascade: AttitudeCascade,
    moments: [f64; 3],
) -> impl Iterator<Item = Spec> {
    gains.iter().map(move |row| gain(row.name, *(row.at)(&mut cascade) / row.unit.factor(moments)))
}

/// The cascade from the parameters; missing values come from `otherwise`.
pub(super) fn cascade(
    gains: &[Gain],
    parameters: &Parameters,
    otherwise: &AttitudeCascade,
    moments: [f64; 3],
) -> AttitudeCascade {
    let mut cascade = *otherwise;
    for row in gains {
        if let Some(value) = parameters.named(row.name) {
            *(row.at)(&mut cascade) = value * row.unit.factor(moments);
        }
    }
    cascade
}

/// Applies the true gain factors to a cascade.
pub(super) fn scaled(cascade: AttitudeCascade, truth: Option<PdGain>) -> AttitudeCascade {
    let Some(PdGain { kp_scale, kd_scale }) = truth else { return cascade };
    let times = |gains: [f64; 3], scale: [f64; 3]| std::array::from_fn(|i| gains[i] * scale[i]);
    let angle = std::array::from_fn(|i| kp_scale[i] / kd_scale[i].max(1e-9));
    AttitudeCascade {
        angle_p_per_s: times(cascade.angle_p_per_s, angle),
        rate_p_nms: times(cascade.rate_p_nms, kd_scale),
        rate_i_nm: times(cascade.rate_i_nm, kd_scale),
        rate_d_nms2: times(cascade.rate_d_nms2, kd_scale),
        rate_ff_nms: times(cascade.rate_ff_nms, kd_scale),
        ..cascade
    }
}
