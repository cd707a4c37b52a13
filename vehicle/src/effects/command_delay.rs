//! Command delay: total mean transport delay from sending a setpoint on the ground to its use on
//! board.
//!
//! It acts on the way into the autopilot, not in the plant.

use super::{Effect, EffectId, Need, Parameter, Slots, Spec, slots};

/// Transport delay of setpoints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandDelay {
    /// Delay in s.
    pub delay_s: f64,
}

impl Effect for CommandDelay {
    const ID: EffectId = EffectId::CommandDelay;
    const SPEC: Spec = Spec {
        id: "command_delay",
        parameters: &[Parameter::of_vehicle("delay_s", "s", |v| v.command_delay_s, [0.0, 1.0])],
        needs: &[Need::Input, Need::Motion, Need::FastInput],
        typical: |_| slots([0.03]),
        strong: |_, _, growth| growth.by[0] = 0.05,
        ..Spec::PLAIN
    };

    fn from_slots(&[delay_s, ..]: &Slots) -> Self {
        Self { delay_s }
    }
}
