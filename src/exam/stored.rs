//! Stored evidence of a case with its key and answer, to score another decision without new flights
//! or fits.

use serde::{Deserialize, Serialize};

use super::answer::{GivenAnswer, GivenEffect, GivenGap};
use super::key::KeyEntry;
use super::order::Kind;
use super::score::Row;
use super::world::LoopKind;
use crate::diagnose::likelihood::fit::interval;
use crate::diagnose::verdict::calibration::Calibration;
use crate::diagnose::verdict::decide_with;
use crate::diagnose::verdict::evidence::{Evidence, Explained};

/// A case as `exam --evidence` writes it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StoredCase {
    /// The case's name.
    pub case: String,
    /// The right answer.
    pub key: KeyEntry,
    /// The evidence of the verdict; `None` without a diagnosis, or with data at fault.
    pub evidence: Option<Evidence>,
    /// The answer, or the reason that there is none.
    pub answer: Result<GivenAnswer, String>,
    /// The true closure of the answer.
    pub true_closure: Option<f64>,
    /// Duration of the diagnosis, s.
    pub seconds: f64,
}

impl StoredCase {
    /// Whether it belongs to the families for testing a calibration rather than fitting it:
    /// cascades on board with logged setpoints, outputs at 250 Hz, and other laws for the same
    /// cause.
    pub fn is_for_testing(&self) -> bool {
        let KeyEntry { kind, on_board, outputs_hz, .. } = &self.key;
        *kind == Kind::OtherLaw || *on_board == LoopKind::Cascade || *outputs_hz > 200.0
    }

    /// The case with a new decision, scored.
    pub fn row(&self, calibration: &Calibration) -> Row {
        let answer = self.answer.as_ref().map_err(String::as_str);
        let decided = answer
            .ok()
            .and_then(|given| Some(decided(given, self.evidence.as_ref()?, calibration)));
        let is_same = decided.as_ref().zip(answer.ok()).is_some_and(|(new, old)| {
            let ids = |given: &GivenAnswer| -> Vec<String> {
                given.effects.iter().map(|effect| effect.id.clone()).collect()
            };
            ids(new) == ids(old)
        });
        let closure = self.true_closure.filter(|_| is_same || decided.is_none());
        let given = decided.as_ref().map_or(answer, Ok);
        Row::new(&self.case, &self.key, given, closure, self.seconds)
    }
}

/// The answer after a new decision on the evidence. An effect that was named before keeps its
/// numbers and intervals; others have those of the fit to the flights for fitting.
fn decided(given: &GivenAnswer, evidence: &Evidence, calibration: &Calibration) -> GivenAnswer {
    let decision = decide_with(evidence, calibration);
    let explained = evidence.explanations.get(decision.explanation);
    let effect = |(id, probability): &(String, f64)| {
        let old = given.effects.iter().find(|effect| effect.id == *id);
        let known = old.cloned().or_else(|| Some(as_fitted(explained?, id)));
        let known = known.unwrap_or_else(|| GivenEffect { id: id.clone(), ..Default::default() });
        let widened = |(name, [low, high]): (&String, &[f64; 2])| {
            let numbers = &explained?.numbers;
            let number = numbers.iter().find(|n| n.effect == *id && n.name == *name)?;
            let (value, fitted) = (0.5 * (low + high), *known.deviations.get(name)?);
            let deviation = calibration.deviation(fitted, value - number.reference);
            Some((name.clone(), interval(value, deviation)))
        };
        let intervals = known.intervals.iter().filter_map(widened).collect();
        GivenEffect { probability: *probability, intervals, ..known }
    };
    let gap = explained.and_then(|explained| {
        let (before, after) = (evidence.shipped[1]?, explained.reported?.effects);
        Some(GivenGap { before, after, floor: 1.0 })
    });
    GivenAnswer {
        verdict: decision.verdict.name().to_owned(),
        effects: decision.effects.iter().map(effect).collect(),
        gap: gap.or(given.gap),
        ambiguous_with: decision.ambiguous_with.clone(),
        ..given.clone()
    }
}

/// An effect of an explanation with its fitted numbers and their 90 % intervals.
fn as_fitted(explained: &Explained, id: &str) -> GivenEffect {
    let own = explained.numbers.iter().filter(|number| number.effect == id);
    GivenEffect {
        id: id.to_owned(),
        probability: 0.0,
        parameters: explained.parameters.get(id).cloned().unwrap_or_default(),
        intervals: own.clone().map(|n| (n.name.clone(), interval(n.value, n.deviation))).collect(),
        deviations: own.map(|n| (n.name.clone(), n.deviation)).collect(),
    }
}
