//! Flags of many simulated flights.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;

/// Flags of `sweep`.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// The sweep (TOML): inputs of `simulate`, `diagnose` or `exam`, some of them on a grid, in a
    /// list, or drawn.
    pub manifest: PathBuf,
    /// Folder for the rows and table.csv; created if missing. Rows already in it are not computed
    /// again.
    #[arg(long, value_name = "DIR", default_value = "sweep-out")]
    pub out: PathBuf,
    /// Computes only every N-th point, from the I-th: one of N workers on one folder. The worker
    /// that finds all rows in it writes the table.
    #[arg(long, value_name = "I/N", default_value = "1/1")]
    pub shard: Shard,
    /// Points in parallel [default: one for each core]. The rows do not depend on it.
    #[arg(long, value_name = "COUNT")]
    pub jobs: Option<NonZeroUsize>,
    /// Lists the points and computes nothing.
    #[arg(long)]
    pub list: bool,
    /// Prints the summary as JSON; with --list the points, one object per line.
    #[arg(long)]
    pub json: bool,
}

/// One of several workers, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Which.
    pub index: usize,
    /// Of how many.
    pub count: usize,
}

impl Shard {
    /// Whether it flies this point.
    pub fn has(self, point: usize) -> bool {
        point % self.count == self.index - 1
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| {
            Some(Self { index: index.trim().parse().ok()?, count: count.trim().parse().ok()? })
        });
        numbers
            .filter(|shard| (1..=shard.count).contains(&shard.index))
            .ok_or_else(|| format!("expected I/N with I from 1 to N, found {text:?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_in_exactly_one_shard() {
        let shards: Vec<Shard> =
            (1..=7).map(|index| format!("{index}/7").parse().expect("a shard")).collect();
        for point in 0..50 {
            assert_eq!(shards.iter().filter(|shard| shard.has(point)).count(), 1);
        }
        for wrong in ["0/7", "8/7", "1", "1/0", "-1/2", "a/b"] {
            assert!(wrong.parse::<Shard>().is_err(), "{wrong}");
        }
    }
}
