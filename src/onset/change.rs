//! A change that was found.

use schemars::JsonSchema;
use serde::Serialize;

use super::columns::{Cause, Sizes, quantity};
use super::likelihood::Numbers;

/// Deviations to either side of a 90 % interval.
const WIDTH: f64 = 1.645;

/// Something that changed in a flight.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Change {
    /// When it began, s of the vehicle's clock.
    pub at_s: f64,
    /// 90 % interval of that, s.
    pub interval_s: [f64; 2],
    /// When the evidence passed the bound, s.
    pub alarmed_s: f64,
    /// What changed, most likely.
    pub cause: Cause,
    /// The rotor, counted as in the vehicle file from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotor: Option<usize>,
    /// Effects of the catalogue that act so.
    pub effects: Vec<&'static str>,
    /// Probability of that cause among those that were asked.
    pub probability: f64,
    /// The other causes that have a chance, the likeliest first.
    pub others: Vec<Other>,
    /// How much likelier a change makes the flight than none, nats.
    pub evidence: f64,
    /// What it was before and after.
    pub values: Vec<Value>,
}

/// Another cause.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Other {
    /// Which.
    pub cause: Cause,
    /// Its probability.
    pub probability: f64,
}

/// A number that changed; the vehicle file's is 0.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Value {
    /// `thrust` over weight and `rotor_thrust` as shares more than the file's, `centre_front`,
    /// `centre_right`, `force_north`, `force_east`, `drag`.
    pub name: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Before, with a 90 % interval.
    pub before: Estimate,
    /// After.
    pub after: Estimate,
    /// After less before.
    pub change: Estimate,
}

/// A number with its 90 % interval.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Its interval.
    pub interval: [f64; 2],
}

impl Estimate {
    /// Of a mean and a deviation.
    pub fn normal([value, deviation]: [f64; 2]) -> Self {
        Self { value, interval: [value - WIDTH * deviation, value + WIDTH * deviation] }
    }
}

impl Value {
    pub(super) fn of(numbers: &Numbers, sizes: &Sizes) -> Self {
        let (name, unit) = quantity(numbers.direction);
        let size = sizes.direction(numbers.direction);
        let estimate = |pair: [f64; 2]| Estimate::normal(pair.map(|number| number * size));
        Self {
            name,
            unit,
            before: estimate(numbers.before),
            after: estimate(numbers.after),
            change: estimate(numbers.change),
        }
    }
}
