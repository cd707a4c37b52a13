//! Scores one answer against the key.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::answer::{Given, NAMED, class_of};
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
        given: Result<&Given, &str>,
        true_closure: Option<f64>,
        seconds: f64,
    ) -> Self {
        let verdict = given.map_or("missing", |given| given.verdict.as_str()).to_owned();
        let probabilities = given.map(Given::probabilities).unwrap_or_default();
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
        let deviations: Vec<String> = match given {
            Ok(given) => given
                .effects
                .iter()
                .filter(|effect| !is_true(&class_of(&effect.id)))
                .filter(|effect| is_deviation(effect, key))
                .map(|effect| class_of(&effect.id))
                .collect(),
            Err(_) => Vec::new(),
        };
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
        let (mut errors, mut covered) = (BTreeMap::new(), BTreeMap::new());
        if let (Ok(given), true) = (given, names_effect) {
            for effect in findable {
                if effect.parameters.is_empty() {
                    continue;
                }
                if let Some(found) = estimate(given, effect, key.nominal_mass_kg) {
                    let TrueEffect { id, parameters, neutral, .. } = effect;
                    errors.insert(id.clone(), relative_errors(id, parameters, neutral, &found));
                }
                covered.insert(effect.id.clone(), coverage(given, effect));
            }
        }
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
            truth: truth_in_words(key),
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

fn truth_in_words(key: &KeyEntry) -> Vec<String> {
    let foreign = key.foreign.as_ref().map(|foreign| format!("({})", foreign.name()));
    key.effects.iter().map(|effect| effect.id.clone()).chain(foreign).collect()
}

/// For a trap that confuses effects, a right answer lists the truth with an effect that looks like
/// it, or says that these logs cannot show it. For a trap that hides its effect, the right answer
/// is none, and naming the effect by luck does no harm.
fn trap_right(key: &KeyEntry, given: Option<&Given>, set: &[&String], named: &[&String]) -> bool {
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
mod tests {
    use super::*;
    use crate::exam::deviations::Deviation;
    use crate::exam::deviations::Parameters;
    use crate::exam::strength::Strength;

    fn parameters(text: &str) -> Parameters {
        serde_json::from_str(text).expect("parameters")
    }

    fn key(kind: Kind, effects: &[(&str, &str, &str)]) -> KeyEntry {
        let effects = effects.iter().map(|(id, truth, neutral)| TrueEffect {
            id: (*id).to_owned(),
            parameters: parameters(truth),
            neutral: parameters(neutral),
            ratio: 5.0,
        });
        KeyEntry {
            kind,
            condition: Condition::Plain,
            file: FileKind::Claimed,
            on_board: LoopKind::Pd,
            outputs_hz: 100.0,
            deviations: Vec::new(),
            beyond_tolerances: vec![Some(4.0)],
            ratio_beyond_file: Some(5.0),
            is_practical: true,
            verdict: "effect".to_owned(),
            effects: effects.collect(),
            also_right: Vec::new(),
            candidates: Vec::new(),
            foreign: None,
            without: Vec::new(),
            snr: Strength { ratio: 5.0, channel: String::new() },
            is_weak: false,
            nominal_mass_kg: 1.2,
            tags: Vec::new(),
        }
    }

    fn row(key: &KeyEntry, answer: &str) -> Row {
        let given: Given = serde_json::from_str(answer).expect("an answer");
        Row::new("case", key, Ok(&given), None, 1.0)
    }

    #[test]
    fn right_effect_is_scored_by_its_numbers_and_intervals() {
        let key = key(
            Kind::Single,
            &[("wind", r#"{"north_m_s":3,"east_m_s":4}"#, r#"{"north_m_s":0,"east_m_s":0}"#)],
        );
        let row = row(
            &key,
            r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.9,
            "parameters":{"north_m_s":3.0,"east_m_s":3.5},
            "intervals":{"north_m_s":[2.9,3.1],"east_m_s":[3.4,3.6]}}]}"#,
        );
        assert!(row.top_right && row.in_set && row.is_definite && row.exact);
        assert!((row.errors["wind"][0] - 0.1).abs() < 1e-12);
        assert_eq!(row.covered["wind"], [false, true]);
        assert!((row.brier - 0.01).abs() < 1e-12);
    }

    #[test]
    fn undetectable_effect_may_go_unnamed_without_penalty() {
        let key = key(Kind::Trap, &[("vortex_ring", r#"{"loss_max":0.2}"#, r#"{"loss_max":0}"#)]);
        let none = row(&key, r#"{"verdict":"none","effects":[]}"#);
        assert!(none.trap_right && none.brier == 0.0);
        let by_luck = r#"{"verdict":"effect","effects":[{"id":"vortex_ring","probability":0.9}]}"#;
        assert_eq!(row(&key, by_luck).brier, 0.0);
        let other = r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.9}]}"#;
        assert!((row(&key, other).brier - 0.81).abs() < 1e-12);
    }

    #[test]
    fn equivalent_effect_is_right_and_its_number_converted() {
        let key = key(Kind::Single, &[("mass", r#"{"mass_kg":1.5}"#, r#"{"mass_kg":1.2}"#)]);
        let row = row(
            &key,
            r#"{"verdict":"effect","effects":[
            {"id":"thrust_scale","probability":0.95,"parameters":{"scale":0.8}}]}"#,
        );
        assert!(row.top_right && row.errors["mass"][0] < 1e-9, "{row:?}");
    }

    #[test]
    fn confident_wrong_name_is_distinguished_from_ambiguity() {
        let key = key(Kind::Single, &[("wind", "{}", "{}")]);
        let wrong = row(
            &key,
            r#"{"verdict":"effect",
            "effects":[{"id":"attitude_trim","probability":0.97}]}"#,
        );
        assert_eq!(wrong.confidently_wrong.as_deref(), Some("attitude_trim"));
        assert!(!wrong.in_set && !wrong.admits_ignorance());
        let unsure = row(
            &key,
            r#"{"verdict":"effect","ambiguous_with":["wind"],
            "effects":[{"id":"attitude_trim","probability":0.6}]}"#,
        );
        assert!(unsure.in_set && !unsure.top_right && unsure.admits_ignorance());
        assert!(unsure.confidently_wrong.is_none());
    }

    #[test]
    fn naming_an_effect_missing_from_the_catalogue_is_wrong() {
        let mut key = key(Kind::LeftOut, &[("wind", "{}", "{}")]);
        key.without = vec!["wind".to_owned()];
        key.verdict = "unknown".to_owned();
        let named =
            row(&key, r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.9}]}"#);
        assert_eq!(named.confidently_wrong.as_deref(), Some("wind"));
        let unknown = row(&key, r#"{"verdict":"unknown"}"#);
        assert!(unknown.verdict_right() && unknown.admits_ignorance() && unknown.brier == 0.0);
    }

    #[test]
    fn trap_requires_the_truth_among_the_candidates() {
        let mut key = key(Kind::Trap, &[("wind", "{}", "{}")]);
        key.candidates = ["wind", "attitude_trim"].map(str::to_owned).to_vec();
        let is_right = |answer: &str| row(&key, answer).trap_right;
        assert!(is_right(
            r#"{"verdict":"effect","ambiguous_with":["wind"],
            "effects":[{"id":"attitude_trim","probability":0.6}]}"#
        ));
        assert!(is_right(r#"{"verdict":"none","not_testable":[{"id":"wind"}]}"#));
        assert!(!is_right(r#"{"verdict":"none"}"#));
        assert!(!is_right(
            r#"{"verdict":"effect","ambiguous_with":["gusts"],
            "effects":[{"id":"wind","probability":0.9}]}"#
        ));
    }

    /// A mass 10 % above a file whose thrust and inertia are off.
    fn off_file(kind: Kind) -> KeyEntry {
        let deviation = |id: &str, is: &str, stated: &str| Deviation {
            id: id.to_owned(),
            parameters: parameters(is),
            neutral: parameters(stated),
            alternatives: Vec::new(),
            tolerances: Some(1.0),
        };
        let effects: &[_] = match kind {
            Kind::Null => &[],
            _ => &[("mass", r#"{"mass_kg":1.32}"#, r#"{"mass_kg":1.2}"#)],
        };
        let inertia = deviation("inertia", r#"{"scale":[1.08,1.0,0.95]}"#, r#"{"scale":[1,1,1]}"#);
        let verdict = if kind == Kind::Null { "none" } else { "effect" };
        KeyEntry { deviations: vec![inertia], verdict: verdict.to_owned(), ..key(kind, effects) }
    }

    #[test]
    fn deviation_is_acceptable_only_with_its_right_value() {
        let null = off_file(Kind::Null);
        let graded = |scale: &str, intervals: &str| {
            let effect = format!(
                r#"{{"id":"inertia","probability":0.9,"parameters":{{"scale":{scale}}}{intervals}}}"#
            );
            row(&null, &format!(r#"{{"verdict":"effect","effects":[{effect}]}}"#))
        };
        let right = graded("[1.07,1.01,0.96]", "");
        assert_eq!(right.grade, Grade::Acceptable);
        assert!(right.confidently_wrong.is_none() && right.brier == 0.0 && right.verdict_right());
        let wrong = graded("[1.3,1.01,0.96]", "");
        assert_eq!(wrong.grade, Grade::Wrong);
        assert_eq!(wrong.confidently_wrong.as_deref(), Some("inertia"));
        let wide =
            r#","intervals":{"scale[0]":[1.0,1.1],"scale[1]":[0.95,1.1],"scale[2]":[0.9,1.0]}"#;
        assert_eq!(graded("[1.05,1.04,0.95]", "").grade, Grade::Wrong);
        assert_eq!(graded("[1.05,1.04,0.95]", wide).grade, Grade::Acceptable);
        let unknown = row(&null, r#"{"verdict":"unknown"}"#);
        assert!(unknown.grade == Grade::Wrong && !unknown.verdict_right());
    }

    #[test]
    fn truth_with_a_deviation_is_right_otherwise_mixed() {
        let case = off_file(Kind::Single);
        let mass = r#"{"id":"mass","probability":0.95,"parameters":{"mass_kg":1.3}}"#;
        let inertia = r#"{"id":"inertia","probability":0.97,"parameters":{"scale":[1.08,1,0.95]}}"#;
        let wind = r#"{"id":"wind","probability":0.7}"#;
        let graded =
            |effects: &str| row(&case, &format!(r#"{{"verdict":"effect","effects":[{effects}]}}"#));
        assert_eq!(graded(mass).grade, Grade::Right);
        let both = graded(&format!("{mass},{inertia}"));
        assert!(both.grade == Grade::Acceptable && both.top_right && both.exact, "{both:?}");
        let mixed = graded(&format!("{mass},{wind}"));
        assert_eq!(
            (mixed.grade, mixed.false_named.as_slice()),
            (Grade::Mixed, &["wind".to_owned()][..])
        );
        assert_eq!(graded(wind).grade, Grade::Wrong);
        assert_eq!(row(&case, r#"{"verdict":"unknown"}"#).grade, Grade::Missed);
    }

    #[test]
    fn naming_or_none_is_right_below_the_practical_size() {
        let case = KeyEntry { is_practical: false, ..off_file(Kind::Single) };
        let mass = r#"{"verdict":"effect","effects":[{"id":"mass","probability":0.8}]}"#;
        assert_eq!(row(&case, r#"{"verdict":"none"}"#).grade, Grade::Right);
        assert_eq!(row(&case, mass).grade, Grade::Right);
        let wind = r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.8}]}"#;
        assert_eq!(row(&case, wind).grade, Grade::Wrong);
    }
}
