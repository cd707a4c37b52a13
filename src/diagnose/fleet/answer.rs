//! The answer on a fleet: the data behind `diagnose --fleet --json` and its report.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet};

use crate::diagnose::answer::{Answer, FullVerdict};
use crate::diagnose::catalogue::reference::reference_slots;
use crate::diagnose::fleet::shared::{Cause, Fleet};
use crate::diagnose::fleet::survey::Survey;
use crate::diagnose::likelihood::fit::interval;
use crate::diagnose::verdict::calibration::Calibration;
use crate::diagnose::verdict::parameter::{Parameter, parameters};

/// Least probability at which a vehicle shares a cause.
const MEMBER_PROBABILITY_MIN: f64 = 0.5;
/// Least mean of a number over the fleet that the answer mentions, in tolerances.
const MENTIONED_TOLERANCES_MIN: f64 = 0.7;

/// The state of a vehicle relative to its type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Nothing beyond the type's effects.
    AsType,
    /// An effect that it shares with a group of the vehicles.
    Group,
    /// An effect of its own.
    Own,
    /// One of several effects of its own; its flights do not distinguish them.
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
    /// Its id in the catalogue.
    pub id: String,
    /// Probability that the effect acts on the vehicle, 0..1.
    pub probability: f64,
    /// Absolute values of its parameters on this vehicle, by name.
    pub parameters: BTreeMap<String, serde_json::Value>,
    /// 90 % intervals of the fitted numbers, by parameter (component).
    pub intervals: BTreeMap<String, [f64; 2]>,
}

/// A vehicle of the fleet.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct VehicleAnswer {
    /// Its name in the fleet.
    pub name: String,
    /// Its state relative to the type.
    pub state: State,
    /// Effects with a probability of a half or more, the most probable first.
    pub effects: Vec<OwnEffect>,
    /// Effects that its flights do not distinguish from these.
    pub ambiguous_with: Vec<String>,
    /// The reason for the state, in a sentence.
    pub sentence: String,
    /// The gap on its held-out flights against the type's file, in units of the floor: first as is,
    /// then with its own effects.
    pub gap: [Option<f64>; 2],
    /// Effects that its logs cannot show.
    pub not_testable: Vec<String>,
    /// Faults of its logs.
    pub faults: Vec<String>,
}

impl VehicleAnswer {
    /// A vehicle that could not be diagnosed (`sentence` says why), or whose logs have `faults`.
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

    /// The vehicle according to the diagnosis of its flights against the type's file.
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

/// A vehicle's own value of a number, estimated without the rest of the fleet.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct OwnValue {
    /// The vehicle's name.
    pub vehicle: String,
    /// Estimate from its flights alone.
    pub value: f64,
    /// 90 % interval.
    pub interval: [f64; 2],
    /// Probability that it has the cause that the fleet has.
    pub has: f64,
}

/// A number of a cause over the fleet.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct FleetNumber {
    /// Its name within the effect.
    pub name: String,
    /// The fleet's value.
    pub value: f64,
    /// 90 % interval of the fleet's value.
    pub interval: [f64; 2],
    /// Standard deviation of the vehicles about it.
    pub spread: f64,
    /// The vehicle file's value.
    pub file: f64,
    /// The estimates from each vehicle's own flights.
    pub vehicles: Vec<OwnValue>,
}

/// An effect that several vehicles have.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct CauseAnswer {
    /// The effect's id.
    pub id: String,
    /// Probability that it acts, 0..1.
    pub probability: f64,
    /// Probability that nearly every vehicle of the type has it, rather than some of them.
    pub of_type: f64,
    /// Absolute values of its parameters, by name.
    pub parameters: BTreeMap<&'static str, Parameter>,
    /// Its fitted numbers over the fleet.
    pub numbers: Vec<FleetNumber>,
    /// Names of the vehicles that have it.
    pub vehicles: Vec<String>,
    /// Effects that would explain the fleet as well.
    pub ambiguous_with: Vec<String>,
}

/// A number of the vehicle file within its tolerance, over the fleet.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct CommonNumber {
    /// Its name, after its effect's id where it belongs to one.
    pub name: String,
    /// Mean over the vehicles.
    pub mean: f64,
    /// Standard error of the mean.
    pub error: f64,
    /// Standard deviation of the vehicles.
    pub spread: f64,
    /// The file's value, or the one that the logs show directly.
    pub expected: f64,
    /// Distance of the mean from it, in tolerances.
    pub tolerances: f64,
}

/// The answer on a fleet.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct FleetAnswer {
    /// The finding in a sentence or two.
    pub sentence: String,
    /// Number of vehicles whose flights were used.
    pub looked_at: usize,
    /// Effects of the type beyond its file.
    pub shared: Vec<CauseAnswer>,
    /// Effects that some of the vehicles share.
    pub groups: Vec<CauseAnswer>,
    /// Effects that a few vehicles share, too few to decide whether the type has them.
    pub open: Vec<CauseAnswer>,
    /// Numbers of the file that are off by a common amount over the fleet, within the tolerances.
    pub file_numbers: Vec<CommonNumber>,
    /// Quality of the vehicle file: the scale of the tolerances that it does not state.
    pub file_scale: f64,
    /// Every vehicle, with its state.
    pub vehicles: Vec<VehicleAnswer>,
}

/// The effects of causes, with the file's values for all other numbers.
pub fn effects_of(vehicle: &VehicleParams, causes: &[Cause]) -> EffectSet {
    let mut effects = EffectSet::new();
    for cause in causes {
        let Ok(id) = cause.effect().parse::<EffectId>() else { continue };
        let mut slots = reference_slots(vehicle, id);
        for number in &cause.numbers {
            slots[number.number.slot] = number.value;
        }
        if id == EffectId::RotorLoss {
            let rotor = cause.key.split(' ').nth(1).and_then(|rotor| rotor.parse::<u8>().ok());
            slots[0] = f64::from(rotor.unwrap_or_default());
        }
        // A number outside the accepted range leaves the file's value in force.
        let _ = effects.insert(id, slots);
    }
    effects
}

impl CauseAnswer {
    /// Describes a cause over the vehicles with these names.
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
        let has = names.iter().zip(&cause.has).filter(|(_, has)| **has > MEMBER_PROBABILITY_MIN);
        Self {
            id: cause.effect().to_owned(),
            probability: cause.probability,
            of_type: cause.type_probability,
            parameters: id.map_or_else(|_| BTreeMap::new(), |id| parameters(&set, id)),
            numbers: numbers.collect(),
            vehicles: has.map(|(name, _)| (*name).to_owned()).collect(),
            ambiguous_with: cause.ambiguous_with.clone(),
        }
    }

    /// 90 % intervals of the fleet's values, by number.
    pub fn intervals(&self) -> BTreeMap<String, [f64; 2]> {
        self.numbers.iter().map(|number| (number.name.clone(), number.interval)).collect()
    }
}

/// The vehicle file's numbers that are off by a common amount over the fleet.
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
            number.tolerances.abs() > MENTIONED_TOLERANCES_MIN
                && (number.mean - number.expected).abs() > 3.0 * number.error
        })
        .collect();
    numbers.sort_by(|a, b| b.tolerances.abs().total_cmp(&a.tolerances.abs()));
    numbers
}

impl FleetAnswer {
    /// The answer for a decided fleet, without its sentence. `looked_at` holds the vehicles whose
    /// surveys decide the fleet's causes, by name with the last survey; `vehicles` holds all of
    /// them.
    pub fn new(
        fleet: &Fleet,
        vehicle: &VehicleParams,
        looked_at: &[(&str, &Survey)],
        scale: f64,
        mut vehicles: Vec<VehicleAnswer>,
    ) -> Self {
        let names: Vec<&str> = looked_at.iter().map(|(name, _)| *name).collect();
        let surveys: Vec<&Survey> = looked_at.iter().map(|(_, survey)| *survey).collect();
        let answers = |causes: &[Cause]| -> Vec<CauseAnswer> {
            causes.iter().map(|cause| CauseAnswer::of(cause, vehicle, &names)).collect()
        };
        let groups = answers(&fleet.groups);
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
            shared: answers(&fleet.shared),
            groups,
            open: answers(&fleet.open),
            file_numbers: file_numbers(&surveys),
            file_scale: scale,
            vehicles,
        }
    }

    /// Number of vehicles in a state.
    pub fn count(&self, state: State) -> usize {
        self.vehicles.iter().filter(|vehicle| vehicle.state == state).count()
    }
}
