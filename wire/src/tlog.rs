//! Telemetry logs (.tlog) in the format of ground stations: eight bytes of time, then one frame.
//!
//! The time is in big-endian microseconds since the Unix epoch. The log keeps every byte from the
//! wire: bytes outside frames form a separate entry with a time stamp, which readers skip as
//! garbage. Frames with unknown message ids are normal entries.

mod writer;

use std::io::{self, Read};

use mavlink::{MAV_STX, MAV_STX_V2};

pub use self::writer::{Splitter, Writer};
use crate::framing::{Front, front};

const STAMP_LEN: usize = 8;

/// Range of plausible time stamps: 2000-01-01 to 2100-01-01.
const STAMP_RANGE_US: std::ops::Range<u64> = 946_684_800_000_000..4_102_444_800_000_000;

fn is_marker(byte: u8) -> bool {
    matches!(byte, MAV_STX | MAV_STX_V2)
}

/// An entry of a log, with the frame that it holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Microseconds since the Unix epoch; `None` if no plausible time stamp precedes the frame.
    pub time_us: Option<u64>,
    /// The whole frame as received.
    pub frame: Vec<u8>,
}

/// Reads the frames of a log one by one and skips everything between them.
///
/// It recognises a frame by its checksum, and one with an unknown message id by its time stamp and
/// what follows (a time stamp and a marker, or the end). Memory is bounded, and a truncated log
/// simply ends early.
#[derive(Debug)]
pub struct Reader<R> {
    source: R,
    buffer: Vec<u8>,
    /// End of the last frame in `buffer`: a stamp cannot start before it.
    last_end: usize,
    /// Position at which the search for the next marker continues.
    position: usize,
    at_end: bool,
    skipped: u64,
    /// Bytes of the source before `buffer`.
    before: u64,
    first_skipped: Option<u64>,
}

impl<R: Read> Reader<R> {
    /// Creates a reader of `source`, which need not be buffered.
    pub fn new(source: R) -> Self {
        Self {
            source,
            buffer: Vec::new(),
            last_end: 0,
            position: 0,
            at_end: false,
            skipped: 0,
            before: 0,
            first_skipped: None,
        }
    }

    /// Offset in the source of the first skipped byte.
    pub fn first_skipped(&self) -> Option<u64> {
        self.first_skipped
    }

    /// Number of skipped bytes that were neither frame nor time stamp.
    pub fn skipped_bytes(&self) -> u64 {
        self.skipped
    }

    /// Returns the next frame, or `None` at the end of the log.
    ///
    /// # Errors
    /// Errors of the underlying reader.
    pub fn read(&mut self) -> io::Result<Option<Entry>> {
        loop {
            // The next entry follows directly; its time stamp may contain a marker by chance.
            if self.position == self.last_end {
                let rest = &self.buffer[self.position..];
                let next = if rest.len() <= STAMP_LEN {
                    Front::Incomplete
                } else if starts_entry(rest) {
                    front(&rest[STAMP_LEN..])
                } else {
                    Front::Other
                };
                match next {
                    Front::Frame(_) => self.position += STAMP_LEN,
                    Front::Incomplete if !self.at_end => {
                        self.fill()?;
                        continue;
                    }
                    Front::Unknown(_) | Front::Incomplete | Front::Other => {}
                }
            }
            let Some(&byte) = self.buffer.get(self.position) else {
                if self.at_end {
                    self.skip_to(self.buffer.len());
                    return Ok(None);
                }
                self.fill()?;
                continue;
            };
            let stamp = self.stamp();
            let len = match if is_marker(byte) {
                front(&self.buffer[self.position..])
            } else {
                Front::Other
            } {
                Front::Frame(len) => len,
                Front::Incomplete if !self.at_end => {
                    self.fill()?;
                    continue;
                }
                Front::Unknown(len) if stamp.is_some() => {
                    let next = &self.buffer[self.position + len..];
                    if next.len() <= STAMP_LEN && !self.at_end {
                        self.fill()?;
                        continue;
                    }
                    if !next.is_empty() && !starts_entry(next) {
                        self.position += 1;
                        continue;
                    }
                    len
                }
                Front::Incomplete | Front::Unknown(_) | Front::Other => {
                    self.position += 1;
                    continue;
                }
            };
            let end = self.position + len;
            let frame = self.buffer[self.position..end].to_vec();
            self.skip_to(self.position - if stamp.is_some() { STAMP_LEN } else { 0 });
            self.position = end;
            self.last_end = end;
            return Ok(Some(Entry { time_us: stamp, frame }));
        }
    }

    /// The time stamp right before the position.
    fn stamp(&self) -> Option<u64> {
        let start = self.position.checked_sub(STAMP_LEN).filter(|&start| start >= self.last_end)?;
        plausible_stamp(self.buffer.get(start..)?)
    }

    fn skip_to(&mut self, end: usize) {
        let count = end.saturating_sub(self.last_end) as u64;
        if count > 0 {
            self.first_skipped.get_or_insert(self.before + self.last_end as u64);
        }
        self.skipped += count;
        self.last_end = end;
    }

    fn fill(&mut self) -> io::Result<()> {
        const CHUNK: usize = 64 * 1024;
        // Drops the searched bytes, except a possible time stamp before the position.
        let keep = self.position.saturating_sub(STAMP_LEN).max(self.last_end);
        self.skip_to(keep);
        self.buffer.drain(..keep);
        self.before += keep as u64;
        self.position -= keep;
        self.last_end = 0;
        let filled = self.buffer.len();
        self.buffer.resize(filled + CHUNK, 0);
        let result = loop {
            match self.source.read(&mut self.buffer[filled..]) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => break result,
            }
        };
        let count = *result.as_ref().unwrap_or(&0);
        self.buffer.truncate(filled + count);
        self.at_end = result? == 0;
        Ok(())
    }
}

impl<R: Read> Iterator for Reader<R> {
    type Item = io::Result<Entry>;

    fn next(&mut self) -> Option<Self::Item> {
        self.read().transpose()
    }
}

fn plausible_stamp(bytes: &[u8]) -> Option<u64> {
    let stamp = u64::from_be_bytes(*bytes.first_chunk::<STAMP_LEN>()?);
    STAMP_RANGE_US.contains(&stamp).then_some(stamp)
}

fn starts_entry(bytes: &[u8]) -> bool {
    plausible_stamp(bytes).is_some() && bytes.get(STAMP_LEN).is_some_and(|&byte| is_marker(byte))
}

#[cfg(test)]
mod tests {
    use mavlink::MavlinkVersion;
    use proptest::prelude::*;

    use super::*;
    use crate::Encoder;
    use crate::dialect::{ATTITUDE_DATA, MavMessage};

    const START_US: u64 = 1_700_000_000_000_000;

    pub(super) fn frame(sequence: u32, version: MavlinkVersion) -> Vec<u8> {
        let mut encoder = Encoder::new(1, 1);
        encoder.set_version(version);
        let data = ATTITUDE_DATA { time_boot_ms: sequence, roll: 0.1, ..Default::default() };
        let mut bytes = Vec::new();
        encoder.encode(&MavMessage::ATTITUDE(data), &mut bytes);
        bytes
    }

    /// A frame with a message id that no dialect has.
    pub(super) fn unknown_frame() -> Vec<u8> {
        vec![MAV_STX_V2, 2, 0, 0, 7, 1, 1, 0xFF, 0xFF, 0x70, 1, 2, 0xAA, 0xBB]
    }

    fn read_all(bytes: &[u8]) -> (Vec<Entry>, u64) {
        let mut reader = Reader::new(bytes);
        let entries = reader.by_ref().map(Result::unwrap).collect();
        (entries, reader.skipped_bytes())
    }

    #[test]
    fn unknown_frames_are_kept() {
        let mut writer = Writer::new(Vec::new());
        let frames = [frame(1, MavlinkVersion::V2), unknown_frame(), frame(2, MavlinkVersion::V1)];
        for (index, frame) in frames.iter().enumerate() {
            writer.write(START_US + index as u64, frame).unwrap();
        }
        let (entries, skipped) = read_all(&writer.into_inner());
        assert_eq!(skipped, 0);
        assert_eq!(entries.len(), 3);
        for (index, (entry, frame)) in entries.iter().zip(&frames).enumerate() {
            assert_eq!(entry.time_us, Some(START_US + index as u64));
            assert_eq!(&entry.frame, frame);
        }
    }

    /// A log in which the first time stamp and what follows happen to form a MAVLink 1 frame with a
    /// valid checksum.
    fn log_with_a_frame_by_chance() -> (Vec<u8>, usize) {
        const ATTITUDE: u8 = 30;
        let extra = <MavMessage as mavlink::Message>::extra_crc(ATTITUDE.into());
        let mut encoder = Encoder::new(1, 1);
        let mut frames = vec![Vec::new(); 40];
        for bytes in &mut frames {
            let data = ATTITUDE_DATA { roll: 0.1, yawspeed: 0.1, ..Default::default() };
            encoder.encode(&MavMessage::ATTITUDE(data), bytes);
        }
        // The first frame's marker is the other frame's length, its sequence the other's id.
        let frames = &frames[usize::from(ATTITUDE)..];
        let mut writer = Writer::new(Vec::new());
        for bytes in frames {
            writer.write(START_US & !0xFF | u64::from(MAV_STX), bytes).unwrap();
        }
        let mut log = writer.into_inner();
        let start = STAMP_LEN - 1;
        let end = start + 6 + usize::from(log[start + 1]);
        let chance = mavlink::calculate_crc(&log[start + 1..end], extra).to_le_bytes();
        log[end..end + 2].copy_from_slice(&chance);
        // Recomputes the checksum of the entry whose payload now contains that checksum.
        let entry = STAMP_LEN + frames[0].len();
        let (frame, crc) = (end / entry * entry + STAMP_LEN, (end / entry + 1) * entry - 2);
        assert!(frame + 10 <= end && end + 2 <= crc, "in the payload");
        let sound = mavlink::calculate_crc(&log[frame + 1..crc], extra).to_le_bytes();
        log[crc..crc + 2].copy_from_slice(&sound);
        assert!(matches!(front(&log[start..]), Front::Frame(_)));
        (log, frames.len())
    }

    #[test]
    fn accidental_frame_across_a_stamp_hides_no_entry() {
        let (log, count) = log_with_a_frame_by_chance();
        let (entries, skipped) = read_all(&log);
        assert_eq!((entries.len(), skipped), (count, 0));
    }

    #[test]
    fn frames_without_stamps_are_read() {
        let (a, b) = (frame(1, MavlinkVersion::V2), frame(2, MavlinkVersion::V2));
        let mut writer = Writer::new(Vec::new());
        writer.write(START_US, &[a.clone(), b.clone()].concat()).unwrap();
        let (entries, skipped) = read_all(&writer.into_inner());
        assert_eq!(skipped, 0);
        assert_eq!(entries[0], Entry { time_us: Some(START_US), frame: a });
        assert_eq!(entries[1], Entry { time_us: None, frame: b });
    }

    fn any_chunk() -> impl Strategy<Value = Vec<u8>> {
        prop_oneof![
            any::<u32>().prop_map(|n| frame(n, MavlinkVersion::V2)),
            any::<u32>().prop_map(|n| frame(n, MavlinkVersion::V1)),
            // Garbage without markers, which cannot hide a frame by chance.
            prop::collection::vec(0u8..0xFD, 1..40),
        ]
    }

    proptest! {
        #[test]
        fn every_frame_survives_garbage_and_truncation(
            chunks in prop::collection::vec(any_chunk(), 0..30),
            cut in 0usize..200,
        ) {
            let mut writer = Writer::new(Vec::new());
            let mut ends = Vec::new();
            let mut len = 0;
            for chunk in &chunks {
                writer.write(START_US, chunk).unwrap();
                len += STAMP_LEN + chunk.len();
                if is_marker(chunk[0]) {
                    ends.push((len, chunk.clone()));
                }
            }
            let log = writer.into_inner();
            let length = log.len().saturating_sub(cut);
            let (entries, _) = read_all(&log[..length]);
            let expected: Vec<_> = ends.iter().filter(|(end, _)| *end <= length).collect();
            prop_assert_eq!(entries.len(), expected.len());
            for (entry, (_, frame)) in entries.iter().zip(expected) {
                prop_assert_eq!(&entry.frame, frame);
                prop_assert_eq!(entry.time_us, Some(START_US));
            }
        }

        #[test]
        fn arbitrary_log_never_fails_the_reader(log in prop::collection::vec(any::<u8>(), 0..3000)) {
            let (entries, skipped) = read_all(&log);
            let kept: usize = entries
                .iter()
                .map(|e| e.frame.len() + if e.time_us.is_some() { STAMP_LEN } else { 0 })
                .sum();
            prop_assert_eq!(kept as u64 + skipped, log.len() as u64);
        }
    }
}
