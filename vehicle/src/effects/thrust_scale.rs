//! Thrust scale: T_i <- scale T_i for every rotor; the drag torque scales too.
//!
//! Causes are propeller wear, a different propeller or thin air. Only the ratio of thrust to mass
//! matters, so only the rotor speeds distinguish it from a mass.

use super::{ConstantEffect, Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::physics::Constants;

/// Every rotor's thrust multiplied by `scale`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThrustScale {
    /// Factor on the thrust.
    pub scale: f64,
}

impl Effect for ThrustScale {
    const ID: EffectId = EffectId::ThrustScale;
    const SPEC: Spec = Spec {
        id: "thrust_scale",
        parameters: &[Parameter::scalar("scale", "-", 1.0, [0.05, 20.0])],
        needs: &[Need::Input, Need::Motion],
        typical: |_| slots([0.15]),
        strong: |_, chance, growth| growth.by[0] = chance.sign() * 0.2,
        ..Spec::PLAIN
    };

    fn from_slots(&[scale, ..]: &Slots) -> Self {
        Self { scale }
    }
}

impl ConstantEffect for ThrustScale {
    fn apply(&self, constants: &mut Constants) {
        for rotor in &mut constants.rotors {
            rotor.thrust_max *= self.scale;
        }
    }
}
