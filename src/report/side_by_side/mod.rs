//! Flights in two groups, side by side: how far B differs from A, with what chance leaves open.

mod entry;
mod page;
mod statistics;

use std::collections::{BTreeMap, BTreeSet};

use schemars::JsonSchema;
use serde::Serialize;

use self::entry::Metric;
pub use self::entry::{Alignment, Entry};
use self::statistics::holm;
pub use self::statistics::{Sample, Test, Tested};

/// Facts by which flights are paired: what was flown, and its chance.
const TRAJECTORY: &str = "trajectory";
const SEED: &str = "seed";
/// Facts that differ from flight to flight by their nature.
const OF_ONE_FLIGHT: [&str; 3] = [SEED, "started", "run"];
/// A p-value below which a single number of many differs.
const SIGNIFICANT: f64 = 0.05;

/// How flights of A and B are paired.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pairing {
    /// By trajectory and seed where every flight has a partner, else by trajectory, else not.
    #[default]
    Auto,
    /// In the order that they were given.
    Order,
    /// Not at all.
    None,
}

/// Whether B is worse than A.
#[derive(Clone, Copy, Debug, PartialEq, Eq, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// By more than chance.
    Worse,
    /// The other way round.
    Better,
    /// Not by more than chance.
    NoDifference,
    /// There are too few flights to tell, or they have no error in common.
    Undecided,
}

/// Two groups of flights compared: the JSON of `compare`.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Comparison {
    /// `downwash.compare`.
    pub schema: &'static str,
    /// Version of this JSON.
    pub schema_version: u32,
    /// Logs of A, by their paths as given.
    pub a: Vec<String>,
    /// Logs of B, by their paths as given.
    pub b: Vec<String>,
    /// What the page's curves are laid along.
    pub alignment: Alignment,
    /// What flights were paired by; `null` where they were not.
    pub paired_by: Option<&'static str>,
    /// Pairs: places in A and B.
    pub pairs: Vec<[usize; 2]>,
    /// Whether B is worse than A, by the first of the differences.
    pub outcome: Outcome,
    /// In words.
    pub sentence: String,
    /// Numbers that all flights have. The first decides.
    pub differences: Vec<Difference>,
    /// What is not the same in A and B.
    pub facts: Vec<FactDifference>,
}

/// One number of the flights.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Difference {
    /// What it is.
    pub metric: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// Whether more of it is worse; `null` where it is only other.
    pub more_is_worse: Option<bool>,
    /// Flights of A.
    pub a: Sample,
    /// Flights of B.
    pub b: Sample,
    /// B less A; `null` of fewer than two flights, or pairs.
    pub tested: Option<Tested>,
    /// p-value among all of the table's, after Holm: below 0.05 it differs, whatever the others do.
    pub p_of_all: Option<f64>,
}

/// A fact that differs.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct FactDifference {
    /// Which.
    pub key: String,
    /// Its values in A, `missing` where a flight does not say.
    pub a: Vec<String>,
    /// And in B.
    pub b: Vec<String>,
    /// Whether flights of one group differ in it too: then it cannot be what parts A and B alone.
    pub varies_within: bool,
}

impl Difference {
    /// B less A as a share of A.
    pub fn relative(&self) -> Option<f64> {
        let difference = self.tested?.difference;
        (self.a.mean.abs() > 0.0).then(|| difference / self.a.mean.abs())
    }

    fn outcome(&self) -> Outcome {
        match (self.tested, self.more_is_worse) {
            (None, _) | (_, None) => Outcome::Undecided,
            (Some(tested), _) if !tested.is_more_than_chance() => Outcome::NoDifference,
            (Some(tested), Some(more_is_worse)) => match (tested.difference > 0.0) == more_is_worse
            {
                true => Outcome::Worse,
                false => Outcome::Better,
            },
        }
    }
}

impl Comparison {
    /// Compares flights of two groups.
    pub fn new(a: &[&Entry], b: &[&Entry], alignment: Alignment, pairing: Pairing) -> Self {
        let (paired_by, pairs) = pairs(a, b, pairing);
        let mut differences = differences(a, b, &pairs);
        let p: Vec<f64> = differences.iter().map(|d| d.tested.map_or(1.0, |t| t.p)).collect();
        for (difference, p) in differences.iter_mut().zip(holm(&p)) {
            difference.p_of_all = difference.tested.map(|_| p);
        }
        let first = differences.first().filter(|d| d.more_is_worse == Some(true));
        let outcome = first.map_or(Outcome::Undecided, Difference::outcome);
        let names = |entries: &[&Entry]| entries.iter().map(|entry| entry.log.clone()).collect();
        let sentence = sentence(outcome, first, [a.len(), b.len()], pairs.len());
        Self {
            schema: "downwash.compare",
            schema_version: 1,
            a: names(a),
            b: names(b),
            alignment,
            paired_by,
            pairs,
            outcome,
            sentence,
            differences,
            facts: facts(a, b),
        }
    }
}

/// The pairs, and what they were found by.
fn pairs(a: &[&Entry], b: &[&Entry], pairing: Pairing) -> (Option<&'static str>, Vec<[usize; 2]>) {
    match pairing {
        Pairing::None => return (None, Vec::new()),
        Pairing::Order if a.len() == b.len() => {
            return (Some("order"), (0..a.len()).map(|i| [i, i]).collect());
        }
        Pairing::Order => return (None, Vec::new()),
        Pairing::Auto => {}
    }
    let kinds: [(&'static str, &[&str]); 2] =
        [("trajectory and seed", &[TRAJECTORY, SEED]), ("trajectory", &[TRAJECTORY])];
    for (name, keys) in kinds {
        let named = |entries: &[&Entry]| -> Option<BTreeMap<Vec<String>, usize>> {
            let key =
                |entry: &Entry| keys.iter().map(|key| entry.facts.get(*key).cloned()).collect();
            let mut named = BTreeMap::new();
            for (place, entry) in entries.iter().enumerate() {
                let key: Option<Vec<String>> = key(entry);
                // Two of one name are no partner of anyone.
                if named.insert(key?, place).is_some() {
                    return None;
                }
            }
            Some(named)
        };
        let (Some(of_a), Some(of_b)) = (named(a), named(b)) else { continue };
        if of_a.len() > 1 && of_a.keys().eq(of_b.keys()) {
            return (
                Some(name),
                of_a.into_values().zip(of_b.into_values()).map(|(a, b)| [a, b]).collect(),
            );
        }
    }
    (None, Vec::new())
}

fn differences(a: &[&Entry], b: &[&Entry], pairs: &[[usize; 2]]) -> Vec<Difference> {
    let Some(first) = a.first() else { return Vec::new() };
    let in_all =
        |metric: &&Metric| a.iter().chain(b).all(|entry| entry.metrics.contains_key(metric));
    let of = |entries: &[&Entry], metric: &Metric| -> Vec<f64> {
        entries.iter().filter_map(|entry| entry.metrics.get(metric)).copied().collect()
    };
    let difference = |metric: &Metric| {
        let (of_a, of_b) = (of(a, metric), of(b, metric));
        let tested = match pairs {
            [] => Tested::unpaired(&of_a, &of_b),
            pairs => {
                let side = |values: &[f64], side: usize| -> Vec<f64> {
                    pairs.iter().filter_map(|pair| values.get(pair[side])).copied().collect()
                };
                Tested::paired(&side(&of_a, 0), &side(&of_b, 1))
            }
        };
        Some(Difference {
            metric: metric.name,
            unit: metric.unit,
            more_is_worse: metric.more_is_worse,
            a: Sample::of(&of_a)?,
            b: Sample::of(&of_b)?,
            tested,
            p_of_all: None,
        })
    };
    first.metrics.keys().filter(in_all).filter_map(difference).collect()
}

fn facts(a: &[&Entry], b: &[&Entry]) -> Vec<FactDifference> {
    let keys: BTreeSet<&String> = a.iter().chain(b).flat_map(|entry| entry.facts.keys()).collect();
    let values = |entries: &[&Entry], key: &String| -> Vec<String> {
        let value =
            |entry: &&Entry| entry.facts.get(key).map_or("missing", String::as_str).to_owned();
        entries.iter().map(value).collect::<BTreeSet<String>>().into_iter().collect()
    };
    let differs = |key: &&String| !OF_ONE_FLIGHT.contains(&key.as_str());
    let mut all: Vec<FactDifference> = keys
        .into_iter()
        .filter(differs)
        .map(|key| {
            let (a, b) = (values(a, key), values(b, key));
            let varies_within = a.len() > 1 || b.len() > 1;
            FactDifference { key: key.clone(), a, b, varies_within }
        })
        .filter(|fact| fact.a != fact.b)
        .collect();
    all.sort_by_key(|fact| fact.varies_within);
    all
}

fn sentence(
    outcome: Outcome,
    first: Option<&Difference>,
    [a, b]: [usize; 2],
    pairs: usize,
) -> String {
    let Some(first) = first else {
        return "The flights have no error in common to compare.".to_owned();
    };
    let name = first.metric;
    let Some(tested) = first.tested else {
        let (a_mean, b_mean) =
            (page::value(first.a.mean, first.unit), page::value(first.b.mean, first.unit));
        return format!(
            "{name}: {a_mean} in A, {b_mean} in B; {a} and {b} flights are too few to rule out \
             chance."
        );
    };
    let [by, low, high] = page::signed(&tested, first.unit);
    let how = match tested.test {
        Test::PairedT => format!("{pairs} pairs"),
        Test::WelchT => format!("{a} and {b} flights"),
    };
    let share =
        first.relative().map_or(String::new(), |share| format!(", {:+.0} %", 100.0 * share));
    let verdict = match outcome {
        Outcome::Worse => "B is worse than A",
        Outcome::Better => "B is better than A",
        _ => "No difference beyond chance",
    };
    format!("{verdict}: {name} {by}{share} (95 % interval {low} to {high}; {how}).")
}

impl Difference {
    /// Whether it stands among all of the table's.
    pub fn stands(&self) -> bool {
        self.p_of_all.is_some_and(|p| p < SIGNIFICANT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flight with this error, of a trajectory with a seed.
    fn entry(error: f64, trajectory: &str, seed: u32, law: &str) -> Entry {
        let facts = [
            (TRAJECTORY, trajectory.to_owned()),
            (SEED, seed.to_string()),
            ("law", law.to_owned()),
        ];
        let facts = facts.into_iter().map(|(key, value)| (key.to_owned(), value)).collect();
        Entry::constant(&format!("{law} {seed}"), error, facts)
    }

    fn compared(a: &[Entry], b: &[Entry]) -> Comparison {
        let borrowed = |entries: &[Entry]| -> Vec<Entry> { entries.to_vec() };
        let (a, b) = (borrowed(a), borrowed(b));
        let (a, b): (Vec<&Entry>, Vec<&Entry>) = (a.iter().collect(), b.iter().collect());
        Comparison::new(&a, &b, Alignment::Time, Pairing::Auto)
    }

    #[test]
    fn flights_of_one_seed_are_paired_and_small_differences_show() {
        let errors = [0.10, 0.25, 0.40, 0.18];
        let a: Vec<Entry> = (0..4).map(|i| entry(errors[i as usize], "circle", i, "lqr")).collect();
        let b: Vec<Entry> = (0..4)
            .rev()
            .map(|i| entry(errors[i as usize] + 0.01 + 1e-4 * f64::from(i), "circle", i, "other"))
            .collect();
        let comparison = compared(&a, &b);
        assert_eq!(comparison.paired_by, Some("trajectory and seed"));
        assert_eq!(comparison.pairs, [[0, 3], [1, 2], [2, 1], [3, 0]]);
        assert_eq!(comparison.outcome, Outcome::Worse);
        assert_eq!(comparison.facts.len(), 1);
        assert_eq!(
            (comparison.facts[0].key.as_str(), comparison.facts[0].varies_within),
            ("law", false)
        );
        // Without pairs the same numbers are lost in their spread.
        let (a, b): (Vec<&Entry>, Vec<&Entry>) = (a.iter().collect(), b.iter().collect());
        let apart = Comparison::new(&a, &b, Alignment::Time, Pairing::None);
        assert_eq!(apart.outcome, Outcome::NoDifference);
    }

    #[test]
    fn trajectories_pair_flights_without_a_common_seed() {
        let a = [entry(0.1, "circle", 1, "x"), entry(0.3, "eight", 2, "x")];
        let b = [entry(0.1, "eight", 3, "x"), entry(0.1, "circle", 4, "x")];
        let comparison = compared(&a, &b);
        assert_eq!(
            (comparison.paired_by, comparison.pairs),
            (Some("trajectory"), vec![[0, 1], [1, 0]])
        );
    }

    #[test]
    fn single_flights_are_undecided() {
        let comparison = compared(&[entry(0.1, "circle", 1, "x")], &[entry(9.0, "circle", 1, "y")]);
        assert_eq!(comparison.outcome, Outcome::Undecided);
        assert!(
            comparison.sentence.contains("are too few to rule out chance"),
            "{}",
            comparison.sentence
        );
        assert_eq!(compared(&[], &[]).outcome, Outcome::Undecided);
    }
}
