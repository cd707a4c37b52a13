//! Rotor loss: one rotor's thrust and drag torque are multiplied by scale, as with a chipped
//! propeller or a worn motor.

use super::{ConstantEffect, Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::params::ROTORS;
use crate::physics::Constants;

/// One weak rotor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotorLoss {
    /// Index of the rotor in the vehicle file, from 0.
    pub rotor: usize,
    /// Factor on its thrust and drag torque.
    pub scale: f64,
}

impl Effect for RotorLoss {
    const ID: EffectId = EffectId::RotorLoss;
    const SPEC: Spec = Spec {
        id: "rotor_loss",
        parameters: &[
            Parameter::index("rotor", ROTORS),
            Parameter::scalar("scale", "-", 1.0, [0.0, 2.0]),
        ],
        needs: &[Need::Moment],
        typical: |_| slots([0.0, 0.15]),
        strong: |_, chance, growth| {
            (growth.from[0], growth.from[1]) = (chance.below(ROTORS) as f64, 1.0);
            growth.by[1] = -0.25;
        },
        ..Spec::PLAIN
    };

    fn from_slots(&[rotor, scale, ..]: &Slots) -> Self {
        Self { rotor: rotor as usize, scale }
    }
}

impl ConstantEffect for RotorLoss {
    fn apply(&self, constants: &mut Constants) {
        if let Some(rotor) = constants.rotors.get_mut(self.rotor) {
            rotor.thrust_max *= self.scale;
        }
    }
}
