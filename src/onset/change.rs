//! A detected change.

use schemars::JsonSchema;
use serde::Serialize;

use super::columns::{Cause, Sizes, quantity};
use super::likelihood::DirectionChange;

/// Standard deviations to either side of a 90 % interval.
const WIDTH: f64 = 1.645;

/// A change in a flight.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Change {
    /// Time of the onset, s of the vehicle's clock.
    pub at_s: f64,
    /// 90 % interval of the onset, s.
    pub interval_s: [f64; 2],
    /// Time at which the evidence passed the threshold, s.
    pub alarmed_s: f64,
    /// The most probable cause.
    pub cause: Cause,
    /// The rotor, with the vehicle file's index from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotor: Option<usize>,
    /// Effects of the catalogue that have this result.
    pub effects: Vec<&'static str>,
    /// Probability of that cause among those tested.
    pub probability: f64,
    /// The other causes with a notable probability, most probable first.
    pub others: Vec<Other>,
    /// Log Bayes factor of a change against none, nats.
    pub evidence: f64,
    /// The changed quantities, before and after.
    pub values: Vec<Value>,
}

/// An alternative cause.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Other {
    /// The cause.
    pub cause: Cause,
    /// Its probability.
    pub probability: f64,
}

/// A quantity that changed, relative to the vehicle file, whose value is 0.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Value {
    /// `thrust` over weight and `rotor_thrust` as fractions above the file's, `centre_front`,
    /// `centre_right`, `force_north`, `force_east`, `drag`.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Value before, with a 90 % interval.
    pub before: Estimate,
    /// Value after.
    pub after: Estimate,
    /// After minus before.
    pub change: Estimate,
}

/// A value with its 90 % interval.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct Estimate {
    /// The estimate.
    pub value: f64,
    /// Its 90 % interval.
    pub interval: [f64; 2],
}

impl Estimate {
    /// The estimate from a mean and a standard deviation.
    pub fn normal([value, deviation]: [f64; 2]) -> Self {
        Self { value, interval: [value - WIDTH * deviation, value + WIDTH * deviation] }
    }
}

impl Value {
    pub(super) fn of(change: &DirectionChange, sizes: &Sizes) -> Self {
        let (name, unit) = quantity(change.direction);
        let size = sizes.direction(change.direction);
        let estimate = |pair: [f64; 2]| Estimate::normal(pair.map(|number| number * size));
        Self {
            name,
            unit,
            before: estimate(change.before),
            after: estimate(change.after),
            change: estimate(change.change),
        }
    }
}
