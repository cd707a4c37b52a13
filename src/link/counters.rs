//! What the link counts: rates, losses, refusals.

use std::time::Duration;

use wire::{DecoderStats, Frame};

use super::timesync::ClockEstimate;
use crate::clock::HostTime;

/// Time over which rates are taken.
pub const RATE_WINDOW: Duration = Duration::from_secs(1);
/// Most senders whose sequence is followed.
const SENDERS_MAX: usize = 32;
/// A jump of the sequence beyond this is a restart or a swapped frame, not a loss.
const GAP_MAX: u8 = 100;

/// How the link is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinkState {
    /// No vehicle was heard yet.
    Searching,
    /// The vehicle is heard.
    Connected,
    /// The vehicle has been silent for a while.
    Stale,
    /// The vehicle is gone.
    Lost,
}

/// A snapshot of the link for the log and the status.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkStats {
    /// State.
    pub state: LinkState,
    /// System and component id of the vehicle.
    pub vehicle: Option<(u32, u8)>,
    /// What the decoders saw, all peers together.
    pub received: DecoderStats,
    /// Frames of other systems and components.
    pub foreign: u64,
    /// Frames with the vehicle's ids from a peer that is not the vehicle's.
    pub stray: u64,
    /// Frames of the vehicle whose content could not be true.
    pub refused: u64,
    /// Frames lost on the way, by gaps in senders' sequences.
    pub lost: u64,
    /// Frames sent.
    pub sent_frames: u64,
    /// Bytes sent.
    pub sent_bytes: u64,
    /// Round trip of the newest TIMESYNC answer.
    pub round_trip: Option<Duration>,
    /// The vehicle's clock against the host's.
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

#[derive(Clone, Copy, Debug)]
struct Arrivals {
    count: MessageCount,
    in_window: u32,
}

#[derive(Clone, Copy, Debug)]
struct Sender {
    system: u32,
    component: u8,
    sequence: u8,
}

/// Counts frames of all senders and messages of the vehicle.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) foreign: u64,
    pub(super) stray: u64,
    pub(super) refused: u64,
    pub(super) sent_frames: u64,
    pub(super) sent_bytes: u64,
    lost: u64,
    senders: Vec<Sender>,
    /// Sorted by id; the dialect bounds its length.
    arrivals: Vec<Arrivals>,
    window_start: HostTime,
}

impl Counters {
    /// Follows the sender's sequence.
    pub(super) fn sequence(&mut self, frame: &Frame) {
        let (system, component, sequence) = (frame.system(), frame.component(), frame.sequence());
        let is_room = self.senders.len() < SENDERS_MAX;
        let known =
            self.senders.iter_mut().find(|s| s.system == system && s.component == component);
        match known {
            Some(sender) => {
                let gap = sequence.wrapping_sub(sender.sequence).wrapping_sub(1);
                if gap <= GAP_MAX {
                    self.lost += u64::from(gap);
                }
                sender.sequence = sequence;
            }
            None if is_room => {
                self.senders.push(Sender { system, component, sequence });
            }
            None => {}
        }
    }

    /// Counts a message of the vehicle.
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

    /// Forgets the vehicle's messages.
    pub(super) fn restart(&mut self, now: HostTime) {
        self.arrivals.clear();
        self.window_start = now;
    }

    /// When the current window ends.
    pub(super) fn window_end(&self) -> HostTime {
        self.window_start + RATE_WINDOW
    }

    /// Takes the rates at the end of a window.
    pub(super) fn roll(&mut self, now: HostTime) {
        let seconds = now.since(self.window_start).as_secs_f64();
        for arrivals in &mut self.arrivals {
            arrivals.count.rate_hz = f64::from(arrivals.in_window) / seconds.max(1e-3);
            arrivals.in_window = 0;
        }
        self.window_start = now;
    }

    pub(super) fn lost(&self) -> u64 {
        self.lost
    }

    pub(super) fn messages(&self) -> Vec<MessageCount> {
        self.arrivals.iter().map(|arrivals| arrivals.count).collect()
    }
}

#[cfg(test)]
mod tests {
    use wire::dialect::MavMessage;
    use wire::{Decoder, Encoder};

    use super::*;

    #[test]
    fn gaps_are_counted_over_the_wrap_and_restarts_are_not() {
        let mut encoder = Encoder::new(1, 1);
        let mut counters = Counters::default();
        let mut decoder = Decoder::new();
        let heartbeat = MavMessage::HEARTBEAT(Default::default());
        for k in 0..300 {
            let mut bytes = Vec::new();
            encoder.encode(&heartbeat, &mut bytes);
            // Three frames are lost, one of them at the wrap.
            if ![100, 101, 255].contains(&k) {
                decoder.push(&bytes);
                counters.sequence(&decoder.next_frame().unwrap());
            }
        }
        assert_eq!(counters.lost(), 3);
        let mut bytes = Vec::new();
        Encoder::new(1, 1).encode(&heartbeat, &mut bytes);
        decoder.push(&bytes);
        counters.sequence(&decoder.next_frame().unwrap());
        assert_eq!(counters.lost(), 3, "a restart begins at zero");
    }

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
