//! PD gain: true on-board gains = nominal times scale, per axis roll, pitch, yaw.
//!
//! It acts in the autopilot, not in the plant.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::params::AttitudePd;

/// True gains of the on-board attitude loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PdGain {
    /// Factors on kp for roll, pitch and yaw.
    pub kp_scale: [f64; 3],
    /// Factors on kd for roll, pitch and yaw.
    pub kd_scale: [f64; 3],
}

impl Effect for PdGain {
    const ID: EffectId = EffectId::PdGain;
    const SPEC: Spec = Spec {
        id: "pd_gain",
        parameters: &[
            Parameter::vec3("kp_scale", "-", 1.0, [0.0, 20.0]),
            Parameter::vec3("kd_scale", "-", 1.0, [0.0, 20.0]),
        ],
        needs: &[Need::Moment, Need::WholeSetpoint],
        typical: |_| slots([0.3; 6]),
        strong: |_, chance, growth| {
            let [tilt, yaw] = [chance.scale([0.3, 0.6]), chance.scale([0.2, 0.5])];
            growth.by[..3].copy_from_slice(&[tilt, tilt * chance.within([0.8, 1.2]), yaw]);
            growth.by[3..5].fill(chance.scale([0.1, 0.4]));
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[px, py, pz, dx, dy, dz]: &Slots) -> Self {
        Self { kp_scale: [px, py, pz], kd_scale: [dx, dy, dz] }
    }
}

impl PdGain {
    /// The true gains, from the nominal ones; the rate of the loop is unchanged.
    pub fn apply(&self, nominal: &AttitudePd) -> AttitudePd {
        let times = |gains: [f64; 3], scale: [f64; 3]| std::array::from_fn(|i| gains[i] * scale[i]);
        AttitudePd {
            kp: times(nominal.kp, self.kp_scale),
            kd: times(nominal.kd, self.kd_scale),
            rate_hz: nominal.rate_hz,
        }
    }
}
