//! Incremental MAVLink framing without I/O: bytes are pushed in, checked frames come out.

use std::cell::Cell;
use std::collections::VecDeque;
use std::fmt;
use std::io::{self, Read};

use mavlink::consts::v2;
use mavlink::error::{EncoderError, ParserError};
use mavlink::{
    Dialect, MAV_STX, MAV_STX_V2, MAVLinkMessageRaw, MAVLinkV1MessageRaw, MAVLinkV2MessageRaw,
    MavHeader, MavlinkReader, MavlinkVersion, Message, MessageData,
};

use crate::dialect::MavMessage;

/// Longest MAVLink frame: a signed MAVLink 2 frame with a 32-bit system id.
const FRAME_LEN_MAX: usize = 283;
/// Longest payload.
const PAYLOAD_LEN_MAX: usize = 255;

/// One frame whose checksum is right.
pub struct Frame {
    raw: MAVLinkMessageRaw,
}

impl Frame {
    /// The frame that `bytes` are, such as an entry of a log. `None` unless they are one whole
    /// frame of a message that the dialect has, its checksum right.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        Self::at_front(bytes).filter(|frame| frame.bytes().len() == bytes.len())
    }

    /// The frame at the front of `bytes`, if a whole and sound one is there.
    fn at_front(bytes: &[u8]) -> Option<Self> {
        let (version, len) = extent(bytes).ok()?;
        let (raw, check) = raw(version, bytes.get(..len)?);
        (check == Check::Passed).then_some(Self { raw })
    }

    /// MAVLink message id.
    pub fn id(&self) -> u32 {
        self.raw.message_id()
    }

    /// Sender's system id.
    pub fn system(&self) -> u32 {
        self.raw.system_id()
    }

    /// Sender's component id.
    pub fn component(&self) -> u8 {
        self.raw.component_id()
    }

    /// Sender's sequence number, wrapping at 256.
    pub fn sequence(&self) -> u8 {
        self.raw.sequence()
    }

    /// Protocol version of the frame.
    pub fn version(&self) -> MavlinkVersion {
        self.raw.version()
    }

    /// The whole frame as it was on the wire, signature included.
    pub fn bytes(&self) -> &[u8] {
        match &self.raw {
            MAVLinkMessageRaw::V1(raw) => raw.raw_bytes(),
            MAVLinkMessageRaw::V2(raw) => raw.raw_bytes(),
        }
    }

    /// Payload bytes, trailing zeros of MAVLink 2 cut off as on the wire.
    pub fn payload(&self) -> &[u8] {
        self.raw.payload()
    }

    /// Decodes the payload.
    ///
    /// # Errors
    /// [`ParserError`] if the payload does not fit the message, such as an enum value that the
    /// dialect does not have. The frame itself was intact.
    pub fn message(&self) -> Result<MavMessage, ParserError> {
        MavMessage::parse(self.version(), self.id(), self.payload())
    }
}

/// What a [`Decoder`] has seen since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderStats {
    /// Bytes pushed in.
    pub bytes: u64,
    /// Frames whose checksum was right.
    pub frames: u64,
    /// Candidates of a known message id whose checksum was wrong, or whose end was missing.
    pub crc_errors: u64,
    /// Candidates of a message id that the dialect does not have; they cannot be checked.
    pub unknown: u64,
    /// Bytes that belong to no frame, or to one that is not complete yet.
    pub unframed_bytes: u64,
}

/// Finds frames of MAVLink 1 and 2 in a stream of bytes that may hold anything.
///
/// Garbage is skipped: every false start is retried from its second byte, so it cannot hide a
/// frame that follows it. Memory is bounded; no input makes it fail.
pub struct Decoder {
    reader: MavlinkReader<ByteQueue>,
    dialect: CountingDialect,
    frames: u64,
    frame_bytes: u64,
    pushed: u64,
    /// `unframed()` when the last datagram ended.
    settled: u64,
    /// The newest bytes of a datagram, as many as a frame can have.
    tail: Vec<u8>,
}

impl fmt::Debug for Decoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder").field("stats", &self.stats()).finish_non_exhaustive()
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder with nothing in it.
    pub fn new() -> Self {
        Self {
            reader: MavlinkReader::new(ByteQueue::default()),
            dialect: CountingDialect::default(),
            frames: 0,
            frame_bytes: 0,
            pushed: 0,
            settled: 0,
            tail: Vec::new(),
        }
    }

    /// Takes bytes of a stream (TCP, serial), where a frame may span two calls.
    pub fn push(&mut self, bytes: &[u8]) {
        self.pushed += bytes.len() as u64;
        self.tail.extend_from_slice(&bytes[bytes.len().saturating_sub(FRAME_LEN_MAX)..]);
        self.tail.drain(..self.tail.len().saturating_sub(FRAME_LEN_MAX));
        self.reader.get_mut().bytes.extend(bytes);
    }

    /// The next frame, or `None` until more bytes are pushed.
    pub fn next_frame(&mut self) -> Option<Frame> {
        let frame = self.read()?;
        self.count(&frame);
        Some(frame)
    }

    fn read(&mut self) -> Option<Frame> {
        // The only error a byte queue can give is "empty for now".
        let raw = self.reader.read_any_raw_message_with_dialect(&self.dialect).ok()?;
        Some(Frame { raw })
    }

    fn count(&mut self, frame: &Frame) {
        self.frames += 1;
        self.frame_bytes += frame.bytes().len() as u64;
        self.dialect.known.set(self.dialect.known.get() - 1);
    }

    /// Takes a whole datagram (UDP) and gives its frames. None spans two datagrams, so that a
    /// truncated one cannot swallow the next datagram's start.
    pub fn datagram(&mut self, bytes: &[u8], mut on_frame: impl FnMut(Frame)) {
        let mut rest = bytes;
        // What most datagrams are: frames and nothing else. They need no queue to be found in.
        while let Some(frame) = Frame::at_front(rest) {
            let len = frame.bytes().len();
            rest = &rest[len..];
            self.pushed += len as u64;
            self.frames += 1;
            self.frame_bytes += len as u64;
            on_frame(frame);
        }
        if rest.is_empty() {
            return;
        }
        self.push(rest);
        while let Some(frame) = self.next_frame() {
            on_frame(frame);
        }
        self.end_datagram(on_frame);
    }

    /// Searches what is left once more, then drops it.
    fn end_datagram(&mut self, mut on_frame: impl FnMut(Frame)) {
        if self.unframed() == self.settled {
            self.tail.clear();
            return;
        }
        let tail = std::mem::take(&mut self.tail);
        // Zeros hold no frame marker: they only bring a pending candidate to its end. A candidate
        // that ends well with them, such as one cut in its signature, which nothing checks, is no
        // frame: it was not in the datagram.
        self.reader.get_mut().bytes.extend([0; FRAME_LEN_MAX]);
        while let Some(frame) = self.read() {
            let bytes = frame.bytes();
            if !tail.windows(bytes.len()).any(|window| window == bytes) {
                break;
            }
            self.count(&frame);
            on_frame(frame);
        }
        self.reader = MavlinkReader::new(ByteQueue::default());
        self.settled = self.unframed();
    }

    fn unframed(&self) -> u64 {
        self.pushed.saturating_sub(self.frame_bytes)
    }

    /// Counters since the decoder was made.
    pub fn stats(&self) -> DecoderStats {
        DecoderStats {
            bytes: self.pushed,
            frames: self.frames,
            crc_errors: self.dialect.known.get(),
            unknown: self.dialect.unknown.get(),
            unframed_bytes: self.unframed(),
        }
    }
}

/// Writes messages as frames of one sender, counting its sequence.
#[derive(Clone, Debug)]
pub struct Encoder {
    header: MavHeader,
    version: MavlinkVersion,
}

impl Encoder {
    /// A sender of MAVLink 2 frames.
    pub fn new(system: u8, component: u8) -> Self {
        Self {
            header: MavHeader { system_id: system.into(), component_id: component, sequence: 0 },
            version: MavlinkVersion::V2,
        }
    }

    /// Speaks another protocol version from the next frame on.
    pub fn set_version(&mut self, version: MavlinkVersion) {
        self.version = version;
    }

    /// Appends `message` to `out` as one frame. Returns whether it could: MAVLink 1 has no room
    /// for message ids above 255.
    pub fn encode(&mut self, message: &MavMessage, out: &mut Vec<u8>) -> bool {
        match self.version {
            MavlinkVersion::V2 => {
                let id = message.message_id();
                self.write(id, MavMessage::extra_crc(id), out, |payload| {
                    message.ser(MavlinkVersion::V2, payload)
                });
            }
            MavlinkVersion::V1 if message.message_id() > u8::MAX.into() => return false,
            MavlinkVersion::V1 => {
                let mut raw = MAVLinkV1MessageRaw::new();
                raw.serialize_message(self.header, message);
                out.extend_from_slice(raw.raw_bytes());
            }
        }
        self.header.sequence = self.header.sequence.wrapping_add(1);
        true
    }

    /// As [`encode`](Self::encode), for a payload that the dialect's types cannot express, such as
    /// the acknowledgement of a command that it does not name.
    pub fn encode_data<D: MessageData>(&mut self, data: &D, out: &mut Vec<u8>) -> bool {
        match self.version {
            MavlinkVersion::V2 => {
                self.write(D::ID, D::EXTRA_CRC, out, |payload| {
                    data.ser(MavlinkVersion::V2, payload)
                });
            }
            MavlinkVersion::V1 if D::ID > u8::MAX.into() => return false,
            MavlinkVersion::V1 => {
                let mut raw = MAVLinkV1MessageRaw::new();
                raw.serialize_message_data(self.header, data);
                out.extend_from_slice(raw.raw_bytes());
            }
        }
        self.header.sequence = self.header.sequence.wrapping_add(1);
        true
    }

    /// Appends a MAVLink 2 frame whose payload `serialize` writes; it returns its length.
    fn write(
        &self,
        id: u32,
        extra_crc: u8,
        out: &mut Vec<u8>,
        serialize: impl FnOnce(&mut [u8]) -> usize,
    ) {
        let mut payload = [0; PAYLOAD_LEN_MAX];
        let len = serialize(&mut payload);
        let MavHeader { system_id, component_id, sequence } = self.header;
        let [a, b, c, _] = id.to_le_bytes();
        let start = out.len() + 1;
        out.extend([MAV_STX_V2, len as u8, 0, 0, sequence, system_id as u8, component_id, a, b, c]);
        out.extend_from_slice(&payload[..len]);
        let crc = checksum(&out[start..], extra_crc);
        out.extend(crc.to_le_bytes());
    }
}

/// The checksum of a frame's bytes after its marker: CRC-16/MCRF4XX, closed by the message's own
/// byte. It needs no table: one would be fetched anew for every frame that comes after a pause.
fn checksum(bytes: &[u8], extra_crc: u8) -> u16 {
    bytes.iter().chain([&extra_crc]).fold(0xFFFF, |crc: u16, byte| {
        let low = byte ^ crc as u8;
        let low = u16::from(low ^ (low << 4));
        (crc >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
    })
}

/// What the first bytes of a slice are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Front {
    /// A frame of this length, its checksum right.
    Frame(usize),
    /// What would be a frame of this length, of a message id that the dialect does not have.
    Unknown(usize),
    /// The start of a frame, perhaps: more bytes are needed to tell.
    Incomplete,
    /// No frame.
    Other,
}

/// Looks for a frame at the front of `bytes`.
pub(crate) fn front(bytes: &[u8]) -> Front {
    let (version, len) = match extent(bytes) {
        Ok(extent) => extent,
        Err(front) => return front,
    };
    let Some(bytes) = bytes.get(..len) else {
        return Front::Incomplete;
    };
    match raw(version, bytes).1 {
        Check::Passed => Front::Frame(len),
        Check::Failed => Front::Other,
        Check::Unknown => Front::Unknown(len),
    }
}

/// Version and length of what would be a frame at the front of `bytes`, or why there is none.
fn extent(bytes: &[u8]) -> Result<(MavlinkVersion, usize), Front> {
    const V1_OVERHEAD: usize = 8;
    const V2_OVERHEAD: usize = 12;
    match *bytes {
        [] | [MAV_STX | MAV_STX_V2] | [MAV_STX_V2, _] => Err(Front::Incomplete),
        [MAV_STX, payload, ..] => Ok((MavlinkVersion::V1, V1_OVERHEAD + usize::from(payload))),
        [MAV_STX_V2, payload, flags, ..] if flags & !v2::SUPPORTED_IFLAGS == 0 => {
            let system =
                if flags & v2::IFLAG_SYSID32 == 0 { 0 } else { v2::SYSID32_EXTRA_HEADER_SIZE };
            let signature = if flags & v2::IFLAG_SIGNED == 0 { 0 } else { v2::SIGNATURE_SIZE };
            Ok((MavlinkVersion::V2, V2_OVERHEAD + usize::from(payload) + system + signature))
        }
        _ => Err(Front::Other),
    }
}

/// What a frame's checksum says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Check {
    Passed,
    Failed,
    /// The dialect does not have the message, so that it cannot be checked.
    Unknown,
}

/// The bytes of what would be a frame, and whether its checksum is right.
fn raw(version: MavlinkVersion, bytes: &[u8]) -> (MAVLinkMessageRaw, Check) {
    let check = |id: u32, stated: u16, end: usize| match known_extra_crc(id) {
        Some(extra_crc) if stated == checksum(&bytes[1..end], extra_crc) => Check::Passed,
        Some(_) => Check::Failed,
        None => Check::Unknown,
    };
    // The checksum is over everything between the marker and itself.
    match version {
        MavlinkVersion::V1 => {
            let mut raw = MAVLinkV1MessageRaw::new();
            raw.as_mut_slice()[..bytes.len()].copy_from_slice(bytes);
            let check = check(raw.message_id().into(), raw.checksum(), bytes.len() - 2);
            (MAVLinkMessageRaw::V1(raw), check)
        }
        MavlinkVersion::V2 => {
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.as_mut_slice()[..bytes.len()].copy_from_slice(bytes);
            let end = 1 + raw.header().len() + raw.payload().len();
            let check = check(raw.message_id(), raw.checksum(), end);
            (MAVLinkMessageRaw::V2(raw), check)
        }
    }
}

/// The checksum seed of a message id that the dialect has.
fn known_extra_crc(id: u32) -> Option<u8> {
    let extra_crc = MavMessage::extra_crc(id);
    // Zero is what an unknown id gives, and what a few known ids have.
    let known = extra_crc != 0 || MavMessage::default_message_from_id(id).is_some();
    known.then_some(extra_crc)
}

/// Bytes pushed and not yet taken; "would block" when there are none.
#[derive(Default)]
struct ByteQueue {
    bytes: VecDeque<u8>,
}

impl Read for ByteQueue {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.bytes.read(buffer)? {
            0 => Err(io::ErrorKind::WouldBlock.into()),
            count => Ok(count),
        }
    }
}

/// The dialect, counting the candidates that the reader asks it about: a candidate that is asked
/// about and does not come out as a frame had a wrong checksum.
#[derive(Default)]
struct CountingDialect {
    known: Cell<u64>,
    unknown: Cell<u64>,
}

impl Dialect for CountingDialect {
    type Message = MavMessage;
    type EncodeError = EncoderError;

    fn message_id(&self, message: &MavMessage) -> u32 {
        message.message_id()
    }

    fn extra_crc(&self, message_id: u32) -> Option<u8> {
        let extra_crc = known_extra_crc(message_id);
        let counter = if extra_crc.is_some() { &self.known } else { &self.unknown };
        counter.set(counter.get() + 1);
        extra_crc
    }

    fn decode(
        &self,
        version: MavlinkVersion,
        id: u32,
        payload: &[u8],
    ) -> Result<MavMessage, ParserError> {
        MavMessage::parse(version, id, payload)
    }

    fn encode(
        &self,
        version: MavlinkVersion,
        message: &MavMessage,
        payload: &mut [u8],
    ) -> Result<usize, EncoderError> {
        Ok(message.ser(version, payload))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::dialect::*;

    fn attitude(number: u32) -> MavMessage {
        let data = ATTITUDE_DATA { time_boot_ms: number, yaw: 1.5, ..Default::default() };
        MavMessage::ATTITUDE(data)
    }

    fn encoded(number: u32, version: MavlinkVersion) -> Vec<u8> {
        let mut encoder = Encoder::new(1, 2);
        encoder.set_version(version);
        let mut bytes = Vec::new();
        assert!(encoder.encode(&attitude(number), &mut bytes));
        bytes
    }

    fn drain(decoder: &mut Decoder) -> Vec<Frame> {
        std::iter::from_fn(|| decoder.next_frame()).collect()
    }

    #[test]
    fn both_versions_come_back_as_they_went() {
        let mut decoder = Decoder::new();
        for version in [MavlinkVersion::V1, MavlinkVersion::V2] {
            let bytes = encoded(7, version);
            decoder.push(&bytes);
            let frame = decoder.next_frame().unwrap();
            assert_eq!(frame.bytes(), bytes);
            assert_eq!((frame.system(), frame.component(), frame.sequence()), (1, 2, 0));
            assert_eq!(frame.message().unwrap(), attitude(7));
            let parsed = Frame::parse(&bytes).unwrap();
            assert_eq!((parsed.bytes(), parsed.id()), (frame.bytes(), frame.id()));
            assert!(Frame::parse(&bytes[1..]).is_none() && Frame::parse(&[]).is_none());
            assert!(Frame::parse(&bytes[..bytes.len() - 1]).is_none());
            assert!(Frame::parse(&[&bytes[..], &[0]].concat()).is_none());
        }
        assert_eq!(decoder.stats().frames, 2);
        assert_eq!(decoder.stats().unframed_bytes, 0);
    }

    #[test]
    fn a_signed_frame_is_read() {
        let mut bytes = encoded(1, MavlinkVersion::V2);
        let crc_start = bytes.len() - 2;
        bytes[2] |= v2::IFLAG_SIGNED;
        let extra_crc = MavMessage::extra_crc(30);
        let crc = mavlink::calculate_crc(&bytes[1..crc_start], extra_crc).to_le_bytes();
        bytes[crc_start..].copy_from_slice(&crc);
        bytes.extend([7; v2::SIGNATURE_SIZE]);
        let mut decoder = Decoder::new();
        decoder.push(&bytes);
        assert_eq!(decoder.next_frame().unwrap().bytes(), bytes);
        assert_eq!(front(&bytes), Front::Frame(bytes.len()));
    }

    #[test]
    fn message_ids_that_mavlink_1_has_no_room_for_are_not_sent() {
        let mut encoder = Encoder::new(1, 1);
        encoder.set_version(MavlinkVersion::V1);
        let mut bytes = Vec::new();
        assert!(!encoder.encode(&MavMessage::ODOMETRY(Default::default()), &mut bytes));
        assert!(bytes.is_empty());
    }

    #[test]
    fn sequence_wraps() {
        let mut encoder = Encoder::new(1, 1);
        let mut decoder = Decoder::new();
        for k in 0..300u32 {
            let mut bytes = Vec::new();
            encoder.encode(&attitude(k), &mut bytes);
            decoder.push(&bytes);
            assert_eq!(u32::from(decoder.next_frame().unwrap().sequence()), k % 256);
        }
    }

    #[test]
    fn wrong_checksums_and_unknown_ids_are_counted_apart() {
        let mut broken = encoded(1, MavlinkVersion::V2);
        *broken.last_mut().unwrap() ^= 1;
        let unknown = [MAV_STX_V2, 1, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0x70, 9, 0, 0];
        let good = encoded(2, MavlinkVersion::V2);
        let mut decoder = Decoder::new();
        decoder.push(&[&broken[..], &unknown, &good].concat());
        assert_eq!(drain(&mut decoder).len(), 1);
        let stats = decoder.stats();
        assert_eq!((stats.frames, stats.crc_errors, stats.unknown), (1, 1, 1));
        assert_eq!(stats.unframed_bytes as usize, broken.len() + unknown.len());
    }

    #[test]
    fn a_cut_datagram_does_not_swallow_the_next() {
        let whole = encoded(1, MavlinkVersion::V2);
        let mut decoder = Decoder::new();
        for cut in 0..whole.len() {
            decoder.datagram(&whole[..cut], |_| panic!("there was no whole frame"));
            let mut frames = 0;
            decoder.datagram(&whole, |_| frames += 1);
            assert_eq!(frames, 1, "after a cut at {cut}");
        }
    }

    #[test]
    fn a_frame_behind_a_false_start_in_a_datagram_is_found_at_its_end() {
        // The marker and length byte claim more than the datagram has.
        let mut datagram = vec![MAV_STX_V2, 255, 0];
        datagram.extend(encoded(3, MavlinkVersion::V2));
        let mut decoder = Decoder::new();
        let mut frames = 0;
        decoder.datagram(&datagram, |_| frames += 1);
        assert_eq!(frames, 1);
    }

    /// The frame of a whole ATTITUDE whose payload is cut or padded to `len`, its length byte and
    /// checksum made anew, so that framing has nothing against it.
    fn resized(version: MavlinkVersion, len: u8) -> Vec<u8> {
        let mut bytes = encoded(1, version);
        let header = if version == MavlinkVersion::V2 { 10 } else { 6 };
        bytes.resize(header + usize::from(len), 0x55);
        bytes[1] = len;
        let crc = mavlink::calculate_crc(&bytes[1..], MavMessage::extra_crc(30));
        bytes.extend(crc.to_le_bytes());
        bytes
    }

    #[test]
    fn payloads_of_any_length_are_framed_and_never_panic() {
        for version in [MavlinkVersion::V1, MavlinkVersion::V2] {
            for len in 0..=u8::MAX {
                let bytes = resized(version, len);
                let mut decoder = Decoder::new();
                decoder.push(&bytes);
                let frame = decoder.next_frame().expect("its checksum is right");
                assert_eq!((frame.bytes(), frame.payload().len()), (&bytes[..], len.into()));
                // What is missing is zero, what is too much is ignored, as MAVLink 2 has it.
                assert!(frame.message().is_ok(), "{version:?} {len}");
                assert_eq!(decoder.stats().unframed_bytes, 0);
            }
        }
    }

    #[test]
    fn a_length_byte_that_lies_is_a_wrong_checksum_and_the_next_frame_is_found() {
        let next = encoded(2, MavlinkVersion::V2);
        for version in [MavlinkVersion::V1, MavlinkVersion::V2] {
            let honest = encoded(1, version);
            for claimed in (0..=u8::MAX).filter(|&claimed| claimed != honest[1]) {
                let mut bytes = honest.clone();
                bytes[1] = claimed;
                bytes.extend(&next);
                let mut decoder = Decoder::new();
                decoder.push(&bytes);
                let mut frames = drain(&mut decoder);
                decoder.end_datagram(|frame| frames.push(frame));
                assert_eq!(frames.len(), 1, "{version:?} {claimed}");
                assert_eq!(frames[0].bytes(), next);
                let stats = decoder.stats();
                assert!(stats.crc_errors >= 1, "{version:?} {claimed}");
                assert_eq!(stats.unframed_bytes as usize, honest.len());
            }
        }
    }

    #[test]
    fn a_signed_frame_that_is_cut_is_dropped_and_the_next_is_found() {
        let mut signed = resized(MavlinkVersion::V2, 28);
        let crc_start = signed.len() - 2;
        signed[2] |= v2::IFLAG_SIGNED;
        let crc = mavlink::calculate_crc(&signed[1..crc_start], MavMessage::extra_crc(30));
        signed[crc_start..].copy_from_slice(&crc.to_le_bytes());
        signed.extend([7; v2::SIGNATURE_SIZE]);
        let next = encoded(2, MavlinkVersion::V2);
        let mut decoder = Decoder::new();
        for cut in 1..signed.len() {
            let dropped_before = decoder.stats().unframed_bytes;
            decoder.push(&signed[..cut]);
            decoder.end_datagram(|_| panic!("cut at {cut} it is no frame"));
            assert_eq!((decoder.stats().unframed_bytes - dropped_before) as usize, cut);
            decoder.push(&next);
            let frame = decoder.next_frame().expect("whole");
            assert_eq!(frame.bytes(), next, "after a cut at {cut}");
        }
    }

    #[derive(Clone, Debug)]
    enum Piece {
        Frame(Vec<u8>),
        Garbage(Vec<u8>),
    }

    fn any_piece() -> impl Strategy<Value = Piece> {
        prop_oneof![
            any::<u32>().prop_map(|n| Piece::Frame(encoded(n, MavlinkVersion::V1))),
            any::<u32>().prop_map(|n| Piece::Frame(encoded(n, MavlinkVersion::V2))),
            prop::collection::vec(any::<u8>(), 0..300).prop_map(Piece::Garbage),
        ]
    }

    proptest! {
        #[test]
        fn every_frame_is_found_in_any_garbage_and_any_chunks(
            pieces in prop::collection::vec(any_piece(), 0..20),
            chunk in 1usize..400,
        ) {
            let wire: Vec<u8> = pieces
                .iter()
                .flat_map(|piece| match piece {
                    Piece::Frame(bytes) | Piece::Garbage(bytes) => bytes.iter().copied(),
                })
                .collect();
            let mut decoder = Decoder::new();
            let mut frames = Vec::new();
            for chunk in wire.chunks(chunk) {
                decoder.push(chunk);
                frames.extend(drain(&mut decoder));
            }
            decoder.end_datagram(|frame| frames.push(frame));
            let sent: Vec<_> = pieces
                .iter()
                .filter_map(|piece| match piece {
                    Piece::Frame(bytes) => Some(bytes.clone()),
                    Piece::Garbage(_) => None,
                })
                .collect();
            let found: Vec<_> = frames.iter().map(|frame| frame.bytes().to_vec()).collect();
            prop_assert_eq!(&found, &sent);
            let stats = decoder.stats();
            let framed: usize = frames.iter().map(|frame| frame.bytes().len()).sum();
            prop_assert_eq!(stats.bytes as usize, wire.len());
            prop_assert_eq!(stats.unframed_bytes as usize, wire.len() - framed);
            // The same as one datagram.
            let (mut decoder, mut found) = (Decoder::new(), Vec::new());
            decoder.datagram(&wire, |frame| found.push(frame.bytes().to_vec()));
            prop_assert_eq!(found, sent);
            prop_assert_eq!((decoder.stats().bytes, decoder.stats().unframed_bytes), (stats.bytes, stats.unframed_bytes));
        }

        #[test]
        fn the_front_agrees_with_the_decoder(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            number in any::<u32>(),
        ) {
            let frame = encoded(number, MavlinkVersion::V2);
            let with_tail = [&frame[..], &bytes].concat();
            prop_assert_eq!(front(&with_tail), Front::Frame(frame.len()));
            for cut in 0..frame.len() {
                prop_assert_eq!(front(&frame[..cut]), Front::Incomplete);
            }
            let _ = front(&bytes);
        }
    }
}
