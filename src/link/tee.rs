//! The tee: every byte of a link, both directions, into a telemetry log.
//!
//! It writes to a file and may wait for the disk, so it belongs on the logging side of a bounded
//! channel and not on the control line.

use std::io::{self, Write};

use wire::tlog::{Splitter, Writer};
use wire::transport::Peer;

use crate::clock::HostTime;

/// Writes what a link receives and sends. A frame is stamped with the arrival of its last byte;
/// bytes that belong to no frame are kept as entries of their own.
#[derive(Debug)]
pub struct Tee<W> {
    writer: Writer<W>,
    datagrams: Splitter,
    streams: Vec<(Peer, Splitter)>,
}

impl<W: Write> Tee<W> {
    /// A tee into `out`, which should be buffered.
    pub fn new(out: W) -> Self {
        Self { writer: Writer::new(out), datagrams: Splitter::default(), streams: Vec::new() }
    }

    /// Takes bytes that arrived.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn received(
        &mut self,
        now: HostTime,
        peer: Peer,
        bytes: &[u8],
        is_datagram: bool,
    ) -> io::Result<()> {
        let writer = &mut self.writer;
        let mut entry = |entry: &[u8]| writer.write(microseconds(now), entry);
        if is_datagram {
            self.datagrams.push(bytes, &mut entry)?;
            return self.datagrams.finish(entry);
        }
        let index = self.streams.iter().position(|(known, _)| *known == peer);
        let index = index.unwrap_or_else(|| {
            self.streams.push((peer, Splitter::default()));
            self.streams.len() - 1
        });
        self.streams[index].1.push(bytes, entry)
    }

    /// Takes a frame that was sent.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn sent(&mut self, now: HostTime, frame: &[u8]) -> io::Result<()> {
        self.writer.write(microseconds(now), frame)
    }

    /// A peer is gone: what it left unfinished is written.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn peer_closed(&mut self, now: HostTime, peer: Peer) -> io::Result<()> {
        self.finish_where(now, |known| known == peer)
    }

    /// All peers are gone: what they left unfinished is written, and everything is flushed.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn finish(&mut self, now: HostTime) -> io::Result<()> {
        self.finish_where(now, |_| true)?;
        self.writer.flush()
    }

    fn finish_where(&mut self, now: HostTime, condition: impl Fn(Peer) -> bool) -> io::Result<()> {
        let writer = &mut self.writer;
        for (_, mut splitter) in self.streams.extract_if(.., |(peer, _)| condition(*peer)) {
            splitter.finish(|entry| writer.write(microseconds(now), entry))?;
        }
        Ok(())
    }

    /// The writer, for what is not flushed yet.
    pub fn into_inner(self) -> W {
        self.writer.into_inner()
    }
}

fn microseconds(time: HostTime) -> u64 {
    time.as_ns() / 1000
}

#[cfg(test)]
mod tests {
    use wire::Encoder;
    use wire::dialect::MavMessage;
    use wire::tlog::Reader;

    use super::*;

    const NOW: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);

    #[test]
    fn every_byte_of_both_directions_is_kept() {
        let mut encoder = Encoder::new(1, 1);
        let mut frame = || {
            let mut bytes = Vec::new();
            encoder.encode(&MavMessage::HEARTBEAT(Default::default()), &mut bytes);
            bytes
        };
        let (a, b, c, sent) = (frame(), frame(), frame(), frame());
        let (peer, other) = (Peer::new(1), Peer::new(2));
        let mut tee = Tee::new(Vec::new());
        tee.received(NOW, peer, &[&a[..], &b[..5]].concat(), false).unwrap();
        tee.received(NOW, other, &c, false).unwrap();
        tee.sent(NOW, &sent).unwrap();
        tee.received(NOW, peer, &[&b[5..], b"rest"].concat(), false).unwrap();
        tee.received(NOW, other, b"garbage", true).unwrap();
        tee.received(NOW, peer, &a[..7], false).unwrap();
        tee.finish(NOW).unwrap();
        let log = tee.into_inner();
        let total = 3 * a.len() + sent.len() + b"restgarbage".len() + 7;
        let entries = 7;
        assert_eq!(log.len(), total + entries * 8);
        let frames: Vec<_> = Reader::new(&log[..]).map(|entry| entry.unwrap().frame).collect();
        assert_eq!(frames, [a, c, sent, b]);
    }
}
