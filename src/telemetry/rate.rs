//! The rate of a stream, measured by its stamps.

use std::collections::VecDeque;

use crate::clock::VehicleTime;

/// The rate is a mean over this time, s, so that a pause of a few periods, which a busy vehicle or
/// link makes, does not pass for a slower stream.
const WINDOW_S: f64 = 1.0;
/// And over this many stamps, where so many take longer.
const STAMPS_MIN: usize = 32;
/// Most stamps that are kept; a stream that is quicker has a shorter window.
const STAMPS_MAX: usize = 1024;
/// Intervals that must have been seen.
const INTERVALS_MIN: usize = 5;
/// Silence of a stream, s, after which it does not count as one.
const SILENT_S: f64 = 0.2;

/// Counts a stream's stamps.
#[derive(Clone, Debug, Default)]
pub(super) struct RateMeter {
    stamps: VecDeque<VehicleTime>,
}

impl RateMeter {
    /// Another message.
    pub fn count(&mut self, stamp: VehicleTime) {
        while self.stamps.len() >= STAMPS_MIN
            && (self.stamps.len() == STAMPS_MAX
                || self.stamps.get(1).is_some_and(|next| stamp.seconds_since(*next) >= WINDOW_S))
        {
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

    /// Whether nothing has come for a while before `now`, or ever.
    pub fn is_silent(&self, now: VehicleTime) -> bool {
        self.stamps.back().is_none_or(|last| now.seconds_since(*last) > SILENT_S)
    }

    /// The rate, 0 where the stream is silent at `now`.
    pub fn live_hz(&self, now: VehicleTime) -> f64 {
        if self.is_silent(now) { 0.0 } else { self.hz() }
    }
}
