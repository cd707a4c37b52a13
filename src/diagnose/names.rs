//! Names of numbers.

use super::hypothesis::Target;

/// The name of a number within its effect: of its parameter, and the component where it has
/// several.
pub(super) fn parameter_name(target: Target) -> String {
    match target {
        Target::Effect(id, slot) => match id.spec().slots().find(|s| s.index == slot) {
            Some(slot) if slot.parameter.kind.slots() > 1 => {
                format!("{}[{}]", slot.parameter.name, slot.component)
            }
            Some(slot) => slot.parameter.name.to_owned(),
            None => slot.to_string(),
        },
        Target::RotorScale(_) => "scale".to_owned(),
        Target::OutputDelay => "delay_s".to_owned(),
        Target::RotorGain(rotor) => format!("thrust of rotor {rotor}"),
        Target::Damping(axis) => format!("damping of the rate[{axis}]"),
    }
}
