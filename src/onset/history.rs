//! Change across flights by date: a value of each flight, tested against the scatter between
//! flights.

use schemars::JsonSchema;
use serde::Serialize;

use super::change::Estimate;
use super::columns::{DIRECTIONS, quantity};
use super::detector::Present;

/// Fewest flights for two groups and their scatter.
const FLIGHTS_MIN: usize = 4;
/// Significance level of a step, over all quantities and places.
const CHANCE: f64 = 0.01;
/// Steps of the numerical integral of Student's density.
const STEPS: usize = 2000;

/// An estimate from one flight.
#[derive(Clone, Copy, Debug)]
pub struct FlightValue {
    /// Difference from the file.
    pub value: f64,
    /// Standard deviation within the flight.
    pub deviation: f64,
}

/// A quantity that differs between the flights before one and those from it on.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Step {
    /// Name of the quantity, as for a change in flight.
    pub name: &'static str,
    /// The rotor, with index from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotor: Option<usize>,
    /// Its unit.
    pub unit: &'static str,
    /// Index of the first flight with the new value.
    pub from: usize,
    /// Mean of the flights before.
    pub before: Estimate,
    /// Mean of the flights from it on.
    pub after: Estimate,
    /// Probability of such a step by chance, anywhere and in any of the quantities.
    pub chance: f64,
}

/// Summary of a detector's estimates of the vehicle over a flight.
pub fn of_flight(looks: &[Present]) -> Option<[FlightValue; DIRECTIONS.len()]> {
    if looks.is_empty() {
        return None;
    }
    let count = looks.len() as f64;
    Some(std::array::from_fn(|direction| {
        let values = || looks.iter().map(|look| look[direction][0]);
        let value = values().sum::<f64>() / count;
        let own = looks.iter().map(|look| look[direction][1].powi(2)).sum::<f64>() / count;
        let spread = values().map(|v| (v - value).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
        FlightValue { value, deviation: (own.max(spread) / count).sqrt() }
    }))
}

/// The most significant step of each quantity between flights in date order, if it is significant:
/// a two-sample t test with pooled scatter, at least as large as the flights' own errors, with
/// Bonferroni correction for the places and quantities tested.
pub fn steps(flights: &[[FlightValue; DIRECTIONS.len()]]) -> Vec<Step> {
    let mut found: Vec<Step> = (0..DIRECTIONS.len())
        .filter_map(|direction| {
            let values: Vec<FlightValue> = flights.iter().map(|flight| flight[direction]).collect();
            step(&values, direction)
        })
        .collect();
    found.sort_by(|a, b| a.chance.total_cmp(&b.chance));
    found
}

fn step(values: &[FlightValue], direction: usize) -> Option<Step> {
    let count = values.len();
    if count < FLIGHTS_MIN {
        return None;
    }
    let own = values.iter().map(|value| value.deviation.powi(2)).sum::<f64>() / count as f64;
    let freedom = count - 2;
    let split = |from: usize| {
        let (a, b) = values.split_at(from);
        let mean = |part: &[FlightValue]| {
            part.iter().map(|value| value.value).sum::<f64>() / part.len() as f64
        };
        let (low, high) = (mean(a), mean(b));
        let squares = |part: &[FlightValue], mean: f64| {
            part.iter().map(|value| (value.value - mean).powi(2)).sum::<f64>()
        };
        let pooled = (squares(a, low) + squares(b, high)) / freedom as f64;
        let variance = pooled.max(own);
        let error = (variance * (1.0 / a.len() as f64 + 1.0 / b.len() as f64)).sqrt();
        ((high - low) / error, [low, high], variance, from)
    };
    let best = (1..count).map(split).max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))?;
    let (t, [before, after], variance, from) = best;
    let comparisons = ((count - 1) * DIRECTIONS.len()) as f64;
    let chance = (comparisons * two_sided(t, freedom as f64)).min(1.0);
    if chance.is_nan() || chance >= CHANCE {
        return None;
    }
    let (name, unit) = quantity(direction);
    let mean = |value: f64, of: usize| Estimate::normal([value, (variance / of as f64).sqrt()]);
    Some(Step {
        name,
        rotor: (1..=4).contains(&direction).then(|| direction - 1),
        unit,
        from,
        before: mean(before, from),
        after: mean(after, count - from),
        chance,
    })
}

/// Two-sided p-value of Student's t with `freedom` degrees of freedom: with t = sqrt(n) tan a, the
/// integral of cos(a)^(n - 1), which has no tail.
fn two_sided(t: f64, freedom: f64) -> f64 {
    let limit = (t.abs() / freedom.sqrt()).atan();
    let half = std::f64::consts::FRAC_PI_2;
    let integral = |from: f64, to: f64| {
        let step = (to - from) / STEPS as f64;
        let at = |k: usize| (from + (k as f64 + 0.5) * step).cos().powf(freedom - 1.0);
        (0..STEPS).map(at).sum::<f64>() * step
    };
    integral(limit, half) / integral(0.0, half)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn flights(rng: &mut Pcg64Mcg, count: usize, step: f64) -> Vec<[FlightValue; 10]> {
        (0..count)
            .map(|flight| {
                std::array::from_fn(|direction| {
                    let z: f64 = StandardNormal.sample(rng);
                    let by = if direction == 2 && flight >= 4 { step } else { 0.0 };
                    FlightValue { value: 0.01 * z + by, deviation: 0.002 }
                })
            })
            .collect()
    }

    #[test]
    fn step_is_located_with_the_stated_false_alarm_rate() {
        let mut rng = Pcg64Mcg::seed_from_u64(11);
        let found = steps(&flights(&mut rng, 9, -0.1));
        assert_eq!((found[0].from, found[0].rotor), (4, Some(1)), "{found:?}");
        assert!((found[0].after.value + 0.1).abs() < 0.02);
        let reported = (0..400).filter(|_| !steps(&flights(&mut rng, 7, 0.0)).is_empty()).count();
        assert!(reported <= 10, "{reported} of 400, where 1 % is stated");
    }

    #[test]
    fn student_t_tail_matches_tables() {
        for (t, freedom, expected) in [(2.776, 4.0, 0.05), (4.604, 4.0, 0.01), (12.706, 1.0, 0.05)]
        {
            assert!((two_sided(t, freedom) / expected - 1.0).abs() < 2e-3, "{t} {freedom}");
        }
    }
}
