//! The vehicle's clock against the host's, by TIMESYNC.
//!
//! The host asks: `ts1` is its clock. The vehicle answers with its own in `tc1`. With the answer
//! at `now`, the vehicle's clock read `tc1` somewhere between, so that
//! `offset = tc1 - (ts1 + now) / 2` to within half the round trip. Queues make round trips long
//! and lopsided but never too short: of a window of samples the one with the least error bound is
//! believed, the bound growing with age by the worst drift between the clocks.
//!
//! For a vehicle that never answers, the stamps of its messages serve: the least delay seen is
//! taken for none, which leaves the offset late by the shortest transport time.

use std::collections::VecDeque;
use std::time::Duration;

use crate::clock::{HostTime, VehicleTime};

/// Time between requests.
pub const PERIOD: Duration = Duration::from_millis(100);
/// Samples kept: 5 s of them.
const WINDOW: usize = 50;
/// Requests that can still be answered; older ones took longer than any useful round trip.
const OUTSTANDING: usize = 10;
/// Worst drift between two crystal clocks.
const DRIFT: f64 = 100e-6;
/// Samples in a row that contradict the estimate before it is dropped: the vehicle has rebooted.
const CONTRADICTIONS: u32 = 3;
/// What two samples may differ by beyond their error bounds.
const TOLERANCE_NS: f64 = 20e6;
/// How long a least delay is believed.
const ARRIVAL_SPAN: Duration = Duration::from_secs(5);

/// The offset between the clocks, and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockEstimate {
    /// Vehicle time minus host time, ns.
    pub offset_ns: i64,
    /// Half the width of the interval that holds the true offset, ns. For [`ClockSource::Arrival`]
    /// it is not known.
    pub error_ns: Option<u64>,
    /// Where the estimate comes from.
    pub source: ClockSource,
}

/// Where a [`ClockEstimate`] comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockSource {
    /// Answers to TIMESYNC.
    Timesync,
    /// The least delay of stamped messages.
    Arrival,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    at: HostTime,
    offset_ns: i64,
    round_trip_ns: u64,
}

impl Sample {
    fn error_ns(&self, now: HostTime) -> f64 {
        self.round_trip_ns as f64 / 2.0 + now.since(self.at).as_nanos() as f64 * DRIFT
    }
}

/// Keeps the offset between the vehicle's clock and the host's.
#[derive(Debug, Default)]
pub struct TimeSync {
    outstanding: VecDeque<i64>,
    samples: VecDeque<Sample>,
    contradictions: u32,
    estimate: Option<ClockEstimate>,
    round_trip: Option<Duration>,
    /// Offset of the message with the least delay, of the current and of the previous span.
    arrival: [Option<i64>; 2],
    span_start: HostTime,
}

/// What an answer did to the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Not an answer to a request of ours that is still open.
    NotOurs,
    /// Taken in.
    Sample,
    /// The vehicle's clock has jumped: everything known before was dropped.
    Jump,
}

impl TimeSync {
    /// The `ts1` to ask with now; `tc1` is 0.
    pub fn request(&mut self, now: HostTime) -> i64 {
        let ts1 = i64::try_from(now.as_ns()).unwrap_or(i64::MAX);
        if self.outstanding.len() == OUTSTANDING {
            self.outstanding.pop_front();
        }
        self.outstanding.push_back(ts1);
        ts1
    }

    /// Takes an answer. Only one to an open request counts, and only once.
    pub fn answer(&mut self, now: HostTime, tc1: i64, ts1: i64) -> Answer {
        let Some(index) = self.outstanding.iter().position(|&open| open == ts1) else {
            return Answer::NotOurs;
        };
        self.outstanding.remove(index);
        let Ok(sent) = u64::try_from(ts1) else { return Answer::NotOurs };
        let Some(round_trip_ns) = now.as_ns().checked_sub(sent) else { return Answer::NotOurs };
        let middle = ts1.saturating_add_unsigned(round_trip_ns / 2);
        let sample = Sample { at: now, offset_ns: tc1.saturating_sub(middle), round_trip_ns };
        self.round_trip = Some(Duration::from_nanos(round_trip_ns));

        let jumped = self.is_contradicted_by(now, &sample);
        if jumped {
            self.samples.clear();
            self.arrival = [None; 2];
        } else if self.contradictions > 0 {
            // Believed only if it is not alone.
            return Answer::Sample;
        }
        if self.samples.len() == WINDOW {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
        let best = self.samples.iter().min_by(|a, b| a.error_ns(now).total_cmp(&b.error_ns(now)));
        self.estimate = best.map(|best| ClockEstimate {
            offset_ns: best.offset_ns,
            error_ns: Some(best.error_ns(now) as u64),
            source: ClockSource::Timesync,
        });
        if jumped { Answer::Jump } else { Answer::Sample }
    }

    /// Counts contradictions; true once there are enough of them.
    fn is_contradicted_by(&mut self, now: HostTime, sample: &Sample) -> bool {
        let newest = self.samples.back();
        let contradicts = newest.is_some_and(|newest| {
            let difference = (sample.offset_ns as f64 - newest.offset_ns as f64).abs();
            difference > newest.error_ns(now) + sample.error_ns(now) + TOLERANCE_NS
        });
        self.contradictions = if contradicts { self.contradictions + 1 } else { 0 };
        let jumped = self.contradictions >= CONTRADICTIONS;
        if jumped {
            self.contradictions = 0;
        }
        jumped
    }

    /// Takes the stamp of a message that just arrived.
    pub fn observe(&mut self, now: HostTime, stamp: VehicleTime) {
        if now.since(self.span_start) > ARRIVAL_SPAN {
            self.arrival = [None, self.arrival[0]];
            self.span_start = now;
        }
        let offset = nanoseconds(stamp).saturating_sub_unsigned(now.as_ns());
        // Delay makes the stamp look older, so the largest offset had the least of it.
        self.arrival[0] = self.arrival[0].max(Some(offset));
    }

    /// The offset now.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        self.estimate.or_else(|| {
            let offset_ns = self.arrival[0].max(self.arrival[1])?;
            Some(ClockEstimate { offset_ns, error_ns: None, source: ClockSource::Arrival })
        })
    }

    /// Round trip of the newest answer.
    pub fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }

    /// Host time at which the vehicle's clock reads `time`.
    pub fn to_host(&self, time: VehicleTime) -> Option<HostTime> {
        let offset_ns = self.estimate()?.offset_ns;
        let ns = nanoseconds(time).checked_sub(offset_ns)?;
        u64::try_from(ns).ok().map(HostTime::from_ns)
    }
}

fn nanoseconds(time: VehicleTime) -> i64 {
    i64::try_from(time.as_us()).unwrap_or(i64::MAX).saturating_mul(1000)
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
    /// The vehicle booted 20 s before START.
    const OFFSET_NS: i64 = 20_000_000_000 - START.as_ns() as i64;

    fn vehicle_ns(at: HostTime) -> i64 {
        at.as_ns() as i64 + OFFSET_NS
    }

    /// One exchange with given delays there and back.
    fn exchange(sync: &mut TimeSync, at: HostTime, there: Duration, back: Duration) -> Answer {
        let ts1 = sync.request(at);
        sync.answer(at + there + back, vehicle_ns(at + there), ts1)
    }

    #[test]
    fn lopsided_jitter_does_not_move_the_offset() {
        let mut sync = TimeSync::default();
        let us = Duration::from_micros;
        for k in 0..200u32 {
            // Replies queue for up to 40 ms; one in seven passes freely.
            let queue = if k % 7 == 0 { 0 } else { u64::from(k * 7919 % 40_000) };
            exchange(&mut sync, START + PERIOD * k, us(150), us(150 + queue));
        }
        let estimate = sync.estimate().unwrap();
        let error = (estimate.offset_ns - OFFSET_NS).unsigned_abs();
        assert!(error < 1_000, "{error} ns");
        assert!(u128::from(error) <= u128::from(estimate.error_ns.unwrap()));
        assert_eq!(estimate.source, ClockSource::Timesync);
        let host = sync.to_host(VehicleTime::from_us(25_000_000)).unwrap();
        assert!(host.since(START + Duration::from_secs(5)) < us(2));
    }

    #[test]
    fn only_own_open_requests_count() {
        let mut sync = TimeSync::default();
        let ts1 = sync.request(START);
        let later = START + Duration::from_millis(1);
        assert_eq!(sync.answer(later, 5, ts1 + 1), Answer::NotOurs);
        assert_eq!(sync.answer(later, vehicle_ns(START), ts1), Answer::Sample);
        assert_eq!(sync.answer(later, vehicle_ns(START), ts1), Answer::NotOurs, "twice");
        assert_eq!(sync.answer(later, i64::MIN, i64::MIN), Answer::NotOurs);
    }

    #[test]
    fn a_reboot_is_a_jump_and_one_wild_sample_is_not() {
        let mut sync = TimeSync::default();
        let ms = Duration::from_millis(1);
        exchange(&mut sync, START, ms, ms);
        let before = sync.estimate();
        let mut rebooted = |k: u32| {
            let at = START + PERIOD * k;
            let ts1 = sync.request(at);
            sync.answer(at + ms, PERIOD.as_nanos() as i64 * i64::from(k), ts1)
        };
        assert_eq!(rebooted(1), Answer::Sample);
        assert_eq!(rebooted(2), Answer::Sample);
        assert_eq!(rebooted(3), Answer::Jump);
        assert_ne!(sync.estimate(), before);
    }

    #[test]
    fn stamps_serve_where_nobody_answers() {
        let mut sync = TimeSync::default();
        for k in 0..100u32 {
            let sampled = START + Duration::from_millis(10) * k;
            let stamp = VehicleTime::from_us((vehicle_ns(sampled) / 1000) as u64);
            sync.observe(sampled + Duration::from_micros(200 + u64::from(k % 13) * 300), stamp);
        }
        let estimate = sync.estimate().unwrap();
        assert_eq!(estimate.source, ClockSource::Arrival);
        assert_eq!(estimate.offset_ns, OFFSET_NS - 200_000);
    }
}
