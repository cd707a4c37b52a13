//! Parasitic drag: F_body = -1/2 rho cda |v_a| v_a, the frame's quadratic drag.

use super::{BodyEffect, Effect, EffectId, Flow, Need, Parameter, Slots, Spec, Wrench, slots};
use crate::scalar::Scalar;

/// Quadratic drag of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParasiticDrag {
    /// Drag coefficient times frontal area in m^2.
    pub cda_m2: f64,
}

impl Effect for ParasiticDrag {
    const ID: EffectId = EffectId::ParasiticDrag;
    const SPEC: Spec = Spec {
        id: "parasitic_drag",
        parameters: &[Parameter::scalar("cda_m2", "m^2", 0.0, [0.0, 10.0])],
        needs: &[Need::Pose, Need::Input],
        // A seventh of the weight at 8 m/s.
        typical: |vehicle| slots([0.15 * vehicle.weight_n() / (0.5 * vehicle.air_density * 64.0)]),
        strong: |vehicle, _, growth| {
            growth.by[0] = 0.6 * vehicle.weight_n() / (0.5 * vehicle.air_density * 64.0);
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[cda_m2, ..]: &Slots) -> Self {
        Self { cda_m2 }
    }
}

impl BodyEffect for ParasiticDrag {
    #[inline(always)]
    fn add<T: Scalar>(&self, flow: &Flow<T>, wrench: &mut Wrench<T>) {
        let v = flow.air_relative;
        let speed2 = flow.horizontal_speed2 + v.down() * v.down();
        // At rest the square root has an infinite derivative, although the force's derivative is 0.
        if speed2.is_above(0.0) {
            wrench.force += v * (speed2.sqrt() * (-0.5 * flow.air_density * self.cda_m2));
        }
    }
}
