//! Centre of mass offset: the centre of mass is at (x, y) relative to the nominal one, so the
//! rotors' arms become position - offset.

use super::{ConstantEffect, Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::physics::Constants;

/// A shifted centre of mass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComOffset {
    /// Towards the front, m.
    pub x_m: f64,
    /// Towards the right, m.
    pub y_m: f64,
}

impl Effect for ComOffset {
    const ID: EffectId = EffectId::ComOffset;
    const SPEC: Spec = Spec {
        id: "com_offset",
        parameters: &[
            Parameter::scalar("x_m", "m", 0.0, [-2.0, 2.0]),
            Parameter::scalar("y_m", "m", 0.0, [-2.0, 2.0]),
        ],
        needs: &[Need::Moment],
        typical: |vehicle| slots([0.05 * vehicle.arm_m(); 2]),
        strong: |vehicle, chance, growth| {
            let [x, y] = chance.heading();
            let most_m = 0.12 * vehicle.arm_m();
            (growth.by[0], growth.by[1]) = (most_m * x, most_m * y);
        },
        judged: &[&["x_m", "y_m"]],
        ..Spec::PLAIN
    };

    fn from_slots(&[x_m, y_m, ..]: &Slots) -> Self {
        Self { x_m, y_m }
    }
}

impl ConstantEffect for ComOffset {
    fn apply(&self, constants: &mut Constants) {
        for rotor in &mut constants.rotors {
            rotor.x -= self.x_m;
            rotor.y -= self.y_m;
        }
    }
}
