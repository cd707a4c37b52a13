//! Parameters of an effect in the form of an answer.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::{EffectId, EffectSet, Kind, ParameterValue};

/// A parameter's value, untagged in JSON.
#[derive(Clone, Debug, JsonSchema, Serialize)]
#[serde(untagged)]
pub enum Parameter {
    /// An index, such as a rotor's.
    Index(u64),
    /// A number.
    Number(f64),
    /// A vector.
    Vector(Vec<f64>),
}

/// All parameters of effect `id`, by name; empty where it is off in `set`.
pub fn parameters(set: &EffectSet, id: EffectId) -> BTreeMap<&'static str, Parameter> {
    let Some(slots) = set.slots(id) else { return BTreeMap::new() };
    id.spec()
        .slots()
        .filter(|slot| slot.component == 0)
        .map(|slot| {
            let first = slot.index;
            let value = match slot.parameter.kind {
                Kind::Index => Parameter::Index(slots[first] as u64),
                Kind::Scalar => Parameter::Number(slots[first]),
                Kind::Vec3 => Parameter::Vector(slots[first..first + 3].to_vec()),
            };
            (slot.parameter.name, value)
        })
        .collect()
}

impl From<&Parameter> for ParameterValue {
    fn from(parameter: &Parameter) -> Self {
        match parameter {
            Parameter::Index(index) => ParameterValue::Number(*index as f64),
            Parameter::Number(number) => ParameterValue::Number(*number),
            Parameter::Vector(numbers) => ParameterValue::Vector(numbers.clone()),
        }
    }
}
