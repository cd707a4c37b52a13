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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_of_an_effect_keep_their_kinds() {
        let mut set = EffectSet::new();
        for argument in ["rotor_loss:rotor=2,scale=0.8", "inertia:scale=[1.2,1.1,1.0]"] {
            set.insert_argument(argument).expect("an effect");
        }
        let json = |id| serde_json::to_value(parameters(&set, id)).expect("an object");
        let loss = json(EffectId::RotorLoss);
        assert_eq!(loss, serde_json::json!({"rotor": 2, "scale": 0.8}));
        assert_eq!(json(EffectId::Inertia), serde_json::json!({"scale": [1.2, 1.1, 1.0]}));
        assert!(parameters(&set, EffectId::Wind).is_empty());
        // What the answer states can be put back into a set.
        for id in [EffectId::RotorLoss, EffectId::Inertia] {
            let stated = parameters(&set, id);
            let values: Vec<_> = stated.iter().map(|(name, value)| (*name, value.into())).collect();
            let mut again = EffectSet::new();
            let named = values.iter().map(|(name, value)| (*name, value));
            again.insert_named(id, named).expect("an effect");
            assert_eq!(again.slots(id), set.slots(id));
        }
    }
}
