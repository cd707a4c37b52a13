//! Scores one answer against the key.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::answer::{GivenAnswer, GivenEffect, NAMED, class_of};
use super::condition::Condition;
use super::estimate::{coverage, estimate, is_deviation, relative_errors};
use super::grade::{Grade, Stated, grade};
use super::key::{KeyEntry, TrueEffect};
use super::order::Kind;
use super::world::{FileKind, LoopKind};

/// Probability above which a wrong effect is harmful.
const CONFIDENT: f64 = 0.8;
/// The law of a case's truth.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize, Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// No truth.
    Null,
    /// A law of the catalogue.
    Catalogue,
    /// Another law, for a cause in the catalogue.
    Other,
    /// A law that the diagnosis lacks.
    Unknown,
}

impl Law {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Null => "nothing",
            Self::Catalogue => "catalogue",
            Self::Other => "other law",
            Self::Unknown => "unknown",
        }
    }

    fn of(kind: Kind) -> Self {
        match kind {
            Kind::Null => Self::Null,
            Kind::OtherLaw => Self::Other,
            Kind::LeftOut | Kind::Foreign => Self::Unknown,
            _ => Self::Catalogue,
        }
    }
}

/// The score of one case.
#[derive(Clone, Debug, JsonSchema, Serialize, Deserialize)]
pub struct Row {
    /// The case's name.
    pub case: String,
    /// The kind of question that it asks.
    pub kind: Kind,
    /// Condition of its logs.
    pub condition: Condition,
    /// The law of its truth.
    pub law: Law,
    /// Quality of its vehicle file.
    pub file: FileKind,
    /// The loop on board.
    pub on_board: LoopKind,
    /// Rate of the logged outputs, Hz.
    pub outputs_hz: f64,
    /// Whether its effects are of practical size, so that an answer should name them.
    pub is_practical: bool,
    /// Grade of the answer against the key.
    pub grade: Grade,
    /// Named deviations of the vehicle file with the right values.
    pub deviations_named: Vec<String>,
    /// Named effects that are false.
    pub false_named: Vec<String>,
    /// Ids of the true effects; in parentheses, a disturbance or law outside the catalogue.
    pub truth: Vec<String>,
    /// Classes of effects that are right to name.
    pub right: Vec<String>,
    /// Classes of the answer's effects that are real deviations of the vehicle file with the right
    /// values.
    pub deviations: Vec<String>,
    /// Strength of the true effects, as a ratio over noise.
    pub ratio: f64,
    /// The right verdict.
    pub right_verdict: String,
    /// The verdict of the answer; `missing` without an answer.
    pub verdict: String,
    /// Every class of effects in the answer, with its probability.
    pub probabilities: Vec<(String, f64)>,
    /// Classes that the answer calls ambiguous with the named ones.
    pub ambiguous_with: Vec<String>,
    /// Whether the most probable effect is true, apart from deviations of the file.
    pub top_right: bool,
    /// Whether the most probable effect and the ambiguous ones are at most two, one of them true.
    pub in_set: bool,
    /// Whether the most probable effect is true, and none is ambiguous with it.
    pub is_definite: bool,
    /// Whether every true effect is named.
    pub all_named: bool,
    /// Whether every true effect is named, and nothing false.
    pub exact: bool,
    /// For a trap: whether the answer admits what the flights do not distinguish.
    pub trap_right: bool,
    /// A false effect that is named with a probability above 0.8, or without the truth among the
    /// ambiguous effects.
    pub confidently_wrong: Option<String>,
    /// Sum over effects of (probability - truth)^2.
    pub brier: f64,
    /// Relative errors of the true effects' parameters, by effect.
    pub errors: BTreeMap<String, Vec<f64>>,
    /// Whether each 90 % interval of the true effects contains the truth, by effect.
    pub covered: BTreeMap<String, Vec<bool>>,
    /// The closure that the answer claims.
    pub claimed_closure: Option<f64>,
    /// The closure of the truth that the real named effects reach.
    pub true_closure: Option<f64>,
    /// The finding, or the reason that there is none.
    pub finding: String,
    /// Duration of the diagnosis, s.
    pub seconds: f64,
}

impl Row {
    /// Scores an answer, or the error in its place.
    pub fn new(
        case: &str,
        key: &KeyEntry,
        given: Result<&GivenAnswer, &str>,
        true_closure: Option<f64>,
        seconds: f64,
    ) -> Self {
        let verdict = given.map_or("missing", |given| given.verdict.as_str()).to_owned();
        let probabilities = given.map(GivenAnswer::probabilities).unwrap_or_default();
        let ambiguous: Vec<String> = given.map_or_else(
            |_| Vec::new(),
            |given| given.ambiguous_with.iter().map(|id| class_of(id)).collect(),
        );
        // Effects outside the catalogue cannot be found.
        let findable: &[TrueEffect] = if key.without.is_empty() { &key.effects } else { &[] };
        let truth: Vec<String> = findable.iter().map(|effect| class_of(&effect.id)).collect();
        let also: Vec<String> = key.also_right.iter().map(|id| class_of(id)).collect();
        let is_true = |id: &String| truth.contains(id) || also.contains(id);
        let names_effect = verdict == "effect";
        let given_effects: &[GivenEffect] = match given {
            Ok(given) => &given.effects,
            Err(_) => &[],
        };
        let deviations: Vec<String> = given_effects
            .iter()
            .filter(|effect| !is_true(&class_of(&effect.id)) && is_deviation(effect, key))
            .map(|effect| class_of(&effect.id))
            .collect();
        let is_there = |id: &String| is_true(id) || deviations.contains(id);
        let named: Vec<&String> =
            probabilities.iter().filter(|(_, p)| *p >= NAMED).map(|(id, _)| id).collect();
        // An answer `effect` that names nothing asserts its first effect.
        let first = probabilities.first().map(|(id, _)| id).filter(|_| named.is_empty());
        let asserted: Vec<&String> =
            named.iter().copied().chain(first).filter(|_| names_effect).collect();
        let false_named: Vec<String> =
            asserted.iter().filter(|id| !is_there(id)).map(|id| (*id).clone()).collect();
        let deviations_named: Vec<String> =
            asserted.iter().filter(|id| deviations.contains(id)).map(|id| (*id).clone()).collect();
        let top = probabilities
            .iter()
            .map(|(id, _)| id)
            .find(|id| !deviations.contains(id))
            .filter(|_| names_effect);
        let mut set: Vec<&String> = top.into_iter().chain(&ambiguous).collect();
        set.sort_unstable();
        set.dedup();
        let top_right = top.is_some_and(is_true);
        let admits = ambiguous.iter().any(is_true);
        let confidently_wrong = probabilities
            .iter()
            .filter(|(id, _)| false_named.contains(id))
            .find(|(_, p)| *p > CONFIDENT || !admits)
            .map(|(id, _)| id.clone());
        let trap_right = trap_right(key, given.ok(), &set, &named);
        let found = asserted.iter().filter(|id| is_true(id)).count();
        let grade = grade(&Stated {
            key,
            verdict: &verdict,
            trap_right,
            found,
            expected: truth.len(),
            first: asserted.first().is_some_and(|id| is_true(id)),
            is_false: !false_named.is_empty(),
            is_deviation: !deviations_named.is_empty(),
            admits: admits && false_named.len() <= 1 && confidently_wrong.is_none(),
        });
        let Estimates { errors, covered } = match given {
            Ok(given) if names_effect => Estimates::of(given, findable, key.nominal_mass_kg),
            _ => Estimates::default(),
        };
        Self {
            case: case.to_owned(),
            kind: key.kind,
            condition: key.condition,
            law: Law::of(key.kind),
            file: key.file,
            on_board: key.on_board,
            outputs_hz: key.outputs_hz,
            is_practical: key.is_practical,
            grade,
            truth: truth_text(key),
            right: truth.iter().chain(&also).cloned().collect(),
            ratio: key.snr.ratio,
            right_verdict: key.verdict.clone(),
            top_right,
            in_set: names_effect && set.len() <= 2 && set.iter().any(|id| is_true(id)),
            is_definite: top_right && ambiguous.is_empty(),
            all_named: names_effect && truth.iter().all(|id| named.contains(&id)),
            exact: names_effect && found == truth.len() && false_named.is_empty(),
            confidently_wrong,
            trap_right,
            brier: match key.hides_its_effect() {
                true => brier(&probabilities, &[], &truth, &deviations),
                false => brier(&probabilities, &truth, &also, &deviations),
            },
            deviations_named,
            false_named,
            deviations,
            errors,
            covered,
            claimed_closure: given.ok().and_then(|given| given.gap?.closure()),
            true_closure,
            finding: given.map_or_else(str::to_owned, |given| given.finding.sentence.clone()),
            seconds,
            verdict,
            probabilities,
            ambiguous_with: ambiguous,
        }
    }

    /// Whether an effect of the answer is real: a true one, or a deviation of the vehicle file.
    pub fn is_right(&self, id: &str) -> bool {
        self.right.iter().chain(&self.deviations).any(|right| right == id)
    }

    /// Whether the verdict is right.
    pub fn verdict_right(&self) -> bool {
        self.verdict == self.right_verdict || self.kind == Kind::Null && self.grade.is_good()
    }

    /// Whether the answer admits ignorance: unknown, or several ambiguous effects and none with
    /// confidence.
    pub fn admits_ignorance(&self) -> bool {
        let unsure = self.probabilities.iter().all(|(_, p)| *p <= CONFIDENT);
        self.verdict == "unknown" || !self.ambiguous_with.is_empty() && unsure
    }
}

/// An answer's parameters against the truth, by effect.
#[derive(Default)]
struct Estimates {
    /// Relative errors.
    errors: BTreeMap<String, Vec<f64>>,
    /// Whether each 90 % interval contains the truth.
    covered: BTreeMap<String, Vec<bool>>,
}

impl Estimates {
    fn of(given: &GivenAnswer, truth: &[TrueEffect], nominal_mass_kg: f64) -> Self {
        let mut estimates = Self::default();
        for effect in truth.iter().filter(|effect| !effect.parameters.is_empty()) {
            let TrueEffect { id, parameters, neutral, .. } = effect;
            if let Some(found) = estimate(given, effect, nominal_mass_kg) {
                let errors = relative_errors(id, parameters, neutral, &found);
                estimates.errors.insert(id.clone(), errors);
            }
            estimates.covered.insert(id.clone(), coverage(given, effect));
        }
        estimates
    }
}

fn truth_text(key: &KeyEntry) -> Vec<String> {
    let foreign = key.foreign.as_ref().map(|foreign| format!("({})", foreign.name()));
    key.effects.iter().map(|effect| effect.id.clone()).chain(foreign).collect()
}

/// For a trap that confuses effects, a right answer lists the truth with an effect that looks like
/// it, or says that these logs cannot show it. For a trap that hides its effect, the right answer
/// is none, and naming the effect by luck does no harm.
fn trap_right(
    key: &KeyEntry,
    given: Option<&GivenAnswer>,
    set: &[&String],
    named: &[&String],
) -> bool {
    let Some(given) = given else { return false };
    let truth: Vec<String> = key.effects.iter().map(|effect| class_of(&effect.id)).collect();
    let is_truth = |id: &String| truth.contains(id);
    match given.verdict.as_str() {
        "none" if key.hides_its_effect() => true,
        "none" => given.not_testable.iter().any(|effect| is_truth(&class_of(&effect.id))),
        "effect" if key.hides_its_effect() => named.iter().all(|id| is_truth(id)),
        "effect" => {
            let candidates: Vec<String> = key.candidates.iter().map(|id| class_of(id)).collect();
            set.iter().any(|id| is_truth(id))
                && set.iter().any(|id| candidates.contains(id) && !is_truth(id))
        }
        _ => false,
    }
}

/// Where an effect has several right names, they count together. Naming an effect of `also`, or a
/// real deviation of the vehicle file, costs nothing.
fn brier(
    probabilities: &[(String, f64)],
    truth: &[String],
    also: &[String],
    deviations: &[String],
) -> f64 {
    let of =
        |id: &String| probabilities.iter().find(|(other, _)| other == id).map_or(0.0, |(_, p)| *p);
    let also_given: f64 = also.iter().map(of).sum();
    let right: f64 = truth.iter().map(|id| (1.0 - (of(id) + also_given).min(1.0)).powi(2)).sum();
    let wrong: f64 = probabilities
        .iter()
        .filter(|(id, _)| ![truth, also, deviations].into_iter().any(|ids| ids.contains(id)))
        .map(|(_, p)| p * p)
        .sum();
    right + wrong
}

#[cfg(test)]
mod tests;
