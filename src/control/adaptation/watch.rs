//! When adaptation loses trust.

use crate::setpoint::State;
use std::fmt;

/// Why adaptation switched itself off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Distrust {
    /// A number of the state or of the estimate was not finite.
    NotFinite,
    /// The state did not change.
    Frozen,
    /// The state jumped repeatedly.
    Jumping,
    /// Setpoints met limits for too long: the vehicle did not get what the law commanded.
    Saturated,
    /// A parameter stayed at its bound.
    Bound,
    /// The learned values explained nothing: changes kept following each other.
    Diverging,
}

impl fmt::Display for Distrust {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "a value was not finite",
            Self::Frozen => "the state stopped changing",
            Self::Jumping => "the state jumped repeatedly",
            Self::Saturated => "setpoints were at their limits for too long",
            Self::Bound => "a parameter stayed at its bound",
            Self::Diverging => "the learned values explained nothing",
        })
    }
}

/// A state that is bitwise unchanged for this time is frozen, s.
const FROZEN_S: f64 = 0.15;
/// Longest time for which setpoints may meet limits, s; recovery from a gust takes less.
const SATURATED_S: f64 = 1.0;
/// Longest time for which a parameter may stay at its bound, s.
const BOUND_S: f64 = 1.0;
/// Time in which the count of jumps or changes falls by one, s.
const CALMED_S: f64 = 1.0;
/// Counts above which there are too many jumps, or changes.
const JUMPS_MAX: f64 = 3.0;
const CHANGES_MAX: f64 = 8.0;

/// Collects the evidence against the estimate.
#[derive(Clone, Debug, Default)]
pub(super) struct Watch {
    last: Option<State>,
    frozen_s: f64,
    saturated_s: f64,
    bound_s: f64,
    jumps: f64,
    changes: f64,
}

impl Watch {
    /// Checks a state `dt` after the last, and whether the last setpoint met a limit.
    pub fn sees(&mut self, state: &State, is_limited: bool, dt: f64) -> Option<Distrust> {
        if !state.is_finite() {
            return Some(Distrust::NotFinite);
        }
        let is_same = self.last.replace(*state) == Some(*state);
        self.frozen_s = if is_same { self.frozen_s + dt } else { 0.0 };
        // Limits that are met intermittently count as well.
        let more = if is_limited { dt } else { -dt };
        self.saturated_s = (self.saturated_s + more).max(0.0);
        self.jumps = (self.jumps - dt / CALMED_S).max(0.0);
        self.changes = (self.changes - dt / CALMED_S).max(0.0);
        if self.frozen_s > FROZEN_S {
            Some(Distrust::Frozen)
        } else if self.saturated_s > SATURATED_S {
            Some(Distrust::Saturated)
        } else {
            None
        }
    }

    /// Counts a state that does not continue the last ones.
    pub fn jumped(&mut self) -> Option<Distrust> {
        self.jumps += 1.0;
        (self.jumps > JUMPS_MAX).then_some(Distrust::Jumping)
    }

    /// Checks the outcome of learning from a sample.
    pub fn learned(&mut self, is_change: bool, at_bound: bool, dt: f64) -> Option<Distrust> {
        self.bound_s = if at_bound { self.bound_s + dt } else { 0.0 };
        if is_change {
            self.changes += 1.0;
        }
        if self.changes > CHANGES_MAX {
            Some(Distrust::Diverging)
        } else if self.bound_s > BOUND_S {
            Some(Distrust::Bound)
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle::frame::Ned;

    const DT: f64 = 0.01;

    fn moving(tick: usize) -> State {
        State { position: Ned::new(tick as f64 * 1e-3, 0.0, 0.0), ..State::default() }
    }

    #[test]
    fn frozen_state_is_distrusted_and_moving_state_trusted() {
        let mut watch = Watch::default();
        assert!((0..1000).all(|tick| watch.sees(&moving(tick), false, DT).is_none()));
        let first = (0..100).find_map(|tick| watch.sees(&moving(7), false, DT).map(|d| (tick, d)));
        assert_eq!(first.map(|(_, distrust)| distrust), Some(Distrust::Frozen));
        assert!(first.is_some_and(|(tick, _)| tick > 10));
    }

    #[test]
    fn only_prolonged_saturation_is_distrusted() {
        let mut watch = Watch::default();
        assert!((0..80).all(|tick| watch.sees(&moving(tick), true, DT).is_none()));
        assert!((80..400).all(|tick| watch.sees(&moving(tick), false, DT).is_none()));
        let met = (400..600).find_map(|tick| watch.sees(&moving(tick), true, DT));
        assert_eq!(met, Some(Distrust::Saturated));
    }

    #[test]
    fn repeated_jumps_changes_and_bound_hits_are_distrusted() {
        let mut watch = Watch::default();
        assert_eq!([(); 4].map(|()| watch.jumped())[2..], [None, Some(Distrust::Jumping)]);
        let mut watch = Watch::default();
        let changed = (0..20).find_map(|_| watch.learned(true, false, DT));
        assert_eq!(changed, Some(Distrust::Diverging));
        let mut watch = Watch::default();
        let bound = (0..200).find_map(|_| watch.learned(false, true, DT));
        assert_eq!(bound, Some(Distrust::Bound));
        let nan = State { position: Ned::new(f64::NAN, 0.0, 0.0), ..State::default() };
        assert_eq!(watch.sees(&nan, false, DT), Some(Distrust::NotFinite));
    }
}
