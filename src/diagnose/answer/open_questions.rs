//! The hypotheses that an answer leaves open, for the next flight to distinguish.

use std::collections::BTreeSet;

use vehicle::effects::EffectId;

use crate::diagnose::answer::Answer;
use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::next_flight::{LiveHypothesis, OpenQuestions, typical};
use crate::diagnose::search::explanation::Explanation;

/// The explanations and the untested effects that an answer leaves open.
pub fn open_questions(
    catalogue: &Catalogue,
    found: &[Explanation],
    answer: &Answer,
) -> OpenQuestions {
    OpenQuestions {
        explanations: explanations(catalogue, found, answer),
        untested: untested(catalogue, answer),
    }
}

/// The open explanations of an answer: fitted sets of effects that the answer mentions, and each
/// ambiguous effect that no such set contains. Probabilities are in proportion to the answer's.
fn explanations(
    catalogue: &Catalogue,
    found: &[Explanation],
    answer: &Answer,
) -> Vec<LiveHypothesis> {
    if answer.ambiguous_with.is_empty() {
        return Vec::new();
    }
    let ids = |explanation: &Explanation| -> Vec<EffectId> {
        let hypotheses = explanation.fit.hypotheses.iter();
        hypotheses.map(|h| catalogue.hypotheses[*h].effect).collect()
    };
    let probability = |id: EffectId| {
        let found = answer.effects.iter().find(|effect| effect.id == id);
        found.map_or(PROBABILITY_MIN, |effect| effect.probability.max(PROBABILITY_MIN))
    };
    let is_open = |explanation: &&Explanation| {
        let is_in_answer = |id: &EffectId| {
            answer.ambiguous_with.contains(id) || answer.effects.iter().any(|own| own.id == *id)
        };
        ids(explanation).iter().all(is_in_answer)
    };
    let mut live: Vec<LiveHypothesis> = Vec::new();
    let mut seen = BTreeSet::new();
    for explanation in found.iter().filter(is_open) {
        let ids = ids(explanation);
        if ids.iter().all(|id| seen.contains(id)) {
            continue;
        }
        let effects = catalogue.effects(&explanation.fit.values, Some(&ids));
        if !effects.is_empty() {
            let least = ids.iter().map(|id| probability(*id)).fold(1.0, f64::min);
            live.push(LiveHypothesis { effects, probability: least });
            seen.extend(ids);
        }
    }
    // Effects without a full fit are taken at their typical strength.
    for effect in EffectId::ALL.into_iter().filter(|id| answer.ambiguous_with.contains(id)) {
        if !seen.contains(&effect) {
            let usual = typical(catalogue, effect, 1.0);
            live.extend(
                usual.map(|usual| LiveHypothesis { probability: probability(effect), ..usual }),
            );
        }
    }
    let sum: f64 = live.iter().map(|one| one.probability).sum();
    live.iter_mut().for_each(|one| one.probability /= sum);
    live
}

/// Effects that these flights cannot show, each at its typical strength.
fn untested(catalogue: &Catalogue, answer: &Answer) -> Vec<LiveHypothesis> {
    let is_untested = |id: &EffectId| answer.not_testable.iter().any(|effect| effect.id == *id);
    let ids = EffectId::ALL.into_iter().filter(is_untested);
    ids.filter_map(|id| typical(catalogue, id, 1.0)).collect()
}

/// Least probability of an explanation that an answer mentions as possible.
const PROBABILITY_MIN: f64 = 0.1;

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use vehicle::VehicleParams;

    use super::*;
    use crate::diagnose::answer::EffectAnswer;
    use crate::diagnose::likelihood::fit::Fit;

    #[test]
    fn leading_ambiguous_explanation_is_open_even_below_half_probability() {
        let text = include_str!("../../../config/vehicles/quad1200.toml");
        let catalogue = Catalogue::new(&VehicleParams::from_toml_str(text).unwrap(), true);
        let explanation = |effect: EffectId| {
            let is_it = |hypothesis: &usize| catalogue.hypotheses[*hypothesis].effect == effect;
            let hypothesis = (0..catalogue.hypotheses.len()).find(is_it).unwrap();
            let number = catalogue.hypotheses[hypothesis].numbers[0];
            let mut values = catalogue.references();
            values[number] += 0.2 * catalogue.numbers[number].magnitude;
            let fit = Fit {
                hypotheses: vec![hypothesis],
                deviation: vec![0.0; values.len()],
                values,
                joint: nalgebra::DMatrix::default(),
                evidence: 0.0,
                cost: 0.0,
                power: Vec::new(),
            };
            Explanation { fit, evidence: 0.0, blocks: Vec::new() }
        };
        let found = [EffectId::Mass, EffectId::ThrustCurve].map(explanation);
        let mass = EffectAnswer {
            id: EffectId::Mass,
            probability: 0.45,
            parameters: BTreeMap::new(),
            intervals: BTreeMap::new(),
            deviations: BTreeMap::new(),
        };
        let answer = Answer {
            effects: vec![mass],
            ambiguous_with: vec![EffectId::ThrustCurve],
            ..Answer::data_fault(Vec::new())
        };
        let live = explanations(&catalogue, &found, &answer);
        let names: Vec<_> = live.iter().flat_map(LiveHypothesis::names).collect();
        assert_eq!(names, ["mass", "thrust_curve"]);
    }
}
