//! Hypotheses that are still alive.

use vehicle::effects::{EffectId, EffectSet};

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::catalogue::number::Target;

/// An explanation that may be true: effects with their numbers.
#[derive(Clone, Debug)]
pub struct Live {
    /// The effects, with the vehicle's true values.
    pub effects: EffectSet,
    /// Its probability.
    pub probability: f64,
}

impl Live {
    /// No effect at all.
    pub fn none(probability: f64) -> Self {
        Self { effects: EffectSet::new(), probability }
    }

    /// Ids of its effects.
    pub fn names(&self) -> Vec<&'static str> {
        self.effects.iter().map(|(id, _)| id.name()).collect()
    }
}

/// What an answer leaves open.
#[derive(Clone, Debug)]
pub struct OpenQuestions {
    /// Explanations that cannot be told apart; none where one is named.
    pub explanations: Vec<Live>,
    /// Effects that these logs cannot show for want of motion, each at its usual strength.
    pub untested: Vec<Live>,
}

/// An effect with its numbers at `strength` of their usual distance from what the vehicle file
/// says; `None` for one that the file lacks a number for.
pub fn typical(catalogue: &Catalogue, effect: EffectId, strength: f64) -> Option<Live> {
    let hypothesis = catalogue.hypotheses.iter().find(|h| h.effect == effect)?;
    let mut values = catalogue.references();
    for index in &hypothesis.numbers {
        let number = &catalogue.numbers[*index];
        let [low, high] = number.bounds;
        let up = number.reference + strength * number.magnitude;
        let down = number.reference - strength * number.magnitude;
        // A rotor only loses thrust.
        let falls = matches!(number.target, Target::RotorScale(_));
        values[*index] = if falls || up > high { down } else { up }.clamp(low, high);
    }
    let effects = catalogue.effects(&values, Some(&[effect]));
    (!effects.is_empty()).then_some(Live { effects, probability: 0.5 })
}
