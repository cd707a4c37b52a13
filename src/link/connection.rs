//! The connection: an endpoint that is opened, and reopened whenever it is lost.

use std::fmt;
use std::future::{Future, poll_fn};
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::time::{Sleep, sleep, timeout};
use wire::Endpoint;
use wire::transport::{Incoming, OpenError, Peer, Transport, TransportStats};

/// The first pause before reopening; each further one is twice as long.
const PAUSE_MIN: Duration = Duration::from_millis(100);
/// The longest pause.
const PAUSE_MAX: Duration = Duration::from_secs(3);
/// Longest time for opening: a TCP connection to a host that is off would take minutes.
const OPEN_LIMIT: Duration = Duration::from_secs(5);

/// What [`Connection::recv`] returns.
#[derive(Debug)]
pub enum Input {
    /// Bytes from a peer, at the start of the buffer.
    Bytes {
        /// The sender.
        peer: Peer,
        /// Number of bytes.
        len: usize,
    },
    /// The endpoint is open. Peer numbers start again.
    Opened,
    /// The endpoint could not be opened. The connection retries.
    Failed {
        /// The reason.
        error: OpenFailure,
        /// Time until the next attempt.
        retry_in: Duration,
    },
    /// The open endpoint was lost. The connection reopens it.
    Lost(io::Error),
    /// A peer connected.
    PeerOpened(Peer),
    /// A peer closed its connection.
    PeerClosed(Peer),
}

/// Why an endpoint could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenFailure {
    /// The system refused to open it.
    #[error(transparent)]
    Refused(#[from] OpenError),
    /// Opening took longer than the limit.
    #[error("cannot open {endpoint}: no answer within {} s; is the host up?", OPEN_LIMIT.as_secs())]
    TimedOut {
        /// The endpoint that did not open.
        endpoint: Endpoint,
    },
}

type Opening = Pin<Box<dyn Future<Output = Result<Transport, OpenFailure>> + Send>>;

enum State {
    Opening(Opening),
    Open(Transport),
    Waiting(Pin<Box<Sleep>>),
}

/// An endpoint that stays open, across losses.
pub struct Connection {
    endpoint: Endpoint,
    state: State,
    pause: Duration,
    peers: Vec<Peer>,
}

impl Connection {
    /// A connection that starts to open with the first [`recv`](Self::recv).
    pub fn new(endpoint: Endpoint) -> Self {
        let state = State::Opening(open(endpoint.clone()));
        Self { endpoint, state, pause: PAUSE_MIN, peers: Vec::new() }
    }

    /// Waits for bytes or for a change. Cancel-safe: a dropped future loses nothing, and an attempt
    /// to open continues. Never fails: a lost endpoint is reopened after a pause, which grows with
    /// each attempt and is short again once bytes arrive.
    pub async fn recv(&mut self, buffer: &mut [u8]) -> Input {
        poll_fn(|cx| self.poll_recv(cx, buffer)).await
    }

    fn poll_recv(&mut self, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<Input> {
        loop {
            match &mut self.state {
                State::Open(transport) => {
                    let incoming = ready!(transport.poll_recv(cx, buffer));
                    return Poll::Ready(self.input(incoming));
                }
                State::Opening(opening) => {
                    return Poll::Ready(match ready!(opening.as_mut().poll(cx)) {
                        Ok(transport) => {
                            self.state = State::Open(transport);
                            Input::Opened
                        }
                        Err(error) => Input::Failed { error, retry_in: self.pause() },
                    });
                }
                State::Waiting(pause) => {
                    ready!(pause.as_mut().poll(cx));
                    self.state = State::Opening(open(self.endpoint.clone()));
                }
            }
        }
    }

    /// Whether [`wait`](Self::wait) works now: the endpoint is open and carries datagrams.
    pub fn can_wait(&self) -> bool {
        matches!(&self.state, State::Open(transport) if transport.is_datagram())
    }

    /// Like [`recv`](Self::recv), but in the calling thread and without the runtime, which is
    /// faster. Returns `None` after `timeout` or earlier, and at once where
    /// [`can_wait`](Self::can_wait) is false.
    pub fn wait(&mut self, buffer: &mut [u8], timeout: Duration) -> Option<Input> {
        let State::Open(transport) = &mut self.state else { return None };
        if !transport.is_datagram() {
            return None;
        }
        let incoming = transport.wait(buffer, timeout).transpose()?;
        Some(self.input(incoming))
    }

    fn input(&mut self, incoming: io::Result<Incoming>) -> Input {
        match incoming {
            Ok(Incoming::Bytes { peer, len }) => {
                self.pause = PAUSE_MIN;
                Input::Bytes { peer, len }
            }
            Ok(Incoming::Opened(peer)) => Input::PeerOpened(peer),
            Ok(Incoming::Closed(peer)) => Input::PeerClosed(peer),
            Err(error) => {
                self.pause();
                Input::Lost(error)
            }
        }
    }

    /// Starts a pause and returns its length.
    fn pause(&mut self) -> Duration {
        let pause = self.pause;
        self.pause = (pause * 2).min(PAUSE_MAX);
        self.state = State::Waiting(Box::pin(sleep(pause)));
        pause
    }

    /// Sends a frame to one peer, or to every peer. Never waits; returns whether the system took
    /// every copy. Without a connection the frame is dropped.
    pub fn send(&mut self, to: Option<Peer>, frame: &[u8]) -> bool {
        let State::Open(transport) = &mut self.state else { return false };
        if let Some(peer) = to {
            return transport.send(peer, frame);
        }
        self.peers.clear();
        self.peers.extend(transport.peers());
        let mut is_taken = true;
        for &peer in &self.peers {
            is_taken &= transport.send(peer, frame);
        }
        is_taken
    }

    /// Protects a peer from being displaced by newer ones; see [`Transport::keep`].
    pub fn keep(&mut self, peer: Option<Peer>) {
        if let State::Open(transport) = &mut self.state {
            transport.keep(peer);
        }
    }

    /// Whether bytes arrive as datagrams.
    pub fn is_datagram(&self) -> bool {
        matches!(self.endpoint, Endpoint::UdpIn(_) | Endpoint::UdpOut(_))
    }

    /// Whether the endpoint is open.
    pub fn is_open(&self) -> bool {
        matches!(self.state, State::Open(_))
    }

    /// The local address while open, with the port that the system chose.
    pub fn local_addr(&self) -> Option<SocketAddr> {
        match &self.state {
            State::Open(transport) => transport.local_addr(),
            State::Opening(_) | State::Waiting(_) => None,
        }
    }

    /// The counters of the open transport; zero while it is closed.
    pub fn stats(&self) -> TransportStats {
        match &self.state {
            State::Open(transport) => transport.stats(),
            State::Opening(_) | State::Waiting(_) => TransportStats::default(),
        }
    }
}

impl fmt::Debug for Connection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut debug = f.debug_struct("Connection");
        debug.field("endpoint", &self.endpoint).field("is_open", &self.is_open());
        debug.finish_non_exhaustive()
    }
}

fn open(endpoint: Endpoint) -> Opening {
    Box::pin(async move {
        match timeout(OPEN_LIMIT, Transport::open(&endpoint)).await {
            Ok(result) => Ok(result?),
            Err(_) => Err(OpenFailure::TimedOut { endpoint }),
        }
    })
}
