//! In which states of the flight which faults acted.

use std::collections::BTreeMap;

use super::script::Timed;
use crate::supervisor::FlightState;

/// Flights by state and kind of fault. Of one flight, each pair counts once.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Coverage(BTreeMap<(String, String), u64>);

impl Coverage {
    /// What acts at `now_us` in this state. What happens in an instant acts for a moment.
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

    /// Adds another flight's, or other flights'.
    pub fn add(&mut self, other: &Self) {
        for (pair, count) in &other.0 {
            *self.0.entry(pair.clone()).or_default() += count;
        }
    }

    /// Pairs of state and fault, with their flights.
    pub fn pairs(&self) -> impl Iterator<Item = (&str, &str, u64)> {
        self.0.iter().map(|((state, fault), count)| (state.as_str(), fault.as_str(), *count))
    }

    /// From pairs.
    pub fn of(pairs: impl IntoIterator<Item = (String, String, u64)>) -> Self {
        Self(pairs.into_iter().map(|(state, fault, count)| ((state, fault), count)).collect())
    }
}
