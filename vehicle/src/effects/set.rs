//! A set of effects with their parameters, read from files and the command line.

use std::collections::BTreeMap;
use std::fmt;

use serde::de::{Error as _, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::spec::{Kind, Parameter, Slots};
use super::{COUNT, Effect, EffectId};
use crate::law::{LAWS_MAX, Law, LawError, LawText};

/// A set of active effects. Each parameter is within its accepted range.
///
/// Files hold it as a map from id to parameters, `{"rotor_drag": {"d_xy": 0.02, "d_z": 0.01}}`,
/// with laws by name under `law`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EffectSet {
    values: [Option<Slots>; COUNT],
    laws: Vec<Law>,
}

/// The key of the laws in files.
const LAW: &str = EffectSet::LAW;

/// A parameter's value in a file or on the command line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected a number, or a list of three numbers")]
pub enum ParameterValue {
    /// A scalar or an index.
    Number(f64),
    /// A vector of three components; other lengths are refused later.
    Vector(Vec<f64>),
}

impl fmt::Display for ParameterValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            ParameterValue::Number(number) => write!(f, "{number}"),
            ParameterValue::Vector(numbers) => write!(f, "{numbers:?}"),
        }
    }
}

/// Why an effect is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EffectError {
    /// Not in the catalogue.
    #[error("unknown effect {id:?}; known are {}", EffectId::ALL.map(EffectId::name).join(", "))]
    UnknownEffect {
        /// The text as given.
        id: String,
    },
    /// The effect has no such parameter.
    #[error("effect {effect}: unknown parameter {parameter:?}; it has {}", parameters(*.effect))]
    UnknownParameter {
        /// The effect.
        effect: EffectId,
        /// The text as given.
        parameter: String,
    },
    /// A parameter without a default is missing.
    #[error("effect {effect}: parameter {parameter} ({unit}) must be given")]
    Missing {
        /// The effect.
        effect: EffectId,
        /// The parameter.
        parameter: &'static str,
        /// Its unit.
        unit: &'static str,
    },
    /// A value has the wrong shape or is outside its accepted range.
    #[error("effect {effect}: {parameter}: expected {expected}, found {found}")]
    Value {
        /// The effect.
        effect: EffectId,
        /// The parameter.
        parameter: &'static str,
        /// The accepted shape or range.
        expected: String,
        /// The value as given.
        found: String,
    },
    /// A law is refused.
    #[error(transparent)]
    Law(#[from] LawError),
    /// An onset is refused.
    #[error(transparent)]
    Onset(#[from] super::OnsetError),
    /// Two arguments give one effect or law.
    #[error("{name} is given twice; give it once, with all its numbers")]
    Twice {
        /// The effect's id or the law's name.
        name: String,
    },
    /// There are more than [`LAWS_MAX`] laws.
    #[error("expected at most {LAWS_MAX} laws, found more; leave some out")]
    TooManyLaws,
    /// The text does not follow `id:key=value,key=value`.
    #[error("effect argument {argument:?}: {reason}; write id:key=value,key=[x,y,z]")]
    Syntax {
        /// The text as given.
        argument: String,
        /// Where the text departs from the form.
        reason: String,
    },
}

fn parameters(effect: EffectId) -> String {
    let names: Vec<_> = effect.spec().parameters.iter().map(|p| p.name).collect();
    names.join(", ")
}

impl EffectSet {
    /// The key of the laws in files, beside the effects' ids.
    pub const LAW: &str = "law";

    /// Creates an empty set.
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether the set has neither an effect nor a law.
    pub fn is_empty(&self) -> bool {
        self.values.iter().all(Option::is_none) && self.laws.is_empty()
    }

    /// The laws, sorted by name.
    pub fn laws(&self) -> &[Law] {
        &self.laws
    }

    /// Adds a law, or replaces the one of the same name.
    ///
    /// # Errors
    /// The set already has [`LAWS_MAX`] laws.
    pub fn insert_law(&mut self, law: Law) -> Result<(), EffectError> {
        match self.laws.binary_search_by(|own| own.name().cmp(law.name())) {
            Ok(index) => self.laws[index] = law,
            Err(_) if self.laws.len() >= LAWS_MAX => return Err(EffectError::TooManyLaws),
            Err(index) => self.laws.insert(index, law),
        }
        Ok(())
    }

    /// Whether the set has this effect.
    pub fn contains(&self, id: EffectId) -> bool {
        self.values[id as usize].is_some()
    }

    /// The effect `E`, if the set has it.
    pub fn get<E: Effect>(&self) -> Option<E> {
        self.values[E::ID as usize].as_ref().map(E::from_slots)
    }

    /// The effects in the catalogue's order, without the laws.
    pub fn iter(&self) -> impl Iterator<Item = (EffectId, &Slots)> {
        EffectId::ALL.into_iter().filter_map(|id| self.slots(id).map(|slots| (id, slots)))
    }

    /// An effect's numbers, if the set has it.
    pub fn slots(&self, id: EffectId) -> Option<&Slots> {
        self.values[id as usize].as_ref()
    }

    /// One number of an effect, if the set has it; `component` is 0 for a scalar.
    pub fn value(&self, id: EffectId, parameter: &str, component: usize) -> Option<f64> {
        let slot = id.spec().find(parameter)?;
        (component < slot.parameter.kind.slots())
            .then(|| self.slots(id).map(|slots| slots[slot.index + component]))?
    }

    /// Adds or replaces an effect, given all its numbers in the order of its specification.
    ///
    /// # Errors
    /// A number is outside its accepted range. The set stays unchanged.
    pub fn insert(&mut self, id: EffectId, slots: Slots) -> Result<(), EffectError> {
        for slot in id.spec().slots() {
            check(id, slot.parameter, slots[slot.index])?;
        }
        self.values[id as usize] = Some(slots);
        Ok(())
    }

    /// Adds or replaces an effect with named parameters; missing ones take their defaults.
    ///
    /// # Errors
    /// A parameter is unknown, missing, of the wrong shape or out of range. The set stays
    /// unchanged.
    pub fn insert_named<'a>(
        &mut self,
        id: EffectId,
        given: impl IntoIterator<Item = (&'a str, &'a ParameterValue)>,
    ) -> Result<(), EffectError> {
        let given: BTreeMap<_, _> = given.into_iter().collect();
        let spec = id.spec();
        if let Some(name) = given.keys().find(|name| spec.find(name).is_none()) {
            let parameter = (*name).to_owned();
            return Err(EffectError::UnknownParameter { effect: id, parameter });
        }
        let mut slots = Slots::default();
        for slot in spec.slots() {
            let parameter = slot.parameter;
            slots[slot.index] = match (given.get(parameter.name), parameter.kind) {
                (Some(ParameterValue::Number(number)), Kind::Scalar | Kind::Index) => *number,
                (Some(ParameterValue::Vector(numbers)), Kind::Vec3) if numbers.len() == 3 => {
                    numbers[slot.component]
                }
                (Some(found), kind) => {
                    let expected = match kind {
                        Kind::Vec3 => "three numbers [x, y, z]",
                        Kind::Scalar | Kind::Index => "one number",
                    };
                    return Err(EffectError::Value {
                        effect: id,
                        parameter: parameter.name,
                        expected: expected.to_owned(),
                        found: found.to_string(),
                    });
                }
                (None, _) => parameter.default.ok_or(EffectError::Missing {
                    effect: id,
                    parameter: parameter.name,
                    unit: parameter.unit,
                })?,
            };
        }
        self.insert(id, slots)
    }

    /// Removes an effect; does nothing if the set does not have it.
    pub fn remove(&mut self, id: EffectId) {
        self.values[id as usize] = None;
    }

    /// These effects with those of `other` added or replacing them. Drops the last laws of `other`
    /// once [`LAWS_MAX`] is reached.
    pub fn overlay(&self, other: &EffectSet) -> EffectSet {
        let mut values = self.values;
        for (mine, theirs) in values.iter_mut().zip(other.values) {
            *mine = theirs.or(*mine);
        }
        let mut both = Self { values, laws: self.laws.clone() };
        for law in &other.laws {
            let _ = both.insert_law(law.clone());
        }
        both
    }

    /// An effect or law that is in both sets.
    pub(super) fn shared(&self, other: &EffectSet) -> Option<&str> {
        let effect = self.iter().map(|(id, _)| id).find(|id| other.contains(*id));
        let is_other = |name: &&str| other.laws.iter().any(|law| law.name() == *name);
        effect.map(EffectId::name).or_else(|| self.laws.iter().map(Law::name).find(is_other))
    }

    /// Adds the effect of a command-line argument such as `motor_lag:tau_s=0.03` or
    /// `inertia:scale=[1.2,1.1,1.0]`, or a one-line law such as `force_x = -0.02[kg/s] * air_x`.
    ///
    /// # Errors
    /// The text does not follow this form, or [`EffectSet::insert_named`] refuses it.
    pub fn insert_argument(&mut self, argument: &str) -> Result<(), EffectError> {
        if Law::is_line(argument) {
            let names = std::iter::once(LAW.to_owned()).chain((2..).map(|n| format!("{LAW}_{n}")));
            let is_free = |name: &String| self.laws.iter().all(|law| law.name() != name);
            let name = names.take(LAWS_MAX + 1).find(is_free).ok_or(EffectError::TooManyLaws)?;
            return self.insert_law(Law::from_line(&name, argument)?);
        }
        let syntax = |reason: String| EffectError::Syntax { argument: argument.to_owned(), reason };
        let (id, list) = argument.split_once(':').unwrap_or((argument, ""));
        let id: EffectId = id.trim().parse()?;
        let mut given: BTreeMap<&str, ParameterValue> = BTreeMap::new();
        for item in split_outside_brackets(list).filter(|item| !item.trim().is_empty()) {
            let (name, text) =
                item.split_once('=').ok_or_else(|| syntax(format!("{item:?} has no '='")))?;
            let value = parse_value(text.trim())
                .ok_or_else(|| syntax(format!("{text:?} is not a number or [x,y,z]")))?;
            if given.insert(name.trim(), value).is_some() {
                return Err(syntax(format!("{:?} is given twice", name.trim())));
            }
        }
        self.insert_named(id, given.iter().map(|(name, value)| (*name, value)))
    }
}

fn check(effect: EffectId, parameter: &Parameter, value: f64) -> Result<(), EffectError> {
    let is_integral = parameter.kind != Kind::Index || value.fract() == 0.0;
    // NaN is in no range.
    if (parameter.min..=parameter.max).contains(&value) && is_integral {
        return Ok(());
    }
    let number = if parameter.kind == Kind::Index { "a whole number" } else { "a number" };
    Err(EffectError::Value {
        effect,
        parameter: parameter.name,
        expected: format!("{number} in {}..={} {}", parameter.min, parameter.max, parameter.unit),
        found: value.to_string(),
    })
}

/// Splits at commas outside brackets.
fn split_outside_brackets(list: &str) -> impl Iterator<Item = &str> {
    let mut depth = 0_i32;
    list.split(move |c| {
        match c {
            '[' => depth += 1,
            ']' => depth -= 1,
            _ => {}
        }
        c == ',' && depth == 0
    })
}

fn parse_value(text: &str) -> Option<ParameterValue> {
    match text.strip_prefix('[') {
        Some(rest) => {
            let inside = rest.strip_suffix(']')?;
            let numbers: Result<Vec<f64>, _> =
                inside.split(',').map(|n| n.trim().parse()).collect();
            numbers.ok().map(ParameterValue::Vector)
        }
        None => text.parse().ok().map(ParameterValue::Number),
    }
}

impl Serialize for EffectSet {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for (id, slots) in self.iter() {
            map.serialize_entry(id.name(), &Named { id, slots })?;
        }
        if !self.laws.is_empty() {
            let laws: BTreeMap<&str, &LawText> =
                self.laws.iter().map(|law| (law.name(), law.text())).collect();
            map.serialize_entry(LAW, &laws)?;
        }
        map.end()
    }
}

/// Serialises an effect's numbers under its parameters' names.
struct Named<'a> {
    id: EffectId,
    slots: &'a Slots,
}

impl Serialize for Named<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        for slot in self.id.spec().slots().filter(|slot| slot.component == 0) {
            let (name, first) = (slot.parameter.name, slot.index);
            match slot.parameter.kind {
                Kind::Scalar => map.serialize_entry(name, &self.slots[first])?,
                Kind::Index => map.serialize_entry(name, &(self.slots[first] as u64))?,
                Kind::Vec3 => map.serialize_entry(name, &self.slots[first..first + 3])?,
            }
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for EffectSet {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Effects;

        impl<'de> Visitor<'de> for Effects {
            type Value = EffectSet;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a map from effect id to parameters")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<EffectSet, A::Error> {
                let mut set = EffectSet::new();
                while let Some(name) = map.next_key::<String>()? {
                    if name == LAW {
                        for (name, text) in map.next_value::<BTreeMap<String, LawText>>()? {
                            let law = Law::new(&name, text).map_err(A::Error::custom)?;
                            set.insert_law(law).map_err(A::Error::custom)?;
                        }
                        continue;
                    }
                    let id: EffectId = name.parse().map_err(A::Error::custom)?;
                    if set.contains(id) {
                        return Err(A::Error::custom(format_args!("effect {id} is given twice")));
                    }
                    let given: BTreeMap<String, ParameterValue> = map.next_value()?;
                    set.insert_named(id, given.iter().map(|(name, value)| (name.as_str(), value)))
                        .map_err(A::Error::custom)?;
                }
                Ok(set)
            }
        }

        deserializer.deserialize_map(Effects)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(argument: &str) -> Result<EffectSet, EffectError> {
        let mut set = EffectSet::new();
        set.insert_argument(argument).map(|()| set)
    }

    #[test]
    fn argument_takes_scalars_vectors_and_defaults() {
        let set = parsed("pd_gain:kp_scale=[1.2, 1.1,1.0]").unwrap();
        assert_eq!(set.value(EffectId::PdGain, "kp_scale", 1), Some(1.1));
        assert_eq!(set.value(EffectId::PdGain, "kd_scale", 2), Some(1.0));
        let set = parsed("rotor_drag:d_xy=0.02,d_z=1e-2").unwrap();
        assert_eq!(set.value(EffectId::RotorDrag, "d_z", 0), Some(0.01));
    }

    #[test]
    fn invalid_argument_is_refused_by_name() {
        let message = |argument: &str| parsed(argument).unwrap_err().to_string();
        assert!(message("rotor_drug:d_xy=1").contains("unknown effect \"rotor_drug\""));
        assert!(
            message("rotor_drag:dxy=1").contains("unknown parameter \"dxy\"; it has d_xy, d_z")
        );
        assert!(message("rotor_drag:d_xy").contains("has no '='"));
        assert!(message("rotor_drag:d_xy=fast").contains("not a number"));
        assert!(message("rotor_drag:d_xy=1,d_xy=2").contains("given twice"));
        assert!(message("rotor_drag:d_xy=NaN").contains("found NaN"));
        assert!(message("rotor_drag:d_xy=[1,2,3]").contains("expected one number"));
        assert!(message("inertia:scale=1").contains("three numbers"));
        assert!(message("inertia:scale=[1,2]").contains("three numbers"));
        assert!(message("inertia:scale=[1,2,3").contains("not a number"));
        assert!(message("mass").contains("mass_kg (kg) must be given"));
        assert!(message("rotor_loss:rotor=1.5,scale=0.9").contains("whole number"));
        assert!(message("rotor_loss:rotor=4,scale=0.9").contains("0..=3"));
    }

    #[test]
    fn effect_set_round_trips_through_json_and_toml() {
        let mut set = parsed("inertia:scale=[1.2,1.1,1.0]").unwrap();
        set.insert_argument("rotor_loss:rotor=2,scale=0.9").unwrap();
        set.insert_argument("wind:north_m_s=3").unwrap();
        let json = serde_json::to_string(&set).unwrap();
        assert!(json.contains(r#""rotor":2,"#));
        assert_eq!(serde_json::from_str::<EffectSet>(&json).unwrap(), set);
        assert_eq!(toml::from_str::<EffectSet>(&toml::to_string(&set).unwrap()).unwrap(), set);
    }

    #[test]
    fn files_may_write_whole_numbers() {
        let set: EffectSet = toml::from_str("rotor_drag = { d_xy = 1, d_z = 0 }").unwrap();
        assert_eq!(set.value(EffectId::RotorDrag, "d_xy", 0), Some(1.0));
    }

    #[test]
    fn overlay_replaces_whole_effects() {
        let base = parsed("rotor_drag:d_xy=0.1,d_z=0.2").unwrap();
        let top = parsed("rotor_drag:d_xy=0.3").unwrap();
        let both = base.overlay(&top);
        assert_eq!(both.value(EffectId::RotorDrag, "d_xy", 0), Some(0.3));
        assert_eq!(both.value(EffectId::RotorDrag, "d_z", 0), Some(0.0));
        assert_eq!(base.overlay(&EffectSet::new()), base);
    }
}
