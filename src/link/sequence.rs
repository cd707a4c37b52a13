//! The order in which the vehicle sent its frames, from their sequence numbers.
//!
//! A second radio, or a forked route, delivers frames twice, late and out of order. A late frame's
//! mode is then older than the known one. The number wraps after 256 frames, which a fast link
//! sends in half a second: a later copy is recognised by its bytes.

use std::time::Duration;

use crate::clock::HostTime;

/// A step of the sequence up to this size is a loss of the frames in between.
const STEP_MAX: u8 = 101;
/// A frame that up to this many others overtook is late; beyond that, the sequence restarted.
const BEHIND_MAX: u64 = 100;
/// After this many frames behind the newest, with no newer one in between, the sequence restarted.
const RESTART: u32 = 8;
/// Silence after which the sequence is unknown.
const SILENCE: Duration = Duration::from_secs(1);
/// Time after a restart, or after a step beyond the sender's pace, for which the order is not
/// settled: it may be an old frame, or frames that arrive a hundred late.
const UNSETTLED: Duration = Duration::from_secs(1);
/// Least time over which the rate of the frames is measured.
const PACE_SPAN: Duration = Duration::from_secs(1);
/// Remembered frames with one number.
const WRAPS: usize = 4;
/// A copy of the link's frames continues within this many numbers.
const COPY_STEP_MAX: u8 = 8;
/// A copied stream counts as present for this many frames after its last copy.
const COPY_ALIVE: u64 = 64;

/// The place of a frame in the sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// Sent after all received frames; its place.
    New(u64),
    /// Sent before other received frames; its place.
    Overtaken(u64),
    /// Received before.
    Copy,
}

#[derive(Clone, Copy, Debug, Default)]
struct ReceivedFrame {
    place: u64,
    hash: u32,
}

/// Follows the sequence of one sender. An autopilot numbers the frames of each link separately, so
/// other senders' frames leave no gap.
#[derive(Debug)]
pub(super) struct Sequence {
    /// By number: the newest frames with that number. Places begin at 256, so 0 means none.
    received: Box<[[ReceivedFrame; WRAPS]; 256]>,
    /// Place of the newest frame; its lowest byte is its number. `None` where any number may
    /// follow.
    newest: Option<u64>,
    /// The highest place given so far. No place is given twice.
    floor: u64,
    /// Place of the newest copy, and of the newest frame when the copy arrived.
    copy: Option<(u64, u64)>,
    /// Consecutive frames that were behind.
    behind: u32,
    at: HostTime,
    /// When the sequence last seemed to restart, or stepped faster than the sender counts.
    anew: Option<HostTime>,
    pace: Pace,
    lost: u64,
}

/// How fast the sender counts.
#[derive(Debug, Default)]
struct Pace {
    /// Begin of the measurement, and the place then.
    from: Option<(HostTime, u64)>,
    /// Frames per second in the last full measurement.
    per_s: f64,
}

impl Pace {
    fn count(&mut self, now: HostTime, place: u64) {
        let (since, first) = *self.from.get_or_insert((now, place));
        let passed = now.since(since);
        if passed >= PACE_SPAN {
            self.per_s = place.saturating_sub(first) as f64 / passed.as_secs_f64();
            self.from = Some((now, place));
        }
    }

    /// Frames that the sender counts in `time`.
    fn frames(&self, time: Duration) -> f64 {
        self.per_s * time.as_secs_f64()
    }
}

impl Default for Sequence {
    fn default() -> Self {
        Self {
            received: Box::new([[ReceivedFrame::default(); WRAPS]; 256]),
            newest: None,
            floor: 256,
            copy: None,
            behind: 0,
            at: HostTime::default(),
            anew: None,
            pace: Pace::default(),
            lost: 0,
        }
    }
}

impl Sequence {
    /// Frames lost on the way, less those that arrived late.
    pub(super) fn lost(&self) -> u64 {
        self.lost
    }

    /// Whether a frame with this number follows the newest without a gap.
    pub(super) fn is_next(&self, number: u8) -> bool {
        self.newest.is_some_and(|newest| number == (newest as u8).wrapping_add(1))
    }

    /// Whether the sequence recently seemed to restart, was silent for so long that its numbers may
    /// have wrapped, or went on faster than the sender counts.
    pub(super) fn is_unsettled(&self, now: HostTime) -> bool {
        self.anew.is_some_and(|anew| now.since(anew) < UNSETTLED)
    }

    /// Accepts any number in the next frame, because the vehicle or the path to it is another.
    pub(super) fn restart(&mut self) {
        (self.newest, self.copy, self.behind) = (None, None, 0);
    }

    /// Places a frame that arrived. `is_unique` means that no other frame has the same bytes, as
    /// with frames that contain a time.
    pub(super) fn take(
        &mut self,
        now: HostTime,
        number: u8,
        bytes: &[u8],
        is_unique: bool,
    ) -> Order {
        let hash = hash(bytes);
        let passed = now.since(self.at);
        let is_silent = passed > SILENCE;
        self.at = now;
        let Some(newest) = self.newest else { return self.begin(now, number, hash) };
        if let Some(place) = self.copied(newest, number, hash, is_unique) {
            self.copy = Some((place, newest));
            return Order::Copy;
        }
        let step = number.wrapping_sub(newest as u8);
        let after_copy = self.copy_place(newest, number);
        let counted = self.pace.frames(passed);
        let may_have_wrapped = counted > f64::from(STEP_MAX);
        // A loss takes time. A step that takes none may be an old frame that is sent again, and the
        // frames that follow then seem overtaken.
        let is_hasty =
            step <= STEP_MAX && f64::from(step) > 2.0 * counted + f64::from(COPY_STEP_MAX);
        if step > COPY_STEP_MAX && (may_have_wrapped || is_hasty) {
            self.anew = Some(now);
        }
        match step {
            // A sender that does not count its frames.
            0 => self.advance(now, newest + 256, hash),
            1..=COPY_STEP_MAX => self.continue_with(now, newest + u64::from(step), hash),
            _ if after_copy.is_some() => {
                let place = after_copy.unwrap_or(newest);
                self.copy = Some((place, newest));
                self.lost = self.lost.saturating_sub(1);
                self.remember(place, hash);
                Order::Overtaken(place)
            }
            _ if step <= STEP_MAX => self.continue_with(now, newest + u64::from(step), hash),
            _ if is_silent => self.begin(now, number, hash),
            _ => {
                let behind = 256 - u64::from(step);
                let place = newest - behind;
                self.behind += 1;
                // Where another frame was received already, this one is more than 256 late, or the
                // vehicle restarted.
                let there = &self.received[usize::from(number)];
                let is_taken = there.iter().any(|frame| frame.place == place);
                let is_anew = behind > BEHIND_MAX || self.behind >= RESTART;
                if is_taken || is_anew {
                    self.anew = Some(now);
                }
                if is_anew {
                    return self.begin(now, number, hash);
                }
                // It was counted as lost.
                self.lost = self.lost.saturating_sub(1);
                self.remember(place, hash);
                Order::Overtaken(place)
            }
        }
    }

    /// Starts at the first frame, or at the first after a restart of the vehicle, which counts from
    /// zero.
    fn begin(&mut self, now: HostTime, number: u8, hash: u32) -> Order {
        (self.copy, self.pace.from) = (None, None);
        let place = (self.floor / 256 + 1) * 256 + u64::from(number);
        self.advance(now, place, hash)
    }

    fn continue_with(&mut self, now: HostTime, place: u64, hash: u32) -> Order {
        self.lost += place.saturating_sub(self.newest.unwrap_or(place) + 1);
        self.advance(now, place, hash)
    }

    fn advance(&mut self, now: HostTime, place: u64, hash: u32) -> Order {
        (self.newest, self.floor) = (Some(place), place);
        self.behind = 0;
        self.pace.count(now, place);
        self.remember(place, hash);
        Order::New(place)
    }

    fn remember(&mut self, place: u64, hash: u32) {
        let slots = &mut self.received[usize::from(place as u8)];
        if let Some(oldest) = slots.iter_mut().min_by_key(|frame| frame.place) {
            *oldest = ReceivedFrame { place, hash };
        }
    }

    /// The place of an earlier frame with the same bytes, if this is a copy of it. Some messages,
    /// such as HEARTBEAT, repeat their bytes. If such a frame is next in order and its equal is
    /// long past, it is a copy only if the frames before it were.
    fn copied(&self, newest: u64, number: u8, hash: u32, is_unique: bool) -> Option<u64> {
        let is_certain = is_unique || number != (newest as u8).wrapping_add(1);
        let after_copy = self.copy_place(newest, number);
        let same = self.received[usize::from(number)].iter().filter(|frame| frame.hash == hash);
        same.map(|frame| frame.place).filter(|place| *place > 0).find(|place| {
            is_certain || newest.saturating_sub(*place) <= BEHIND_MAX || after_copy == Some(*place)
        })
    }

    /// The place of a frame with this number, if it continues a sequence of copies.
    fn copy_place(&self, newest: u64, number: u8) -> Option<u64> {
        let (place, _) = self.copy.filter(|(_, at)| newest.saturating_sub(*at) <= COPY_ALIVE)?;
        let step = number.wrapping_sub(place as u8);
        (1..=COPY_STEP_MAX).contains(&step).then(|| place + u64::from(step))
    }
}

/// FNV-1a over words: enough to distinguish frames with the same number.
fn hash(bytes: &[u8]) -> u32 {
    const OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
    const PRIME: u64 = 0x0000_0100_0000_01b3;
    let mut words = bytes.chunks_exact(8);
    let hash = words.by_ref().fold(OFFSET, |hash, word| {
        let word = u64::from_le_bytes(word.try_into().unwrap_or_default());
        (hash ^ word).wrapping_mul(PRIME).rotate_left(23)
    });
    let hash = words
        .remainder()
        .iter()
        .fold(hash, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(PRIME));
    (hash ^ (hash >> 32)) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: HostTime = HostTime::from_ns(1_000_000_000_000);

    /// Losses after frames with these numbers, 10 ms apart, each with different bytes.
    fn lost_after(numbers: impl IntoIterator<Item = u8>) -> u64 {
        let mut sequence = Sequence::default();
        for (k, number) in numbers.into_iter().enumerate() {
            sequence.take(
                START + Duration::from_millis(10) * k as u32,
                number,
                &k.to_le_bytes(),
                true,
            );
        }
        sequence.lost()
    }

    #[test]
    fn gaps_count_as_losses_across_the_wrap_but_not_restarts() {
        let sent = (0..300_u32).filter(|k| ![100, 101, 255].contains(k));
        assert_eq!(lost_after(sent.map(|k| k as u8)), 3);
        assert_eq!(lost_after([150, 151, 0, 1]), 0, "a restart begins at zero");
    }

    #[test]
    fn late_frames_are_not_counted_as_lost() {
        assert_eq!(lost_after([7, 8, 10, 9, 11]), 0);
        assert_eq!(lost_after([254, 1, 255, 0, 2]), 0);
        assert_eq!(lost_after([7, 8, 8, 9, 9]), 0);
    }

    #[test]
    fn new_path_starts_its_own_sequence() {
        let mut sequence = Sequence::default();
        sequence.take(START, 10, b"a", true);
        sequence.restart();
        assert!(matches!(sequence.take(START, 60, b"b", true), Order::New(_)));
        assert_eq!(sequence.lost(), 0);
    }

    #[test]
    fn order_is_unsettled_after_another_frame_at_a_place_already_taken() {
        let at = |k: u32| START + Duration::from_millis(5) * k;
        // 300 frames but the `missing` one, then the frame 0 of a vehicle that restarted: it seems
        // 43 frames late.
        let after = |missing: u32| {
            let mut sequence = Sequence::default();
            for k in (0..300u32).filter(|k| *k != missing) {
                sequence.take(at(k), k as u8, &k.to_le_bytes(), true);
            }
            assert!(!sequence.is_unsettled(at(300)));
            sequence.take(at(300), 0, b"restarted", false);
            sequence.is_unsettled(at(300))
        };
        assert!(after(100));
        assert!(!after(256), "it may be the missing one");
    }

    #[test]
    fn sender_restart_is_followed_from_any_sequence_number() {
        for last in 0..=255u8 {
            let mut sequence = Sequence::default();
            let mut frame = 0u32;
            let mut take = |number| {
                frame += 1;
                sequence.take(
                    START + Duration::from_millis(5) * frame,
                    number,
                    &frame.to_le_bytes(),
                    true,
                )
            };
            (0..300u32).for_each(|k| {
                take((k as u8).wrapping_add(last));
            });
            let after: Vec<_> = (0..20u8).map(&mut take).collect();
            assert!(after[RESTART as usize..].iter().all(|o| matches!(o, Order::New(_))), "{last}");
        }
    }

    #[test]
    fn order_is_unsettled_after_a_step_faster_than_the_sender_counts() {
        // 3 s of 500 frames a second, then a step within 2 ms.
        let after = |step: u8| {
            let mut sequence = Sequence::default();
            let at = |k: u32| START + Duration::from_millis(2) * k;
            // The frame of the step was lost before, if it was sent at all.
            let number = (1499u32 as u8).wrapping_add(step);
            for k in (0..1500u32).filter(|k| *k < 1244 || *k as u8 != number) {
                sequence.take(at(k), k as u8, &k.to_le_bytes(), true);
            }
            sequence.take(at(1500), number, b"after", true);
            sequence.is_unsettled(at(1501))
        };
        assert!(!after(1) && !after(8), "a few lost frames");
        assert!(after(60), "an old frame whose number lies ahead by chance");
        assert!(!after(200), "a frame that others overtook");
    }

    #[test]
    fn order_is_unsettled_after_a_silence_long_enough_to_wrap() {
        // Frames at a rate, a silence, and a step of the number: whether the order is unsettled.
        let after = |per_s: u32, silent_ms: u64, step: u8| {
            let mut sequence = Sequence::default();
            let frames = 3 * per_s;
            let at = |k: u32| START + Duration::from_secs(1) * k / per_s;
            // The frame of the step was lost before, if it was sent at all.
            let number = ((frames - 1) as u8).wrapping_add(step);
            for k in (0..frames).filter(|k| *k + 256 < frames || *k as u8 != number) {
                sequence.take(at(k), k as u8, &k.to_le_bytes(), true);
            }
            let now = at(frames - 1) + Duration::from_millis(silent_ms);
            sequence.take(now, number, b"after", true);
            sequence.is_unsettled(now)
        };
        assert!(after(600, 400, 248), "a fast link wraps in 0.4 s");
        assert!(!after(100, 400, 248), "a slow link does not");
        assert!(!after(600, 400, 1), "nothing was lost");
        assert!(!after(600, 100, 60), "too short to wrap");
    }

    #[test]
    fn frames_with_constant_sequence_number_are_accepted() {
        let mut sequence = Sequence::default();
        for k in 0..2000u32 {
            let at = START + Duration::from_millis(10) * k;
            assert!(matches!(sequence.take(at, 0, &k.to_le_bytes(), true), Order::New(_)));
        }
    }

    /// Frame `k` of a vehicle: every fiftieth has no stamp and carries one of two contents.
    fn bytes(k: u32) -> Vec<u8> {
        let state = [b'a' + u8::from(k / 1000 % 2 == 1)];
        match k.is_multiple_of(50) {
            true => [&[k as u8], b"state".as_slice(), &state].concat(),
            false => [&[k as u8], k.to_le_bytes().as_slice()].concat(),
        }
    }

    #[test]
    fn copies_from_a_second_radio_are_dropped_at_any_lag() {
        // At 500 frames a second.
        for lag in [0, 1, 5, 90, 130, 255, 256, 257, 400, 700] {
            let mut sequence = Sequence::default();
            for k in 0..6000u32 {
                let at = START + Duration::from_millis(2) * k;
                let order = sequence.take(at, k as u8, &bytes(k), k % 50 != 0);
                assert!(matches!(order, Order::New(_)), "lag {lag}: frame {k} is {order:?}");
                // The first copy may look like the next frame.
                if let Some(old) = k.checked_sub(lag).filter(|old| *old > 0) {
                    let order = sequence.take(at, old as u8, &bytes(old), old % 50 != 0);
                    assert_eq!(order, Order::Copy, "lag {lag}: frame {old} at {k}");
                }
            }
            assert_eq!(sequence.lost(), 0);
        }
    }

    #[test]
    fn frames_of_two_lossy_radios_pass_once_and_in_order() {
        let lost = |k: u32, of: u32| k.wrapping_mul(2_654_435_761) >> 24 < of;
        for lag in [3, 60, 300] {
            let mut sequence = Sequence::default();
            let mut newest = 0;
            for k in 0..6000u32 {
                let at = START + Duration::from_millis(2) * k;
                if !lost(k, 50) {
                    match sequence.take(at, k as u8, &bytes(k), k % 50 != 0) {
                        Order::New(place) => newest = place,
                        order => panic!("lag {lag}: frame {k} is {order:?}"),
                    }
                }
                let Some(old) = k.checked_sub(lag).filter(|old| !lost(old + 77, 50)) else {
                    continue;
                };
                match sequence.take(at, old as u8, &bytes(old), old % 50 != 0) {
                    Order::Copy => assert!(!lost(old, 50), "lag {lag}: frame {old}"),
                    Order::Overtaken(place) => {
                        assert!(lost(old, 50) && place < newest, "lag {lag}: frame {old}");
                    }
                    order @ Order::New(_) => panic!("lag {lag}: frame {old} at {k} is {order:?}"),
                }
            }
        }
    }
}
