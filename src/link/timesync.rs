//! The vehicle's clock from TIMESYNC.
//!
//! The host sends its clock as `ts1`. The vehicle answers with its own in `tc1`. With the answer at
//! `now`, the vehicle's clock read `tc1` somewhere in between, so `offset = tc1 - (ts1 + now) / 2`
//! to within half the round trip. Queues make round trips long and asymmetric but never too short.
//! So the estimate uses the exchange with the least error bound, which grows with age by the
//! clocks' possible drift. Two such bounds give the skew to within their sum over the time between
//! them; a skew too small for them to show counts as zero.
//!
//! A second answer to one request, with a later `tc1`, shows that the link carried the request to the
//! vehicle twice, and how long after.
//!
//! An exchange whose bounds contradict the estimate proves that the clock slipped. Several in a row
//! that agree with one another restart the estimate.

use std::collections::VecDeque;
use std::time::Duration;

use super::clock_estimate::{ClockEstimate, ClockSource, SKEW_MAX, TOLERANCE_NS, ns_between};
use crate::clock::HostTime;

/// Time between requests.
pub const PERIOD: Duration = Duration::from_millis(100);
/// Time between requests while the newest answers contradict the estimate.
pub const PERIOD_IN_DOUBT: Duration = Duration::from_millis(10);
/// Exchanges kept: 5 s of them.
const WINDOW: usize = 50;
/// Requests that can still be answered; older ones exceed any useful round trip.
const OUTSTANDING: usize = 32;
/// Answered requests kept: another answer shows that the link repeated the request.
const ANSWERED: usize = 512;
/// With more open requests than this, the link is holding back answers.
const OPEN_MAX: usize = 5;
/// Round trip below which the link can take closely spaced requests.
const QUICK: Duration = Duration::from_millis(50);
/// Worst drift between two crystal clocks.
const DRIFT: f64 = 100e-6;
/// Least time between the two exchanges that give a skew, ns: stamps may be in whole milliseconds.
const SKEW_SPAN_NS: f64 = 0.5e9;
/// Exchanges that are less than this apart, ns, give a skew only to within [`SKEW_EARLY`].
const SKEW_SPAN_LONG_NS: f64 = 1.5e9;
/// Largest error of an early skew.
const SKEW_EARLY: f64 = 0.01;
/// Exchanges in a row that contradict the estimate before it is dropped.
const CONTRADICTIONS: usize = 3;
/// Time without an answer after which the estimate is dropped.
const ESTIMATE_AGE_MAX: Duration = Duration::from_secs(20);

#[derive(Clone, Copy, Debug)]
struct Exchange {
    /// Halfway between request and answer.
    at: HostTime,
    offset_ns: i64,
    round_trip_ns: u64,
}

impl Exchange {
    /// Half the round trip, enlarged for the largest skew of the vehicle's clock.
    fn half_trip_ns(&self) -> f64 {
        self.round_trip_ns as f64 / 2.0 * (1.0 + SKEW_MAX)
    }

    /// Error bound of its offset at time `at`, for a skew that is wrong by at most `drift`.
    fn error_ns(&self, at: HostTime, drift: f64) -> f64 {
        self.half_trip_ns() + ns_between(self.at, at).abs() * drift
    }

    /// How far the two exchanges contradict each other, ns, at a skew known to within `drift`;
    /// negative where they are consistent.
    fn conflict_ns(&self, other: &Self, skew: f64, drift: f64) -> f64 {
        let predicted = self.offset_ns as f64 + skew * ns_between(self.at, other.at);
        let bound = self.error_ns(other.at, drift) + other.half_trip_ns() + TOLERANCE_NS;
        (other.offset_ns as f64 - predicted).abs() - bound
    }
}

/// The skew between the clocks, and half the width of the interval that contains it.
#[derive(Clone, Copy, Debug)]
struct Skew {
    value: f64,
    error: f64,
}

/// Keeps the offset between the vehicle's clock and the host's.
#[derive(Debug, Default)]
pub(super) struct TimeSync {
    outstanding: VecDeque<i64>,
    /// `ts1` and `tc1` of the answered requests.
    answered: VecDeque<(i64, i64)>,
    exchanges: VecDeque<Exchange>,
    /// The exchange with the least error; it outlives the others.
    best: Option<Exchange>,
    skew: Option<Skew>,
    /// The newest exchanges, while they contradict the others.
    rivals: Vec<Exchange>,
    answered_at: HostTime,
    round_trip: Option<Duration>,
}

/// The effect of an answer on the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// No open request of this program matches it.
    NotOurs,
    /// The vehicle answered this request before: the link carried the request to it again.
    Again {
        /// Time from the first answer to this one, by both clocks.
        after: Duration,
    },
    /// The exchange was added.
    Sample,
    /// The exchange contradicts the estimate, but too few do so far to drop it.
    Contradiction {
        /// Size of the jump that would explain it, ns.
        by_ns: i64,
    },
    /// The vehicle's clock jumped: the former estimate was dropped.
    Jump {
        /// Size of the jump, ns; negative backwards, as after a reboot or a simulator's pause.
        by_ns: i64,
    },
}

impl TimeSync {
    pub(super) fn request(&mut self, now: HostTime) -> i64 {
        let ts1 = i64::try_from(now.as_ns()).unwrap_or(i64::MAX);
        if self.outstanding.len() == OUTSTANDING {
            self.outstanding.pop_front();
        }
        self.outstanding.push_back(ts1);
        ts1
    }

    pub(super) fn answer(&mut self, now: HostTime, tc1: i64, ts1: i64) -> Answer {
        let Some(index) = self.outstanding.iter().position(|&open| open == ts1) else {
            return self.again(now, tc1, ts1);
        };
        // Links keep the order, so earlier requests are lost.
        self.outstanding.drain(..=index);
        let Ok(sent) = u64::try_from(ts1) else { return Answer::NotOurs };
        let Some(round_trip_ns) = now.as_ns().checked_sub(sent) else { return Answer::NotOurs };
        let middle = ts1.saturating_add_unsigned(round_trip_ns / 2);
        let at = HostTime::from_ns(sent + round_trip_ns / 2);
        let exchange = Exchange { at, offset_ns: tc1.saturating_sub(middle), round_trip_ns };
        self.round_trip = Some(Duration::from_nanos(round_trip_ns));
        self.answered_at = now;
        if self.answered.len() == ANSWERED {
            self.answered.pop_front();
        }
        self.answered.reserve_exact(ANSWERED - self.answered.len());
        self.answered.push_back((ts1, tc1));

        if self.is_contradicted_by(&exchange) {
            let skew = self.skew.map_or(0.0, |skew| skew.value);
            let before = self.best.map_or(0.0, |best| {
                best.offset_ns as f64 + skew * ns_between(best.at, exchange.at)
            });
            if self.rivals.len() < CONTRADICTIONS {
                let by_ns = (exchange.offset_ns as f64 - before) as i64;
                return Answer::Contradiction { by_ns };
            }
            let rivals = std::mem::take(&mut self.rivals);
            (self.exchanges, self.best, self.skew) = (rivals.into(), None, None);
            self.choose(now);
            let best = self.best.map_or(exchange.offset_ns, |best| best.offset_ns);
            return Answer::Jump { by_ns: (best as f64 - before) as i64 };
        }
        if self.exchanges.len() == WINDOW {
            self.exchanges.pop_front();
        }
        self.exchanges.push_back(exchange);
        self.fit_skew();
        self.choose(now);
        Answer::Sample
    }

    /// A request that the vehicle answered twice reached it twice. A copy of its answer, made on the
    /// way back, has the same `tc1`.
    fn again(&self, now: HostTime, tc1: i64, ts1: i64) -> Answer {
        let first = self.answered.iter().find(|(request, _)| *request == ts1);
        let Some((_, first_tc1)) = first else { return Answer::NotOurs };
        let by_vehicle = u64::try_from(tc1.saturating_sub(*first_tc1)).unwrap_or(0);
        let by_host = now.as_ns().saturating_sub(ts1.unsigned_abs());
        match by_vehicle.min(by_host) {
            0 => Answer::NotOurs,
            after_ns => Answer::Again { after: Duration::from_nanos(after_ns) },
        }
    }

    /// Whether answers arrive quickly, so that closely spaced requests are no burden.
    pub(super) fn is_quick(&self) -> bool {
        self.outstanding.len() <= OPEN_MAX && self.round_trip.is_some_and(|time| time < QUICK)
    }

    pub(super) fn is_in_doubt(&self) -> bool {
        !self.rivals.is_empty()
    }

    /// Keeps the exchanges that contradict the earlier ones, as long as they agree with one
    /// another.
    fn is_contradicted_by(&mut self, exchange: &Exchange) -> bool {
        let Skew { value, error } = self.skew.unwrap_or(Skew { value: 0.0, error: SKEW_MAX });
        let drift = DRIFT + error.min(SKEW_MAX);
        let mut known = self.exchanges.iter().chain(&self.best);
        let is_contradicted = known.any(|known| known.conflict_ns(exchange, value, drift) > 0.0);
        let agrees = |rival: &Exchange| rival.conflict_ns(exchange, 0.0, SKEW_MAX) <= 0.0;
        if is_contradicted {
            if !self.rivals.iter().all(agrees) {
                self.rivals.clear();
            }
            self.rivals.push(*exchange);
        } else if !self.rivals.iter().all(agrees) {
            self.rivals.clear();
        }
        is_contradicted
    }

    /// The skew between the best exchange of the older half and that of the newer one.
    fn fit_skew(&mut self) {
        let half = self.exchanges.len() / 2;
        let least = |a: &&Exchange, b: &&Exchange| a.round_trip_ns.cmp(&b.round_trip_ns);
        let older = self.exchanges.iter().take(half).min_by(least);
        let newer = self.exchanges.iter().skip(half).rev().min_by(least);
        let (Some(older), Some(newer)) = (older, newer) else { return };
        let span_ns = ns_between(older.at, newer.at);
        let error = (older.half_trip_ns() + newer.half_trip_ns()) / span_ns;
        if span_ns < SKEW_SPAN_NS || (span_ns < SKEW_SPAN_LONG_NS && error > SKEW_EARLY) {
            return;
        }
        let slope = newer.offset_ns.saturating_sub(older.offset_ns) as f64 / span_ns;
        let is_shown = slope.abs() > error + DRIFT;
        let found = Skew { value: if is_shown { slope } else { 0.0 }, error };
        let is_better = self.skew.is_none_or(|known| {
            found.error <= known.error || (known.value - slope).abs() > error + DRIFT
        });
        if is_better {
            self.skew = Some(found);
        }
    }

    /// Possible error of the skew over time. A skew too large for a crystal varies.
    fn drift(&self) -> f64 {
        self.skew.map_or(SKEW_MAX, |skew| DRIFT + skew.value.abs())
    }

    fn choose(&mut self, now: HostTime) {
        let drift = self.drift();
        let error = |exchange: &Exchange| exchange.error_ns(now, drift);
        let known = self.exchanges.iter().chain(&self.best);
        self.best = known.min_by(|a, b| error(a).total_cmp(&error(b))).copied();
    }

    pub(super) fn estimate(&self, now: HostTime) -> Option<ClockEstimate> {
        let best = self.best.filter(|_| now.since(self.answered_at) < ESTIMATE_AGE_MAX)?;
        Some(ClockEstimate {
            offset_ns: best.offset_ns,
            at: best.at,
            skew: self.skew.map_or(0.0, |skew| skew.value),
            error_ns: Some(best.error_ns(now, self.drift()) as u64),
            source: ClockSource::Timesync,
        })
    }

    pub(super) fn round_trip(&self) -> Option<Duration> {
        self.round_trip
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::VehicleTime;
    use crate::link::vehicle_clock::VehicleClock;

    const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
    /// The vehicle booted 20 s before START.
    const OFFSET_NS: i64 = 20_000_000_000 - START.as_ns() as i64;

    fn vehicle_ns(at: HostTime) -> i64 {
        at.as_ns() as i64 + OFFSET_NS
    }

    /// One exchange with given delays in each direction.
    fn exchange(sync: &mut VehicleClock, at: HostTime, there: Duration, back: Duration) -> Answer {
        let ts1 = sync.request(at);
        sync.answer(at + there + back, vehicle_ns(at + there), ts1)
    }

    #[test]
    fn asymmetric_jitter_does_not_bias_the_offset() {
        let mut sync = VehicleClock::default();
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
    fn only_own_pending_requests_are_accepted() {
        let mut sync = VehicleClock::default();
        let ts1 = sync.request(START);
        let later = START + Duration::from_millis(1);
        assert_eq!(sync.answer(later, 5, ts1 + 1), Answer::NotOurs);
        assert_eq!(sync.answer(later, vehicle_ns(START), ts1), Answer::Sample);
        assert_eq!(sync.answer(later, vehicle_ns(START), ts1), Answer::NotOurs, "twice");
        assert_eq!(sync.answer(later, i64::MIN, i64::MIN), Answer::NotOurs);
    }

    #[test]
    fn second_answer_shows_a_repeated_request() {
        let mut sync = VehicleClock::default();
        let ms = Duration::from_millis(1);
        let ts1 = sync.request(START);
        let tc1 = vehicle_ns(START + ms);
        assert_eq!(sync.answer(START + ms * 2, tc1, ts1), Answer::Sample);
        let late = START + ms * 900;
        assert_eq!(sync.answer(late, tc1, ts1), Answer::NotOurs, "a copy of the answer");
        assert_eq!(sync.answer(late, tc1 - 1, ts1), Answer::NotOurs, "overtaken");
        let after = ms * 800;
        let again = Answer::Again { after };
        assert_eq!(sync.answer(late, tc1 + after.as_nanos() as i64, ts1), again);
        let jumped = sync.answer(late, i64::MAX, ts1);
        assert_eq!(jumped, Answer::Again { after: ms * 900 }, "no longer than since the request");
    }

    #[test]
    fn reboot_is_a_jump_but_a_single_outlier_is_not() {
        let mut sync = VehicleClock::default();
        let ms = Duration::from_millis(1);
        exchange(&mut sync, START, ms, ms);
        let before = sync.estimate();
        let mut rebooted = |k: u32| {
            let at = START + PERIOD * k;
            let ts1 = sync.request(at);
            sync.answer(at + ms, PERIOD.as_nanos() as i64 * i64::from(k), ts1)
        };
        for k in [1, 2] {
            let Answer::Contradiction { by_ns } = rebooted(k) else { panic!("{k}: not in doubt") };
            assert!(by_ns < -19_000_000_000, "{by_ns}");
        }
        let Answer::Jump { by_ns } = rebooted(3) else { panic!("no jump") };
        assert!(by_ns < -19_000_000_000, "{by_ns}");
        assert_ne!(sync.estimate(), before);
    }

    #[test]
    fn arrival_stamps_are_used_without_timesync_answers() {
        let mut sync = VehicleClock::default();
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
