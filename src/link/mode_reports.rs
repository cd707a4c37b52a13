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
/// Time for which a rejected copy is expected again. A true report that repeats its bytes then is
/// rejected too, but the vehicle's reports a second apart do so only by chance.
const COPY_EXPECTED: Duration = Duration::from_millis(900);

/// What a frame adds to what is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Newness {
    /// New content.
    New,
    /// Nothing: it was received before, or is older.
    Old,
    /// A mode report that may be an old one, or the vehicle's newest.
    Doubtful,
    /// A HEARTBEAT that reports stopped motors and may be an old one, or the vehicle's newest.
    DoubtfulArming,
}

/// A frame that reports the mode.
#[derive(Clone, Copy, Debug)]
pub(super) struct ModeReport<'a> {
    /// Its bytes.
    pub frame: &'a [u8],
    /// The reported mode.
    pub mode: u32,
    /// The mode in which setpoints are obeyed, where it is known.
    pub obeys: Option<u32>,
    /// Whether it reports armed motors; `None` where it says nothing of them, or a newer HEARTBEAT
    /// is known for certain.
    pub is_armed: Option<bool>,
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
pub(super) struct ModeReports {
    hashes: VecDeque<u32>,
    newest: Option<u32>,
    /// Whether the newest HEARTBEAT reports armed motors.
    is_armed: bool,
    last_arrival: HostTime,
    /// Whether no mode was reported since the last silence.
    is_in_doubt: bool,
    /// Whether the last report withdrew a permission, but seemed older than what is known.
    is_overtaken: bool,
    /// Copies rejected of late, each once, and when last; at most `REMEMBERED`.
    copies: VecDeque<(u32, HostTime)>,
}

impl ModeReports {
    /// Notes that a frame arrived from the vehicle.
    pub fn frame_arrived(&mut self, now: HostTime) {
        self.is_in_doubt |= now.since(self.last_arrival) > SILENCE;
        self.last_arrival = now;
    }

    /// Notes the copy of a mode report that its place in the sequence showed.
    pub fn copied(&mut self, now: HostTime, frame: &[u8]) {
        self.reject(now, crc32fast::hash(frame));
    }

    /// Notes a rejected copy. However many arrive, memory stays bounded.
    fn reject(&mut self, now: HostTime, hash: u32) {
        self.copies.retain(|(copy, at)| *copy != hash && now.since(*at) <= COPY_EXPECTED);
        if self.copies.len() == REMEMBERED {
            self.copies.pop_front();
        }
        self.copies.push_back((hash, now));
    }

    /// Whether a report was rejected as a copy of late.
    fn is_rejected(&self, hash: u32) -> bool {
        let is_late = |at: HostTime| self.last_arrival.since(at) <= COPY_EXPECTED;
        self.copies.iter().any(|(copy, at)| *copy == hash && is_late(*at))
    }

    /// Judges a mode report.
    ///
    /// A HEARTBEAT that reports stopped motors for the first time is not dropped even where its mode
    /// is: whether they are armed is then doubtful.
    pub fn judge(&mut self, report: &ModeReport) -> Newness {
        let is_repeated = self.hashes.contains(&crc32fast::hash(report.frame));
        let newness = self.judge_mode(report);
        match (newness, report.is_armed) {
            (Newness::New, Some(is_armed)) => self.is_armed = is_armed,
            (Newness::Old | Newness::Doubtful, Some(false)) if self.is_armed && !is_repeated => {
                return Newness::DoubtfulArming;
            }
            _ => {}
        }
        newness
    }

    /// Judges the mode of a report.
    ///
    /// A report grants permission if setpoints are obeyed in its mode and this is not known
    /// already. Such a report is doubtful if it copies an earlier one, or if its place in the
    /// vehicle's sequence is not settled. About one in eight true reports is doubtful because it
    /// equals an older one; the next one resolves that. A report that withdraws permission is
    /// doubtful, and not dropped, if it seems older than what is known and the places are not
    /// settled.
    ///
    /// A copy out of its place confirms no known mode, and makes another one doubtful: the vehicle
    /// may have left the copy's mode since. A copy that arrives again and again is in its place
    /// once by chance; it counts no more then.
    fn judge_mode(&mut self, report: &ModeReport) -> Newness {
        let ModeReport { frame, mode, obeys, is_newer, is_settled, is_next, .. } = *report;
        let is_known = !self.is_in_doubt && self.newest == Some(mode);
        if !is_newer {
            let withdraws = obeys.is_some_and(|obeys| obeys != mode) && !is_known;
            self.is_overtaken |= withdraws && is_settled;
            return if withdraws && !is_settled { Newness::Doubtful } else { Newness::Old };
        }
        let hash = crc32fast::hash(frame);
        let is_repeated = self.hashes.contains(&hash);
        if is_repeated && (!is_next || self.is_rejected(hash)) {
            self.reject(self.last_arrival, hash);
            return if is_known { Newness::Old } else { Newness::Doubtful };
        }
        let grants = obeys == Some(mode) && !is_known;
        if grants && (is_repeated || !is_settled) {
            return Newness::Doubtful;
        }
        if self.hashes.len() == REMEMBERED {
            self.hashes.pop_front();
        }
        self.hashes.push_back(hash);
        (self.newest, self.is_in_doubt, self.is_overtaken) = (Some(mode), false, false);
        Newness::New
    }

    /// Notes that the order of the frames is no longer settled. Returns whether the mode is in
    /// doubt by that: a report that seemed overtaken, and withdrew a permission, may have been the
    /// first after a restart of the vehicle.
    pub fn unsettled(&mut self) -> bool {
        std::mem::take(&mut self.is_overtaken)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OFFBOARD: u32 = 6;

    /// A report in sequence, while the order is settled.
    fn report(frame: &[u8], mode: u32) -> ModeReport<'_> {
        ModeReport {
            frame,
            mode,
            obeys: Some(OFFBOARD),
            is_armed: None,
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
        let mut reports = ModeReports::default();
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New);
        reports.frame_arrived(at(300));
        assert_eq!(reports.judge(&report(b"position 2", 3)), Newness::New);
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::Doubtful);
        assert_eq!(
            reports.judge(&report(b"offboard 3", 6)),
            Newness::New,
            "the pilot's switch is not a copy"
        );
        assert_eq!(
            reports.judge(&report(b"position 2", 3)),
            Newness::New,
            "a takeover is accepted at once"
        );
    }

    #[test]
    fn report_in_unsettled_order_revokes_but_never_grants() {
        let mut reports = ModeReports::default();
        let unsettled = |frame, mode| ModeReport { is_settled: false, ..report(frame, mode) };
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&report(b"position 1", 3)), Newness::New);
        assert_eq!(reports.judge(&unsettled(b"offboard 2", 6)), Newness::Doubtful);
        assert_eq!(reports.judge(&unsettled(b"return 3", 5)), Newness::New);
    }

    #[test]
    fn old_revoking_report_is_dropped_only_in_settled_order() {
        let mut reports = ModeReports::default();
        let older = |is_settled, mode| ModeReport {
            is_newer: false,
            is_settled,
            ..report(b"overtaken", mode)
        };
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New);
        assert_eq!(reports.judge(&older(true, 3)), Newness::Old);
        assert_eq!(reports.judge(&older(false, 3)), Newness::Doubtful);
        assert_eq!(reports.judge(&older(false, 6)), Newness::Old, "it would grant permission");
    }

    #[test]
    fn stopped_motors_are_doubtful_where_the_mode_is_overtaken() {
        let mut reports = ModeReports::default();
        let heartbeat = |frame, is_armed| ModeReport { is_armed, ..report(frame, OFFBOARD) };
        let overtaken = |frame| ModeReport { is_newer: false, ..heartbeat(frame, Some(false)) };
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&heartbeat(b"stopped 1", Some(false))), Newness::New);
        assert_eq!(reports.judge(&overtaken(b"stopped 2")), Newness::Old, "it is known");
        assert_eq!(reports.judge(&heartbeat(b"armed 3", Some(true))), Newness::New);
        assert_eq!(reports.judge(&overtaken(b"stopped 1")), Newness::Old, "received before");
        assert_eq!(reports.judge(&overtaken(b"stopped 4")), Newness::DoubtfulArming);
        let unsettled = ModeReport { is_settled: false, mode: 3, ..overtaken(b"stopped 5") };
        assert_eq!(reports.judge(&unsettled), Newness::DoubtfulArming);
        assert_eq!(reports.judge(&heartbeat(b"stopped 6", Some(false))), Newness::New);
        assert_eq!(reports.judge(&overtaken(b"stopped 7")), Newness::Old, "it is known again");
    }

    #[test]
    fn out_of_sequence_copy_does_not_confirm_the_mode() {
        let mut reports = ModeReports::default();
        let copy = |frame, mode| ModeReport { is_next: false, ..report(frame, mode) };
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&copy(b"offboard 1", 6)), Newness::New, "its first arrival");
        assert_eq!(reports.judge(&copy(b"offboard 1", 6)), Newness::Old);
        (1..4).for_each(|step| reports.frame_arrived(at(400 * step)));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New, "next in the sequence");
    }

    #[test]
    fn out_of_sequence_copy_does_not_show_another_mode() {
        let mut reports = ModeReports::default();
        let copy = |frame, mode| ModeReport { is_next: false, ..report(frame, mode) };
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&report(b"position 1", 3)), Newness::New);
        assert_eq!(reports.judge(&report(b"offboard 2", 6)), Newness::New);
        assert_eq!(reports.judge(&copy(b"position 1", 3)), Newness::Doubtful);
        assert_eq!(reports.judge(&copy(b"position 3", 3)), Newness::New, "never seen before");
        assert_eq!(reports.judge(&copy(b"position 1", 3)), Newness::Old, "it confirms nothing");
    }

    #[test]
    fn copy_that_keeps_arriving_confirms_nothing_even_in_its_place() {
        let mut reports = ModeReports::default();
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New);
        reports.copied(at(300), b"offboard 1");
        (1..4).for_each(|step| reports.frame_arrived(at(300 * step)));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::Old);
        (4..8).for_each(|step| reports.frame_arrived(at(300 * step)));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New, "copied long ago");
    }

    #[test]
    fn flood_of_copies_takes_no_more_memory() {
        let mut reports = ModeReports::default();
        for k in 0..10_000u32 {
            reports.copied(at(u64::from(k) / 100), &(k % 100).to_le_bytes());
        }
        assert_eq!(reports.copies.len(), REMEMBERED);
    }

    #[test]
    fn overtaken_report_puts_the_mode_in_doubt_once_the_order_is_unsettled() {
        let mut reports = ModeReports::default();
        let overtaken = ModeReport { is_newer: false, ..report(b"position 2", 3) };
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New);
        assert!(!reports.unsettled());
        assert_eq!(reports.judge(&overtaken), Newness::Old);
        assert!(reports.unsettled() && !reports.unsettled());
        assert_eq!(reports.judge(&overtaken), Newness::Old);
        assert_eq!(reports.judge(&report(b"offboard 3", 6)), Newness::New);
        assert!(!reports.unsettled(), "a newer report follows it");
    }

    #[test]
    fn copy_is_doubtful_only_after_a_silence_or_change() {
        let mut reports = ModeReports::default();
        reports.frame_arrived(at(0));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New);
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New, "it changes nothing");
        reports.frame_arrived(at(501));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::Doubtful);
        reports.frame_arrived(at(600));
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::Doubtful);
        assert_eq!(reports.judge(&report(b"offboard 7", 6)), Newness::New);
        assert_eq!(reports.judge(&report(b"offboard 1", 6)), Newness::New);
    }
}
