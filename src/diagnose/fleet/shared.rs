//! Decides which effects the type has: weighs sets of effects on the fleet, with a vehicle as a
//! block.

use std::collections::BTreeSet;

use crate::diagnose::fleet::mixture::{
    Fitted, Member, Normal, Quadratic, Width, alone, fit, values_of, without,
};
use crate::diagnose::fleet::survey::{Survey, Surveyed, SurveyedNumber};
use crate::diagnose::verdict::evidence::{Evidence, Explained, Found};
use crate::diagnose::verdict::{NAMED, decide};

/// Least probability at which the type has an effect, rather than a group.
const TYPE_PROBABILITY_MIN: f64 = 0.75;
/// Least probability at which a vehicle follows its type, or belongs to a group.
const MEMBER_PROBABILITY_MIN: f64 = 0.5;
/// Most effects of a type, and most groups.
const EFFECTS_MAX: usize = 3;
const GROUPS_MAX: usize = 4;
/// Fewest vehicles of a group: two may just have similar damage.
const GROUP_MIN: usize = 3;

/// An effect over the fleet.
#[derive(Clone, Debug, PartialEq)]
pub struct Cause {
    /// Key of its hypothesis: the effect's id, and the rotor for rotor_loss.
    pub key: String,
    /// Probability that it acts.
    pub probability: f64,
    /// Probability that the type has it, if it acts.
    pub type_probability: f64,
    /// Its numbers.
    pub numbers: Vec<CauseNumber>,
    /// Probability that each vehicle has the cause.
    pub has: Vec<f64>,
    /// Estimates of the numbers from each vehicle's own flights, with standard deviations.
    pub own: Vec<Option<Vec<[f64; 2]>>>,
    /// Effects that would explain the fleet as well.
    pub ambiguous_with: Vec<String>,
}

/// A number of a cause.
#[derive(Clone, Debug, PartialEq)]
pub struct CauseNumber {
    /// The number's description.
    pub number: SurveyedNumber,
    /// The fleet's value, in the number's unit.
    pub value: f64,
    /// Its standard deviation.
    pub deviation: f64,
    /// Standard deviation of the vehicles about it.
    pub spread: f64,
}

impl Cause {
    /// The effect's id.
    pub fn effect(&self) -> &str {
        self.numbers.first().map_or(self.key.as_str(), |of| of.number.effect.as_str())
    }

    /// The fleet's values of its numbers.
    pub fn values(&self) -> Vec<f64> {
        self.numbers.iter().map(|number| number.value).collect()
    }
}

/// The effects of a fleet that are decided so far.
#[derive(Clone, Debug, Default)]
pub struct Fleet {
    /// Effects of the type.
    pub shared: Vec<Cause>,
    /// Effects of a part of the vehicles.
    pub groups: Vec<Cause>,
    /// Effects of too few vehicles to decide whether the type has them.
    pub open: Vec<Cause>,
    /// The type's values.
    base: Option<Fitted>,
}

impl Fleet {
    /// Decides on surveys made beside the type's effects so far. Returns whether to survey the
    /// vehicles again, beside one more effect of the type.
    pub fn update(&mut self, surveys: &[&Survey]) -> bool {
        (self.groups, self.open) = (Vec::new(), Vec::new());
        let base = self.base.as_ref().map_or_else(
            || Normal { mean: Vec::new(), deviation: Vec::new() },
            |fitted| fitted.of_type.clone(),
        );
        let alone: Vec<[f64; 2]> = surveys.iter().map(|survey| alone(survey, &base)).collect();
        let mut kept: BTreeSet<usize> = (0..surveys.len()).collect();
        while kept.len() > 1 && self.groups.len() < GROUPS_MAX {
            let Some((set, cause)) = self.best(surveys, &alone, &kept) else { break };
            let members: Vec<usize> =
                kept.iter().copied().filter(|v| cause.has[*v] > MEMBER_PROBABILITY_MIN).collect();
            if cause.type_probability >= TYPE_PROBABILITY_MIN {
                self.shared.push(cause);
                self.refresh(&set.fitted);
                self.base = Some(set.fitted);
                return self.shared.len() < EFFECTS_MAX;
            }
            if members.is_empty() {
                break;
            }
            kept.retain(|vehicle| !members.contains(vehicle));
            if members.len() >= GROUP_MIN {
                self.groups.push(cause);
            } else {
                self.open.push(cause);
            }
        }
        false
    }

    /// Updates the type's numbers after the newest effect.
    fn refresh(&mut self, fitted: &Fitted) {
        let numbers = self.shared.iter_mut().flat_map(|cause| &mut cause.numbers);
        for (at, number) in numbers.enumerate() {
            let magnitude = number.number.magnitude;
            number.value = number.number.reference + magnitude * fitted.of_type.mean[at];
            number.deviation = magnitude * fitted.error[at];
            number.spread = magnitude * fitted.of_type.deviation[at];
        }
    }

    /// The effect that the verdict rests on, beside the type's so far, among the vehicles `kept`.
    fn best(
        &self,
        surveys: &[&Survey],
        alone: &[[f64; 2]],
        kept: &BTreeSet<usize>,
    ) -> Option<(Set, Cause)> {
        let prefix: Vec<&str> = self.shared.iter().map(|cause| cause.key.as_str()).collect();
        let keys: BTreeSet<&str> = surveys
            .iter()
            .flat_map(|survey| &survey.beside)
            .filter_map(|set| set.keys.last().map(String::as_str))
            .collect();
        let sets: Vec<Set> = keys
            .into_iter()
            .filter_map(|key| self.set(surveys, alone, kept, &prefix, key))
            .collect();
        // The type's effects so far are the file of this round.
        let nothing = kept.iter().map(|v| without(alone[*v])).collect();
        let nothing = Explained { blocks: nothing, ..Explained::default() };
        let explanations: Vec<Explained> =
            std::iter::once(nothing).chain(sets.iter().map(|set| set.explained.clone())).collect();
        let most = |is: &dyn Fn(&Survey) -> bool| {
            2 * kept.iter().filter(|v| is(surveys[**v])).count() >= kept.len()
        };
        let evidence = Evidence {
            scale: 1.0,
            fitted_blocks: kept.len(),
            explanations,
            voltage_differs: most(&|survey| survey.voltage_differs),
            outputs_logged: most(&|survey| survey.outputs_logged),
            ..Evidence::default()
        };
        let decision = decide(&evidence);
        let index = decision.explanation.checked_sub(1)?;
        let set = sets.into_iter().nth(index)?;
        let key = set.key.clone();
        let effect = set.numbers.first()?.effect.clone();
        let (_, probability) = *decision
            .effects
            .iter()
            .find(|(id, probability)| *id == effect && *probability >= NAMED)?;
        let count = set.numbers.len();
        let first = count - set.newest;
        let number = |i: usize| CauseNumber {
            number: set.numbers[i].clone(),
            value: set.value(i),
            deviation: set.numbers[i].magnitude * set.fitted.error[i],
            spread: set.numbers[i].magnitude * set.fitted.of_type.deviation[i],
        };
        let mut has = vec![0.0; surveys.len()];
        for (vehicle, states) in kept.iter().zip(&set.fitted.states) {
            has[*vehicle] = states[0];
        }
        let own = surveys.iter().map(|survey| {
            let own = newest(survey, &prefix, &key)?;
            let values = values_of(own).into_iter().zip(&own.numbers).skip(first);
            Some(
                values
                    .map(|([m, d], n)| [n.reference + n.magnitude * m, n.magnitude * d])
                    .collect(),
            )
        });
        let cause = Cause {
            probability,
            type_probability: set.fitted.type_probability,
            numbers: (first..count).map(number).collect(),
            has,
            own: own.collect(),
            ambiguous_with: decision.ambiguous_with,
            key,
        };
        Some((set, cause))
    }

    /// The type's effects with one more, fitted over the fleet.
    fn set(
        &self,
        surveys: &[&Survey],
        alone: &[[f64; 2]],
        kept: &BTreeSet<usize>,
        prefix: &[&str],
        key: &str,
    ) -> Option<Set> {
        let survey_of = |v: &usize| newest(surveys[*v], prefix, key);
        let mut numbers = kept.iter().find_map(survey_of)?.numbers.clone();
        for (i, number) in numbers.iter_mut().enumerate() {
            // The channels of a log add to a tolerance, by a different amount for each vehicle.
            let all = kept.iter().filter_map(|v| survey_of(v)?.numbers.get(i));
            let (sum, count) =
                all.fold((0.0, 0.0), |(sum, n), other| (sum + other.unremarkable, n + 1.0));
            number.unremarkable = sum / f64::max(count, 1.0);
        }
        let newest = numbers.iter().filter(|number| number.key == key).count();
        let first = numbers.len() - newest;
        let widths: Vec<Width> = numbers
            .iter()
            .enumerate()
            .map(|(i, n)| Width { tolerance: n.unremarkable / n.magnitude, is_base: i < first })
            .collect();
        let members: Vec<Member> = kept
            .iter()
            .map(|v| {
                let set = survey_of(v).filter(|set| set.mean.len() == numbers.len());
                let [file, own] = alone[*v];
                Member { set: set.and_then(Quadratic::of), file, own }
            })
            .collect();
        let starts: Vec<Vec<f64>> = kept
            .iter()
            .filter_map(survey_of)
            .map(|set| set.mean.clone())
            .filter(|mean| mean.len() == numbers.len())
            .collect();
        let fitted = fit(&members, &widths, &starts)?;
        let found = numbers.iter().enumerate().skip(first).map(|(i, number)| {
            let value = number.reference + number.magnitude * fitted.of_type.mean[i];
            let near = 1e-3 * number.magnitude;
            let [low, high] = number.bounds;
            let is_absent = number.absent.is_some_and(|absent| (value - absent).abs() < near);
            let off = (value - number.reference).abs() > near;
            Found {
                effect: number.effect.clone(),
                name: number.name.clone(),
                value,
                deviation: number.magnitude * fitted.error[i],
                reference: number.reference,
                unremarkable: number.unremarkable,
                magnitude: number.magnitude,
                is_at_bound: off && !is_absent && (value - low < near || high - value < near),
            }
        });
        let explained = Explained {
            effects: vec![effect_of(key).to_owned()],
            numbers: found.collect(),
            blocks: fitted.blocks.clone(),
            ..Explained::default()
        };
        Some(Set { key: key.to_owned(), numbers, newest, fitted, explained })
    }
}

/// A set of effects, fitted over the fleet.
struct Set {
    key: String,
    numbers: Vec<SurveyedNumber>,
    /// Number of the newest effect's numbers, which come last.
    newest: usize,
    fitted: Fitted,
    explained: Explained,
}

impl Set {
    /// The fleet's value of a number.
    fn value(&self, number: usize) -> f64 {
        let of = &self.numbers[number];
        of.reference + of.magnitude * self.fitted.of_type.mean[number]
    }
}

/// The effect of a hypothesis' key.
pub fn effect_of(key: &str) -> &str {
    key.split(' ').next().unwrap_or(key)
}

/// A vehicle's survey of the type's effects with `key` beside them.
fn newest<'a>(survey: &'a Survey, prefix: &[&str], key: &str) -> Option<&'a Surveyed> {
    survey.beside.iter().find(|set| {
        let keys = set.keys.iter().map(String::as_str);
        keys.eq(prefix.iter().copied().chain(std::iter::once(key)))
    })
}
