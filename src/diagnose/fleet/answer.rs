//! The answer on a fleet: what `diagnose --fleet --json` prints and its report shows.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet, Slots};

use crate::diagnose::answer::{Answer, FullVerdict};
use crate::diagnose::catalogue::hypothesis::reference;
use crate::diagnose::fleet::shared::{Cause, Fleet};
use crate::diagnose::fleet::survey::Survey;
use crate::diagnose::likelihood::fit::interval;
use crate::diagnose::verdict::calibration::Calibration;
use crate::diagnose::verdict::parameter::{Parameter, parameters};

/// A vehicle has a cause as others do from this probability on, and lacks it below the other.
const HAS: f64 = 0.5;
/// The mean of a number over the fleet is worth a word from so many tolerances on.
const MENTIONED: f64 = 0.7;

/// What a vehicle was found to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Nothing beyond what the type has.
    AsType,
    /// What a group of the vehicles has.
    Group,
    /// An effect of its own.
    Own,
    /// One of several effects of its own; its flights do not tell which.
    Ambiguous,
    /// A gap that no effect explains.
    Unknown,
    /// Its logs are at fault.
    Faulty,
    /// It could not be diagnosed.
    Unusable,
}

/// An effect that one vehicle has beyond its type.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct OwnEffect {
    /// Its id.
    pub id: String,
    /// Probability that the vehicle has it, 0..1.
    pub probability: f64,
    /// The vehicle's values, absolute.
    pub parameters: BTreeMap<String, serde_json::Value>,
    /// 90 % intervals of the fitted numbers.
    pub intervals: BTreeMap<String, [f64; 2]>,
}

/// A vehicle of the fleet.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct VehicleAnswer {
    /// Its name.
    pub name: String,
    /// What it was found to be.
    pub state: State,
    /// Effects with a probability of a half or more, the most probable first.
    pub effects: Vec<OwnEffect>,
    /// Effects that cannot be told from these.
    pub ambiguous_with: Vec<String>,
    /// Why, in a sentence.
    pub sentence: String,
    /// The gap on its flights held out against the type's file, in units of the noise, and with its
    /// own effects.
    pub gap: [Option<f64>; 2],
    /// Effects that its logs cannot show.
    pub not_testable: Vec<String>,
    /// What is at fault in its logs.
    pub faults: Vec<String>,
}

impl VehicleAnswer {
    /// One that could not be diagnosed, or whose logs are at fault.
    pub fn unusable(name: &str, sentence: String, faults: Vec<String>) -> Self {
        Self {
            name: name.to_owned(),
            state: if faults.is_empty() { State::Unusable } else { State::Faulty },
            effects: Vec::new(),
            ambiguous_with: Vec::new(),
            sentence,
            gap: [None; 2],
            not_testable: Vec::new(),
            faults,
        }
    }

    /// What the diagnosis of its flights against the type's file says.
    pub fn of(name: &str, answer: &Answer, faults: Vec<String>) -> Self {
        let effects: Vec<OwnEffect> = answer
            .named()
            .map(|effect| OwnEffect {
                id: effect.id.name().to_owned(),
                probability: effect.probability,
                parameters: effect
                    .parameters
                    .iter()
                    .filter_map(|(name, value)| {
                        Some(((*name).to_owned(), serde_json::to_value(value).ok()?))
                    })
                    .collect(),
                intervals: effect.intervals.clone(),
            })
            .collect();
        let state = match answer.finding.verdict {
            FullVerdict::Named | FullVerdict::OtherLaw if !effects.is_empty() => State::Own,
            FullVerdict::Ambiguous if !effects.is_empty() => State::Ambiguous,
            FullVerdict::None | FullVerdict::NotTestable => State::AsType,
            FullVerdict::DataFault => State::Faulty,
            _ => State::Unknown,
        };
        Self {
            name: name.to_owned(),
            state,
            effects,
            ambiguous_with: answer.ambiguous_with.iter().map(|id| id.name().to_owned()).collect(),
            sentence: answer.finding.sentence.clone(),
            gap: [
                answer.gap.as_ref().map(|gap| gap.times(gap.before)),
                answer.gap.as_ref().map(|gap| gap.times(gap.after)),
            ],
            not_testable: answer.not_testable.iter().map(|of| of.id.name().to_owned()).collect(),
            faults,
        }
    }
}

/// A vehicle's own value of a number, whatever the others have.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct OwnValue {
    /// The vehicle.
    pub vehicle: String,
    /// By its flights alone.
    pub value: f64,
    /// 90 % interval.
    pub interval: [f64; 2],
    /// Probability that it has the cause as the fleet does.
    pub has: f64,
}

/// A number of a cause over the fleet.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct FleetNumber {
    /// Its name within the effect.
    pub name: String,
    /// The fleet's value.
    pub value: f64,
    /// 90 % interval of that.
    pub interval: [f64; 2],
    /// Standard deviation of the vehicles about it.
    pub spread: f64,
    /// As the vehicle file has it.
    pub file: f64,
    /// The values that the vehicles' own flights give.
    pub vehicles: Vec<OwnValue>,
}

/// An effect that several vehicles have.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct CauseAnswer {
    /// The effect.
    pub id: String,
    /// Probability that it acts, 0..1.
    pub probability: f64,
    /// Probability that nearly every vehicle of the type has it, rather than a part of them.
    pub of_type: f64,
    /// Its parameters, absolute.
    pub parameters: BTreeMap<&'static str, Parameter>,
    /// Its fitted numbers.
    pub numbers: Vec<FleetNumber>,
    /// The vehicles that have it.
    pub vehicles: Vec<String>,
    /// Effects that would do as well in its place.
    pub ambiguous_with: Vec<String>,
}

/// A number of the vehicle file within its tolerance, over the fleet.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct CommonNumber {
    /// Its name.
    pub name: String,
    /// Mean over the vehicles.
    pub mean: f64,
    /// Standard error of the mean.
    pub error: f64,
    /// Standard deviation of the vehicles.
    pub spread: f64,
    /// As the file has it, or the logs say directly.
    pub expected: f64,
    /// By how many tolerances the mean is off.
    pub tolerances: f64,
}

/// The answer.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct FleetAnswer {
    /// In a sentence or two.
    pub sentence: String,
    /// Vehicles whose flights were looked at.
    pub looked_at: usize,
    /// What the type has beyond its file.
    pub shared: Vec<CauseAnswer>,
    /// What a part of the vehicles has in common.
    pub groups: Vec<CauseAnswer>,
    /// What a few vehicles have in common, too few to tell whether it is the type's.
    pub open: Vec<CauseAnswer>,
    /// Numbers of the file that the vehicles have off in common, within the tolerances.
    pub file_numbers: Vec<CommonNumber>,
    /// How good the vehicle file is: the scale of the tolerances that it does not state.
    pub file_scale: f64,
    /// Every vehicle.
    pub vehicles: Vec<VehicleAnswer>,
}

/// The effects of causes over a vehicle file.
pub fn effects_of(vehicle: &VehicleParams, causes: &[Cause]) -> EffectSet {
    let mut effects = EffectSet::new();
    for cause in causes {
        let Ok(id) = cause.effect().parse::<EffectId>() else { continue };
        let mut slots = Slots::default();
        for slot in id.spec().slots() {
            slots[slot.index] = reference(vehicle, id, slot.index);
        }
        for number in &cause.numbers {
            slots[number.number.slot] = number.value;
        }
        if id == EffectId::RotorLoss {
            let rotor = cause.key.split(' ').nth(1).and_then(|rotor| rotor.parse::<u8>().ok());
            slots[0] = f64::from(rotor.unwrap_or_default());
        }
        // A number outside of the accepted range leaves the file's in force.
        let _ = effects.insert(id, slots);
    }
    effects
}

impl CauseAnswer {
    /// Of a cause, over the vehicles of these names.
    pub fn of(cause: &Cause, vehicle: &VehicleParams, names: &[&str]) -> Self {
        let calibration = Calibration::shipped();
        let set = effects_of(vehicle, std::slice::from_ref(cause));
        let id = cause.effect().parse::<EffectId>();
        let numbers = cause.numbers.iter().enumerate().map(|(i, number)| {
            let off = number.value - number.number.reference;
            let of_vehicle = |(v, name): (usize, &&str)| {
                let [value, deviation] = *cause.own.get(v)?.as_ref()?.get(i)?;
                Some(OwnValue {
                    vehicle: (*name).to_owned(),
                    value,
                    interval: interval(value, deviation),
                    has: cause.has.get(v).copied().unwrap_or_default(),
                })
            };
            FleetNumber {
                name: number.number.name.clone(),
                value: number.value,
                interval: interval(number.value, calibration.deviation(number.deviation, off)),
                spread: number.spread,
                file: number.number.reference,
                vehicles: names.iter().enumerate().filter_map(of_vehicle).collect(),
            }
        });
        let has = names.iter().zip(&cause.has).filter(|(_, has)| **has > HAS);
        Self {
            id: cause.effect().to_owned(),
            probability: cause.probability,
            of_type: cause.whole,
            parameters: id.map_or_else(|_| BTreeMap::new(), |id| parameters(&set, id)),
            numbers: numbers.collect(),
            vehicles: has.map(|(name, _)| (*name).to_owned()).collect(),
            ambiguous_with: cause.ambiguous_with.clone(),
        }
    }

    /// 90 % intervals of the fleet's values, by name.
    pub fn intervals(&self) -> BTreeMap<String, [f64; 2]> {
        self.numbers.iter().map(|number| (number.name.clone(), number.interval)).collect()
    }
}

/// The numbers of the vehicle file that the fleet has off in common.
fn file_numbers(surveys: &[&Survey]) -> Vec<CommonNumber> {
    let mut by_name: BTreeMap<&str, Vec<[f64; 3]>> = BTreeMap::new();
    for number in surveys.iter().flat_map(|survey| &survey.file) {
        let all = by_name.entry(&number.name).or_default();
        all.push([number.value, number.expected, number.tolerances]);
    }
    let of_one = |(name, all): (&str, Vec<[f64; 3]>)| {
        let n = all.len() as f64;
        let mean = |of: usize| all.iter().map(|values| values[of]).sum::<f64>() / n;
        let square: f64 = all.iter().map(|values| (values[0] - mean(0)).powi(2)).sum();
        let spread = (square / (n - 1.0).max(1.0)).sqrt();
        CommonNumber {
            name: name.to_owned(),
            mean: mean(0),
            error: spread / n.sqrt(),
            spread,
            expected: mean(1),
            tolerances: mean(2),
        }
    };
    let mut numbers: Vec<CommonNumber> = by_name
        .into_iter()
        .filter(|(_, all)| all.len() > 2)
        .map(of_one)
        .filter(|number| {
            number.tolerances.abs() > MENTIONED
                && (number.mean - number.expected).abs() > 3.0 * number.error
        })
        .collect();
    numbers.sort_by(|a, b| b.tolerances.abs().total_cmp(&a.tolerances.abs()));
    numbers
}

impl FleetAnswer {
    /// Of what was decided; `looked_at` are the vehicles that the fleet's causes are told by, by name and
    /// last survey, and `vehicles` all of them. The sentence is still to be written.
    pub fn new(
        fleet: &Fleet,
        vehicle: &VehicleParams,
        looked_at: &[(&str, &Survey)],
        scale: f64,
        mut vehicles: Vec<VehicleAnswer>,
    ) -> Self {
        let names: Vec<&str> = looked_at.iter().map(|(name, _)| *name).collect();
        let surveys: Vec<&Survey> = looked_at.iter().map(|(_, survey)| *survey).collect();
        let told = |causes: &[Cause]| -> Vec<CauseAnswer> {
            causes.iter().map(|cause| CauseAnswer::of(cause, vehicle, &names)).collect()
        };
        let groups = told(&fleet.groups);
        for vehicle in
            vehicles.iter_mut().filter(|v| matches!(v.state, State::Own | State::Ambiguous))
        {
            let is_groups = |effect: &OwnEffect| {
                groups.iter().any(|g| g.id == effect.id && g.vehicles.contains(&vehicle.name))
            };
            if vehicle.effects.iter().all(is_groups) {
                vehicle.state = State::Group;
            }
        }
        Self {
            sentence: String::new(),
            looked_at: looked_at.len(),
            shared: told(&fleet.shared),
            groups,
            open: told(&fleet.open),
            file_numbers: file_numbers(&surveys),
            file_scale: scale,
            vehicles,
        }
    }

    /// How many vehicles are in a state.
    pub fn count(&self, state: State) -> usize {
        self.vehicles.iter().filter(|vehicle| vehicle.state == state).count()
    }
}
