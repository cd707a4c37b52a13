//! Words of the mode that were heard before, byte for byte.
//!
//! HEARTBEAT and CURRENT_MODE bear no time. A copy that comes after more frames than the sequence
//! remembers looks new, and would give back a permission that the vehicle has taken meanwhile.

use std::collections::VecDeque;
use std::time::Duration;

use crate::clock::HostTime;

/// Words that are remembered: some ten seconds of them where both messages come.
const REMEMBERED: usize = 32;
/// After such a silence the mode may have changed.
const SILENCE: Duration = Duration::from_millis(500);

/// What the vehicle said of its mode lately.
#[derive(Debug, Default)]
pub(super) struct ModeWords {
    hashes: VecDeque<u32>,
    newest: Option<u32>,
    heard: HostTime,
    /// Nothing was said of the mode since the link was silent.
    is_in_doubt: bool,
}

impl ModeWords {
    /// A frame of the vehicle came.
    pub fn heard(&mut self, now: HostTime) {
        self.is_in_doubt |= now.since(self.heard) > SILENCE;
        self.heard = now;
    }

    /// Whether a frame that says `word` is believed. A copy of one that was heard before is not,
    /// where it says that setpoints are obeyed, by the mode `obeys`, and that is not known anyway:
    /// about one in eight true words is doubted by that then, and the next tells the same. Neither is
    /// one whose place among the vehicle's frames is not settled.
    pub fn is_believed(
        &mut self,
        frame: &[u8],
        word: u32,
        obeys: Option<u32>,
        is_settled: bool,
    ) -> bool {
        let hash = crc32fast::hash(frame);
        let gives = obeys == Some(word) && (self.is_in_doubt || self.newest != Some(word));
        if gives && (!is_settled || self.hashes.contains(&hash)) {
            return false;
        }
        if self.hashes.len() == REMEMBERED {
            self.hashes.pop_front();
        }
        self.hashes.push_back(hash);
        (self.newest, self.is_in_doubt) = (Some(word), false);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OBEYS: Option<u32> = Some(6);
    const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);

    fn at(ms: u64) -> HostTime {
        START + Duration::from_millis(ms)
    }

    #[test]
    fn a_copy_gives_back_no_permission_that_was_taken() {
        let mut words = ModeWords::default();
        words.heard(at(0));
        assert!(words.is_believed(b"offboard 1", 6, OBEYS, true));
        words.heard(at(300));
        assert!(words.is_believed(b"position 2", 3, OBEYS, true));
        assert!(!words.is_believed(b"offboard 1", 6, OBEYS, true));
        assert!(words.is_believed(b"offboard 3", 6, OBEYS, true), "the pilot's switch is none");
        assert!(
            words.is_believed(b"position 2", 3, OBEYS, true),
            "who takes over is believed at once"
        );
    }

    #[test]
    fn a_word_without_a_place_takes_and_does_not_give() {
        let mut words = ModeWords::default();
        words.heard(at(0));
        assert!(words.is_believed(b"position 1", 3, OBEYS, true));
        assert!(!words.is_believed(b"offboard 2", 6, OBEYS, false));
        assert!(words.is_believed(b"return 3", 5, OBEYS, false));
    }

    #[test]
    fn after_a_silence_a_copy_says_nothing_and_while_all_is_known_it_may_come() {
        let mut words = ModeWords::default();
        words.heard(at(0));
        assert!(words.is_believed(b"offboard 1", 6, OBEYS, true));
        assert!(words.is_believed(b"offboard 1", 6, OBEYS, true), "it tells nothing new");
        words.heard(at(501));
        assert!(!words.is_believed(b"offboard 1", 6, OBEYS, true));
        words.heard(at(600));
        assert!(!words.is_believed(b"offboard 1", 6, OBEYS, true));
        assert!(words.is_believed(b"offboard 7", 6, OBEYS, true));
        assert!(words.is_believed(b"offboard 1", 6, OBEYS, true));
    }
}
