//! The attribution: the squared gap as shipped, parted into shares.
//!
//! Each effect's share and that of the vehicle file's numbers are the mean over the orders of
//! adding them of what each takes off the squared gap (Shapley 1953), on flights that chose
//! nothing; what is left is noise, and a remainder. Shares add up to one; one is negative where it
//! makes predictions worse.

use schemars::JsonSchema;
use serde::Serialize;

/// A share of the squared gap.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Share {
    /// An effect's id, `file`, `remainder` or `noise`.
    pub of: String,
    /// The share.
    pub share: f64,
}

/// Shapley values of `players`, given the squared gap with each subset of them, whose members are
/// the bits of its index: what each takes off.
pub fn shapley(players: usize, square: &[f64]) -> Vec<f64> {
    let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
    (0..players)
        .map(|player| {
            let without = (0..square.len()).filter(|set| set & (1 << player) == 0);
            without
                .map(|set| {
                    let size = set.count_ones() as usize;
                    let weight =
                        factorial(size) * factorial(players - size - 1) / factorial(players);
                    weight * (square[set] - square[set | (1 << player)])
                })
                .sum()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up_and_what_does_nothing_has_none() {
        // Two that overlap, and one that does nothing.
        let square = |set: usize| match set & 3 {
            0 => 9.0,
            1 => 4.0,
            2 => 5.0,
            _ => 1.0,
        };
        let squares: Vec<f64> = (0..8).map(square).collect();
        let shares = shapley(3, &squares);
        assert!((shares.iter().sum::<f64>() - 8.0).abs() < 1e-12);
        assert!((shares[0] - 4.5).abs() < 1e-12 && (shares[1] - 3.5).abs() < 1e-12);
        assert_eq!(shares[2], 0.0);
    }
}
