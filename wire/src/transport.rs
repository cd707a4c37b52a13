//! Transports: open [`Endpoint`]s, which receive and send bytes, serve several peers and never
//! block a sender.
//!
//! One task polls a transport. Receiving costs one system call per datagram, sending one per frame,
//! and neither allocates.

mod stream;
mod udp;

use std::future::poll_fn;
use std::io;
use std::net::SocketAddr;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::net::{TcpStream, lookup_host};

use self::stream::{Listener, Stream, StreamPeer};
use self::udp::{UdpListener, UdpRemote};
use crate::endpoint::{Address, Endpoint};

/// Size of a receive buffer that fits any datagram.
pub const RECEIVE_LEN: usize = 65_536;

/// Largest number of peers that a listening transport serves at once.
pub const PEERS_MAX: usize = 32;

/// One remote end of a transport. A transport does not reuse ids.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Peer(u32);

impl Peer {
    /// Creates a peer with a number chosen by the caller, for transports outside this module
    /// (in-process links, tests).
    pub const fn new(id: u32) -> Self {
        Self(id)
    }

    /// The peer's number, unique within its transport.
    pub const fn id(self) -> u32 {
        self.0
    }
}

/// What [`Transport::recv`] received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Incoming {
    /// Bytes from a peer, at the start of the buffer: one datagram, or a piece of a stream. The
    /// first bytes of a UDP peer announce it.
    Bytes {
        /// The sender.
        peer: Peer,
        /// Number of bytes.
        len: usize,
    },
    /// A connection was accepted (`tcpin`).
    Opened(Peer),
    /// A peer is gone: its connection ended (`tcpin`), or a newer peer took its place in a full
    /// table (`udpin`).
    Closed(Peer),
}

/// Counters since a transport was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TransportStats {
    /// Sends dropped because the send buffer was full, or the peer unknown or gone.
    pub dropped: u64,
    /// Number of times that a UDP remote reported that nobody listens there.
    pub refused: u64,
    /// Connections refused because [`PEERS_MAX`] were open.
    pub turned_away: u64,
}

/// Why an endpoint cannot be opened, and what to do.
#[derive(Debug, thiserror::Error)]
#[error("cannot open {endpoint}: {cause}{hint}")]
pub struct OpenError {
    endpoint: Endpoint,
    #[source]
    cause: io::Error,
    hint: &'static str,
}

impl OpenError {
    fn new(endpoint: &Endpoint, cause: io::Error) -> Self {
        let serial = matches!(endpoint, Endpoint::Serial { .. });
        let hint = match cause.kind() {
            io::ErrorKind::AddrInUse => {
                "; the port is in use: stop the other program or choose another port"
            }
            io::ErrorKind::ResourceBusy => {
                "; the port is in use by another program (a ground station, ModemManager?)"
            }
            io::ErrorKind::NotFound if serial => "; is the device plugged in?",
            io::ErrorKind::PermissionDenied if serial => {
                "; add the user to the group that owns the device (often 'dialout')"
            }
            io::ErrorKind::ConnectionRefused => "; nothing listens there yet",
            io::ErrorKind::AddrNotAvailable => "; the host is not an address of this machine",
            _ => "",
        };
        Self { endpoint: endpoint.clone(), cause, hint }
    }

    /// The system's kind of error; a busy port is `AddrInUse` or `ResourceBusy`.
    pub fn kind(&self) -> io::ErrorKind {
        self.cause.kind()
    }
}

/// An open endpoint with its peers.
#[derive(Debug)]
pub struct Transport {
    kind: Kind,
    stats: TransportStats,
}

#[derive(Debug)]
enum Kind {
    UdpIn(UdpListener),
    UdpOut(UdpRemote),
    Stream(StreamPeer),
    TcpIn(Listener),
}

impl Transport {
    /// Opens an endpoint. A TCP connection attempt can take minutes: bound it with a time-out.
    ///
    /// # Errors
    /// [`OpenError`], such as a port in use, a missing device, or a host without an address.
    pub async fn open(endpoint: &Endpoint) -> Result<Self, OpenError> {
        let kind = match endpoint {
            Endpoint::UdpIn(address) => UdpListener::bind(address).await.map(Kind::UdpIn),
            Endpoint::UdpOut(address) => UdpRemote::connect(address).await.map(Kind::UdpOut),
            Endpoint::TcpOut(address) => connect(address).await.map(Kind::Stream),
            Endpoint::TcpIn(address) => Listener::bind(address).await.map(Kind::TcpIn),
            Endpoint::Serial { path, baud } => Stream::open_serial(path, *baud)
                .map(|stream| Kind::Stream(StreamPeer::new(Peer(0), stream))),
        };
        match kind {
            Ok(kind) => Ok(Self { kind, stats: TransportStats::default() }),
            Err(cause) => Err(OpenError::new(endpoint, cause)),
        }
    }

    /// Whether bytes arrive as datagrams; a frame never spans two of them.
    pub fn is_datagram(&self) -> bool {
        matches!(self.kind, Kind::UdpIn(_) | Kind::UdpOut(_))
    }

    /// The local address, if there is one, with the port that the system chose.
    pub fn local_addr(&self) -> Option<SocketAddr> {
        match &self.kind {
            Kind::UdpIn(listener) => listener.local_addr(),
            Kind::UdpOut(remote) => remote.local_addr(),
            Kind::Stream(peer) => peer.stream.local_addr(),
            Kind::TcpIn(listener) => listener.local_addr(),
        }
    }

    /// The peers that can receive now: the remote end of `udpout`, `tcp` and `serial` from the
    /// start, those of `udpin` and `tcpin` after their first datagram or connection.
    pub fn peers(&self) -> impl Iterator<Item = Peer> + '_ {
        let (one, udp, tcp) = match &self.kind {
            Kind::UdpIn(listener) => (None, Some(listener.peers()), None),
            Kind::UdpOut(_) => (Some(UdpRemote::PEER), None, None),
            Kind::Stream(stream) => (Some(stream.peer), None, None),
            Kind::TcpIn(listener) => (None, None, Some(listener.peers())),
        };
        one.into_iter().chain(udp.into_iter().flatten()).chain(tcp.into_iter().flatten())
    }

    /// A peer's address; `None` for a serial port or a peer that is gone.
    pub fn remote_addr(&self, peer: Peer) -> Option<SocketAddr> {
        match &self.kind {
            Kind::UdpIn(listener) => listener.remote_addr(peer),
            Kind::UdpOut(remote) => remote.remote_addr(),
            Kind::Stream(stream) => stream.stream.remote_addr(),
            Kind::TcpIn(listener) => listener.remote_addr(peer),
        }
    }

    /// Counters since the transport was opened.
    pub fn stats(&self) -> TransportStats {
        self.stats
    }

    /// Waits for bytes or for a peer to come or go. Cancel-safe: a dropped future loses nothing.
    /// A datagram longer than `buffer` is cut; [`RECEIVE_LEN`] is always enough.
    ///
    /// # Errors
    /// The transport is lost and must be reopened: the remote end closed (`UnexpectedEof`), the
    /// serial device was unplugged, or the socket failed. A UDP remote that does not listen is not
    /// an error.
    pub async fn recv(&mut self, buffer: &mut [u8]) -> io::Result<Incoming> {
        poll_fn(|cx| self.poll_recv(cx, buffer)).await
    }

    /// [`recv`](Self::recv) as a poll function: registers the task for a wake-up if nothing is
    /// ready.
    pub fn poll_recv(
        &mut self,
        cx: &mut Context<'_>,
        buffer: &mut [u8],
    ) -> Poll<io::Result<Incoming>> {
        match &mut self.kind {
            Kind::UdpIn(listener) => listener.poll_recv(cx, buffer),
            Kind::UdpOut(remote) => remote.poll_recv(cx, buffer, &mut self.stats),
            Kind::Stream(stream) => {
                let peer = stream.peer;
                stream.poll_recv(cx, buffer).map_ok(|len| Incoming::Bytes { peer, len })
            }
            Kind::TcpIn(listener) => listener.poll_recv(cx, buffer, &mut self.stats),
        }
    }

    /// As [`recv`](Self::recv), blocking the calling thread without the runtime. Returns `None`
    /// after `timeout`, or earlier after another event. For a dedicated thread, which then receives
    /// a datagram sooner, without the runtime's latency.
    ///
    /// # Errors
    /// As [`recv`](Self::recv); `Unsupported` unless the transport [carries
    /// datagrams](Self::is_datagram).
    pub fn wait(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<Option<Incoming>> {
        match &mut self.kind {
            Kind::UdpIn(listener) => listener.wait(buffer, timeout),
            Kind::UdpOut(remote) => remote.wait(buffer, timeout, &mut self.stats),
            Kind::Stream(_) | Kind::TcpIn(_) => Err(io::ErrorKind::Unsupported.into()),
        }
    }

    /// Passes bytes (whole frames) to the system without blocking. Returns whether it took them.
    ///
    /// It drops and counts what does not fit, since a late setpoint is worse than none. If a stream
    /// takes part of the bytes, the rest is kept and sent first, so no frame is cut; until then,
    /// further sends are dropped whole. The next [`recv`](Self::recv) reports a failed stream.
    pub fn send(&mut self, peer: Peer, bytes: &[u8]) -> bool {
        let sent = match &mut self.kind {
            Kind::UdpIn(listener) => listener.send(peer, bytes),
            Kind::UdpOut(remote) => remote.send(bytes, &mut self.stats),
            Kind::Stream(stream) => stream.send(bytes),
            Kind::TcpIn(listener) => listener.send(peer, bytes),
        };
        self.stats.dropped += u64::from(!sent);
        sent
    }

    /// Protects one peer of `udpin` from eviction by newer ones; replaces the previously protected
    /// peer.
    pub fn keep(&mut self, peer: Option<Peer>) {
        if let Kind::UdpIn(listener) = &mut self.kind {
            listener.keep(peer);
        }
    }

    /// Forgets a peer of `udpin`, or closes a connection of `tcpin`. No [`Incoming::Closed`]
    /// follows. A forgotten UDP peer that sends again counts as new.
    pub fn close(&mut self, peer: Peer) {
        match &mut self.kind {
            Kind::UdpIn(listener) => listener.close(peer),
            Kind::TcpIn(listener) => listener.close(peer),
            Kind::UdpOut(_) | Kind::Stream(_) => {}
        }
    }
}

async fn connect(address: &Address) -> io::Result<StreamPeer> {
    let stream = TcpStream::connect((address.host.as_str(), address.port)).await?;
    Ok(StreamPeer::new(Peer(0), Stream::tcp(stream)))
}

/// The addresses of a host, at least one.
async fn resolve(address: &Address) -> io::Result<Vec<SocketAddr>> {
    let found: Vec<_> = lookup_host((address.host.as_str(), address.port)).await?.collect();
    if found.is_empty() {
        let message = format!("host '{}' has no address", address.host);
        return Err(io::Error::new(io::ErrorKind::NotFound, message));
    }
    Ok(found)
}
