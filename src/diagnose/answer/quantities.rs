//! Effects with their numbers and units as text.

use std::fmt::Display;

use vehicle::effects::{EffectId, ParameterValue};

use crate::diagnose::answer::{EffectAnswer, ExplanationAnswer};
use crate::diagnose::verdict::parameter::Parameter;

/// An effect of the answer with its parameters.
pub fn one(effect: &EffectAnswer) -> String {
    let numbers = effect.parameters.iter().map(|(name, value)| {
        let value = match value {
            Parameter::Index(index) => index.to_string(),
            Parameter::Number(number) => short(*number),
            Parameter::Vector(numbers) => list(numbers),
        };
        quantity(Some(effect.id), name, value)
    });
    with_numbers(effect.id, numbers)
}

/// The effects of an explanation with their fitted numbers.
pub fn numbered(explanation: &ExplanationAnswer) -> String {
    let effect = |name: &String| {
        let id = name.parse().ok();
        let parameters = explanation.parameters.get(name).into_iter().flatten();
        let numbers = parameters.map(|(name, value)| {
            let value = match value {
                // An index, such as a rotor's, or a number at its neutral value.
                ParameterValue::Number(number) if number.fract() == 0.0 => number.to_string(),
                ParameterValue::Number(number) => short(*number),
                ParameterValue::Vector(numbers) => list(numbers),
            };
            quantity(id, name, value)
        });
        with_numbers(name, numbers)
    };
    explanation.effects.iter().map(effect).collect::<Vec<_>>().join(" and ")
}

/// The interval of a parameter, or of a component such as `scale[0]`.
pub fn bounded(effect: EffectId, name: &str, [low, high]: [f64; 2]) -> String {
    quantity(Some(effect), name, format!("{} .. {}", short(low), short(high)))
}

/// A number to four significant digits.
pub fn short(number: f64) -> String {
    if number == 0.0 {
        return "0".to_owned();
    }
    let digits = 3 - number.abs().log10().floor() as i32;
    format!("{number:.*}", usize::try_from(digits.clamp(0, 12)).unwrap_or(0))
}

fn with_numbers(effect: impl Display, numbers: impl Iterator<Item = String>) -> String {
    format!("{effect} ({})", numbers.collect::<Vec<_>>().join(", "))
}

fn list(numbers: &[f64]) -> String {
    format!("[{}]", numbers.iter().map(|n| short(*n)).collect::<Vec<_>>().join(", "))
}

/// A parameter with its value and unit. A law from a file has parameters without a unit here.
fn quantity(effect: Option<EffectId>, name: &str, value: String) -> String {
    let parameter = name.split('[').next().unwrap_or(name);
    let parameters = effect.map_or(&[][..], |id| id.spec().parameters);
    match parameters.iter().find(|known| known.name == parameter) {
        Some(known) if known.unit != "-" => format!("{name} {value} {}", known.unit),
        _ => format!("{name} {value}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_their_units() {
        let drag = bounded(EffectId::RotorDrag, "d_xy", [0.019, 0.021]);
        assert_eq!(drag, "d_xy 0.01900 .. 0.02100 kg/s");
        assert_eq!(bounded(EffectId::Inertia, "scale[2]", [1.0, 2.0]), "scale[2] 1.000 .. 2.000");
    }
}
