//! Command delay: total mean transport delay from the ground station's send to use on board.
//!
//! Acts on the way into the autopilot, not in the plant.

use super::{Effect, EffectId, Parameter, Slots, Spec};

/// Delay of setpoints.
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
    };

    fn from_slots(&[delay_s, ..]: &Slots) -> Self {
        Self { delay_s }
    }
}
