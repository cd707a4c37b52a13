//! Translational lift: T <- T (1 + min(0.5, k V_h^2)).

use super::{Effect, EffectId, Flow, Need, Parameter, Slots, Spec, ThrustEffect, slots};
use crate::scalar::Scalar;

/// Extra thrust in horizontal flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TranslationalLift {
    /// Relative gain in thrust per squared horizontal speed, s^2/m^2.
    pub k_s2_m2: f64,
}

impl Effect for TranslationalLift {
    const ID: EffectId = EffectId::TranslationalLift;
    const SPEC: Spec = Spec {
        id: "translational_lift",
        parameters: &[Parameter::scalar("k_s2_m2", "s^2/m^2", 0.0, [0.0, 1.0])],
        needs: &[Need::Pose, Need::Input],
        typical: |_| slots([0.005]),
        strong: |_, _, growth| growth.by[0] = 0.02,
        ..Spec::PLAIN
    };

    fn from_slots(&[k_s2_m2, ..]: &Slots) -> Self {
        Self { k_s2_m2 }
    }
}

impl ThrustEffect for TranslationalLift {
    #[inline(always)]
    fn factor<T: Scalar>(&self, flow: &Flow<T>) -> T {
        (flow.horizontal_speed2 * self.k_s2_m2).min(T::from(0.5)) + 1.0
    }
}
