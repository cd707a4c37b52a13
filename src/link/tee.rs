//! The tee: every byte of a link, both directions, into a telemetry log.
//!
//! It writes to a file and may wait for the disk, so it belongs on the logging side of a bounded
//! channel and not on the control line.

use std::io::{self, Write};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, JoinHandle};

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

    /// All peers are gone, and their numbers may be used anew: what they left unfinished is
    /// written.
    ///
    /// # Errors
    /// Those of the writer.
    pub fn transport_closed(&mut self, now: HostTime) -> io::Result<()> {
        self.finish_where(now, |_| true)
    }

    /// The link is at its end: what is left unfinished is written, and everything is flushed.
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

/// Entries that wait for the disk.
const QUEUE: usize = 4096;

/// A [`Tee`] in a thread of its own: handing it bytes never waits. Entries that find the queue full
/// are dropped and counted.
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
    /// `None` is every peer.
    Closed {
        now: HostTime,
        peer: Option<Peer>,
    },
}

impl TeeThread {
    /// Starts writing to `out`.
    ///
    /// # Errors
    /// If the system gives no thread.
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

    /// Bytes that arrived.
    pub fn received(&mut self, now: HostTime, peer: Peer, bytes: &[u8], is_datagram: bool) {
        self.put(Entry::Received { now, peer, bytes: bytes.to_vec(), is_datagram });
    }

    /// A frame that was sent.
    pub fn sent(&mut self, now: HostTime, frame: &[u8]) {
        self.put(Entry::Sent { now, frame: frame.to_vec() });
    }

    /// A peer is gone.
    pub fn peer_closed(&mut self, now: HostTime, peer: Peer) {
        self.put(Entry::Closed { now, peer: Some(peer) });
    }

    /// All peers are gone, and their numbers may be used anew.
    pub fn transport_closed(&mut self, now: HostTime) {
        self.put(Entry::Closed { now, peer: None });
    }

    fn put(&mut self, entry: Entry) {
        if self.queue.try_send(entry).is_err() {
            self.dropped += 1;
        }
    }

    /// Writes what is left and returns the number of entries that were dropped.
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

    /// A buffer that is read while a thread writes to it.
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
    fn what_a_closed_peer_left_unfinished_does_not_swallow_the_next_ones_frame() {
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
