//! Frames out of bytes.

use std::cell::Cell;
use std::collections::VecDeque;
use std::fmt;
use std::io::{self, Read};

use mavlink::error::{EncoderError, ParserError};
use mavlink::{Dialect, MavlinkReader, MavlinkVersion, Message};

use super::frame::{Frame, known_extra_crc};
use crate::dialect::MavMessage;

/// Longest MAVLink frame: a signed MAVLink 2 frame with a 32-bit system id.
const FRAME_LEN_MAX: usize = 283;

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
    pub(super) fn end_datagram(&mut self, mut on_frame: impl FnMut(Frame)) {
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
