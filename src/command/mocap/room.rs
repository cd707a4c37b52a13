//! The room's address and its socket.

use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, ToSocketAddrs};
use std::str::FromStr;

use tokio::net::UdpSocket;

use crate::mocap::natnet::COMMAND_PORT;

/// A room by its protocol.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Room {
    /// Lines of JSON arrive at this address.
    Stream(String),
    /// Motive at this address sends to each client that requests it.
    NatNet(String),
    /// Motive sends to this group.
    NatNetMulticast(SocketAddrV4),
}

/// Why a text is no room.
#[derive(Debug, thiserror::Error)]
#[error(
    "--room {0:?}: expected stream:HOST:PORT, natnet:SERVER[:PORT] or natnet-multicast:GROUP:PORT (such as \
     natnet-multicast:239.255.42.99:1511)"
)]
pub(super) struct RoomError(String);

impl FromStr for Room {
    type Err = RoomError;

    fn from_str(text: &str) -> Result<Self, RoomError> {
        let error = || RoomError(text.to_owned());
        let (scheme, address) = text.split_once(':').ok_or_else(error)?;
        let has_port = |address: &str| {
            address
                .rsplit_once(':')
                .is_some_and(|(host, port)| !host.is_empty() && port.parse::<u16>().is_ok())
        };
        // A server of digits alone would be read as an IPv4 address.
        let is_server = |address: &str| {
            !address.contains(':') && !address.bytes().all(|byte| byte.is_ascii_digit())
        };
        match scheme {
            "stream" if has_port(address) => Ok(Self::Stream(address.to_owned())),
            "natnet" if has_port(address) => Ok(Self::NatNet(address.to_owned())),
            "natnet" if is_server(address) => Ok(Self::NatNet(format!("{address}:{COMMAND_PORT}"))),
            "natnet-multicast" => {
                let group: SocketAddrV4 = address.parse().map_err(|_| error())?;
                if group.ip().is_multicast() {
                    Ok(Self::NatNetMulticast(group))
                } else {
                    Err(error())
                }
            }
            _ => Err(error()),
        }
    }
}

impl fmt::Display for Room {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Stream(address) => write!(f, "stream:{address}"),
            Self::NatNet(address) => write!(f, "natnet:{address}"),
            Self::NatNetMulticast(group) => write!(f, "natnet-multicast:{group}"),
        }
    }
}

impl Room {
    /// Opens the socket for its datagrams, within a runtime.
    pub(super) fn open(&self) -> io::Result<UdpSocket> {
        let socket = match self {
            Self::Stream(address) => std::net::UdpSocket::bind(resolved(address)?)?,
            Self::NatNet(server) => {
                let server = resolved(server)?;
                let any = if server.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
                let socket = std::net::UdpSocket::bind(any)?;
                // Motive sends frames from the requested port, or from its data port.
                socket.set_nonblocking(true)?;
                return UdpSocket::from_std(socket);
            }
            Self::NatNetMulticast(group) => {
                let socket = std::net::UdpSocket::bind(SocketAddrV4::new(
                    Ipv4Addr::UNSPECIFIED,
                    group.port(),
                ))?;
                socket.join_multicast_v4(group.ip(), &Ipv4Addr::UNSPECIFIED)?;
                socket
            }
        };
        socket.set_nonblocking(true)?;
        UdpSocket::from_std(socket)
    }

    /// The address to request frames from.
    pub(super) fn server(&self) -> io::Result<Option<SocketAddr>> {
        match self {
            Self::NatNet(server) => resolved(server).map(Some),
            _ => Ok(None),
        }
    }
}

fn resolved(address: &str) -> io::Result<SocketAddr> {
    let mut found = address.to_socket_addrs()?;
    found.next().ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no such host"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_addresses_are_parsed_and_invalid_ones_refused() {
        for (text, room) in [
            ("stream:0.0.0.0:5005", Room::Stream("0.0.0.0:5005".into())),
            ("natnet:motive.lab", Room::NatNet("motive.lab:1510".into())),
            ("natnet:10.0.0.2:1600", Room::NatNet("10.0.0.2:1600".into())),
        ] {
            assert_eq!(text.parse::<Room>().expect(text), room);
        }
        assert!("natnet-multicast:239.255.42.99:1511".parse::<Room>().is_ok());
        let multicast = "natnet-multicast:10.0.0.1:1";
        for wrong in
            ["", "stream", "stream:5005", "vrpn:host", multicast, "natnet:", "natnet:99999"]
        {
            assert!(wrong.parse::<Room>().is_err(), "{wrong}");
        }
    }
}
