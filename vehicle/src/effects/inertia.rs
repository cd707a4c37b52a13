//! Inertia: true principal moments = nominal times scale, per axis.

use super::{ConstantEffect, Effect, EffectId, Parameter, Slots, Spec};
use crate::physics::Constants;

/// True moments of inertia.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// Factors about front, right, down.
    pub scale: [f64; 3],
}

impl Effect for Inertia {
    const ID: EffectId = EffectId::Inertia;
    const SPEC: Spec =
        Spec { id: "inertia", parameters: &[Parameter::vec3("scale", "-", 1.0, [0.05, 20.0])] };

    fn from_slots(&[x, y, z, ..]: &Slots) -> Self {
        Self { scale: [x, y, z] }
    }
}

impl ConstantEffect for Inertia {
    fn apply(&self, constants: &mut Constants) {
        for (moment, scale) in constants.inertia.iter_mut().zip(self.scale) {
            *moment *= scale;
        }
    }
}
