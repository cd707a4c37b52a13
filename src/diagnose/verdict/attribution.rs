//! The attribution: the squared gap as shipped, split into shares.
//!
//! The share of each effect and of the vehicle file's numbers is its Shapley value (Shapley 1953):
//! the reduction of the squared gap, averaged over the orders of adding them, on held-out flights.
//! The rest is noise and a remainder. Shares add up to one; one that makes predictions worse is
//! negative.

use rand::SeedableRng;
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64Mcg;
use schemars::JsonSchema;
use serde::Serialize;

/// A share of the squared gap.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Share {
    /// An effect's id, `file`, `remainder` or `noise`.
    pub of: String,
    /// The share; negative where it makes predictions worse.
    pub share: f64,
    /// Its 90 % interval over the prediction windows.
    pub interval: [f64; 2],
}

/// Draws of the prediction windows (Bayesian bootstrap over runs of them) for intervals.
const DRAWS: usize = 400;
/// Windows that overlap or are adjacent are drawn together: five seconds of them.
const WINDOWS_PER_RUN: usize = 20;

/// Shares of the squared gap. `squares` returns the squared gap with each subset of the players
/// (the bits of its index) under weights of the windows. `noise` is an upper limit on the part of
/// the squared gap that is noise. `names` holds the players, then the remainder and the noise.
pub fn shares(
    names: &[&str],
    windows: usize,
    squares: impl Fn(&[f64]) -> Option<Vec<f64>>,
    noise: f64,
) -> Option<Vec<Share>> {
    let players = names.len().checked_sub(2)?;
    let parted = |weights: &[f64]| -> Option<Vec<f64>> {
        let squares = squares(weights)?;
        let (before, after) = (*squares.first()?, *squares.last()?);
        let noise = noise.min(after);
        let mut parts = shapley(players, &squares);
        parts.extend([after - noise, noise]);
        Some(parts.into_iter().map(|part| part / before).collect())
    };
    let found = parted(&vec![1.0; windows])?;
    let mut rng = Pcg64Mcg::seed_from_u64(0);
    let drawn: Vec<Vec<f64>> = (0..DRAWS)
        .filter_map(|_| {
            let runs: Vec<f64> =
                (0..windows.div_ceil(WINDOWS_PER_RUN)).map(|_| Exp1.sample(&mut rng)).collect();
            let weights: Vec<f64> =
                (0..windows).map(|window| runs[window / WINDOWS_PER_RUN]).collect();
            parted(&weights)
        })
        .collect();
    let interval = |part: usize| {
        let mut all: Vec<f64> = drawn.iter().map(|parts| parts[part]).collect();
        all.sort_by(f64::total_cmp);
        let at = |quantile: f64| all.get((quantile * all.len() as f64) as usize).copied();
        [at(0.05), at(0.95)].map(|end| end.unwrap_or(found[part]))
    };
    let named = names.iter().zip(&found).enumerate();
    Some(
        named
            .map(|(part, (of, share))| Share {
                of: (*of).to_owned(),
                share: *share,
                interval: interval(part),
            })
            .collect(),
    )
}

/// Shapley values of `players`: the reduction that each brings. `square` holds the squared gap with
/// each subset, whose members are the bits of its index.
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
    fn share_shown_by_one_window_run_has_a_wide_interval() {
        // One effect closes 3 of 4 in every window; the other closes 3 of 4 in the first run only.
        let squares = |steady: bool| {
            move |weights: &[f64]| {
                let total: f64 = weights.iter().sum();
                let closed: f64 = match steady {
                    true => total,
                    false => weights[..WINDOWS_PER_RUN].iter().sum(),
                };
                Some(vec![4.0, 4.0 - 3.0 * closed / total])
            }
        };
        let names = ["wind", "remainder", "noise"];
        let [steady, single] = [true, false].map(|steady| {
            shares(&names, 4 * WINDOWS_PER_RUN, squares(steady), 1.0).expect("shares")
        });
        let wind = &steady[0];
        assert!((wind.share - 0.75).abs() < 1e-12 && (wind.interval[1] - 0.75).abs() < 1e-12);
        assert!((steady.iter().map(|share| share.share).sum::<f64>() - 1.0).abs() < 1e-12);
        let [low, high] = single[0].interval;
        assert!(low < 0.1 && high > 0.3 && low < single[0].share && single[0].share < high);
    }

    #[test]
    fn shares_add_up_and_a_null_player_gets_none() {
        // Two players that overlap, and one that does nothing.
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
