//! Motor lag: tau ds_i/dt = u_i - s_i, tau the total first-order time constant of the rotors.

use super::{ConstantEffect, Effect, EffectId, Need, Parameter, Slots, Spec, slots};
use crate::physics::Constants;

/// First-order lag of the rotors' states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorLag {
    /// Time constant in s; 0 means no lag.
    pub tau_s: f64,
}

impl Effect for MotorLag {
    const ID: EffectId = EffectId::MotorLag;
    const SPEC: Spec = Spec {
        id: "motor_lag",
        parameters: &[Parameter::of_vehicle("tau_s", "s", |v| v.motor_time_constant_s, [0.0, 2.0])],
        needs: &[Need::Moment, Need::FastOutputs],
        typical: |_| slots([0.04]),
        strong: |_, _, growth| growth.by[0] = 0.06,
        ..Spec::PLAIN
    };

    fn from_slots(&[tau_s, ..]: &Slots) -> Self {
        Self { tau_s }
    }
}

impl ConstantEffect for MotorLag {
    fn apply(&self, constants: &mut Constants) {
        constants.motor_time_constant = self.tau_s;
    }
}
