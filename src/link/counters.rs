//! What the link counts: rates, losses, refusals.

use std::time::Duration;

use wire::DecoderStats;

use super::timesync::ClockEstimate;
use crate::clock::HostTime;

/// Time over which rates are taken.
pub const RATE_WINDOW: Duration = Duration::from_secs(1);
/// A step of the sequence beyond this is a restart, not a loss.
const STEP_MAX: u8 = 101;
/// Frames that were overtaken by up to so many others are late, not from a restart.
const LATE_MAX: u8 = 16;

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
    /// Frames of the vehicle that were heard.
    pub heard: u64,
    /// Frames of the vehicle that were lost on the way, by gaps in its sequence; less those that
    /// came late.
    pub lost: u64,
    /// Frames sent.
    pub sent_frames: u64,
    /// Bytes sent.
    pub sent_bytes: u64,
    /// Frames that the transport did not take.
    pub dropped: u64,
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

/// Counts frames and messages of the vehicle, and what is not its own.
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) foreign: u64,
    pub(super) stray: u64,
    pub(super) refused: u64,
    pub(super) sent_frames: u64,
    pub(super) sent_bytes: u64,
    pub(super) dropped: u64,
    heard: u64,
    lost: u64,
    /// That of the vehicle's newest frame.
    sequence: Option<u8>,
    /// Sorted by id; the dialect bounds its length.
    arrivals: Vec<Arrivals>,
    window_start: HostTime,
}

impl Counters {
    /// Follows the vehicle's sequence. An autopilot numbers the frames of each link by itself, so
    /// that nobody else's frames leave a gap.
    pub(super) fn sequence(&mut self, sequence: u8) {
        self.heard += 1;
        let Some(last) = self.sequence.replace(sequence) else { return };
        match sequence.wrapping_sub(last) {
            // The same frame again.
            0 => {}
            step @ 1..=STEP_MAX => self.lost += u64::from(step) - 1,
            // Overtaken, and counted as lost before.
            step if step > u8::MAX - LATE_MAX => {
                self.sequence = Some(last);
                self.lost = self.lost.saturating_sub(1);
            }
            _ => {}
        }
    }

    /// The vehicle is heard another way now, on which frames have other numbers.
    pub(super) fn rerouted(&mut self) {
        self.sequence = None;
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
        self.sequence = None;
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

    pub(super) fn heard(&self) -> u64 {
        self.heard
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
    use super::*;

    fn after(sequences: impl IntoIterator<Item = u8>) -> (u64, u64) {
        let mut counters = Counters::default();
        sequences.into_iter().for_each(|sequence| counters.sequence(sequence));
        (counters.heard(), counters.lost())
    }

    #[test]
    fn gaps_are_counted_over_the_wrap_and_restarts_are_not() {
        let sent = (0..300_u32).filter(|k| ![100, 101, 255].contains(k));
        assert_eq!(after(sent.map(|k| k as u8)), (297, 3));
        assert_eq!(after([150, 151, 0, 1]), (4, 0), "a restart begins at zero");
    }

    #[test]
    fn what_comes_late_or_twice_is_not_lost() {
        assert_eq!(after([7, 8, 10, 9, 11]), (5, 0));
        assert_eq!(after([254, 1, 255, 0, 2]), (5, 0));
        assert_eq!(after([7, 8, 8, 9, 9]), (5, 0));
    }

    #[test]
    fn another_way_has_other_numbers() {
        let mut counters = Counters::default();
        counters.sequence(10);
        counters.rerouted();
        counters.sequence(60);
        assert_eq!(counters.lost(), 0);
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
