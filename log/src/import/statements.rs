//! What each boot of a vehicle states about it.

use std::collections::BTreeMap;

use super::facts::Texts;
use super::kind::StatedKind;

/// One statement of a log.
#[derive(Clone, Debug)]
pub(super) enum Statement {
    Parameter(String, f64),
    /// A text, with its level of syslog if the log has one.
    Text(Option<u8>, String),
    /// MAV_TYPE of a HEARTBEAT, or the number of ArduPilot's build.
    Type(u8),
}

/// What one boot states.
#[derive(Clone, Debug, Default)]
pub(super) struct Statements {
    /// Last value of each parameter.
    pub parameters: BTreeMap<String, f64>,
    pub texts: Texts,
    /// How often each number of a type is stated.
    types: BTreeMap<u8, u64>,
}

impl Statements {
    pub fn add(&mut self, statement: Statement) {
        match statement {
            Statement::Parameter(name, value) => {
                self.parameters.insert(name, value);
            }
            Statement::Text(level, text) => self.texts.add(level, text),
            Statement::Type(number) => *self.types.entry(number).or_default() += 1,
        }
    }

    /// The most frequent number of a type.
    pub fn most_frequent_type(&self) -> Option<f64> {
        let most = self.types.iter().max_by_key(|(_, count)| **count);
        most.map(|(number, _)| f64::from(*number))
    }

    /// What the chosen boot states. Vehicles are rebuilt and exchanged between boots, but a ground
    /// station often asks for the parameters only once. So what this boot lacks (a parameter, all
    /// texts, the type) is taken from the others, those before it first, unless a boot contradicts
    /// what is known: by a kind of vehicle (of `kinds`) that this one does not state, or by other
    /// functions of the outputs or another frame. Nothing of such a boot is taken.
    pub fn of_boot(
        boots: &[Self],
        chosen: usize,
        kinds: impl Fn(&Self) -> Vec<StatedKind>,
    ) -> Self {
        let mut known = boots.get(chosen).cloned().unwrap_or_default();
        let mut known_kinds = kinds(&known);
        let (before, after) = boots.split_at(chosen.min(boots.len()));
        for boot in before.iter().rev().chain(after.iter().skip(1)) {
            let is_known = |stated: StatedKind| known_kinds.iter().any(|k| k.kind == stated.kind);
            let fits = known_kinds.is_empty() || kinds(boot).into_iter().all(is_known);
            if fits && !known.has_other_layout(boot) {
                known.complete(boot);
                known_kinds = kinds(&known);
            }
        }
        known
    }

    /// Whether the other boot has other functions of the outputs, of which each boot that states any
    /// states all, or another frame.
    fn has_other_layout(&self, other: &Self) -> bool {
        let is_function = |name: &str| name.contains("_FUNC");
        let is_frame = |name: &str| name.starts_with("CA_") || name.starts_with("FRAME_");
        let has_functions = self.parameters.keys().any(|name| is_function(name));
        other.parameters.iter().any(|(name, value)| match self.parameters.get(name) {
            Some(known) => known != value && (is_function(name) || is_frame(name)),
            None => has_functions && is_function(name),
        })
    }

    /// Adds what only the other boot states.
    fn complete(&mut self, other: &Self) {
        for (name, value) in &other.parameters {
            self.parameters.entry(name.clone()).or_insert(*value);
        }
        if self.texts.iter().next().is_none() {
            self.texts = other.texts.clone();
        }
        if self.types.is_empty() {
            self.types = other.types.clone();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::kind::{of_mav_type, of_parameters};

    fn boot(mav_type: Option<u8>, parameters: &[(&str, f64)]) -> Statements {
        let mut boot = Statements::default();
        mav_type.into_iter().for_each(|number| boot.add(Statement::Type(number)));
        for (name, value) in parameters {
            boot.add(Statement::Parameter((*name).to_owned(), *value));
        }
        boot
    }

    fn kinds(boot: &Statements) -> Vec<StatedKind> {
        let of_type = boot.most_frequent_type().and_then(of_mav_type);
        let of_type = StatedKind::new(of_type, String::new);
        of_type.into_iter().chain(of_parameters(&boot.parameters)).collect()
    }

    #[test]
    fn a_boot_is_completed_by_those_that_do_not_contradict_it() {
        const FUNCTION: &str = "SERVO1_FUNCTION";
        let chosen = |boots: &[Statements], chosen| {
            let known = Statements::of_boot(boots, chosen, kinds);
            let function = known.parameters.get(FUNCTION).copied();
            (known.most_frequent_type(), function, known.parameters.get("GAIN").copied())
        };
        let whole = boot(Some(2), &[(FUNCTION, 33.0), ("GAIN", 1.0)]);
        // Parameters that were asked for once, and a gain that was tuned since.
        let tuned = boot(Some(2), &[("GAIN", 2.0)]);
        assert_eq!(chosen(&[whole.clone(), tuned], 1), (Some(2.0), Some(33.0), Some(2.0)));
        // Another kind of vehicle, and other outputs.
        let plane = boot(Some(1), &[("TECS_CLMB_MAX", 5.0)]);
        assert_eq!(chosen(&[whole.clone(), plane.clone()], 1), (Some(1.0), None, None));
        assert_eq!(chosen(&[whole.clone(), plane], 0), (Some(2.0), Some(33.0), Some(1.0)));
        let rewired = boot(Some(2), &[(FUNCTION, 36.0)]);
        assert_eq!(chosen(&[rewired, whole.clone()], 0), (Some(2.0), Some(36.0), None));
        let moved = boot(Some(2), &[("SERVO9_FUNCTION", 33.0)]);
        assert_eq!(chosen(&[whole, moved], 1), (Some(2.0), None, None));
        // Of two that contradict each other, the boot before counts.
        let (quad, plane) = (boot(Some(2), &[]), boot(Some(1), &[("GAIN", 3.0)]));
        assert_eq!(chosen(&[plane, boot(None, &[]), quad], 1), (Some(1.0), None, Some(3.0)));
        assert_eq!(chosen(&[], 0), (None, None, None));
    }
}
