//! Mass: the true mass, such as with a payload at the centre of mass; the inertia is unchanged.

use super::{ConstantEffect, Effect, EffectId, Need, Parameter, Slots, Spec, slots};
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
        needs: &[Need::Input, Need::Motion],
        typical: |vehicle| slots([0.15 * vehicle.mass]),
        strong: |vehicle, chance, growth| growth.by[0] = chance.sign() * 0.2 * vehicle.mass,
        family: Some(EffectId::ThrustScale),
        ..Spec::PLAIN
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
