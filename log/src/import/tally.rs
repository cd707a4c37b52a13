//! Counts dropped data by reason.

use std::collections::BTreeMap;

use super::flight::Flight;

/// Counts by reason, and descriptions of losses, for people.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    counts: BTreeMap<String, u64>,
    losses: Vec<String>,
}

impl Tally {
    /// Adds `count` to `reason`; does nothing for zero.
    pub fn add(&mut self, reason: &str, count: u64) {
        if count == 0 {
            return;
        }
        match self.counts.get_mut(reason) {
            Some(total) => *total += count,
            None => {
                self.counts.insert(reason.to_owned(), count);
            }
        }
    }

    /// Adds everything from another tally.
    pub fn merge(&mut self, other: Self) {
        for (reason, count) in other.counts {
            self.add(&reason, count);
        }
        self.losses.extend(other.losses);
    }

    /// Records a description of lost data.
    pub fn lose(&mut self, what: String) {
        self.losses.push(what);
    }

    /// Moves everything to `flight`.
    pub fn give(self, flight: &mut Flight) {
        flight.left_out.extend(self.counts);
        flight.losses.extend(self.losses);
    }

    /// The counts, by reason.
    #[cfg(test)]
    pub fn into_vec(self) -> Vec<(String, u64)> {
        self.counts.into_iter().collect()
    }
}
