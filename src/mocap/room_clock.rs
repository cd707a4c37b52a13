//! The room's clock relative to the host's, from the stamps alone: a room's clock is never queried.
//!
//! `arrival - stamp` is least for the fastest sample. That least offset is the clock, late by the
//! shortest transport time, which `mocap.latency_s` gives. It may rise slowly, because crystals
//! differ.

/// Fastest rise of the least offset, s per s: crystals differ by less.
const DRIFT: f64 = 2e-4;
/// Lead of a stamp beyond which the room's clock was set, s.
const AHEAD_MAX_S: f64 = 0.1;

/// A stamp further ahead than any queue explains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ahead;

/// The room's clock as an offset to the host's.
#[derive(Clone, Copy, Debug, Default)]
pub struct RoomClock {
    /// Least offset, host less room, s, and the host time at which it was known, s.
    line: Option<(f64, f64)>,
}

impl RoomClock {
    /// Takes the stamp, s of the room's clock, of a sample that arrived at `now_s` of the host's.
    ///
    /// # Errors
    /// [`Ahead`]: the room's clock was set. The offset stays unchanged.
    pub fn observe(&mut self, now_s: f64, stamp_s: f64) -> Result<(), Ahead> {
        let offset = now_s - stamp_s;
        let Some(known) = self.offset_s(now_s) else {
            self.line = Some((offset, now_s));
            return Ok(());
        };
        if offset < known - AHEAD_MAX_S {
            return Err(Ahead);
        }
        self.line = Some((offset.min(known), now_s));
        Ok(())
    }

    /// The host time, s, at which the room's clock reads `stamp_s`, as known at `now_s`.
    pub fn host_s(&self, now_s: f64, stamp_s: f64) -> Option<f64> {
        self.offset_s(now_s).map(|offset| stamp_s + offset)
    }

    fn offset_s(&self, now_s: f64) -> Option<f64> {
        // A second of silence lets it rise no more than a second of frames.
        self.line.map(|(offset, at)| offset + DRIFT * (now_s - at).clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Whatever the jitter, stamps are placed between the truth and the shortest delay.
        #[test]
        fn fastest_frames_define_the_clock(
            apart in -1e6..1e6f64, skew in -5e-5..5e-5f64,
            ways in prop::collection::vec(0.001..0.03f64, 300..600),
        ) {
            let mut clock = RoomClock::default();
            let room = |t: f64| t * (1.0 + skew) + apart;
            for (k, way) in ways.iter().enumerate() {
                let t = 0.01 * k as f64;
                // Every tenth frame is not delayed.
                let way = if k % 10 == 0 { 0.001 } else { *way };
                clock.observe(t + way, room(t)).expect("the clock was never set");
                let placed = clock.host_s(t + way, room(t)).expect("it is known");
                prop_assert!(placed > t + 0.001 - 2e-4 && placed < t + 0.001 + 5e-4, "{placed} {t}");
            }
        }
    }

    #[test]
    fn clock_set_ahead_is_detected_and_ignored() {
        let mut clock = RoomClock::default();
        assert_eq!(clock.observe(10.0, 3.0), Ok(()));
        assert_eq!(clock.observe(10.1, 4.0), Err(Ahead));
        let placed = clock.host_s(10.1, 3.1).expect("it is known");
        assert!((placed - 10.1 - DRIFT * 0.1).abs() < 1e-9, "{placed}");
    }
}
