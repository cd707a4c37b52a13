//! Detects mode reports that repeat an earlier one byte for byte.
//!
//! HEARTBEAT and CURRENT_MODE carry no time. A copy that arrives after more frames than the
//! sequence remembers looks new, and would restore a permission that the vehicle has withdrawn
//! meanwhile.

use std::collections::VecDeque;
use std::time::Duration;

use crate::clock::HostTime;

/// Number of remembered reports: about ten seconds where both messages arrive.
const REMEMBERED: usize = 32;
/// Silence after which the mode may have changed.
const SILENCE: Duration = Duration::from_millis(500);

/// What a frame adds to what is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Newness {
    /// New content.
    New,
    /// Nothing: it was received before, or is older.
    Old,
    /// A mode report that may be an old one, or the vehicle's newest.
    Doubtful,
}

/// A frame that reports the mode.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModeWord<'a> {
    /// Its bytes.
    pub frame: &'a [u8],
    /// The reported mode.
    pub word: u32,
    /// The mode in which setpoints are obeyed, where it is known.
    pub obeys: Option<u32>,
    /// Whether its place in the vehicle's sequence is after that of the newest report.
    pub is_newer: bool,
    /// Whether the places of the last second are certain.
    pub is_settled: bool,
    /// Whether it follows the frame before it in the vehicle's sequence, which a copy does only by
    /// chance.
    pub is_next: bool,
}

/// The vehicle's recent mode reports.
#[derive(Debug, Default)]
pub(super) struct ModeWords {
    hashes: VecDeque<u32>,
    newest: Option<u32>,
    heard: HostTime,
    /// Whether no mode was reported since the last silence.
    is_in_doubt: bool,
}

impl ModeWords {
    /// Notes that a frame arrived from the vehicle.
    pub fn heard(&mut self, now: HostTime) {
        self.is_in_doubt |= now.since(self.heard) > SILENCE;
        self.heard = now;
    }

    /// Judges a mode report.
    ///
    /// A report grants permission if setpoints are obeyed in its mode and this is not known
    /// already. Such a report is doubtful if it copies an earlier one, or if its place in the
    /// vehicle's sequence is not settled. About one in eight true reports is doubtful because it
    /// equals an older one; the next one resolves that. A report that withdraws permission is
    /// doubtful, and not dropped, if it seems older than what is known and the places are not
    /// settled.
    ///
    /// A copy out of its place does not confirm a known permission either: the vehicle may have
    /// left the mode since.
    pub fn judge(&mut self, heard: &ModeWord) -> Newness {
        let ModeWord { frame, word, obeys, is_newer, is_settled, is_next } = *heard;
        let is_known = !self.is_in_doubt && self.newest == Some(word);
        if !is_newer {
            let takes = obeys.is_some_and(|obeys| obeys != word) && !is_known;
            return if takes && !is_settled { Newness::Doubtful } else { Newness::Old };
        }
        let hash = crc32fast::hash(frame);
        if obeys == Some(word) {
            let is_repeated = self.hashes.contains(&hash);
            match is_known {
                false if is_repeated || !is_settled => return Newness::Doubtful,
                true if is_repeated && !is_next => return Newness::Old,
                _ => {}
            }
        }
        if self.hashes.len() == REMEMBERED {
            self.hashes.pop_front();
        }
        self.hashes.push_back(hash);
        (self.newest, self.is_in_doubt) = (Some(word), false);
        Newness::New
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFBOARD: u32 = 6;

    /// A report in sequence, while the order is settled.
    fn word(frame: &[u8], word: u32) -> ModeWord<'_> {
        ModeWord {
            frame,
            word,
            obeys: Some(OFFBOARD),
            is_newer: true,
            is_settled: true,
            is_next: true,
        }
    }
    const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);

    fn at(ms: u64) -> HostTime {
        START + Duration::from_millis(ms)
    }

    #[test]
    fn repeated_report_restores_no_revoked_permission() {
        let mut words = ModeWords::default();
        words.heard(at(0));
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::New);
        words.heard(at(300));
        assert_eq!(words.judge(&word(b"position 2", 3)), Newness::New);
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::Doubtful);
        assert_eq!(
            words.judge(&word(b"offboard 3", 6)),
            Newness::New,
            "the pilot's switch is not a copy"
        );
        assert_eq!(
            words.judge(&word(b"position 2", 3)),
            Newness::New,
            "a takeover is accepted at once"
        );
    }

    #[test]
    fn report_in_unsettled_order_revokes_but_never_grants() {
        let mut words = ModeWords::default();
        let unsettled = |frame, mode| ModeWord { is_settled: false, ..word(frame, mode) };
        words.heard(at(0));
        assert_eq!(words.judge(&word(b"position 1", 3)), Newness::New);
        assert_eq!(words.judge(&unsettled(b"offboard 2", 6)), Newness::Doubtful);
        assert_eq!(words.judge(&unsettled(b"return 3", 5)), Newness::New);
    }

    #[test]
    fn old_revoking_report_is_dropped_only_in_settled_order() {
        let mut words = ModeWords::default();
        let older =
            |is_settled, mode| ModeWord { is_newer: false, is_settled, ..word(b"overtaken", mode) };
        words.heard(at(0));
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::New);
        assert_eq!(words.judge(&older(true, 3)), Newness::Old);
        assert_eq!(words.judge(&older(false, 3)), Newness::Doubtful);
        assert_eq!(words.judge(&older(false, 6)), Newness::Old, "it would grant permission");
    }

    #[test]
    fn out_of_sequence_copy_does_not_confirm_the_mode() {
        let mut words = ModeWords::default();
        let copy = |frame, mode| ModeWord { is_next: false, ..word(frame, mode) };
        words.heard(at(0));
        assert_eq!(words.judge(&copy(b"offboard 1", 6)), Newness::New, "its first arrival");
        assert_eq!(words.judge(&copy(b"offboard 1", 6)), Newness::Old);
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::New, "next in the sequence");
    }

    #[test]
    fn copy_is_doubtful_only_after_a_silence_or_change() {
        let mut words = ModeWords::default();
        words.heard(at(0));
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::New);
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::New, "it changes nothing");
        words.heard(at(501));
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::Doubtful);
        words.heard(at(600));
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::Doubtful);
        assert_eq!(words.judge(&word(b"offboard 7", 6)), Newness::New);
        assert_eq!(words.judge(&word(b"offboard 1", 6)), Newness::New);
    }
}
