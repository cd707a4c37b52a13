//! State messages that arrived too late to act on.

use std::fmt;
use std::time::Duration;

use crate::clock::HostTime;

/// Shortest time between events that report them.
const REPORT_PERIOD: Duration = Duration::from_secs(2);

/// Number and delay of late messages.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LateMessages {
    /// Number of late messages.
    pub count: u32,
    /// The longest delay beyond that of the fastest messages, s.
    pub worst_s: f64,
}

impl fmt::Display for LateMessages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let messages = if self.count == 1 { "message" } else { "messages" };
        write!(f, "{} state {messages} arrived up to {:.2} s late", self.count, self.worst_s)
    }
}

impl LateMessages {
    fn count(&mut self, seconds: f64) {
        self.count = self.count.saturating_add(1);
        self.worst_s = self.worst_s.max(seconds);
    }
}

/// Counts late messages, for the judgement of the state and for events.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lateness {
    /// Late messages since the last sample.
    pub(super) since_sample: LateMessages,
    unreported: LateMessages,
    reported_at: Option<HostTime>,
}

impl Lateness {
    pub(super) fn count(&mut self, seconds: f64) {
        self.since_sample.count(seconds);
        self.unreported.count(seconds);
    }

    /// The late messages to report now, if a report is due.
    pub(super) fn take(&mut self, now: HostTime) -> Option<LateMessages> {
        let is_due = self.reported_at.is_none_or(|at| now.since(at) >= REPORT_PERIOD);
        if self.unreported.count == 0 || !is_due {
            return None;
        }
        self.reported_at = Some(now);
        Some(std::mem::take(&mut self.unreported))
    }
}
