//! Arm drag: F_body = -1/2 rho cda (|v_ax| v_ax, |v_ay| v_ay, 0), as from thin arms across the
//! flow.
//!
//! Each axis has its own quadratic drag, whereas parasitic drag acts along the whole velocity. The
//! catalogue does not include this effect: copy it to `vehicle/src/effects/arm_drag.rs` and add the
//! line `ArmDrag arm_drag body,` to `catalogue!` to fly, learn and diagnose it.

use super::{BodyEffect, Effect, EffectId, Flow, Need, Parameter, Slots, Spec, Wrench, slots};
use crate::frame::Frd;
use crate::scalar::Scalar;

/// Drag of the arms along the body's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmDrag {
    /// Area times drag coefficient of the arms, m^2.
    pub cda_m2: f64,
}

impl Effect for ArmDrag {
    const ID: EffectId = EffectId::ArmDrag;
    const SPEC: Spec = Spec {
        id: "arm_drag",
        parameters: &[Parameter::scalar("cda_m2", "m^2", 0.0, [0.0, 10.0])],
        needs: &[Need::Pose, Need::Input],
        // A tenth of the weight at 8 m/s.
        typical: |vehicle| {
            slots([0.1 * vehicle.weight_n() / (0.5 * vehicle.air_density * 64.0)])
        },
        strong: |vehicle, _, growth| {
            growth.by[0] = 0.6 * vehicle.weight_n() / (0.5 * vehicle.air_density * 64.0);
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[cda_m2, ..]: &Slots) -> Self {
        Self { cda_m2 }
    }
}

impl BodyEffect for ArmDrag {
    #[inline(always)]
    fn add<T: Scalar>(&self, flow: &Flow<T>, wrench: &mut Wrench<T>) {
        let half = -0.5 * flow.air_density * self.cda_m2;
        let along = |v: T| v * v.max(-v) * half;
        let (x, y) = (flow.air_relative.front(), flow.air_relative.right());
        wrench.force += Frd::new(along(x), along(y), T::default());
    }
}
