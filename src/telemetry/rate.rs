//! The rate of a stream, from its stamps.

use std::collections::VecDeque;

use crate::clock::VehicleTime;

/// The window of the mean rate, s. It is long enough that a pause of a few periods on a busy
/// vehicle or link does not look like a slower stream.
const WINDOW_S: f64 = 1.0;
/// The window holds at least this many stamps, even where they take longer.
const STAMPS_MIN: usize = 32;
/// The window holds at most this many stamps; a faster stream has a shorter window.
const STAMPS_MAX: usize = 1024;
/// Intervals required before a rate is given.
const INTERVALS_MIN: usize = 5;
/// Silence after which a stream counts as stopped, s.
const SILENT_S: f64 = 0.2;

/// Measures the rate of a stream from its stamps.
#[derive(Clone, Debug, Default)]
pub(super) struct RateMeter {
    stamps: VecDeque<VehicleTime>,
}

impl RateMeter {
    /// Counts a message.
    pub fn count(&mut self, stamp: VehicleTime) {
        while self.stamps.len() >= STAMPS_MIN
            && (self.stamps.len() == STAMPS_MAX
                || self.stamps.get(1).is_some_and(|next| stamp.seconds_since(*next) >= WINDOW_S))
        {
            self.stamps.pop_front();
        }
        self.stamps.push_back(stamp);
    }

    /// Mean rate over the window, 0 until enough messages arrived.
    pub fn hz(&self) -> f64 {
        match (self.stamps.front(), self.stamps.back()) {
            (Some(first), Some(last)) if self.stamps.len() > INTERVALS_MIN => {
                (self.stamps.len() - 1) as f64 / last.seconds_since(*first)
            }
            _ => 0.0,
        }
    }

    /// Whether the stream is silent at `now`, or nothing arrived yet.
    pub fn is_silent(&self, now: VehicleTime) -> bool {
        self.stamps.back().is_none_or(|last| now.seconds_since(*last) > SILENT_S)
    }

    /// The rate, 0 where the stream is silent at `now`.
    pub fn live_hz(&self, now: VehicleTime) -> f64 {
        if self.is_silent(now) { 0.0 } else { self.hz() }
    }
}
