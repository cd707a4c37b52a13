//! Writes a log: a stream of bytes as entries, each after its time stamp.

use std::io::{self, Write};

use super::is_marker;
use crate::framing::{Front, front};

/// Length limit of an entry of bytes without a frame.
const RUN_MAX: usize = 4096;

/// Writes the entries of a log.
#[derive(Debug)]
pub struct Writer<W> {
    out: W,
}

impl<W: Write> Writer<W> {
    /// Creates a writer to `out`, which should be buffered.
    pub fn new(out: W) -> Self {
        Self { out }
    }

    /// Writes one entry: a frame, or a run of bytes outside frames.
    ///
    /// # Errors
    /// Errors of the underlying writer.
    pub fn write(&mut self, time_us: u64, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(&time_us.to_be_bytes())?;
        self.out.write_all(bytes)
    }

    /// Flushes the underlying writer.
    ///
    /// # Errors
    /// Errors of the underlying writer.
    pub fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }

    /// Returns the underlying writer.
    pub fn into_inner(self) -> W {
        self.out
    }
}

/// Splits a stream of bytes into entries, so that every frame gets its own time stamp.
///
/// It preserves all bytes and their order. It recognises a frame by its checksum, and one with an
/// unknown message id by its length and what follows (nothing, or another frame's marker).
#[derive(Debug, Default)]
pub struct Splitter {
    pending: Vec<u8>,
}

impl Splitter {
    /// Adds bytes of a stream and passes the completed entries to `entry`.
    ///
    /// # Errors
    /// The first error of `entry`; the bytes after that entry are kept.
    pub fn push<E>(
        &mut self,
        bytes: &[u8],
        entry: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        self.pending.extend_from_slice(bytes);
        self.split(false, entry)
    }

    /// Passes the remaining bytes to `entry`, at the end of a datagram or stream.
    ///
    /// # Errors
    /// The first error of `entry`; the bytes after that entry are kept.
    pub fn finish<E>(&mut self, entry: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
        self.split(true, entry)
    }

    fn split<E>(
        &mut self,
        is_end: bool,
        mut entry: impl FnMut(&[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut done = 0;
        let mut result = Ok(());
        while result.is_ok() && done < self.pending.len() {
            let rest = &self.pending[done..];
            let Some(len) = entry_len(rest, is_end) else { break };
            result = entry(&rest[..len]);
            done += len;
        }
        self.pending.drain(..done);
        result
    }
}

/// Length of the entry at the start of `bytes`; `None` until more bytes arrive.
fn entry_len(bytes: &[u8], is_end: bool) -> Option<usize> {
    match frame_len(bytes, is_end) {
        Found::Frame(len) => return Some(len),
        Found::Incomplete => return None,
        Found::Nothing => {}
    }
    // A run up to the next possible frame.
    let limit = bytes.len().min(RUN_MAX);
    for start in 1..limit {
        if is_marker(bytes[start]) && frame_len(&bytes[start..], is_end) != Found::Nothing {
            return Some(start);
        }
    }
    Some(limit)
}

#[derive(PartialEq)]
enum Found {
    Frame(usize),
    Incomplete,
    Nothing,
}

fn frame_len(bytes: &[u8], is_end: bool) -> Found {
    match front(bytes) {
        Front::Frame(len) => Found::Frame(len),
        Front::Unknown(len) if bytes.get(len).is_none_or(|&next| is_marker(next)) => {
            Found::Frame(len)
        }
        Front::Incomplete if !is_end => Found::Incomplete,
        Front::Incomplete | Front::Unknown(_) | Front::Other => Found::Nothing,
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use mavlink::{MAV_STX, MAV_STX_V2, MavlinkVersion};
    use proptest::prelude::*;

    use super::super::tests::{frame, unknown_frame};
    use super::*;

    fn split_all(chunks: &[&[u8]]) -> Vec<Vec<u8>> {
        let mut splitter = Splitter::default();
        let mut entries = Vec::new();
        let mut keep = |entry: &[u8]| {
            entries.push(entry.to_vec());
            Ok::<_, Infallible>(())
        };
        for chunk in chunks {
            let Ok(()) = splitter.push(chunk, &mut keep);
        }
        let Ok(()) = splitter.finish(keep);
        entries
    }

    #[test]
    fn splitter_emits_one_entry_per_frame() {
        let (a, b) = (frame(1, MavlinkVersion::V2), frame(2, MavlinkVersion::V1));
        let garbage = [1, 2, MAV_STX_V2, 3];
        let wire = [&garbage[..], &a, &unknown_frame(), &b, &[MAV_STX]].concat();
        let expected = vec![garbage.to_vec(), a.clone(), unknown_frame(), b.clone(), vec![MAV_STX]];
        assert_eq!(split_all(&[&wire]), expected);
        let bytewise: Vec<&[u8]> = wire.chunks(1).collect();
        assert_eq!(split_all(&bytewise).concat(), wire);
        assert!(split_all(&bytewise).contains(&a));
        assert!(split_all(&bytewise).contains(&b));
    }

    proptest! {
        #[test]
        fn splitter_loses_no_byte(
            wire in prop::collection::vec(any::<u8>(), 0..2000),
            cut in 1usize..50,
        ) {
            let chunks: Vec<&[u8]> = wire.chunks(cut).collect();
            prop_assert_eq!(split_all(&chunks).concat(), wire);
        }
    }
}
