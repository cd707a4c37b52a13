//! The vehicle's clock relative to the host's, and the delay of each message.
//!
//! The clock model is a line: `vehicle = host + offset + skew * (host - at)`. `TimeSync` estimates
//! it from exchanges, whose round trip bounds the error. It distinguishes a delayed message from a
//! clock slip, because a queue makes round trips long and a slip does not. `Arrival` estimates it
//! from the stamps alone, for a vehicle that never answers.

use std::time::Duration;

use crate::clock::{HostTime, VehicleTime};
use crate::link::arrival::Arrival;
pub use crate::link::clock_estimate::{ClockEstimate, ClockSource};
use crate::link::timesync::{self, Answer, TimeSync};

/// A stamp further behind the newest than this shows a restarted vehicle, s.
const RESTART_S: f64 = 1.0;

/// Delay beyond which the clock may have slipped instead, s.
const DOUBT_S: f64 = 0.05;

/// How much longer a message took than the fastest ones.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Delay {
    /// Best estimate, s; negative for a message faster than all before.
    pub seconds: f64,
    /// Lower bound, given the error of the clock's estimate, s.
    pub at_least_s: f64,
}

/// Keeps the line between the two clocks, and the delay of the fastest message.
#[derive(Debug, Default)]
pub struct VehicleClock {
    sync: TimeSync,
    arrival: Arrival,
    /// When a message last arrived.
    latest: HostTime,
    newest: Option<VehicleTime>,
    quickest: Option<Quickest>,
    /// That of the stamps before they last jumped. Where some messages have old stamps, the two
    /// alternate, and a delay that begins meanwhile must not count as the fastest.
    before_jump: Option<Quickest>,
    /// Whether the newest message was late, or the clock slipped.
    is_late: bool,
}

/// Delay of the fastest message by the TIMESYNC clock, which need not be the clock of the stamps.
#[derive(Clone, Copy, Debug)]
struct Quickest {
    seconds: f64,
    /// Upper bound on its delay.
    at_most_s: f64,
}

impl VehicleClock {
    /// The `ts1` of a request at `now`; `tc1` is 0.
    pub fn request(&mut self, now: HostTime) -> i64 {
        self.sync.request(now)
    }

    /// Takes an answer. Only an answer to an open request counts, and only once.
    pub fn answer(&mut self, now: HostTime, tc1: i64, ts1: i64) -> Answer {
        self.latest = now;
        let had_none = self.sync.estimate(now).is_none();
        let answer = self.sync.answer(now, tc1, ts1);
        if matches!(answer, Answer::Jump { .. }) {
            self.arrival = Arrival::default();
        }
        if had_none || matches!(answer, Answer::Jump { .. }) {
            (self.quickest, self.before_jump) = (None, None);
        }
        answer
    }

    /// Time between requests. It is short on a fast link while messages are late or the newest
    /// answers contradict the estimate, because the answers then show whether the clock slipped.
    pub fn period(&self) -> Duration {
        let is_in_doubt = self.is_late || self.sync.is_in_doubt();
        if is_in_doubt && self.sync.is_quick() {
            timesync::PERIOD_IN_DOUBT
        } else {
            timesync::PERIOD
        }
    }

    /// Takes the stamp of a message that just arrived; returns the message's delay.
    pub fn observe(&mut self, now: HostTime, stamp: VehicleTime) -> Delay {
        self.latest = now;
        let is_back = self.newest.is_some_and(|newest| stamp.seconds_since(newest) < -RESTART_S);
        if is_back {
            (self.arrival, self.newest) = Default::default();
        }
        self.newest = self.newest.max(Some(stamp));
        let before = self.estimate();
        self.arrival.observe(now, stamp);
        let Some(line) = before else { return Delay::default() };
        let seconds = (now.as_ns() as i64).saturating_sub(line.host_ns(stamp)) as f64 * 1e-9;
        let Some(error_ns) = line.error_ns else {
            return Delay { seconds, at_least_s: seconds };
        };
        let error_s = error_ns as f64 * 1e-9;
        if is_back || self.quickest.is_some_and(|it| it.seconds - seconds > RESTART_S) {
            let is_near = |it: &Quickest| (it.seconds - seconds).abs() <= RESTART_S;
            let returned = self.before_jump.take().filter(is_near);
            self.before_jump = std::mem::replace(&mut self.quickest, returned);
        }
        let first = Quickest { seconds, at_most_s: seconds + error_s };
        let quickest = self.quickest.get_or_insert(first);
        let delay = Delay {
            seconds: seconds - quickest.seconds,
            at_least_s: seconds - error_s - quickest.at_most_s,
        };
        quickest.seconds = quickest.seconds.min(first.seconds);
        quickest.at_most_s = quickest.at_most_s.min(first.at_most_s);
        self.is_late = delay.at_least_s > DOUBT_S;
        delay
    }

    /// The line as of the last arrival.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        self.sync.estimate(self.latest).or_else(|| self.arrival.estimate(self.latest))
    }

    /// Round trip of the newest answer.
    pub fn round_trip(&self) -> Option<Duration> {
        self.sync.round_trip()
    }

    /// Host time at which the vehicle's clock reads `time`.
    pub fn to_host(&self, time: VehicleTime) -> Option<HostTime> {
        self.estimate()?.to_host(time)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::link::clock_estimate::ns_between;
    const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);
    const BOOTED_S: f64 = 20.0;
    const LATE_S: f64 = 0.2;

    fn seconds(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    /// A vehicle whose clock runs at `1 + skew` and loses `stall_s` at `stall_at_s`.
    #[derive(Clone, Copy, Debug)]
    struct Model {
        skew: f64,
        stall_at_s: f64,
        stall_s: f64,
        is_answering: bool,
    }

    impl Model {
        /// The vehicle's clock, s, at `t` s of the host's.
        fn reads(&self, t: f64) -> f64 {
            let run = match t - self.stall_at_s {
                past if past <= 0.0 => t,
                past if past < self.stall_s => self.stall_at_s,
                _ => t - self.stall_s,
            };
            BOOTED_S + run * (1.0 + self.skew)
        }

        fn is_stalled(&self, t: f64) -> bool {
            (self.stall_at_s..self.stall_at_s + self.stall_s).contains(&t)
        }
    }

    /// The fate of a run's messages.
    #[derive(Debug, Default)]
    struct Run {
        /// Arrival of messages that no queue delayed and that are reported as late, s.
        wronged: Vec<f64>,
        /// Messages that a queue delayed by two and a half times the limit and that are not
        /// reported as late.
        missed: Vec<f64>,
        /// Largest error of the offset in the last second, s.
        error_s: f64,
    }

    /// `length_s` of messages at 100 Hz, each delayed by `transport` (s, a function of its number).
    /// Messages sent within `queue` (from, to; s) arrive at its end.
    fn run(model: Model, length_s: f64, queue: (f64, f64), transport: impl Fn(u32) -> f64) -> Run {
        let mut clock = VehicleClock::default();
        let mut run = Run::default();
        // (arrival, sent, the answer's ts1 where it is one, reading)
        let mut arriving: Vec<(f64, f64, Option<i64>, f64)> = Vec::new();
        let mut next_request = 0.0;
        for k in 0..(length_s * 1000.0) as u32 {
            let t = f64::from(k) * 1e-3;
            let now = START + seconds(t);
            let held = |sent: f64| if (queue.0..queue.1).contains(&sent) { queue.1 } else { sent };
            if k % 10 == 0 && !model.is_stalled(t) {
                arriving.push((held(t) + transport(k), t, None, model.reads(t)));
            }
            if model.is_answering && t >= next_request {
                next_request = t + clock.period().as_secs_f64();
                let ts1 = clock.request(now);
                // A stalled vehicle answers when it continues.
                let mut at = t + transport(k + 7);
                if model.is_stalled(at) {
                    at = model.stall_at_s + model.stall_s;
                }
                arriving.push((held(at) + transport(k + 3), at, Some(ts1), model.reads(at)));
            }
            // In the order in which they were sent: links are queues.
            arriving.sort_by(|a, b| a.1.total_cmp(&b.1));
            while arriving.first().is_some_and(|(due, ..)| *due <= t) {
                let (_, sent, ts1, reading) = arriving.remove(0);
                let us = (reading * 1e6) as u64;
                if let Some(ts1) = ts1 {
                    clock.answer(now, us as i64 * 1000, ts1);
                    continue;
                }
                let delay = clock.observe(now, VehicleTime::from_us(us));
                next_request = next_request.min(t + clock.period().as_secs_f64());
                let is_late = delay.at_least_s > LATE_S;
                let waited = t - sent;
                if is_late && waited < 0.5 * LATE_S {
                    run.wronged.push(t);
                }
                if !is_late && waited > 2.5 * LATE_S {
                    run.missed.push(t);
                }
                if t > length_s - 1.0 {
                    let truth = sent + START.as_ns() as f64 * 1e-9;
                    let host = clock.to_host(VehicleTime::from_us(us)).expect("known");
                    let error =
                        ns_between(START, host) * 1e-9 - (truth - START.as_ns() as f64 * 1e-9);
                    run.error_s = run.error_s.max(error.abs());
                }
            }
        }
        run
    }

    fn steady(skew: f64, is_answering: bool) -> Model {
        Model { skew, stall_at_s: f64::INFINITY, stall_s: 0.0, is_answering }
    }

    /// Transport times between `base` and `base + jitter`, s, mostly short.
    fn jittery(base: f64, jitter: f64, seed: u32) -> impl Fn(u32) -> f64 {
        move |k| {
            let number = f64::from(k.wrapping_mul(7919).wrapping_add(seed));
            let noise = (number * 0.618_033_988_75).fract();
            base + jitter * noise * noise
        }
    }

    const NO_QUEUE: (f64, f64) = (f64::INFINITY, f64::INFINITY);

    #[test]
    fn simulator_at_0_989_of_real_time_is_never_late() {
        for is_answering in [true, false] {
            let run = run(steady(-0.011, is_answering), 60.0, NO_QUEUE, |_| 0.001);
            assert!(run.wronged.is_empty(), "{is_answering}: {:?}", run.wronged);
            assert!(run.error_s < 0.02, "{is_answering}: {} s", run.error_s);
        }
    }

    #[test]
    fn vehicle_clock_stall_is_tracked_sooner_with_timesync() {
        let model = Model { stall_at_s: 5.0, stall_s: 0.43, ..steady(0.0, true) };
        let late = run(model, 12.0, NO_QUEUE, |_| 0.001);
        let until = late.wronged.iter().fold(0.0, |a: f64, b| a.max(*b));
        assert!(until < 5.43 + 0.06, "late until {until} s");
        let model = Model { is_answering: false, ..model };
        let late = run(model, 20.0, NO_QUEUE, |_| 0.001);
        let until = late.wronged.iter().fold(0.0, |a: f64, b| a.max(*b));
        assert!(until < 5.43 + 8.0, "late until {until} s");
    }

    #[test]
    fn queueing_delay_is_not_mistaken_for_clock_slip() {
        // A link that is cut for 1.5 s, and one that is 0.6 s behind for 30 s, starting at 10 s.
        for is_answering in [true, false] {
            let cut = run(steady(0.0, is_answering), 15.0, (8.0, 9.5), |_| 0.001);
            assert!(cut.missed.is_empty() && cut.wronged.is_empty(), "{is_answering}: {cut:?}");
        }
        let behind = |k: u32| if (10_000..40_000).contains(&k) { 0.6 } else { 0.001 };
        let behind = run(steady(0.0, true), 41.0, NO_QUEUE, behind);
        assert!(behind.missed.is_empty(), "from {:?} on", behind.missed.first());
    }

    #[test]
    fn timesync_clock_may_differ_from_the_timestamp_clock() {
        let mut clock = VehicleClock::default();
        for k in 0..500u32 {
            let now = START + Duration::from_millis(10) * k;
            if k % 10 == 0 {
                let ts1 = clock.request(now);
                // It answers with the time since 1970.
                clock.answer(now + Duration::from_micros(300), now.as_ns() as i64, ts1);
            }
            let delay = clock.observe(now, VehicleTime::from_us(u64::from(k) * 10_000));
            assert!(delay.at_least_s < 0.01 && delay.seconds < 0.01, "{delay:?}");
        }
    }

    #[test]
    fn delay_is_seen_where_two_clocks_stamp_the_messages() {
        let mut clock = VehicleClock::default();
        let mut at_least_s = |k: u32, delay_s: f64| {
            let now = START + Duration::from_millis(10) * k;
            let sent_s = 20.0 + f64::from(k) * 0.01;
            if k.is_multiple_of(10) {
                let ts1 = clock.request(now);
                clock.answer(now + Duration::from_micros(300), (sent_s * 1e9) as i64, ts1);
            }
            // Every third message has a stamp 3 s old.
            let old_s = if k.is_multiple_of(3) { 3.0 } else { 0.0 };
            let stamp = VehicleTime::from_us(((sent_s - old_s - delay_s) * 1e6) as u64);
            clock.observe(now, stamp).at_least_s
        };
        assert!((0..200).all(|k| at_least_s(k, 0.0) < 0.01));
        assert!((200..400).all(|k| at_least_s(k, 0.35) > 0.3));
    }

    #[test]
    fn vehicle_restart_does_not_count_as_late() {
        let mut clock = VehicleClock::default();
        let mut stamps = |from_s: f64, at_s: f64| {
            (0..300u32)
                .map(|k| {
                    let t = f64::from(k) * 0.01;
                    let stamp = VehicleTime::from_us(((from_s + t) * 1e6) as u64);
                    clock.observe(START + seconds(at_s + t), stamp).at_least_s
                })
                .fold(0.0, f64::max)
        };
        assert!(stamps(500.0, 0.0) < 1e-3);
        assert!(stamps(2.0, 3.0) < 1e-3);
    }

    proptest! {
        /// Whatever a vehicle sends, nothing overflows.
        #[test]
        fn arbitrary_stamps_and_answers_never_panic(heard in prop::collection::vec(any::<(u64, i64)>(), 1..60)) {
            let mut clock = VehicleClock::default();
            for (k, (us, tc1)) in heard.into_iter().enumerate() {
                let now = START + Duration::from_millis(300) * k as u32;
                let ts1 = clock.request(now);
                clock.answer(now + Duration::from_millis(1), tc1, ts1);
                let stamp = VehicleTime::from_us(us);
                let delay = clock.observe(now, stamp);
                prop_assert!(delay.seconds.is_finite() && delay.at_least_s.is_finite());
                clock.to_host(stamp);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        /// Over skews, jitter and round trips: no undelayed message counts as late, and every
        /// queued one does.
        #[test]
        fn only_queued_messages_count_as_late(
            skew in -0.05f64..0.05,
            is_answering: bool,
            base in 0.0005f64..0.03,
            jitter in 0.0f64..0.02,
            queue_at in 6.0f64..9.0,
            queue_s in 0.5f64..2.0,
            seed in 0u32..1000,
        ) {
            let queue = (queue_at, queue_at + queue_s);
            let run = run(steady(skew, is_answering), 14.0, queue, jittery(base, jitter, seed));
            prop_assert!(run.wronged.is_empty(), "late: {:?}", run.wronged);
            prop_assert!(run.missed.is_empty(), "not late: {:?}", run.missed);
        }

        /// A stall of any length below a second, at any skew and with jitter, is soon followed.
        #[test]
        fn clock_stalls_are_tracked(
            skew in -0.03f64..0.03,
            stall_at_s in 3.0f64..6.0,
            stall_s in 0.05f64..0.95,
            base in 0.0005f64..0.02,
            jitter in 0.0f64..0.02,
            seed in 0u32..1000,
        ) {
            let model = Model { skew, stall_at_s, stall_s, is_answering: true };
            let run = run(model, 12.0, NO_QUEUE, jittery(base, jitter, seed));
            let until = run.wronged.iter().fold(0.0, |a: f64, b| a.max(*b));
            prop_assert!(until < stall_at_s + stall_s + 0.3, "late until {until}");
            prop_assert!(run.error_s < 0.02 + 2.0 * (base + jitter), "{} s", run.error_s);
        }
    }
}
