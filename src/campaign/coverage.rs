//! Which faults acted in which states of the flight.

use std::collections::BTreeMap;

use super::script::Timed;
use crate::supervisor::FlightState;

/// Number of flights by state and kind of fault; each pair counts once per flight.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Coverage(BTreeMap<(String, String), u64>);

impl Coverage {
    /// Notes the faults that act at `now_us` in this state. An instantaneous fault counts for a
    /// moment.
    pub fn note(&mut self, state: Option<FlightState>, faults: &[Timed], now_us: u64) {
        const MOMENT_US: u64 = 20_000;
        let state = state.map_or("none", FlightState::name);
        for timed in faults {
            let is_recent = (timed.at_us()..timed.at_us() + MOMENT_US).contains(&now_us);
            if is_recent || timed.acts(now_us) {
                let known = (state.to_owned(), timed.fault.kind().to_owned());
                self.0.insert(known, 1);
            }
        }
    }

    /// Adds the counts of other flights.
    pub fn add(&mut self, other: &Self) {
        for (pair, count) in &other.0 {
            *self.0.entry(pair.clone()).or_default() += count;
        }
    }

    /// Pairs of state and fault, with their number of flights.
    pub fn pairs(&self) -> impl Iterator<Item = (&str, &str, u64)> {
        self.0.iter().map(|((state, fault), count)| (state.as_str(), fault.as_str(), *count))
    }

    /// Builds the counts from such pairs.
    pub fn of(pairs: impl IntoIterator<Item = (String, String, u64)>) -> Self {
        Self(pairs.into_iter().map(|(state, fault, count)| ((state, fault), count)).collect())
    }
}
