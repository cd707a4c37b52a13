//! Compares stated probabilities with observed frequencies.

use schemars::JsonSchema;
use serde::Serialize;

use super::interval::{Rate, ranges};
use super::order::Kind;
use super::score::Row;

/// Borders between probabilities in the reliability table.
const PROBABILITIES: [f64; 9] = [0.0, 0.1, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95];
/// Fewest cases for a bin of the reliability table to count.
const BIN_MIN: usize = 30;

/// Observed frequency in a bin of stated probabilities.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Reliability {
    /// Lower and upper limit of the bin.
    pub probabilities: [f64; 2],
    /// Mean of the stated probabilities.
    pub mean: f64,
    /// Rate of true effects.
    pub is_true: Rate,
}

impl Reliability {
    /// Whether the mean stated probability is within the interval of the true rate, or the bin is
    /// small.
    pub fn holds(&self) -> bool {
        let [low, high] = self.is_true.interval;
        self.is_true.of < BIN_MIN || (low..=high).contains(&self.mean)
    }
}

/// Every non-empty bin of the stated probabilities in `rows`.
pub fn reliability(rows: &[Row]) -> Vec<Reliability> {
    let given: Vec<(f64, bool)> = rows
        .iter()
        .flat_map(|row| {
            let is_true = |id: &String| row.kind != Kind::LeftOut && row.is_right(id);
            row.probabilities.iter().map(move |(id, p)| (*p, is_true(id))).collect::<Vec<_>>()
        })
        .collect();
    ranges(&PROBABILITIES)
        .filter_map(|[low, high]| {
            let here: Vec<_> = given.iter().filter(|(p, _)| (low..high).contains(p)).collect();
            if here.is_empty() {
                return None;
            }
            Some(Reliability {
                probabilities: [low, high.min(1.0)],
                mean: here.iter().map(|(p, _)| p).sum::<f64>() / here.len() as f64,
                is_true: Rate::of(here.iter().map(|(_, is_true)| *is_true)),
            })
        })
        .collect()
}

/// Mean distance between stated and observed probabilities, weighted by the size of each bin.
pub fn calibration_error(bins: &[Reliability]) -> Option<f64> {
    let total: usize = bins.iter().map(|bin| bin.is_true.of).sum();
    let off = bins
        .iter()
        .filter_map(|bin| Some((bin.mean - bin.is_true.rate?).abs() * bin.is_true.of as f64));
    (total > 0).then(|| off.sum::<f64>() / total as f64)
}
