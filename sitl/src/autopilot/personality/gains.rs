//! A cascade as an autopilot's parameters: in both directions by one table, so that the parameters
//! are the loop that is flown.

use super::NoLoop;
use crate::autopilot::parameters::{Parameters, Spec, gain};
use vehicle::effects::PdGain;
use vehicle::{AttitudeCascade, AttitudePd, VehicleParams};

/// The unit of a parameter against the cascade's.
#[derive(Clone, Copy, Debug)]
pub(super) enum Unit {
    /// The same.
    Same,
    /// Degrees against radians.
    Degrees,
    /// Normalised torque about this axis against N m.
    Torque(usize),
}

/// A parameter and its place in the cascade.
pub(super) struct Gain {
    pub name: &'static str,
    pub at: fn(&mut AttitudeCascade) -> &mut f64,
    pub unit: Unit,
}

/// What an autopilot's loop has beside the PD that a vehicle file gives, in the proportions of the
/// autopilot's own defaults.
pub(super) struct Tuning {
    /// Integral over proportional gain of the rate loop, 1/s.
    pub integral_per_s: [f64; 3],
    /// Derivative over proportional gain of the rate loop, s.
    pub derivative_s: [f64; 3],
    /// Bound of the integral, normalised torque.
    pub integral_max: [f64; 3],
    /// rad/s
    pub rate_max_rad_s: [f64; 3],
    pub gyro_cutoff_hz: f64,
    pub derivative_cutoff_hz: f64,
    /// Whether setpoints are shaped before the loop sees them.
    pub shapes_setpoints: bool,
    pub rate_hz: f64,
}

impl Tuning {
    /// The cascade of a vehicle file, or the one that has the same PD near hover as its loop.
    /// `moments` are those of a normalised torque of 1, N m.
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
            // A rate gain of 0 leaves no cascade with the same PD; the least there is stands in.
            angle_p_per_s: std::array::from_fn(|axis| kp[axis] / kd[axis].max(1e-9)),
            rate_max_rad_s: self.rate_max_rad_s,
            rate_p_nms: kd,
            rate_i_nm: of(|tuning| tuning.integral_per_s, kd),
            rate_d_nms2: of(|tuning| tuning.derivative_s, kd),
            rate_ff_nms: [0.0; 3],
            integral_max_nm: of(|tuning| tuning.integral_max, moments),
            gyro_cutoff_hz: self.gyro_cutoff_hz,
            derivative_cutoff_hz: self.derivative_cutoff_hz,
            // A shaped setpoint is followed with its time constant, which is then the PD's lag.
            input_time_constant_s: self.shapes_setpoints.then(|| kd[0] / kp[0].max(1e-9)),
            rate_hz: self.rate_hz,
        })
    }
}

impl Unit {
    /// The cascade's unit over the parameter's.
    fn factor(self, moments: [f64; 3]) -> f64 {
        match self {
            Self::Same => 1.0,
            Self::Degrees => 1f64.to_radians(),
            Self::Torque(axis) => moments.get(axis).copied().unwrap_or(1.0),
        }
    }
}

/// The parameters that say `cascade`.
pub(super) fn specs(
    gains: &'static [Gain],
    mut cascade: AttitudeCascade,
    moments: [f64; 3],
) -> impl Iterator<Item = Spec> {
    gains.iter().map(move |row| gain(row.name, *(row.at)(&mut cascade) / row.unit.factor(moments)))
}

/// The cascade that the parameters say; what they do not say is `otherwise`'s.
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

/// The gains that are really there.
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
