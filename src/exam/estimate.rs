//! Compares an answer's numbers with the key's.

use vehicle::effects::{EffectId, ParameterValue};

use super::answer::{GivenAnswer, GivenEffect, class_of};
use super::deviations::Deviation;
use super::deviations::Parameters;
use super::key::{KeyEntry, TrueEffect};

/// Limit of relative errors.
const ERROR_MAX: f64 = 10.0;

/// A deviation of the vehicle file counts as right within this share of it, or if the answer's 90 %
/// interval, widened by this factor to about 99 %, contains it.
const RIGHT_SHARE: f64 = 0.35;
const INTERVAL_FACTOR: f64 = 1.6;

/// Whether an effect of an answer is a real deviation of the vehicle file with the right value.
pub(super) fn is_deviation(given: &GivenEffect, key: &KeyEntry) -> bool {
    let class = class_of(&given.id);
    let same = |deviation: &&Deviation| class_of(&deviation.id) == class;
    key.deviations.iter().filter(same).any(|deviation| {
        let Some(found) = converted(given, &deviation.id, key.nominal_mass_kg) else {
            return false;
        };
        let ways = std::iter::once(&deviation.parameters).chain(&deviation.alternatives);
        ways.into_iter().any(|way| {
            let errors = relative_errors(&deviation.id, way, &deviation.neutral, &found);
            let worst = errors.iter().copied().fold(0.0, f64::max);
            let is_nearer = !errors.is_empty() && worst < 1.0;
            is_nearer && (worst <= RIGHT_SHARE || intervals_contain(given, &deviation.id, way))
        })
    })
}

/// Whether the answer's widened intervals contain these values under the same id.
fn intervals_contain(given: &GivenEffect, id: &str, values: &Parameters) -> bool {
    if given.id != id || given.intervals.is_empty() {
        return false;
    }
    compared_parameters(id).iter().flatten().all(|name| {
        let values = numbers(values, name);
        values.iter().enumerate().all(|(place, value)| {
            let key =
                if values.len() > 1 { format!("{name}[{place}]") } else { (*name).to_owned() };
            given.intervals.get(&key).is_some_and(|[low, high]| {
                let (middle, half) =
                    (0.5 * (low + high), 0.5 * INTERVAL_FACTOR * (high - low).abs());
                (value - middle).abs() <= half
            })
        })
    })
}

/// The compared parameters; each group is one vector.
fn compared_parameters(id: &str) -> Vec<Vec<&'static str>> {
    id.parse::<EffectId>().map_or_else(|_| Vec::new(), |id| id.spec().judged())
}

/// The answer's parameters of a true effect, converted to its id.
pub(super) fn estimate(
    given: &GivenAnswer,
    truth: &TrueEffect,
    nominal_mass: f64,
) -> Option<Parameters> {
    converted(given.effect(&truth.id)?, &truth.id, nominal_mass)
}

/// An effect's parameters, converted to the id of an effect that acts alike.
fn converted(found: &GivenEffect, id: &str, nominal_mass: f64) -> Option<Parameters> {
    if found.id == id {
        return Some(found.parameters.clone());
    }
    let (from, to) = match id {
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
pub(super) fn relative_errors(
    id: &str,
    truth: &Parameters,
    neutral: &Parameters,
    found: &Parameters,
) -> Vec<f64> {
    let groups = compared_parameters(id);
    let same_rotor = numbers(found, "rotor") == numbers(truth, "rotor");
    groups
        .iter()
        .filter_map(|group| {
            let (mut off, mut size) = (0.0, 0.0);
            for name in group {
                let right = numbers(truth, name);
                let neutral = numbers(neutral, name);
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
            // A group with a neutral true value has no relative error.
            (size > 0.0).then(|| if error.is_finite() { error.min(ERROR_MAX) } else { ERROR_MAX })
        })
        .collect()
}

/// The parameter and the component that an interval's name refers to.
fn component_of(name: &str) -> Option<(&str, usize)> {
    Some(match name.split_once('[') {
        Some((name, rest)) => (name, rest.trim_end_matches(']').parse().ok()?),
        None => (name, 0),
    })
}

/// Whether each interval that the answer gives for a true effect under its id contains the truth.
pub(super) fn coverage(given: &GivenAnswer, truth: &TrueEffect) -> Vec<bool> {
    let Some(found) = given.effects.iter().find(|effect| effect.id == truth.id) else {
        return Vec::new();
    };
    found
        .intervals
        .iter()
        .filter_map(|(name, [low, high])| {
            let (name, component) = component_of(name)?;
            let right = *numbers(&truth.parameters, name).get(component)?;
            Some((*low..=*high).contains(&right))
        })
        .collect()
}
