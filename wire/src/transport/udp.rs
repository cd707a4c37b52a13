//! UDP: a listener with a table of senders, and a socket with one remote.

use std::collections::VecDeque;
use std::io;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::task::{Context, Poll, ready};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use tokio::io::ReadBuf;

use super::{Incoming, PEERS_MAX, Peer, TransportStats, resolve};
use crate::endpoint::Address;

/// A non-blocking socket under two descriptors: one that the runtime watches, and one for calls
/// that bypass it.
#[derive(Debug)]
struct Socket {
    watched: tokio::net::UdpSocket,
    direct: UdpSocket,
}

impl Socket {
    fn new(direct: UdpSocket) -> io::Result<Self> {
        direct.set_nonblocking(true)?;
        let watched = tokio::net::UdpSocket::from_std(direct.try_clone()?)?;
        Ok(Self { watched, direct })
    }

    /// Blocks the calling thread until a datagram arrives or `timeout` passes. Returns whether one
    /// arrived.
    fn wait(&self, timeout: Duration) -> io::Result<bool> {
        let timeout = Timespec::try_from(timeout).ok();
        match poll(&mut [PollFd::new(&self.direct, PollFlags::IN)], timeout.as_ref()) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }
}

/// `udpin`: replies to every sender at its source address.
#[derive(Debug)]
pub(super) struct UdpListener {
    socket: Socket,
    senders: Vec<Sender>,
    /// Counts datagrams, to find the sender that has been silent longest.
    datagrams: u64,
    next_id: u32,
    evicted: VecDeque<Peer>,
    /// The peer that is never evicted.
    kept: Option<Peer>,
}

#[derive(Debug)]
struct Sender {
    peer: Peer,
    address: SocketAddr,
    last_datagram: u64,
}

impl UdpListener {
    pub(super) async fn bind(address: &Address) -> io::Result<Self> {
        let socket = Socket::new(UdpSocket::bind(resolve(address).await?.as_slice())?)?;
        let (senders, evicted) = (Vec::new(), VecDeque::new());
        Ok(Self { socket, senders, datagrams: 0, next_id: 0, evicted, kept: None })
    }

    pub(super) fn local_addr(&self) -> Option<SocketAddr> {
        self.socket.direct.local_addr().ok()
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
            match ready!(self.socket.watched.poll_recv_from(cx, &mut read)) {
                Ok(address) => {
                    let len = read.filled().len();
                    let peer = self.peer_of(address);
                    return Poll::Ready(Ok(Incoming::Bytes { peer, len }));
                }
                Err(error) if is_transient(&error) => {}
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }

    pub(super) fn wait(
        &mut self,
        buffer: &mut [u8],
        timeout: Duration,
    ) -> io::Result<Option<Incoming>> {
        if let Some(peer) = self.evicted.pop_front() {
            return Ok(Some(Incoming::Closed(peer)));
        }
        if !self.socket.wait(timeout)? {
            return Ok(None);
        }
        match self.socket.direct.recv_from(buffer) {
            Ok((len, address)) => Ok(Some(Incoming::Bytes { peer: self.peer_of(address), len })),
            Err(error) if is_nothing(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn peer_of(&mut self, address: SocketAddr) -> Peer {
        self.datagrams += 1;
        if let Some(sender) = self.senders.iter_mut().find(|sender| sender.address == address) {
            sender.last_datagram = self.datagrams;
            return sender.peer;
        }
        if self.senders.len() >= PEERS_MAX {
            let others = self.senders.iter().enumerate().filter(|(_, s)| Some(s.peer) != self.kept);
            let oldest = others.min_by_key(|(_, s)| s.last_datagram);
            if let Some((index, _)) = oldest {
                self.evicted.push_back(self.senders.swap_remove(index).peer);
            }
        }
        let peer = Peer(self.next_id);
        self.next_id = self.next_id.wrapping_add(1);
        self.senders.push(Sender { peer, address, last_datagram: self.datagrams });
        peer
    }

    pub(super) fn send(&mut self, peer: Peer, bytes: &[u8]) -> bool {
        match self.remote_addr(peer) {
            Some(address) => self.socket.direct.send_to(bytes, address).is_ok(),
            None => false,
        }
    }

    pub(super) fn keep(&mut self, peer: Option<Peer>) {
        self.kept = peer;
    }

    pub(super) fn close(&mut self, peer: Peer) {
        self.senders.retain(|sender| sender.peer != peer);
    }
}

/// `udpout`: one remote. The socket is connected, so the system drops datagrams from others.
#[derive(Debug)]
pub(super) struct UdpRemote {
    socket: Socket,
}

impl UdpRemote {
    /// The only peer.
    pub(super) const PEER: Peer = Peer(0);

    pub(super) async fn connect(address: &Address) -> io::Result<Self> {
        let mut failure = None;
        for remote in resolve(address).await? {
            let local: SocketAddr = match remote {
                SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
                SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
            };
            let socket = UdpSocket::bind(local)?;
            match socket.connect(remote) {
                Ok(()) => return Ok(Self { socket: Socket::new(socket)? }),
                Err(error) => failure = Some(error),
            }
        }
        Err(failure.unwrap_or_else(|| io::ErrorKind::NotFound.into()))
    }

    pub(super) fn local_addr(&self) -> Option<SocketAddr> {
        self.socket.direct.local_addr().ok()
    }

    pub(super) fn remote_addr(&self) -> Option<SocketAddr> {
        self.socket.direct.peer_addr().ok()
    }

    pub(super) fn poll_recv(
        &mut self,
        cx: &mut Context<'_>,
        buffer: &mut [u8],
        stats: &mut TransportStats,
    ) -> Poll<io::Result<Incoming>> {
        loop {
            let mut read = ReadBuf::new(buffer);
            match ready!(self.socket.watched.poll_recv(cx, &mut read)) {
                Ok(()) => {
                    let len = read.filled().len();
                    return Poll::Ready(Ok(Incoming::Bytes { peer: Self::PEER, len }));
                }
                Err(error) if is_transient(&error) => stats.refused += 1,
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }

    pub(super) fn wait(
        &mut self,
        buffer: &mut [u8],
        timeout: Duration,
        stats: &mut TransportStats,
    ) -> io::Result<Option<Incoming>> {
        if !self.socket.wait(timeout)? {
            return Ok(None);
        }
        match self.socket.direct.recv(buffer) {
            Ok(len) => Ok(Some(Incoming::Bytes { peer: Self::PEER, len })),
            Err(error) if is_transient(&error) => {
                stats.refused += 1;
                Ok(None)
            }
            Err(error) if is_nothing(&error) => Ok(None),
            Err(error) => Err(error),
        }
    }

    pub(super) fn send(&mut self, bytes: &[u8], stats: &mut TransportStats) -> bool {
        match self.socket.direct.send(bytes) {
            Ok(_) => true,
            // The system reports the refusal of an earlier datagram here and sends nothing now.
            Err(error) if is_transient(&error) => {
                stats.refused += 1;
                self.socket.direct.send(bytes).is_ok()
            }
            Err(_) => false,
        }
    }
}

/// Errors of a receive call that leave the socket intact: the error of an earlier send, or a
/// datagram that the system announced and then dropped for its checksum.
fn is_nothing(error: &io::Error) -> bool {
    is_transient(error) || error.kind() == io::ErrorKind::WouldBlock
}

/// Errors that concern one datagram and not the socket: the remote does not listen (yet).
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
