//! Streams: outgoing and incoming TCP connections, and serial ports.

use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll, ready};

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio_serial::{SerialPortBuilderExt, SerialStream};

use super::{Incoming, PEERS_MAX, Peer, TransportStats, resolve};
use crate::endpoint::Address;

/// A byte stream with non-blocking reads and writes.
#[derive(Debug)]
pub(super) enum Stream {
    Tcp(TcpStream),
    Serial(SerialStream),
}

impl Stream {
    /// Wraps a connection with Nagle's algorithm off, so every frame leaves at once.
    pub(super) fn tcp(stream: TcpStream) -> Self {
        // Fails only on a connection that is already gone, which the next read reports.
        let _ = stream.set_nodelay(true);
        Self::Tcp(stream)
    }

    /// Opens a serial port exclusively.
    pub(super) fn open_serial(path: &str, baud: u32) -> io::Result<Self> {
        let port = tokio_serial::new(path, baud).exclusive(true).open_native_async();
        port.map(Self::Serial).map_err(|error| serial_error(path, error))
    }

    pub(super) fn local_addr(&self) -> Option<SocketAddr> {
        match self {
            Self::Tcp(stream) => stream.local_addr().ok(),
            Self::Serial(_) => None,
        }
    }

    pub(super) fn remote_addr(&self) -> Option<SocketAddr> {
        match self {
            Self::Tcp(stream) => stream.peer_addr().ok(),
            Self::Serial(_) => None,
        }
    }

    fn poll_read(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<io::Result<usize>> {
        let mut read = ReadBuf::new(buffer);
        ready!(match self {
            Self::Tcp(stream) => Pin::new(stream).poll_read(cx, &mut read),
            Self::Serial(stream) => Pin::new(stream).poll_read(cx, &mut read),
        })?;
        Poll::Ready(Ok(read.filled().len()))
    }

    fn poll_write(&mut self, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        match self {
            Self::Tcp(stream) => Pin::new(stream).poll_write(cx, bytes),
            Self::Serial(stream) => Pin::new(stream).poll_write(cx, bytes),
        }
    }

    fn try_write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Tcp(stream) => stream.try_write(bytes),
            Self::Serial(stream) => stream.try_write(bytes),
        }
    }
}

fn serial_error(path: &str, error: tokio_serial::Error) -> io::Error {
    use tokio_serial::ErrorKind as Kind;
    let kind = match error.kind() {
        // The library reports "no device" for a port that another program holds.
        Kind::NoDevice if std::fs::metadata(path).is_ok() => io::ErrorKind::ResourceBusy,
        Kind::NoDevice => io::ErrorKind::NotFound,
        Kind::InvalidInput => io::ErrorKind::InvalidInput,
        Kind::Io(kind) => kind,
        Kind::Unknown => io::ErrorKind::Other,
    };
    io::Error::new(kind, error.description)
}

/// A stream and the unsent rest of the last frame.
#[derive(Debug)]
pub(super) struct StreamPeer {
    pub(super) peer: Peer,
    pub(super) stream: Stream,
    rest: Vec<u8>,
}

impl StreamPeer {
    pub(super) fn new(peer: Peer, stream: Stream) -> Self {
        Self { peer, stream, rest: Vec::new() }
    }

    /// Returns the number of bytes read, never 0. First sends the rest of the last frame.
    pub(super) fn poll_recv(
        &mut self,
        cx: &mut Context<'_>,
        buffer: &mut [u8],
    ) -> Poll<io::Result<usize>> {
        while !self.rest.is_empty() {
            match self.stream.poll_write(cx, &self.rest) {
                Poll::Ready(Ok(0)) => return Poll::Ready(Err(io::ErrorKind::WriteZero.into())),
                Poll::Ready(Ok(count)) => drop(self.rest.drain(..count)),
                Poll::Ready(Err(error)) => return Poll::Ready(Err(error)),
                Poll::Pending => break,
            }
        }
        loop {
            match ready!(self.stream.poll_read(cx, buffer)) {
                Ok(0) => return Poll::Ready(Err(closed())),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => return Poll::Ready(result),
            }
        }
    }

    pub(super) fn send(&mut self, bytes: &[u8]) -> bool {
        if !self.rest.is_empty() {
            match self.stream.try_write(&self.rest) {
                Ok(count) => drop(self.rest.drain(..count)),
                Err(_) => return false,
            }
            if !self.rest.is_empty() {
                return false;
            }
        }
        match self.stream.try_write(bytes) {
            Ok(0) => bytes.is_empty(),
            Ok(count) => {
                self.rest.extend_from_slice(bytes.get(count..).unwrap_or_default());
                true
            }
            Err(_) => false,
        }
    }
}

fn closed() -> io::Error {
    io::Error::new(io::ErrorKind::UnexpectedEof, "the far end closed the connection")
}

/// `tcpin`: serves several connections at once.
#[derive(Debug)]
pub(super) struct Listener {
    socket: TcpListener,
    connections: Vec<StreamPeer>,
    /// Connections that the runtime has not polled yet; a write to them would block.
    opening: Vec<TcpStream>,
    /// Where the next search for bytes starts, so no connection starves another.
    turn: usize,
    next_id: u32,
}

impl Listener {
    pub(super) async fn bind(address: &Address) -> io::Result<Self> {
        let socket = TcpListener::bind(resolve(address).await?.as_slice()).await?;
        Ok(Self { socket, connections: Vec::new(), opening: Vec::new(), turn: 0, next_id: 0 })
    }

    pub(super) fn local_addr(&self) -> Option<SocketAddr> {
        self.socket.local_addr().ok()
    }

    pub(super) fn peers(&self) -> impl Iterator<Item = Peer> + '_ {
        self.connections.iter().map(|connection| connection.peer)
    }

    pub(super) fn remote_addr(&self, peer: Peer) -> Option<SocketAddr> {
        let connection = self.connections.iter().find(|connection| connection.peer == peer)?;
        connection.stream.remote_addr()
    }

    pub(super) fn poll_recv(
        &mut self,
        cx: &mut Context<'_>,
        buffer: &mut [u8],
        stats: &mut TransportStats,
    ) -> Poll<io::Result<Incoming>> {
        while let Poll::Ready(accepted) = self.socket.poll_accept(cx) {
            match accepted {
                Ok(_) if self.connections.len() + self.opening.len() >= PEERS_MAX => {
                    stats.turned_away += 1;
                }
                Ok((stream, _)) => self.opening.push(stream),
                // The connection ended before it was accepted.
                Err(error) if error.kind() == io::ErrorKind::ConnectionAborted => {}
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
        let ready = self.opening.iter().position(|stream| stream.poll_write_ready(cx).is_ready());
        if let Some(index) = ready {
            let stream = Stream::tcp(self.opening.swap_remove(index));
            let peer = Peer(self.next_id);
            self.next_id = self.next_id.wrapping_add(1);
            self.connections.push(StreamPeer::new(peer, stream));
            return Poll::Ready(Ok(Incoming::Opened(peer)));
        }
        let count = self.connections.len();
        for offset in 0..count {
            let index = (self.turn + offset) % count;
            let connection = &mut self.connections[index];
            let peer = connection.peer;
            match connection.poll_recv(cx, buffer) {
                Poll::Ready(Ok(len)) => {
                    self.turn = index + 1;
                    return Poll::Ready(Ok(Incoming::Bytes { peer, len }));
                }
                Poll::Ready(Err(_)) => {
                    self.connections.swap_remove(index);
                    return Poll::Ready(Ok(Incoming::Closed(peer)));
                }
                Poll::Pending => {}
            }
        }
        Poll::Pending
    }

    pub(super) fn send(&mut self, peer: Peer, bytes: &[u8]) -> bool {
        let connection = self.connections.iter_mut().find(|connection| connection.peer == peer);
        connection.is_some_and(|connection| connection.send(bytes))
    }

    pub(super) fn close(&mut self, peer: Peer) {
        self.connections.retain(|connection| connection.peer != peer);
    }
}
