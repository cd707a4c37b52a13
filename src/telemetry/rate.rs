//! The rate of a stream, measured by its stamps.

use std::collections::VecDeque;

use crate::clock::VehicleTime;

/// Stamps that the rate is taken over.
const WINDOW: usize = 32;
/// Intervals that must have been seen.
const INTERVALS_MIN: usize = 5;

/// Counts a stream's stamps.
#[derive(Clone, Debug, Default)]
pub(super) struct RateMeter {
    stamps: VecDeque<VehicleTime>,
}

impl RateMeter {
    /// Another message.
    pub fn count(&mut self, stamp: VehicleTime) {
        if self.stamps.len() == WINDOW {
            self.stamps.pop_front();
        }
        self.stamps.push_back(stamp);
    }

    /// Mean rate over the newest stamps, 0 until enough came.
    pub fn hz(&self) -> f64 {
        match (self.stamps.front(), self.stamps.back()) {
            (Some(first), Some(last)) if self.stamps.len() > INTERVALS_MIN => {
                (self.stamps.len() - 1) as f64 / last.seconds_since(*first)
            }
            _ => 0.0,
        }
    }
}
