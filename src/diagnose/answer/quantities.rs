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
        quantity(effect.id.name(), name, value)
    });
    with_numbers(effect.id, numbers)
}

/// The effects of an explanation with their fitted numbers.
pub fn numbered(explanation: &ExplanationAnswer) -> String {
    let effect = |name: &String| {
        let parameters = explanation.parameters.get(name).into_iter().flatten();
        let numbers = parameters.map(|(parameter, value)| {
            let value = match value {
                // An index, such as a rotor's, or a number at its neutral value.
                ParameterValue::Number(number) if number.fract() == 0.0 => number.to_string(),
                ParameterValue::Number(number) => short(*number),
                ParameterValue::Vector(numbers) => list(numbers),
            };
            quantity(name, parameter, value)
        });
        with_numbers(name, numbers)
    };
    explanation.effects.iter().map(effect).collect::<Vec<_>>().join(" and ")
}

/// The interval of a parameter, or of a component such as `scale[0]`.
pub fn bounded(effect: &str, name: &str, [low, high]: [f64; 2]) -> String {
    quantity(effect, name, format!("{} .. {}", short(low), short(high)))
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
    let numbers = numbers.collect::<Vec<_>>().join(", ");
    if numbers.is_empty() { effect.to_string() } else { format!("{effect} ({numbers})") }
}

fn list(numbers: &[f64]) -> String {
    format!("[{}]", numbers.iter().map(|n| short(*n)).collect::<Vec<_>>().join(", "))
}

/// A parameter of an effect, or a component such as `scale[0]`, with its value and unit.
pub fn quantity(effect: &str, name: &str, value: impl Display) -> String {
    format!(
        "{name} {value}{}",
        unit(effect, name).map(|unit| format!(" {unit}")).unwrap_or_default()
    )
}

/// The unit of an effect's parameter or component; `None` for a dimensionless one, for one whose
/// name ends with it, such as `mass_kg`, and for those of a law from a file.
pub fn unit(effect: &str, name: &str) -> Option<&'static str> {
    let parameter = name.split('[').next()?;
    let id: EffectId = effect.parse().ok()?;
    let known = id.spec().parameters.iter().find(|known| known.name == parameter)?;
    let in_a_name = match known.unit {
        "m/s" => "m_s",
        "N m per m/s" => "Nms_m",
        "rad per m/s" => "rad_s_m",
        unit => unit,
    };
    let is_said = parameter.strip_suffix(in_a_name).is_some_and(|name| name.ends_with('_'));
    (known.unit != "-" && !is_said).then_some(known.unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_printed_with_their_units() {
        let drag = bounded("rotor_drag", "d_xy", [0.019, 0.021]);
        assert_eq!(drag, "d_xy 0.01900 .. 0.02100 kg/s");
        // Once: not beside a name that ends with the unit.
        assert_eq!(quantity("mass", "mass_kg", "0.033"), "mass_kg 0.033");
        assert_eq!(quantity("wind", "north_m_s", "1.5"), "north_m_s 1.5");
        assert_eq!(bounded("inertia", "scale[2]", [1.0, 2.0]), "scale[2] 1.000 .. 2.000");
    }
}
