//! Mass: the true mass, a payload at the centre of mass; the inertia is unchanged.

use super::{ConstantEffect, Effect, EffectId, Parameter, Slots, Spec};
use crate::physics::Constants;

/// The true mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mass {
    /// Mass in kg.
    pub mass_kg: f64,
}

impl Effect for Mass {
    const ID: EffectId = EffectId::Mass;
    const SPEC: Spec = Spec {
        id: "mass",
        parameters: &[Parameter::of_vehicle("mass_kg", "kg", |v| v.mass, [1e-4, 1e4])],
    };

    fn from_slots(&[mass_kg, ..]: &Slots) -> Self {
        Self { mass_kg }
    }
}

impl ConstantEffect for Mass {
    fn apply(&self, constants: &mut Constants) {
        constants.mass = self.mass_kg;
    }
}
