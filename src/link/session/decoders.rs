//! The decoders of all peers, one for each stream of bytes.

use wire::transport::{PEERS_MAX, Peer};
use wire::{Decoder, DecoderStats, Frame};

/// A decoder for all datagrams, and one for each stream.
#[derive(Debug, Default)]
pub(super) struct Decoders {
    datagrams: Decoder,
    streams: Vec<Stream>,
    /// Statistics of the decoders of closed streams.
    closed: DecoderStats,
}

#[derive(Debug)]
struct Stream {
    peer: Peer,
    decoder: Decoder,
}

impl Decoders {
    /// Decodes a datagram, which holds whole frames.
    pub fn datagram(&mut self, bytes: &[u8], on: impl FnMut(Frame)) {
        self.datagrams.datagram(bytes, on);
    }

    /// Decodes the next bytes of a peer's stream. Of too many streams, the oldest ends.
    pub fn stream(&mut self, peer: Peer, bytes: &[u8], mut on: impl FnMut(Frame)) {
        let index = match self.streams.iter().position(|stream| stream.peer == peer) {
            Some(index) => index,
            None => {
                if self.streams.len() == PEERS_MAX {
                    self.closed += self.streams.remove(0).decoder.stats();
                }
                self.streams.push(Stream { peer, decoder: Decoder::new() });
                self.streams.len() - 1
            }
        };
        let decoder = &mut self.streams[index].decoder;
        decoder.push(bytes);
        while let Some(frame) = decoder.next_frame() {
            on(frame);
        }
    }

    /// Ends the stream of a peer.
    pub fn close(&mut self, peer: Peer) {
        for stream in self.streams.extract_if(.., |stream| stream.peer == peer) {
            self.closed += stream.decoder.stats();
        }
    }

    /// Ends all streams.
    pub fn close_all(&mut self) {
        for stream in self.streams.drain(..) {
            self.closed += stream.decoder.stats();
        }
    }

    /// Statistics of all decoders, closed ones included.
    pub fn stats(&self) -> DecoderStats {
        let mut stats = self.closed;
        stats += self.datagrams.stats();
        for stream in &self.streams {
            stats += stream.decoder.stats();
        }
        stats
    }
}
