//! Yaw torque: true drag torque per thrust = nominal times scale.

use super::{ConstantEffect, Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::physics::Constants;

/// True drag torque of the rotors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct YawTorque {
    /// Factor on drag_torque_per_thrust_m.
    pub scale: f64,
}

impl Effect for YawTorque {
    const ID: EffectId = EffectId::YawTorque;
    const SPEC: Spec = Spec {
        id: "yaw_torque",
        parameters: &[Parameter::scalar("scale", "-", 1.0, [0.0, 20.0])],
        needs: &[Need::Moment],
        typical: |_| slots([0.35]),
        strong: |_, chance, growth| growth.by[0] = chance.scale([0.6, 1.0]),
        ..Spec::PLAIN
    };

    fn from_slots(&[scale, ..]: &Slots) -> Self {
        Self { scale }
    }
}

impl ConstantEffect for YawTorque {
    fn apply(&self, constants: &mut Constants) {
        for rotor in &mut constants.rotors {
            rotor.torque_per_thrust *= self.scale;
        }
    }
}
