//! Rates with confidence intervals.

use schemars::JsonSchema;
use serde::Serialize;

/// Normal quantile for 95 % intervals.
const Z95: f64 = 1.959_964;

/// A rate with Wilson's 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Rate {
    /// Number of successes.
    pub count: usize,
    /// Number of cases.
    pub of: usize,
    /// count / of; missing for no cases.
    pub rate: Option<f64>,
    /// 95 % interval of the true rate.
    pub interval: [f64; 2],
}

impl Rate {
    /// The rate of true outcomes.
    pub fn of(outcomes: impl IntoIterator<Item = bool>) -> Self {
        let (mut count, mut of) = (0, 0);
        for outcome in outcomes {
            of += 1;
            count += usize::from(outcome);
        }
        Self::new(count, of)
    }

    /// The rate of `count` successes among `of` cases.
    pub fn new(count: usize, of: usize) -> Self {
        Self {
            count,
            of,
            rate: (of > 0).then(|| count as f64 / of as f64),
            interval: wilson(count, of),
        }
    }
}

/// Wilson's score interval: it stays within 0..1 and holds for few outcomes (E. B. Wilson, J. Am.
/// Stat. Assoc. 22, 1927).
fn wilson(count: usize, of: usize) -> [f64; 2] {
    if of == 0 {
        return [0.0, 1.0];
    }
    let n = of as f64;
    let rate = count as f64 / n;
    let z2 = Z95 * Z95 / n;
    let middle = rate + 0.5 * z2;
    let half = (rate * (1.0 - rate) * z2 + 0.25 * z2 * z2).sqrt();
    [middle - half, middle + half].map(|bound| (bound / (1.0 + z2)).clamp(0.0, 1.0))
}

/// The median; `None` without a value.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    Some(if values.len() % 2 == 1 {
        values[middle]
    } else {
        0.5 * (values[middle - 1] + values[middle])
    })
}

/// Ranges between consecutive borders; the last range has no upper end.
pub(super) fn ranges(borders: &[f64]) -> impl Iterator<Item = [f64; 2]> + '_ {
    let ends = borders.iter().skip(1).copied().chain([f64::INFINITY]);
    borders.iter().copied().zip(ends).map(|(low, high)| [low, high])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_interval_matches_published_values() {
        // Newcombe, Stat. Med. 17 (1998), table I: 81 of 263 gives 0.2553 to 0.3662.
        let [low, high] = wilson(81, 263);
        assert!((low - 0.2553).abs() < 1e-4 && (high - 0.3662).abs() < 1e-4);
        let [low, high] = wilson(0, 20);
        assert!(low == 0.0 && (high - 0.1611).abs() < 1e-4);
        assert_eq!(wilson(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn rates_and_medians_are_computed() {
        let rate = Rate::of([true, false, true, true]);
        assert_eq!((rate.count, rate.of, rate.rate), (3, 4, Some(0.75)));
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0]), Some(2.5));
        assert_eq!(median(Vec::new()), None);
    }
}
