//! The link's counters: rates, losses, rejections.

use std::fmt;
use std::time::Duration;

use message::Inbound;
use message::codec::{self, Refusal};
use wire::{DecoderStats, Frame};

use super::vehicle_clock::ClockEstimate;
use crate::clock::HostTime;

/// Window over which rates are measured.
pub const RATE_WINDOW: Duration = Duration::from_secs(1);

/// State of the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkState {
    /// No vehicle was found yet.
    Searching,
    /// The vehicle's messages arrive.
    Connected,
    /// The vehicle has been silent for a while.
    Stale,
    /// The vehicle is gone.
    Lost,
}

/// A snapshot of the link for the log and the status.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkStats {
    /// State of the link.
    pub state: LinkState,
    /// System and component id of the vehicle.
    pub vehicle: Option<(u32, u8)>,
    /// Statistics of the decoders, all peers together.
    pub received: DecoderStats,
    /// Frames from other systems and components.
    pub foreign: u64,
    /// Frames with the vehicle's ids from a peer that is not the vehicle's.
    pub stray: u64,
    /// Frames from the vehicle whose content is impossible.
    pub refused: u64,
    /// Frames received from the vehicle.
    pub vehicle_frames: u64,
    /// Frames from the vehicle that were lost on the way, counted from gaps in its sequence, less
    /// those that arrived late.
    pub lost: u64,
    /// Frames from the vehicle that were repeated, or older than others with newer values.
    pub repeated: u64,
    /// Frames sent.
    pub sent_frames: u64,
    /// Bytes sent.
    pub sent_bytes: u64,
    /// Frames that the transport did not take.
    pub dropped: u64,
    /// Round trip of the newest TIMESYNC answer.
    pub round_trip: Option<Duration>,
    /// The vehicle's clock relative to the host's.
    pub clock: Option<ClockEstimate>,
    /// The vehicle's messages by id.
    pub messages: Vec<MessageCount>,
}

/// Arrivals of one message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MessageCount {
    /// MAVLink message id.
    pub id: u32,
    /// Arrivals since the vehicle was found.
    pub total: u64,
    /// Arrivals per second over the last full window.
    pub rate_hz: f64,
}

/// A sender besides the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sender {
    /// System id.
    pub system: u32,
    /// Component id.
    pub component: u8,
    /// MAV_AUTOPILOT and MAV_TYPE, once its HEARTBEAT arrived.
    pub kind: Option<(u8, u8)>,
    /// Number of its frames.
    pub frames: u64,
}

impl fmt::Display for Sender {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "system {} component {}", self.system, self.component)?;
        match self.kind {
            Some((autopilot, kind)) => write!(f, " (autopilot {autopilot}, type {kind})"),
            None => write!(f, " (no HEARTBEAT)"),
        }
    }
}

/// Most senders that are remembered.
const SENDERS_MAX: usize = 32;

/// Messages of one kind that were rejected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefusalCount {
    /// MAVLink message id.
    pub id: u32,
    /// Why the newest of them was rejected.
    pub refusal: Refusal,
    /// Their number since the vehicle was found.
    pub count: u64,
}

#[derive(Clone, Copy, Debug)]
struct Arrivals {
    count: MessageCount,
    in_window: u32,
}

/// Counts the vehicle's frames and messages, and those of other senders.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) foreign: u64,
    pub(super) stray: u64,
    pub(super) refused: u64,
    /// Frames received from the vehicle.
    pub(super) vehicle_frames: u64,
    pub(super) repeated: u64,
    refusals: Vec<RefusalCount>,
    senders: Vec<Sender>,
    pub(super) sent_frames: u64,
    pub(super) sent_bytes: u64,
    pub(super) dropped: u64,
    /// Sorted by id; the dialect bounds its length.
    arrivals: Vec<Arrivals>,
    window_start: HostTime,
}

impl Counters {
    /// Counts a frame from another sender.
    pub(super) fn foreign(&mut self, frame: &Frame) {
        self.foreign += 1;
        let (system, component) = (frame.system(), frame.component());
        let is_it = |s: &&mut Sender| (s.system, s.component) == (system, component);
        let kind = (frame.id() == 0).then(|| codec::heartbeat(frame.payload()));
        let kind = kind.and_then(|message| match message {
            Inbound::Heartbeat { autopilot, vehicle_type, .. } => Some((autopilot, vehicle_type)),
            _ => None,
        });
        if let Some(known) = self.senders.iter_mut().find(is_it) {
            known.frames += 1;
            known.kind = kind.or(known.kind);
        } else if self.senders.len() < SENDERS_MAX {
            self.senders.push(Sender { system, component, kind, frames: 1 });
        }
    }

    /// Removes the vehicle from the other senders.
    pub(super) fn is_vehicle(&mut self, system: u8, component: u8) {
        self.senders.retain(|s| (s.system, s.component) != (system.into(), component));
    }

    pub(super) fn senders(&self) -> &[Sender] {
        &self.senders
    }

    /// Counts a message from the vehicle with impossible content.
    pub(super) fn refuse(&mut self, id: u32, refusal: Refusal) {
        self.refused += 1;
        match self.refusals.iter_mut().find(|known| known.id == id) {
            Some(known) => (known.refusal, known.count) = (refusal, known.count + 1),
            None => self.refusals.push(RefusalCount { id, refusal, count: 1 }),
        }
    }

    pub(super) fn refusals(&self) -> &[RefusalCount] {
        &self.refusals
    }

    /// Counts a message from the vehicle.
    pub(super) fn arrival(&mut self, id: u32) {
        match self.arrivals.binary_search_by_key(&id, |arrivals| arrivals.count.id) {
            Ok(index) => {
                let arrivals = &mut self.arrivals[index];
                arrivals.in_window += 1;
                arrivals.count.total += 1;
            }
            Err(index) => {
                let count = MessageCount { id, total: 1, rate_hz: 0.0 };
                self.arrivals.insert(index, Arrivals { count, in_window: 1 });
            }
        }
    }

    /// Arrivals of a message since the vehicle was found.
    pub(super) fn total(&self, id: u32) -> u64 {
        let found = self.arrivals.binary_search_by_key(&id, |arrivals| arrivals.count.id);
        found.map_or(0, |index| self.arrivals[index].count.total)
    }

    /// Forgets the vehicle's messages, and starts a window.
    pub(super) fn restart(&mut self, now: HostTime) {
        self.arrivals.clear();
        self.refusals.clear();
        self.window_start = now;
    }

    /// The end of the present window.
    pub(super) fn window_end(&self) -> HostTime {
        self.window_start + RATE_WINDOW
    }

    /// Computes the rates at the end of a window.
    pub(super) fn roll(&mut self, now: HostTime) {
        let seconds = now.since(self.window_start).as_secs_f64();
        for arrivals in &mut self.arrivals {
            arrivals.count.rate_hz = f64::from(arrivals.in_window) / seconds.max(1e-3);
            arrivals.in_window = 0;
        }
        self.window_start = now;
    }

    pub(super) fn messages(&self) -> Vec<MessageCount> {
        self.arrivals.iter().map(|arrivals| arrivals.count).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_arrivals_per_second() {
        let mut counters = Counters::default();
        let start = HostTime::from_ns(0);
        counters.restart(start);
        (0..100).for_each(|_| counters.arrival(31));
        counters.arrival(0);
        counters.roll(start + Duration::from_secs(2));
        let rates: Vec<_> = counters.messages().iter().map(|m| (m.id, m.rate_hz)).collect();
        assert_eq!(rates, [(0, 0.5), (31, 50.0)]);
        assert_eq!(counters.total(31), 100);
    }
}
