//! The sockets of the simulated room: lines of JSON to an address, NatNet to every client that
//! asks.
//!
//! They never block: a datagram that cannot be sent at once is lost, as on a network.

use std::io;
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};

use crate::autopilot::Vehicle;
use crate::room::{Room, natnet_request, natnet_server};

/// Largest number of NatNet clients.
const CLIENTS_MAX: usize = 8;
/// Requests read in one call.
const AT_ONCE: usize = 16;

/// A room with its sockets.
pub(crate) struct RoomSockets {
    room: Room,
    lines: Option<(UdpSocket, SocketAddr)>,
    natnet: Option<UdpSocket>,
    clients: Vec<SocketAddr>,
}

impl RoomSockets {
    /// Opens the requested sockets: `lines` is the destination of lines, `natnet` the address that
    /// serves NatNet.
    pub(crate) fn open(room: Room, lines: Option<&str>, natnet: Option<&str>) -> io::Result<Self> {
        let lines = lines.map(|to| {
            let to = resolved(to)?;
            let any = if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
            let socket = UdpSocket::bind(any)?;
            socket.set_nonblocking(true)?;
            Ok::<_, io::Error>((socket, to))
        });
        let natnet = natnet.map(|at| {
            let socket = UdpSocket::bind(resolved(at)?)?;
            socket.set_nonblocking(true)?;
            Ok::<_, io::Error>(socket)
        });
        Ok(Self {
            room,
            lines: lines.transpose()?,
            natnet: natnet.transpose()?,
            clients: Vec::new(),
        })
    }

    /// One line for each socket, with its address.
    pub(crate) fn describe(&self) -> impl Iterator<Item = String> + '_ {
        let lines = self.lines.iter().map(|(_, to)| format!("room: lines to {to}"));
        let at = self.natnet.iter().filter_map(|socket| socket.local_addr().ok());
        lines.chain(at.map(|at| format!("room: NatNet served at {at}")))
    }

    /// Time at which the room next captures or sends a frame, us.
    pub(crate) fn next_us(&self) -> u64 {
        self.room.next_us()
    }

    /// Captures the vehicle's pose if due, answers requests and sends due frames.
    pub(crate) fn serve(&mut self, vehicle: &Vehicle) {
        let now_us = vehicle.now_us();
        let state = vehicle.plant().state();
        self.room.look(now_us, state.position, state.attitude, vehicle.flight().armed());
        self.answer();
        while let Some(frame) = self.room.take(now_us) {
            if let Some((socket, to)) = &self.lines {
                let _ = socket.send_to(&frame.lines(), to);
            }
            if let Some(socket) = &self.natnet {
                for client in &self.clients {
                    let _ = socket.send_to(&frame.natnet(), client);
                }
            }
        }
    }

    fn answer(&mut self) {
        let Some(socket) = &self.natnet else { return };
        let mut buffer = [0; 1024];
        for _ in 0..AT_ONCE {
            let Ok((length, client)) = socket.recv_from(&mut buffer) else { break };
            let Some(request) = natnet_request(&buffer[..length]) else { continue };
            if request == 0 {
                let _ = socket.send_to(&natnet_server(), client);
            }
            if !self.clients.contains(&client) && self.clients.len() < CLIENTS_MAX {
                self.clients.push(client);
            }
        }
    }
}

fn resolved(address: &str) -> io::Result<SocketAddr> {
    let found = address.to_socket_addrs()?.next();
    found.ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no such host"))
}
