//! Finds frames in bytes.

use std::cell::Cell;
use std::collections::VecDeque;
use std::fmt;
use std::io::{self, Read};
use std::ops::AddAssign;

use mavlink::error::{EncoderError, ParserError};
use mavlink::{Dialect, MavlinkReader, MavlinkVersion, Message};

use super::frame::{Frame, known_extra_crc};
use crate::dialect::MavMessage;

/// Longest MAVLink frame: a signed MAVLink 2 frame with a 32-bit system id.
const FRAME_LEN_MAX: usize = 283;

/// Counters of a [`Decoder`] since its creation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DecoderStats {
    /// Bytes received.
    pub bytes: u64,
    /// Frames with a valid checksum.
    pub frames: u64,
    /// Candidates with a known message id and a wrong checksum or a missing end.
    pub crc_errors: u64,
    /// Candidates with a message id that the dialect lacks; they cannot be checked.
    pub unknown: u64,
    /// Bytes outside frames, or in a frame that is still incomplete.
    pub unframed_bytes: u64,
}

impl AddAssign for DecoderStats {
    fn add_assign(&mut self, other: Self) {
        self.bytes += other.bytes;
        self.frames += other.frames;
        self.crc_errors += other.crc_errors;
        self.unknown += other.unknown;
        self.unframed_bytes += other.unframed_bytes;
    }
}

/// Finds frames of MAVLink 1 and 2 in an arbitrary stream of bytes.
///
/// It skips garbage and retries every false start from its second byte, so a false start cannot
/// hide a frame that follows it. Memory is bounded, and no input makes it fail.
pub struct Decoder {
    reader: MavlinkReader<ByteQueue>,
    dialect: CountingDialect,
    frames: u64,
    frame_bytes: u64,
    pushed: u64,
    /// `unframed()` when the last datagram ended.
    settled: u64,
    /// The newest bytes of a datagram, up to the longest frame.
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
    /// Creates an empty decoder.
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

    /// Adds bytes of a stream (TCP, serial), where a frame may span two calls.
    pub fn push(&mut self, bytes: &[u8]) {
        self.pushed += bytes.len() as u64;
        self.tail.extend_from_slice(&bytes[bytes.len().saturating_sub(FRAME_LEN_MAX)..]);
        self.tail.drain(..self.tail.len().saturating_sub(FRAME_LEN_MAX));
        self.reader.get_mut().bytes.extend(bytes);
    }

    /// Returns the next frame, or `None` until more bytes arrive.
    pub fn next_frame(&mut self) -> Option<Frame> {
        let frame = self.read()?;
        self.count(&frame);
        Some(frame)
    }

    fn read(&mut self) -> Option<Frame> {
        // The only error of a byte queue is "empty for now".
        let raw = self.reader.read_any_raw_message_with_dialect(&self.dialect).ok()?;
        Some(Frame { raw })
    }

    fn count(&mut self, frame: &Frame) {
        self.frames += 1;
        self.frame_bytes += frame.bytes().len() as u64;
        self.dialect.known.set(self.dialect.known.get() - 1);
    }

    /// Takes a whole datagram (UDP) and passes its frames to `on_frame`. A frame never spans two
    /// datagrams, so a truncated one cannot swallow the start of the next datagram.
    pub fn datagram(&mut self, bytes: &[u8], mut on_frame: impl FnMut(Frame)) {
        let mut rest = bytes;
        // Most datagrams hold frames and nothing else, and need no search through the queue.
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

    /// Searches the remaining bytes once more, then drops them.
    pub(super) fn end_datagram(&mut self, mut on_frame: impl FnMut(Frame)) {
        if self.unframed() == self.settled {
            self.tail.clear();
            return;
        }
        let tail = std::mem::take(&mut self.tail);
        // Zeros hold no frame marker: they only complete a pending candidate. A candidate that is
        // valid only with them, such as one cut in its signature, which the decoder does not check,
        // was not in the datagram and is not a frame.
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

/// Bytes that are not yet consumed; an empty queue returns "would block".
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

/// The dialect, with counters of the candidates that the reader looks up. A known candidate that
/// does not become a frame has a wrong checksum.
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
