//! The vehicle's clock from the stamps of its messages alone.
//!
//! Delay makes a stamp look older, so the largest offsets of stamp to arrival had the least delay.
//! The line through them is the clock, late by the shortest transport time. It is the line above
//! all offsets with the least area in between (Moon, Skelly and Towsley, "Estimation and removal of
//! clock skew from network delay measurements", 1999). A queue that grows by less than the largest
//! skew looks like a slow clock; only TIMESYNC distinguishes the two.

use std::collections::VecDeque;
use std::time::Duration;

use super::clock_estimate::{ClockEstimate, ClockSource, SKEW_MAX, TOLERANCE_NS};
use super::clock_estimate::{nanoseconds, ns_between};
use crate::clock::{HostTime, VehicleTime};

/// Time over which one largest offset is kept.
const SPAN: Duration = Duration::from_secs(1);
/// Spans that are kept. Older fast messages are forgotten, so that a clock which stood still for a
/// while is followed after as many seconds.
const SPANS: usize = 7;
/// Whole spans required for a skew.
const SPANS_MIN: usize = 3;

/// The fastest message of a span.
#[derive(Clone, Copy, Debug)]
struct Quickest {
    at: HostTime,
    offset_ns: i64,
}

impl Quickest {
    fn offset_at(&self, now: HostTime, skew: f64) -> f64 {
        self.offset_ns as f64 + skew * ns_between(self.at, now)
    }
}

/// Keeps the fastest messages of recent spans that had any.
#[derive(Debug, Default)]
pub(super) struct Arrival {
    spans: VecDeque<Quickest>,
    opened: HostTime,
    skew: f64,
}

impl Arrival {
    /// Takes the stamp of a message that just arrived.
    pub(super) fn observe(&mut self, now: HostTime, stamp: VehicleTime) {
        let offset_ns = nanoseconds(stamp).saturating_sub_unsigned(now.as_ns());
        let quickest = Quickest { at: now, offset_ns };
        let skew = self.skew;
        match self.spans.back_mut() {
            Some(last) if now.since(self.opened) < SPAN => {
                if offset_ns as f64 >= last.offset_at(now, skew) {
                    *last = quickest;
                }
            }
            _ => {
                self.skew = self.fit();
                if self.spans.len() == SPANS {
                    self.spans.pop_front();
                }
                self.spans.push_back(quickest);
                self.opened = now;
            }
        }
    }

    /// The estimated clock at `now`: the kept message with the largest offset there, and the skew.
    pub(super) fn estimate(&self, now: HostTime) -> Option<ClockEstimate> {
        let by_offset = |a: &&Quickest, b: &&Quickest| {
            a.offset_at(now, self.skew).total_cmp(&b.offset_at(now, self.skew))
        };
        self.spans.iter().max_by(by_offset).map(|quickest| ClockEstimate {
            offset_ns: quickest.offset_ns,
            at: quickest.at,
            skew: self.skew,
            error_ns: None,
            source: ClockSource::Arrival,
        })
    }

    /// The slope of the closest line above all offsets; 0 where it is too small to be significant.
    fn fit(&self) -> f64 {
        let (Some(first), Some(last)) = (self.spans.front(), self.spans.back()) else { return 0.0 };
        if self.spans.len() < SPANS_MIN {
            return 0.0;
        }
        let points: Vec<(f64, f64)> = self
            .spans
            .iter()
            .map(|q| {
                (ns_between(first.at, q.at), q.offset_ns.saturating_sub(first.offset_ns) as f64)
            })
            .collect();
        let middle = points.iter().map(|(t, _)| t).sum::<f64>() / points.len() as f64;
        let pairs = points
            .iter()
            .enumerate()
            .flat_map(|(i, a)| points.iter().skip(i + 1).map(move |b| (*a, *b)));
        let slope = pairs
            .filter(|(a, b)| a.0 <= middle && middle <= b.0 && b.0 > a.0)
            .map(|(a, b)| (a, (b.1 - a.1) / (b.0 - a.0)))
            .find(|(a, slope)| {
                points.iter().all(|(t, offset)| offset - a.1 <= slope * (t - a.0) + 1e3)
            })
            .map_or(0.0, |(_, slope)| slope);
        let is_shown = slope.abs() * ns_between(first.at, last.at) > TOLERANCE_NS;
        if is_shown && slope.abs() <= SKEW_MAX { slope } else { 0.0 }
    }
}
