//! The answer to a case, as any diagnosis may write it. The schema is that of `diagnose --json`,
//! and everything except the verdict is optional.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use vehicle::effects::{EffectId, EffectSet, ParameterValue};

/// Least probability at which an effect counts as named.
pub const NAMED: f64 = 0.5;

/// An answer to a case.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct GivenAnswer {
    /// `effect`, `none` or `unknown`.
    pub verdict: String,
    /// Effects with their probabilities.
    #[serde(default)]
    pub effects: Vec<GivenEffect>,
    /// The gap on the held-out flights.
    #[serde(default)]
    pub gap: Option<GivenGap>,
    /// Effects that the flights do not distinguish from the named ones.
    #[serde(default)]
    pub ambiguous_with: Vec<String>,
    /// Effects that the logs cannot show.
    #[serde(default)]
    pub not_testable: Vec<Untestable>,
    /// The full verdict with its sentence.
    #[serde(default)]
    pub finding: GivenFinding,
}

/// The full verdict of an answer.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GivenFinding {
    /// Name of the full verdict, in snake case.
    #[serde(default)]
    pub verdict: String,
    /// The finding in a sentence or two.
    #[serde(default)]
    pub sentence: String,
}

/// An effect of an answer.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct GivenEffect {
    /// Its id in the catalogue.
    pub id: String,
    /// Probability that the effect acts, 0..1.
    #[serde(default)]
    pub probability: f64,
    /// Values of its parameters, by name.
    #[serde(default)]
    pub parameters: BTreeMap<String, ParameterValue>,
    /// 90 % intervals by parameter, with components in brackets.
    #[serde(default)]
    pub intervals: BTreeMap<String, [f64; 2]>,
    /// Standard deviations of the fitted numbers, without the errors of the file and the law.
    #[serde(default)]
    pub deviations: BTreeMap<String, f64>,
}

/// The gap of an answer, in units of the noise.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct GivenGap {
    /// With the vehicle file as shipped.
    pub before: f64,
    /// With the named effects.
    pub after: f64,
    /// With noise alone.
    #[serde(default)]
    pub floor: f64,
}

/// An effect that the logs cannot show.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Untestable {
    /// Its id in the catalogue.
    pub id: String,
}

impl GivenAnswer {
    /// Probability of each class of effects that act alike, the most probable first.
    pub fn probabilities(&self) -> Vec<(String, f64)> {
        let mut by_class: BTreeMap<String, f64> = BTreeMap::new();
        for effect in &self.effects {
            *by_class.entry(class_of(&effect.id)).or_default() += effect.bounded();
        }
        let mut all: Vec<_> = by_class.into_iter().map(|(id, p)| (id, p.min(1.0))).collect();
        all.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        all
    }

    /// The effect with this id, else the first that acts alike.
    pub fn effect(&self, id: &str) -> Option<&GivenEffect> {
        let same = |effect: &&GivenEffect| class_of(&effect.id) == class_of(id);
        self.effects
            .iter()
            .find(|effect| effect.id == id)
            .or_else(|| self.effects.iter().find(same))
    }

    /// The named effects as an effect set; ids and values that the catalogue rejects are left out.
    pub fn effect_set(&self) -> EffectSet {
        let mut set = EffectSet::new();
        for effect in self.effects.iter().filter(|effect| effect.bounded() >= NAMED) {
            if let Ok(id) = effect.id.parse::<EffectId>() {
                let given = effect.parameters.iter().map(|(name, value)| (name.as_str(), value));
                let _ = set.insert_named(id, given);
            }
        }
        set
    }
}

impl GivenEffect {
    /// Its probability, limited to 0..1; 0 if it is not finite.
    pub fn bounded(&self) -> f64 {
        if self.probability.is_finite() { self.probability.clamp(0.0, 1.0) } else { 0.0 }
    }
}

impl GivenGap {
    /// (before - after) / (before - floor); `None` where nothing is closable.
    pub fn closure(&self) -> Option<f64> {
        let gap = self.before - self.floor;
        (gap > 0.05).then(|| (self.before - self.after) / gap)
    }
}

/// The id of an effect's class, under which effects that act alike are compared.
pub fn class_of(id: &str) -> String {
    id.parse::<EffectId>().map_or_else(|_| id.to_owned(), |effect| effect.class().name().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equivalent_effects_share_one_probability() {
        let text = r#"{"verdict":"effect","effects":[
            {"id":"wind","probability":0.2},
            {"id":"mass","probability":0.4,"parameters":{"mass_kg":1.5}},
            {"id":"thrust_scale","probability":0.5}],"ambiguous_with":["wind"]}"#;
        let given: GivenAnswer = serde_json::from_str(text).expect("an answer");
        let all = given.probabilities();
        assert_eq!(all[0].0, "thrust_scale");
        assert!((all[0].1 - 0.9).abs() < 1e-12 && all.len() == 2);
        assert_eq!(given.effect("mass").map(|e| e.probability), Some(0.4));
        assert!(given.effect("gusts").is_none());
    }
}
