//! Ground effect: T <- T / (1 - min(0.35, (r_eff / (4 h))^2)), h the height of the centre of mass
//! above the floor (Cheeseman and Bennett 1955).

use super::{Effect, EffectId, Flow, Need, Parameter, Slots, Spec, ThrustEffect, slots};
use crate::scalar::Scalar;

/// Bound on (r_eff / (4 h))^2, which would otherwise diverge at the ground.
const LIMIT: f64 = 0.35;

/// Extra thrust close to the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundEffect {
    /// Effective radius of all rotors together in m.
    pub r_eff_m: f64,
}

impl Effect for GroundEffect {
    const ID: EffectId = EffectId::GroundEffect;
    const SPEC: Spec = Spec {
        id: "ground_effect",
        parameters: &[Parameter::scalar("r_eff_m", "m", 0.0, [0.0, 20.0])],
        needs: &[Need::Pose, Need::Input],
        typical: |vehicle| slots([4.0 * vehicle.rotor_radius_m]),
        strong: |vehicle, _, growth| growth.by[0] = 10.0 * vehicle.rotor_radius_m,
        is_quadratic: true,
        ..Spec::PLAIN
    };

    fn from_slots(&[r_eff_m, ..]: &Slots) -> Self {
        Self { r_eff_m }
    }
}

impl ThrustEffect for GroundEffect {
    #[inline(always)]
    fn factor<T: Scalar>(&self, flow: &Flow<T>) -> T {
        let quarter2 = (0.25 * self.r_eff_m) * (0.25 * self.r_eff_m);
        let height2 = flow.height * flow.height;
        // 1 / (1 - (q / h)^2) with one division. On or below the floor the factor is at its limit.
        if flow.height.is_above(0.0) && (height2 * LIMIT).is_above(quarter2) {
            height2 / (height2 + -quarter2)
        } else if quarter2 > 0.0 {
            T::from(1.0 / (1.0 - LIMIT))
        } else {
            T::from(1.0)
        }
    }
}
