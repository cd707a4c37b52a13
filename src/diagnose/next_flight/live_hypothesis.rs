//! Hypotheses that may still be true.

use vehicle::effects::{EffectId, EffectSet};

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::catalogue::number::Target;

/// An explanation that may be true: effects with their numbers.
#[derive(Clone, Debug)]
pub struct LiveHypothesis {
    /// The effects, with the values of the true vehicle.
    pub effects: EffectSet,
    /// Its probability.
    pub probability: f64,
}

impl LiveHypothesis {
    /// The vehicle as shipped.
    pub fn none(probability: f64) -> Self {
        Self { effects: EffectSet::new(), probability }
    }

    /// Ids of its effects.
    pub fn names(&self) -> Vec<&'static str> {
        self.effects.iter().map(|(id, _)| id.name()).collect()
    }
}

/// The hypotheses that an answer leaves open.
#[derive(Clone, Debug)]
pub struct OpenQuestions {
    /// Explanations that these logs do not separate; empty where one is named.
    pub explanations: Vec<LiveHypothesis>,
    /// Effects that these logs cannot show, each at its typical strength.
    pub untested: Vec<LiveHypothesis>,
}

/// An effect with its numbers off the vehicle file's values by `strength` times their typical
/// magnitude; `None` if the file lacks a number that the effect needs.
pub fn typical(catalogue: &Catalogue, effect: EffectId, strength: f64) -> Option<LiveHypothesis> {
    let hypothesis = catalogue.hypotheses.iter().find(|h| h.effect == effect)?;
    let mut values = catalogue.references();
    for index in &hypothesis.numbers {
        let number = &catalogue.numbers[*index];
        let [low, high] = number.bounds;
        let up = number.reference + strength * number.magnitude;
        let down = number.reference - strength * number.magnitude;
        // A rotor can only lose thrust.
        let falls = matches!(number.target, Target::RotorScale(_));
        values[*index] = if falls || up > high { down } else { up }.clamp(low, high);
    }
    let effects = catalogue.effects(&values, Some(&[effect]));
    (!effects.is_empty()).then_some(LiveHypothesis { effects, probability: 0.5 })
}
