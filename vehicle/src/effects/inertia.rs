//! Inertia: true principal moments = nominal times scale, per axis.

use super::{ConstantEffect, Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::physics::Constants;

/// True moments of inertia.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    /// Factors on the moments about front, right and down.
    pub scale: [f64; 3],
}

impl Effect for Inertia {
    const ID: EffectId = EffectId::Inertia;
    const SPEC: Spec = Spec {
        id: "inertia",
        parameters: &[Parameter::vec3("scale", "-", 1.0, [0.05, 20.0])],
        needs: &[Need::Moment, Need::FastOutputs],
        typical: |_| slots([0.35; 3]),
        strong: |_, chance, growth| {
            for axis in &mut growth.by[..3] {
                *axis = chance.scale([0.3, 0.8]);
            }
        },
        ..Spec::PLAIN
    };

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
