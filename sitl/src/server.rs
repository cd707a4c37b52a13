//! The server: it connects the vehicle to its links and paces its clock.
//!
//! One task does everything. It handles incoming bytes at once, at the vehicle time of their
//! arrival, and otherwise sleeps until the vehicle has something to send. The vehicle's time is the
//! host's monotonic clock times the speed factor, counted from the start, so it does not drift.

use std::future::{Future, poll_fn};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::{Instant, sleep_until};
use wire::endpoint::Endpoint;
use wire::transport::{self, Incoming, OpenError, RECEIVE_LEN, Transport};

use crate::autopilot::{LinkKind, Peer, Vehicle};
use crate::room_sockets::RoomSockets;

/// Delay before reopening a lost link.
const REOPEN_AFTER: Duration = Duration::from_millis(500);

/// Largest vehicle time simulated between two polls of the links, us.
const ADVANCE_MAX_US: u64 = 20_000;

/// Lag in host time at which the vehicle's clock gives up real time.
const LAG_MAX: Duration = Duration::from_secs(1);

/// The vehicle with its links and peers.
pub struct Server {
    vehicle: Vehicle,
    room: Option<RoomSockets>,
    links: Vec<Link>,
    peers: Vec<Route>,
    next_peer: u32,
    buffer: Vec<u8>,
}

/// Maps a peer of the vehicle to a link and a remote address.
struct Route {
    peer: Peer,
    link: usize,
    remote: transport::Peer,
}

struct Link {
    endpoint: Endpoint,
    state: LinkState,
}

enum LinkState {
    Open(Transport),
    Reopening(Pin<Box<dyn Future<Output = Transport>>>),
}

/// The event that woke the server.
enum Wake {
    Bytes(usize, transport::Peer, usize),
    Opened(usize, transport::Peer),
    Closed(usize, transport::Peer),
    Lost(usize, std::io::Error),
    Reopened(usize, Transport),
    Due,
}

impl Server {
    /// Opens every link.
    ///
    /// # Errors
    /// [`OpenError`] of the first link that does not open.
    pub async fn open(vehicle: Vehicle, endpoints: &[Endpoint]) -> Result<Self, OpenError> {
        let mut links = Vec::with_capacity(endpoints.len());
        for endpoint in endpoints {
            let transport = Transport::open(endpoint).await?;
            links.push(Link { endpoint: endpoint.clone(), state: LinkState::Open(transport) });
        }
        let mut server = Self {
            vehicle,
            room: None,
            links,
            peers: Vec::new(),
            next_peer: 0,
            buffer: vec![0; RECEIVE_LEN],
        };
        for link in 0..server.links.len() {
            server.greet(link);
        }
        Ok(server)
    }

    /// Puts the vehicle into a motion-capture room.
    pub(crate) fn inside(self, room: Option<RoomSockets>) -> Self {
        Self { room, ..self }
    }

    /// One line for each link, with its local or remote address.
    pub fn describe(&self) -> impl Iterator<Item = String> + '_ {
        self.links.iter().map(|link| {
            let local = match &link.state {
                LinkState::Open(transport) => transport.local_addr(),
                LinkState::Reopening(_) => None,
            };
            match (&link.endpoint, local) {
                (Endpoint::UdpIn(_), Some(local)) => format!("listening on udpin:{local}"),
                (Endpoint::TcpIn(_), Some(local)) => format!("listening on tcpin:{local}"),
                (endpoint, _) => format!("talking to {endpoint}"),
            }
        })
    }

    /// Time of the next event of the vehicle or the room, us.
    fn next_event_us(&self) -> u64 {
        let room_us = self.room.as_ref().map_or(u64::MAX, RoomSockets::next_us);
        self.vehicle.next_event_us().min(room_us.max(self.vehicle.now_us() + 1))
    }

    /// Serves until `stop` resolves. `speed` is in vehicle seconds per host second. Calls `watch`
    /// with the vehicle whenever its time has advanced; `watch` must not block.
    pub async fn run<S: Future>(
        &mut self,
        speed: f64,
        stop: S,
        mut watch: impl FnMut(&Vehicle),
    ) -> S::Output {
        let mut pacer = Pacer::new(speed, self.vehicle.clock().host_us(self.vehicle.now_us()));
        let mut stop = std::pin::pin!(stop);
        loop {
            let now = Instant::now();
            let target_us = self.vehicle_us(&mut pacer, now);
            let mut reached_us = target_us.min(self.vehicle.now_us() + ADVANCE_MAX_US);
            if let Some(room) = &mut self.room {
                reached_us = reached_us.min(room.next_us().max(self.vehicle.now_us()));
                self.vehicle.advance_to(reached_us);
                room.serve(&self.vehicle);
            } else {
                self.vehicle.advance_to(reached_us);
            }
            self.flush();
            watch(&self.vehicle);
            let due = if reached_us < target_us {
                now
            } else {
                pacer.host_time(self.vehicle.clock().host_us(self.next_event_us()))
            };
            tokio::select! {
                biased;
                output = &mut stop => return output,
                wake = self.wait(due) => {
                    let arrived_us = self.vehicle_us(&mut pacer, Instant::now());
                    self.vehicle.advance_to(arrived_us.min(reached_us + ADVANCE_MAX_US));
                    self.handle(wake);
                    self.flush();
                }
            }
        }
    }

    /// Target of the vehicle's clock at host time `now`.
    fn vehicle_us(&self, pacer: &mut Pacer, now: Instant) -> u64 {
        let clock = self.vehicle.clock();
        let reached_us = clock.host_us(self.vehicle.now_us());
        clock.vehicle_us(pacer.simulated_us(now, reached_us)).max(self.vehicle.now_us())
    }

    async fn wait(&mut self, due: Instant) -> Wake {
        let mut timer = std::pin::pin!(sleep_until(due));
        let (links, buffer) = (&mut self.links, &mut self.buffer);
        poll_fn(|cx| {
            for (index, link) in links.iter_mut().enumerate() {
                if let Poll::Ready(wake) = link.poll(index, cx, buffer) {
                    return Poll::Ready(wake);
                }
            }
            timer.as_mut().poll(cx).map(|()| Wake::Due)
        })
        .await
    }

    fn handle(&mut self, wake: Wake) {
        match wake {
            Wake::Due => {}
            Wake::Bytes(link, remote, len) => {
                let peer = self.peer(link, remote);
                self.vehicle.receive(peer, &self.buffer[..len]);
            }
            Wake::Opened(link, remote) => {
                self.peer(link, remote);
            }
            Wake::Closed(link, remote) => {
                self.forget(|route| route.link == link && route.remote == remote);
            }
            Wake::Lost(link, error) => {
                let endpoint = self.links[link].endpoint.clone();
                eprintln!("{endpoint}: lost ({error}), reopening it");
                self.forget(|route| route.link == link);
                self.links[link].state = LinkState::Reopening(Box::pin(reopen(endpoint)));
            }
            Wake::Reopened(link, transport) => {
                eprintln!("{}: open again", self.links[link].endpoint);
                self.links[link].state = LinkState::Open(transport);
                self.greet(link);
            }
        }
    }

    /// Connects the peers that a link has from the start, before they send anything.
    fn greet(&mut self, link: usize) {
        let LinkState::Open(transport) = &self.links[link].state else { return };
        for remote in transport.peers().collect::<Vec<_>>() {
            self.peer(link, remote);
        }
    }

    /// The vehicle's peer for a remote address; connects a new one if needed.
    fn peer(&mut self, link: usize, remote: transport::Peer) -> Peer {
        let known = self.peers.iter().find(|r| r.link == link && r.remote == remote);
        if let Some(route) = known {
            return route.peer;
        }
        let peer = Peer(self.next_peer);
        self.next_peer = self.next_peer.wrapping_add(1);
        let datagrams = match &self.links[link].state {
            LinkState::Open(transport) => transport.is_datagram(),
            LinkState::Reopening(_) => false,
        };
        let kind = if datagrams { LinkKind::Datagrams } else { LinkKind::Stream };
        self.vehicle.connect(peer, kind);
        self.peers.push(Route { peer, link, remote });
        peer
    }

    fn forget(&mut self, gone: impl Fn(&Route) -> bool) {
        for route in self.peers.extract_if(.., |route| gone(route)) {
            self.vehicle.disconnect(route.peer);
        }
    }

    fn flush(&mut self) {
        let Self { vehicle, links, peers, .. } = self;
        vehicle.take_output(|peer, bytes| {
            let Some(route) = peers.iter().find(|route| route.peer == peer) else { return };
            if let LinkState::Open(transport) = &mut links[route.link].state {
                // A full send queue drops the frame; the transport counts it.
                transport.send(route.remote, bytes);
            }
        });
    }
}

impl Link {
    fn poll(&mut self, index: usize, cx: &mut Context<'_>, buffer: &mut [u8]) -> Poll<Wake> {
        match &mut self.state {
            LinkState::Open(transport) => transport.poll_recv(cx, buffer).map(|got| match got {
                Ok(Incoming::Bytes { peer, len }) => Wake::Bytes(index, peer, len),
                Ok(Incoming::Opened(peer)) => Wake::Opened(index, peer),
                Ok(Incoming::Closed(peer)) => Wake::Closed(index, peer),
                Err(error) => Wake::Lost(index, error),
            }),
            LinkState::Reopening(opening) => {
                opening.as_mut().poll(cx).map(|transport| Wake::Reopened(index, transport))
            }
        }
    }
}

async fn reopen(endpoint: Endpoint) -> Transport {
    loop {
        tokio::time::sleep(REOPEN_AFTER).await;
        if let Ok(transport) = Transport::open(&endpoint).await {
            return transport;
        }
    }
}

/// Maps between the simulation's time and the host's. The vehicle's clock may in turn slip against
/// the simulation's.
struct Pacer {
    speed: f64,
    host: Instant,
    simulated_us: u64,
}

impl Pacer {
    fn new(speed: f64, simulated_us: u64) -> Self {
        Self { speed, host: Instant::now(), simulated_us }
    }

    /// The simulation's time at host time `now`. If the host cannot keep up or was suspended, the
    /// simulation gives up the lost time and continues from where it is.
    fn simulated_us(&mut self, now: Instant, reached_us: u64) -> u64 {
        let passed = now.saturating_duration_since(self.host).as_secs_f64() * self.speed;
        let target_us = self.simulated_us + (passed * 1e6) as u64;
        let lag_max_us = (LAG_MAX.as_secs_f64() * self.speed * 1e6) as u64;
        if target_us > reached_us + lag_max_us {
            (self.host, self.simulated_us) = (now, reached_us);
        }
        target_us.min(reached_us + lag_max_us).max(reached_us)
    }

    /// The host time at which the simulation reaches `simulated_us`.
    fn host_time(&self, simulated_us: u64) -> Instant {
        let ahead_us = simulated_us.saturating_sub(self.simulated_us) as f64 / self.speed;
        self.host + Duration::from_nanos((ahead_us * 1e3) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pace_does_not_drift_and_resets_after_a_suspension() {
        let mut pacer = Pacer::new(4.0, 1000);
        let start = pacer.host;
        let later = start + Duration::from_millis(250);
        assert_eq!(pacer.simulated_us(later, 900_000), 1_001_000);
        assert_eq!(pacer.host_time(1_001_000), later);
        let much_later = start + Duration::from_secs(100);
        let resumed = pacer.simulated_us(much_later, 1_001_000);
        assert_eq!(resumed, 1_001_000 + 4_000_000);
        assert_eq!(pacer.host_time(1_001_000), much_later);
    }
}
