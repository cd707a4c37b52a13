//! One answer against the key.

use std::collections::BTreeMap;

use serde::Serialize;
use sitl::effects::ParameterValue;

use super::answer::{Given, NAMED, class_of};
use super::case::Kind;
use super::condition::Condition;
use super::key::{KeyEntry, TrueEffect};

/// A wrong name from this probability on does harm.
const CONFIDENT: f64 = 0.8;
/// Relative errors count up to this.
const ERROR_MAX: f64 = 10.0;
/// Parameters that are compared, by effect; those of one group as one vector.
const SCORED: [(&str, &[&[&str]]); 22] = [
    ("thrust_scale", &[&["scale"]]),
    ("mass", &[&["mass_kg"]]),
    ("thrust_curve", &[&["a"]]),
    ("battery_sag", &[&["exponent"]]),
    ("rotor_loss", &[&["scale"]]),
    ("motor_lag", &[&["tau_s"]]),
    ("command_delay", &[&["delay_s"]]),
    ("rotor_drag", &[&["d_xy"]]),
    ("parasitic_drag", &[&["cda_m2"]]),
    ("wind", &[&["north_m_s", "east_m_s"]]),
    ("gusts", &[&["sigma_m_s"]]),
    ("ground_effect", &[&["r_eff_m"]]),
    ("translational_lift", &[&["k_s2_m2"]]),
    ("blade_flapping", &[&["moment_Nms_m"], &["tilt_rad_s_m"]]),
    ("vortex_ring", &[&["loss_max"]]),
    ("inertia", &[&["scale"]]),
    ("com_offset", &[&["x_m", "y_m"]]),
    ("rotor_gyroscopic", &[&["rotor_inertia_kgm2"]]),
    ("yaw_torque", &[&["scale"]]),
    ("attitude_trim", &[&["roll_rad", "pitch_rad"]]),
    ("estimator_latency", &[&["latency_s"]]),
    ("pd_gain", &[&["kp_scale"], &["kd_scale"]]),
];

/// How one case went.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Its name.
    pub case: String,
    /// What it asked.
    pub kind: Kind,
    /// State of its logs.
    pub condition: Condition,
    /// The true effects.
    pub truth: Vec<String>,
    /// Classes of effects that are right to name.
    pub right: Vec<String>,
    /// How strongly they show.
    pub ratio: f64,
    /// The right verdict.
    pub right_verdict: String,
    /// The verdict given; `missing` without an answer.
    pub verdict: String,
    /// Every effect of the answer with its probability.
    pub probabilities: Vec<(String, f64)>,
    /// What cannot be told from it, by the answer.
    pub ambiguous_with: Vec<String>,
    /// Whether the most probable effect is true.
    pub top_right: bool,
    /// Whether a true effect is named or among at most two that cannot be told apart.
    pub in_set: bool,
    /// Whether it names a true effect alone, without ambiguity.
    pub is_definite: bool,
    /// Whether every true effect, and whether nothing else, is named.
    pub all_named: bool,
    /// Nothing else is named.
    pub exact: bool,
    /// In a trap: whether the answer admits what the flights cannot tell.
    pub trap_right: bool,
    /// A wrong effect that the answer is confident of.
    pub confidently_wrong: Option<String>,
    /// Sum over effects of (probability - truth)^2.
    pub brier: f64,
    /// Relative errors of the true effects' parameters.
    pub errors: BTreeMap<String, Vec<f64>>,
    /// Of the 90 % intervals of true effects, which hold the truth.
    pub covered: BTreeMap<String, Vec<bool>>,
    /// The closure that the answer claims.
    pub claimed_closure: Option<f64>,
    /// What the named effects close of what the true ones do.
    pub true_closure: Option<f64>,
    /// The finding, or what went wrong.
    pub finding: String,
    /// Time that the diagnosis took, s.
    pub seconds: f64,
}

impl Row {
    /// Scores an answer; an error stands for none.
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
        // What the catalogue lacks is not to be found.
        let findable: &[TrueEffect] = if key.without.is_empty() { &key.effects } else { &[] };
        let truth: Vec<String> = findable.iter().map(|effect| class_of(&effect.id)).collect();
        let also: Vec<String> = key.also_right.iter().map(|id| class_of(id)).collect();
        let is_true = |id: &String| truth.contains(id) || also.contains(id);
        let says_effect = verdict == "effect";
        let named: Vec<&String> =
            probabilities.iter().filter(|(_, p)| *p >= NAMED).map(|(id, _)| id).collect();
        let top = probabilities.first().map(|(id, _)| id).filter(|_| says_effect);
        let mut set: Vec<&String> = top.into_iter().chain(&ambiguous).collect();
        set.sort_unstable();
        set.dedup();
        let top_right = top.is_some_and(is_true);
        let (mut errors, mut covered) = (BTreeMap::new(), BTreeMap::new());
        if let (Ok(given), true) = (given, says_effect) {
            for effect in findable {
                if effect.parameters.is_empty() {
                    continue;
                }
                if let Some(found) = estimate(given, effect, key.nominal_mass_kg) {
                    errors.insert(effect.id.clone(), relative_errors(effect, &found));
                }
                covered.insert(effect.id.clone(), coverage(given, effect));
            }
        }
        Self {
            case: case.to_owned(),
            kind: key.kind,
            condition: key.condition,
            truth: truth_in_words(key),
            right: truth.iter().chain(&also).cloned().collect(),
            ratio: key.snr.ratio,
            right_verdict: key.verdict.clone(),
            top_right,
            in_set: says_effect && set.len() <= 2 && set.iter().any(|id| is_true(id)),
            is_definite: top_right && ambiguous.is_empty(),
            all_named: says_effect && truth.iter().all(|id| named.contains(&id)),
            exact: says_effect && named.len() == truth.len() && named.iter().all(|id| is_true(id)),
            confidently_wrong: probabilities
                .iter()
                .find(|(id, p)| says_effect && *p > CONFIDENT && !is_true(id))
                .map(|(id, _)| id.clone()),
            trap_right: trap_right(key, given.ok(), &set, &named),
            brier: match key.hides_its_effect() {
                true => brier(&probabilities, &[], &truth),
                false => brier(&probabilities, &truth, &also),
            },
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

    /// Whether an effect of the answer is a true one.
    pub fn is_right(&self, id: &str) -> bool {
        self.right.iter().any(|right| right == id)
    }

    /// Whether the verdict is the right one.
    pub fn verdict_right(&self) -> bool {
        self.verdict == self.right_verdict
    }

    /// Whether the answer admits that it does not know: unknown, or several that cannot be told
    /// apart and none with confidence.
    pub fn admits_ignorance(&self) -> bool {
        let unsure = self.probabilities.iter().all(|(_, p)| *p <= CONFIDENT);
        self.verdict == "unknown" || !self.ambiguous_with.is_empty() && unsure
    }
}

fn truth_in_words(key: &KeyEntry) -> Vec<String> {
    let foreign = key.foreign.as_ref().map(|foreign| format!("({})", foreign.name()));
    key.effects.iter().map(|effect| effect.id.clone()).chain(foreign).collect()
}

/// In a trap that confounds, the right answer is a set that holds the truth and what looks like it,
/// or that these logs cannot show it. Where the effect is hidden the right answer is none, and to
/// name it by luck is no harm.
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

/// Where an effect has several right names, the best of them counts; to name what is right `also`
/// where nothing must be named is no harm.
fn brier(probabilities: &[(String, f64)], truth: &[String], also: &[String]) -> f64 {
    let of =
        |id: &String| probabilities.iter().find(|(other, _)| other == id).map_or(0.0, |(_, p)| *p);
    let also_given: f64 = also.iter().map(of).sum();
    let right: f64 = truth.iter().map(|id| (1.0 - (of(id) + also_given).min(1.0)).powi(2)).sum();
    let wrong: f64 = probabilities
        .iter()
        .filter(|(id, _)| !truth.contains(id) && !also.contains(id))
        .map(|(_, p)| p * p)
        .sum();
    right + wrong
}

type Parameters = BTreeMap<String, ParameterValue>;

/// The answer's parameters of a true effect, under its true name.
fn estimate(given: &Given, truth: &TrueEffect, nominal_mass: f64) -> Option<Parameters> {
    let found = given.effect(&truth.id)?;
    if found.id == truth.id {
        return Some(found.parameters.clone());
    }
    let (from, to) = match truth.id.as_str() {
        "mass" => ("scale", "mass_kg"),
        _ => ("mass_kg", "scale"),
    };
    let ParameterValue::Number(value) = found.parameters.get(from)? else { return None };
    let value = ParameterValue::Number(nominal_mass / value);
    Some(Parameters::from([(to.to_owned(), value)]))
}

fn numbers(values: &Parameters, name: &str) -> Vec<f64> {
    match values.get(name) {
        Some(ParameterValue::Number(number)) => vec![*number],
        Some(ParameterValue::Vector(numbers)) => numbers.clone(),
        None => Vec::new(),
    }
}

/// |estimate - true| / |true - neutral| of each group of parameters.
fn relative_errors(truth: &TrueEffect, found: &Parameters) -> Vec<f64> {
    let groups = SCORED.iter().find(|(id, _)| *id == truth.id).map_or(&[][..], |(_, g)| g);
    let same_rotor = numbers(found, "rotor") == numbers(&truth.parameters, "rotor");
    groups
        .iter()
        .filter_map(|group| {
            let (mut off, mut size) = (0.0, 0.0);
            for name in *group {
                let right = numbers(&truth.parameters, name);
                let neutral = numbers(&truth.neutral, name);
                let mut estimate = numbers(found, name);
                if estimate.len() == 1 {
                    estimate.resize(right.len(), estimate[0]);
                }
                if estimate.len() != right.len() || neutral.len() != right.len() {
                    return Some(ERROR_MAX);
                }
                for ((estimate, right), neutral) in estimate.iter().zip(&right).zip(&neutral) {
                    off += (estimate - right).powi(2);
                    size += (right - neutral).powi(2);
                }
            }
            let error = (off / size).sqrt();
            let error = if same_rotor { error } else { error.max(1.0) };
            // A group that is not off its neutral value has no relative error.
            (size > 0.0).then(|| if error.is_finite() { error.min(ERROR_MAX) } else { ERROR_MAX })
        })
        .collect()
}

/// Of the intervals that the answer gives for a true effect under its own name, which hold it.
fn coverage(given: &Given, truth: &TrueEffect) -> Vec<bool> {
    let Some(found) = given.effects.iter().find(|effect| effect.id == truth.id) else {
        return Vec::new();
    };
    found
        .intervals
        .iter()
        .filter_map(|(name, [low, high])| {
            let (name, component) = match name.split_once('[') {
                Some((name, rest)) => (name, rest.trim_end_matches(']').parse().ok()?),
                None => (name.as_str(), 0),
            };
            let right = *numbers(&truth.parameters, name).get(component)?;
            Some((*low..=*high).contains(&right))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
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
    fn who_does_not_name_what_flights_hide_is_sure_of_nothing_wrong() {
        let key = key(Kind::Trap, &[("vortex_ring", r#"{"loss_max":0.2}"#, r#"{"loss_max":0}"#)]);
        let none = row(&key, r#"{"verdict":"none","effects":[]}"#);
        assert!(none.trap_right && none.brier == 0.0);
        let by_luck = r#"{"verdict":"effect","effects":[{"id":"vortex_ring","probability":0.9}]}"#;
        assert_eq!(row(&key, by_luck).brier, 0.0);
        let other = r#"{"verdict":"effect","effects":[{"id":"wind","probability":0.9}]}"#;
        assert!((row(&key, other).brier - 0.81).abs() < 1e-12);
    }

    #[test]
    fn equivalent_name_is_right_and_its_number_is_converted() {
        let key = key(Kind::Single, &[("mass", r#"{"mass_kg":1.5}"#, r#"{"mass_kg":1.2}"#)]);
        let row = row(
            &key,
            r#"{"verdict":"effect","effects":[
            {"id":"thrust_scale","probability":0.95,"parameters":{"scale":0.8}}]}"#,
        );
        assert!(row.top_right && row.errors["mass"][0] < 1e-9, "{row:?}");
    }

    #[test]
    fn wrong_name_with_confidence_is_told_from_ambiguity() {
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
    fn effect_that_the_catalogue_lacks_is_right_to_name_by_nobody() {
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
    fn trap_wants_the_truth_beside_what_looks_like_it() {
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
}
