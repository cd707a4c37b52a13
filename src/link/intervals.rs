//! Message intervals: requested, verified by counting arrivals, requested again.
//!
//! An ACK proves nothing: PX4 accepts intervals for messages that it will never send. Another
//! ground station may lower a rate at any time. So only arrivals count.

use std::fmt;
use std::time::Duration;

use super::profile::MessageRate;
use crate::clock::HostTime;

/// Arrivals are counted for this long before they are judged.
pub const VERIFY: Duration = Duration::from_secs(2);
/// Longest wait for an ACK before the next request.
const ACK_WAIT: Duration = Duration::from_millis(300);
/// Time between requests for a rate that is not served.
const RETRY_SLOW: Duration = Duration::from_secs(10);
/// Requests at the full pace before slowing down.
const QUICK_TRIES: u32 = 3;
/// Share of a rate that counts as served: autopilots quantise rates to their own periods.
const SERVED: f64 = 0.7;
/// Fewest expected arrivals that allow a judgement.
const COUNT_MIN: f64 = 4.0;
/// Refused rates are halved down to this one, Hz.
const HZ_MIN: f64 = 1.0;

/// News about an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum IntervalEvent {
    /// A message arrives too rarely, and is requested again.
    Short {
        /// MAVLink message id.
        id: u32,
        /// Requested rate, Hz.
        requested_hz: f64,
        /// Rate of arrivals, Hz.
        found_hz: f64,
    },
    /// A message that arrived too rarely now arrives as requested.
    Served {
        /// MAVLink message id.
        id: u32,
        /// Rate of arrivals, Hz.
        found_hz: f64,
    },
    /// The vehicle refused a rate. A lower one is requested, or none where `next_hz` is `None`.
    Refused {
        /// MAVLink message id.
        id: u32,
        /// Refused rate, Hz.
        refused_hz: f64,
        /// The next rate to request, Hz.
        next_hz: Option<f64>,
    },
}

impl fmt::Display for IntervalEvent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Short { id, requested_hz, found_hz } => {
                write!(
                    f,
                    "message {id} arrives at {found_hz:.0} Hz, requested {requested_hz:.0} Hz again"
                )
            }
            Self::Served { id, found_hz } => {
                write!(f, "message {id} arrives at {found_hz:.0} Hz, as requested")
            }
            Self::Refused { id, refused_hz, next_hz: Some(next) } => {
                write!(f, "message {id} refused at {refused_hz:.0} Hz, requesting {next:.0} Hz")
            }
            Self::Refused { id, refused_hz, next_hz: None } => {
                write!(f, "message {id} refused at {refused_hz:.0} Hz and below, gave up")
            }
        }
    }
}

/// The start of a counted time.
#[derive(Clone, Copy, Debug)]
struct Count {
    since: HostTime,
    /// Arrivals before it.
    before: u64,
}

#[derive(Clone, Debug)]
struct Interval {
    id: u32,
    requested_hz: f64,
    /// When to request next; `None` from a request until the rate is found short.
    due: Option<HostTime>,
    tries: u32,
    given_up: bool,
    is_short: bool,
    /// Arrivals since the last request or judgement; `None` before the first request.
    counted: Option<Count>,
}

impl Interval {
    /// Time for which arrivals are counted.
    fn span(&self) -> Duration {
        VERIFY.max(
            Duration::try_from_secs_f64(COUNT_MIN / self.requested_hz).unwrap_or(Duration::MAX),
        )
    }
}

/// The requested message intervals of one vehicle.
#[derive(Debug, Default)]
pub struct Intervals {
    intervals: Vec<Interval>,
    /// Index of the message with a pending ACK, and the end of the wait.
    awaiting: Option<(usize, HostTime)>,
}

impl Intervals {
    /// Replaces the requested messages.
    pub fn start(&mut self, now: HostTime, messages: &[MessageRate]) {
        self.awaiting = None;
        self.intervals.clear();
        self.intervals.extend(messages.iter().filter(|rate| rate.hz > 0.0).map(|rate| Interval {
            id: rate.id,
            requested_hz: rate.hz,
            due: Some(now),
            tries: 0,
            given_up: false,
            is_short: false,
            counted: None,
        }));
    }

    /// Removes all requested messages.
    pub fn stop(&mut self) {
        self.awaiting = None;
        self.intervals.clear();
    }

    /// Whether a message is requested.
    pub fn is_requested(&self, id: u32) -> bool {
        self.intervals.iter().any(|interval| interval.id == id)
    }

    /// The next message to request, if one is due. Requests go out one at a time, because an ACK
    /// does not name the message. `total` returns the number of arrivals of a message so far: those
    /// before the request, as from an earlier session of the vehicle, do not answer it.
    pub fn next_request(
        &mut self,
        now: HostTime,
        total: impl Fn(u32) -> u64,
    ) -> Option<MessageRate> {
        if self.awaiting.is_some_and(|(_, until)| now < until) {
            return None;
        }
        self.awaiting = None;
        let index = self.intervals.iter().position(|w| w.due.is_some_and(|due| due <= now))?;
        let interval = &mut self.intervals[index];
        interval.due = None;
        interval.tries += 1;
        interval.counted = Some(Count { since: now, before: total(interval.id) });
        self.awaiting = Some((index, now + ACK_WAIT));
        Some(MessageRate { id: interval.id, hz: interval.requested_hz })
    }

    /// Takes the ACK of the last request.
    pub fn acknowledged(&mut self, now: HostTime, accepted: bool) -> Option<IntervalEvent> {
        let (index, _) = self.awaiting.take()?;
        let interval = self.intervals.get_mut(index)?;
        if accepted {
            return None;
        }
        let refused_hz = interval.requested_hz;
        let next_hz = (refused_hz / 2.0 >= HZ_MIN).then_some(refused_hz / 2.0);
        match next_hz {
            Some(hz) => {
                interval.requested_hz = hz;
                interval.due = Some(now);
            }
            None => interval.given_up = true,
        }
        Some(IntervalEvent::Refused { id: interval.id, refused_hz, next_hz })
    }

    /// Judges the arrivals; `total` returns the number of arrivals of a message so far.
    pub fn verify(
        &mut self,
        now: HostTime,
        total: impl Fn(u32) -> u64,
        mut on_event: impl FnMut(IntervalEvent),
    ) {
        for interval in self.intervals.iter_mut().filter(|interval| !interval.given_up) {
            let Some(Count { since, before }) = interval.counted else { continue };
            let span = now.since(since);
            if span < interval.span() {
                continue;
            }
            let count = total(interval.id);
            let found_hz = count.saturating_sub(before) as f64 / span.as_secs_f64();
            interval.counted = Some(Count { since: now, before: count });
            let (id, requested_hz) = (interval.id, interval.requested_hz);
            if found_hz >= SERVED * requested_hz {
                interval.tries = 0;
                if std::mem::take(&mut interval.is_short) {
                    on_event(IntervalEvent::Served { id, found_hz });
                }
            } else if interval.due.is_none() {
                let pause = if interval.tries < QUICK_TRIES { Duration::ZERO } else { RETRY_SLOW };
                interval.due = Some(now + pause);
                if !std::mem::replace(&mut interval.is_short, true) {
                    on_event(IntervalEvent::Short { id, requested_hz, found_hz });
                }
            }
        }
    }

    /// When the next request or judgement is due.
    pub fn next_deadline(&self) -> Option<HostTime> {
        let blocked_until = self.awaiting.map(|(_, until)| until);
        let request = self.intervals.iter().filter_map(|interval| interval.due).min();
        let request = request.map(|due| blocked_until.map_or(due, |until| due.max(until)));
        let open = self.intervals.iter().filter(|interval| !interval.given_up);
        let judgement = open.filter_map(|open| Some(open.counted?.since + open.span())).min();
        [request, judgement].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: HostTime = HostTime::from_ns(0);
    const ATTITUDE: MessageRate = MessageRate { id: 31, hz: 100.0 };

    fn at(seconds: f64) -> HostTime {
        START + Duration::from_secs_f64(seconds)
    }

    fn request(intervals: &mut Intervals, now: HostTime, total: u64) -> Option<MessageRate> {
        intervals.next_request(now, |_| total)
    }

    fn verify(intervals: &mut Intervals, now: HostTime, total: u64) -> Vec<IntervalEvent> {
        let mut events = Vec::new();
        intervals.verify(now, |_| total, |event| events.push(event));
        events
    }

    #[test]
    fn only_one_interval_request_is_pending() {
        let mut intervals = Intervals::default();
        let position = MessageRate { id: 32, hz: 50.0 };
        intervals.start(START, &[ATTITUDE, position]);
        assert_eq!(request(&mut intervals, START, 0), Some(ATTITUDE));
        assert_eq!(request(&mut intervals, START, 0), None);
        intervals.acknowledged(START, true);
        assert_eq!(request(&mut intervals, START, 0), Some(position));
        // Without an ACK, the next request waits for its time.
        assert_eq!(request(&mut intervals, at(0.2), 0), None);
    }

    #[test]
    fn rate_lowered_by_another_station_is_requested_again() {
        let mut intervals = Intervals::default();
        intervals.start(START, &[ATTITUDE]);
        request(&mut intervals, START, 0);
        intervals.acknowledged(START, true);
        assert_eq!(verify(&mut intervals, at(2.0), 198), []);
        assert_eq!(request(&mut intervals, at(2.0), 198), None);
        let short = IntervalEvent::Short { id: 31, requested_hz: 100.0, found_hz: 4.0 };
        assert_eq!(verify(&mut intervals, at(4.0), 206), [short]);
        assert_eq!(request(&mut intervals, at(4.0), 206), Some(ATTITUDE));
        intervals.acknowledged(at(4.0), true);
        let served = IntervalEvent::Served { id: 31, found_hz: 100.0 };
        assert_eq!(verify(&mut intervals, at(6.0), 406), [served]);
    }

    #[test]
    fn arrivals_before_a_request_do_not_answer_it() {
        let mut intervals = Intervals::default();
        // The vehicle was lost and is back: its messages are counted on.
        intervals.start(START, &[ATTITUDE]);
        assert_eq!(verify(&mut intervals, at(2.0), 5000), []);
        request(&mut intervals, at(2.0), 5000);
        intervals.acknowledged(at(2.0), true);
        assert_eq!(verify(&mut intervals, at(3.9), 5008), []);
        let short = IntervalEvent::Short { id: 31, requested_hz: 100.0, found_hz: 4.0 };
        assert_eq!(verify(&mut intervals, at(4.0), 5008), [short]);
    }

    #[test]
    fn missing_message_is_requested_less_and_less_often() {
        let mut intervals = Intervals::default();
        intervals.start(START, &[ATTITUDE]);
        let mut requests = 0;
        for k in 0..300 {
            let now = at(f64::from(k) * 0.1);
            if request(&mut intervals, now, 0).is_some() {
                requests += 1;
                intervals.acknowledged(now, true);
            }
            verify(&mut intervals, now, 0);
        }
        assert!((4..=6).contains(&requests), "{requests}");
    }

    #[test]
    fn refused_rate_is_halved_and_then_abandoned() {
        let mut intervals = Intervals::default();
        intervals.start(START, &[MessageRate { id: 331, hz: 2.0 }]);
        request(&mut intervals, START, 0);
        let halved = intervals.acknowledged(START, false);
        assert!(matches!(halved, Some(IntervalEvent::Refused { next_hz: Some(1.0), .. })));
        assert_eq!(request(&mut intervals, START, 0), Some(MessageRate { id: 331, hz: 1.0 }));
        let last = intervals.acknowledged(START, false);
        assert!(matches!(last, Some(IntervalEvent::Refused { next_hz: None, .. })));
        assert_eq!(request(&mut intervals, at(60.0), 0), None);
        assert_eq!(intervals.next_deadline(), None);
    }
}
