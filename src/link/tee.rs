//! The tee: every byte of a link, in both directions, into a telemetry log.
//!
//! It writes to a file and may wait for the disk, so it belongs on the logging side of a bounded
//! channel and not on the control path.

use std::io::{self, Write};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

use wire::tlog::{Splitter, Writer};
use wire::transport::Peer;

use crate::clock::HostTime;

/// Writes what a link receives and sends. A frame is stamped with the arrival of its last byte.
/// Bytes that belong to no frame become entries of their own.
#[derive(Debug)]
pub struct Tee<W> {
    writer: Writer<W>,
    datagrams: Splitter,
    streams: Vec<(Peer, Splitter)>,
}

impl<W: Write> Tee<W> {
    /// A tee that writes to `out`, which should be buffered.
    pub fn new(out: W) -> Self {
        Self { writer: Writer::new(out), datagrams: Splitter::default(), streams: Vec::new() }
    }

    /// Takes bytes that arrived.
    ///
    /// # Errors
    /// Errors of the writer.
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
    /// Errors of the writer.
    pub fn sent(&mut self, now: HostTime, frame: &[u8]) -> io::Result<()> {
        self.writer.write(microseconds(now), frame)
    }

    /// Notes that a peer closed: its unfinished bytes are written.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn peer_closed(&mut self, now: HostTime, peer: Peer) -> io::Result<()> {
        self.finish_where(now, |known| known == peer)
    }

    /// Notes that all peers closed, and that their numbers may be reused: their unfinished bytes
    /// are written.
    ///
    /// # Errors
    /// Errors of the writer.
    pub fn transport_closed(&mut self, now: HostTime) -> io::Result<()> {
        self.finish_where(now, |_| true)
    }

    /// Ends the log: unfinished bytes are written, and everything is flushed.
    ///
    /// # Errors
    /// Errors of the writer.
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

    /// The writer, with whatever is not flushed yet.
    pub fn into_inner(self) -> W {
        self.writer.into_inner()
    }
}

/// Entries that may wait for the disk.
const QUEUE: usize = 4096;

/// A [`Tee`] in its own thread: handing it bytes never waits. Entries that do not fit into the
/// queue are dropped and counted.
#[derive(Debug)]
pub struct TeeThread {
    queue: SyncSender<Entry>,
    dropped: u64,
    thread: JoinHandle<io::Result<()>>,
}

#[derive(Debug)]
enum Entry {
    Received {
        now: HostTime,
        peer: Peer,
        bytes: Vec<u8>,
        is_datagram: bool,
    },
    Sent {
        now: HostTime,
        frame: Vec<u8>,
    },
    /// `None` means every peer.
    Closed {
        now: HostTime,
        peer: Option<Peer>,
    },
}

impl TeeThread {
    /// Starts writing to `out`.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn start(out: impl Write + Send + 'static) -> io::Result<Self> {
        let (queue, entries) = sync_channel::<Entry>(QUEUE);
        let thread = thread::Builder::new().name("tlog".into()).spawn(move || {
            let mut tee = Tee::new(out);
            let mut last = HostTime::default();
            for entry in entries {
                match entry {
                    Entry::Received { now, peer, bytes, is_datagram } => {
                        last = now;
                        tee.received(now, peer, &bytes, is_datagram)?;
                    }
                    Entry::Sent { now, frame } => {
                        last = now;
                        tee.sent(now, &frame)?;
                    }
                    Entry::Closed { now, peer } => {
                        last = now;
                        match peer {
                            Some(peer) => tee.peer_closed(now, peer)?,
                            None => tee.transport_closed(now)?,
                        }
                    }
                }
            }
            tee.finish(last)
        })?;
        Ok(Self { queue, dropped: 0, thread })
    }

    /// Records bytes that arrived.
    pub fn received(&mut self, now: HostTime, peer: Peer, bytes: &[u8], is_datagram: bool) {
        self.put(Entry::Received { now, peer, bytes: bytes.to_vec(), is_datagram });
    }

    /// Records a frame that was sent.
    pub fn sent(&mut self, now: HostTime, frame: &[u8]) {
        self.put(Entry::Sent { now, frame: frame.to_vec() });
    }

    /// Records that a peer closed.
    pub fn peer_closed(&mut self, now: HostTime, peer: Peer) {
        self.put(Entry::Closed { now, peer: Some(peer) });
    }

    /// Records that all peers closed, and that their numbers may be reused.
    pub fn transport_closed(&mut self, now: HostTime) {
        self.put(Entry::Closed { now, peer: None });
    }

    fn put(&mut self, entry: Entry) {
        if self.queue.try_send(entry).is_err() {
            self.dropped += 1;
        }
    }

    /// Writes the rest and returns the number of dropped entries.
    ///
    /// # Errors
    /// The error that ended the file, now or earlier.
    pub fn finish(self) -> io::Result<u64> {
        drop(self.queue);
        match self.thread.join() {
            Ok(result) => result.map(|()| self.dropped),
            Err(panic) => std::panic::resume_unwind(panic),
        }
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

    /// A buffer that the test reads while a thread writes to it.
    #[derive(Clone, Default)]
    struct Shared(std::sync::Arc<std::sync::Mutex<Vec<u8>>>);

    impl Write for Shared {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn partial_frame_of_a_closed_peer_is_discarded() {
        let mut encoder = Encoder::new(1, 1);
        let mut frame = Vec::new();
        encoder.encode(&MavMessage::HEARTBEAT(Default::default()), &mut frame);
        let closes: [fn(&mut TeeThread, Peer); 2] =
            [|tee, peer| tee.peer_closed(NOW, peer), |tee, _| tee.transport_closed(NOW)];
        for close in closes {
            let (log, peer) = (Shared::default(), Peer::new(0));
            let mut tee = TeeThread::start(log.clone()).unwrap();
            tee.received(NOW, peer, &frame[..10], false);
            close(&mut tee, peer);
            tee.received(NOW, peer, &frame, false);
            assert_eq!(tee.finish().unwrap(), 0);
            let log = log.0.lock().unwrap();
            let frames: Vec<_> = Reader::new(&log[..]).map(|entry| entry.unwrap().frame).collect();
            assert_eq!(frames, [&frame[..]]);
        }
    }
}
