//! UDP: a listener with a table of the senders it heard, and a socket with one remote.

use std::collections::VecDeque;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::task::{Context, Poll, ready};

use tokio::io::ReadBuf;
use tokio::net::UdpSocket;

use super::{Incoming, PEERS_MAX, Peer, TransportStats, resolve};
use crate::endpoint::Address;

/// `udpin`: answers every sender at its source address.
#[derive(Debug)]
pub(super) struct UdpListener {
    socket: UdpSocket,
    senders: Vec<Sender>,
    /// Counts datagrams, to tell which sender was silent longest.
    heard: u64,
    next_id: u32,
    evicted: VecDeque<Peer>,
}

#[derive(Debug)]
struct Sender {
    peer: Peer,
    address: SocketAddr,
    last_heard: u64,
}

impl UdpListener {
    pub(super) async fn bind(address: &Address) -> io::Result<Self> {
        let socket = UdpSocket::bind(resolve(address).await?.as_slice()).await?;
        // A socket counts as full until the runtime has looked at it once.
        socket.writable().await?;
        Ok(Self { socket, senders: Vec::new(), heard: 0, next_id: 0, evicted: VecDeque::new() })
    }

    pub(super) fn local_addr(&self) -> Option<SocketAddr> {
        self.socket.local_addr().ok()
    }

    pub(super) fn peers(&self) -> impl Iterator<Item = Peer> + '_ {
        self.senders.iter().map(|sender| sender.peer)
    }

    pub(super) fn remote_addr(&self, peer: Peer) -> Option<SocketAddr> {
        self.senders.iter().find(|sender| sender.peer == peer).map(|sender| sender.address)
    }

    pub(super) fn poll_recv(
        &mut self,
        cx: &mut Context<'_>,
        buffer: &mut [u8],
    ) -> Poll<io::Result<Incoming>> {
        if let Some(peer) = self.evicted.pop_front() {
            return Poll::Ready(Ok(Incoming::Closed(peer)));
        }
        loop {
            let mut read = ReadBuf::new(buffer);
            match ready!(self.socket.poll_recv_from(cx, &mut read)) {
                Ok(address) => {
                    let len = read.filled().len();
                    let peer = self.hear(address);
                    return Poll::Ready(Ok(Incoming::Bytes { peer, len }));
                }
                Err(error) if is_transient(&error) => {}
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }

    fn hear(&mut self, address: SocketAddr) -> Peer {
        self.heard += 1;
        if let Some(sender) = self.senders.iter_mut().find(|sender| sender.address == address) {
            sender.last_heard = self.heard;
            return sender.peer;
        }
        if self.senders.len() >= PEERS_MAX {
            let oldest = self.senders.iter().enumerate().min_by_key(|(_, s)| s.last_heard);
            if let Some((index, _)) = oldest {
                self.evicted.push_back(self.senders.swap_remove(index).peer);
            }
        }
        let peer = Peer(self.next_id);
        self.next_id = self.next_id.wrapping_add(1);
        self.senders.push(Sender { peer, address, last_heard: self.heard });
        peer
    }

    pub(super) fn send(&mut self, peer: Peer, bytes: &[u8]) -> bool {
        match self.remote_addr(peer) {
            Some(address) => self.socket.try_send_to(bytes, address).is_ok(),
            None => false,
        }
    }

    pub(super) fn close(&mut self, peer: Peer) {
        self.senders.retain(|sender| sender.peer != peer);
    }
}

/// `udpout`: one remote. The socket is connected, so the system drops what others send.
#[derive(Debug)]
pub(super) struct UdpRemote {
    socket: UdpSocket,
}

impl UdpRemote {
    /// The one peer.
    pub(super) const PEER: Peer = Peer(0);

    pub(super) async fn connect(address: &Address) -> io::Result<Self> {
        let mut failure = None;
        for remote in resolve(address).await? {
            let local: SocketAddr = match remote {
                SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
                SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
            };
            let socket = UdpSocket::bind(local).await?;
            match socket.connect(remote).await {
                Ok(()) => {
                    // A socket counts as full until the runtime has looked at it once.
                    socket.writable().await?;
                    return Ok(Self { socket });
                }
                Err(error) => failure = Some(error),
            }
        }
        Err(failure.unwrap_or_else(|| io::ErrorKind::NotFound.into()))
    }

    pub(super) fn local_addr(&self) -> Option<SocketAddr> {
        self.socket.local_addr().ok()
    }

    pub(super) fn remote_addr(&self) -> Option<SocketAddr> {
        self.socket.peer_addr().ok()
    }

    pub(super) fn poll_recv(
        &mut self,
        cx: &mut Context<'_>,
        buffer: &mut [u8],
        stats: &mut TransportStats,
    ) -> Poll<io::Result<Incoming>> {
        loop {
            let mut read = ReadBuf::new(buffer);
            match ready!(self.socket.poll_recv(cx, &mut read)) {
                Ok(()) => {
                    let len = read.filled().len();
                    return Poll::Ready(Ok(Incoming::Bytes { peer: Self::PEER, len }));
                }
                Err(error) if is_transient(&error) => stats.refused += 1,
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }

    pub(super) fn send(&mut self, bytes: &[u8], stats: &mut TransportStats) -> bool {
        match self.socket.try_send(bytes) {
            Ok(_) => true,
            // The system reports the refusal of an earlier datagram here and sends nothing now.
            Err(error) if is_transient(&error) => {
                stats.refused += 1;
                self.socket.try_send(bytes).is_ok()
            }
            Err(_) => false,
        }
    }
}

/// Errors that tell of one datagram and not of the socket: the remote does not listen (yet).
fn is_transient(error: &io::Error) -> bool {
    use io::ErrorKind as Kind;
    matches!(
        error.kind(),
        Kind::ConnectionRefused
            | Kind::ConnectionReset
            | Kind::HostUnreachable
            | Kind::NetworkUnreachable
            | Kind::Interrupted
    )
}
