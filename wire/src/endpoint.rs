//! Endpoints, parsed from connection strings.
//!
//! Parsing accepts both common spellings: `udpin:0.0.0.0:14540` (pymavlink, rust-mavlink) and
//! `udpin://0.0.0.0:14540` (MAVSDK). `Display` writes the first.

use std::fmt;
use std::str::FromStr;

/// A source and destination of bytes.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Endpoint {
    /// `udpin:HOST:PORT`: listen for datagrams, answer each sender at its source address.
    UdpIn(Address),
    /// `udpout:HOST:PORT`: send datagrams to one address.
    UdpOut(Address),
    /// `tcp:HOST:PORT`, also `tcpout`: connect to a server.
    TcpOut(Address),
    /// `tcpin:HOST:PORT`: listen for connections and serve several at once.
    TcpIn(Address),
    /// `serial:PATH:BAUD`: a serial port, 8N1 without flow control.
    Serial {
        /// The device, such as `/dev/ttyACM0`.
        path: String,
        /// Bits per second.
        baud: u32,
    },
}

/// A host and a port.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Address {
    /// Name, IPv4 address or IPv6 address (without brackets).
    pub host: String,
    /// Port; when listening, 0 lets the system choose.
    pub port: u16,
}

/// Why a connection string is refused, and what to write instead.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("connection '{text}': {reason}")]
pub struct EndpointError {
    text: String,
    reason: Reason,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum Reason {
    #[error(
        "no scheme; write udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT \
         or serial:PATH:BAUD"
    )]
    NoScheme,
    #[error("unknown scheme '{0}'; use udpin, udpout, tcp, tcpin or serial")]
    UnknownScheme(String),
    #[error("'udp' does not say who sends first; write udpin:{0} to listen or udpout:{0} to send")]
    AmbiguousUdp(String),
    #[error("the port is missing; write {0}:HOST:PORT")]
    NoPort(&'static str),
    #[error("'{0}' is not a port; it must be a number from {1} to 65535")]
    BadPort(String, u16),
    #[error("the host to send to is missing; write {0}:HOST:PORT")]
    NoHost(&'static str),
    #[error("write an IPv6 address in brackets, such as [::1]:14540")]
    Ipv6,
    #[error("'{0}' is not a host; it contains a character that no host name has")]
    BadHost(String),
    #[error("the baud rate is missing; write serial:{0}:BAUD, such as serial:{0}:921600")]
    NoBaud(String),
    #[error("'{0}' is not a baud rate; it must be a positive number, such as 57600 or 921600")]
    BadBaud(String),
    #[error(
        "the serial port is missing; write serial:PATH:BAUD, such as serial:/dev/ttyACM0:921600"
    )]
    NoPath,
}

impl FromStr for Endpoint {
    type Err = EndpointError;

    fn from_str(text: &str) -> Result<Self, EndpointError> {
        parse(text.trim()).map_err(|reason| EndpointError { text: text.to_owned(), reason })
    }
}

fn parse(text: &str) -> Result<Endpoint, Reason> {
    let (scheme, rest) = text.split_once(':').ok_or(Reason::NoScheme)?;
    let rest = rest.strip_prefix("//").unwrap_or(rest);
    match scheme {
        "udpin" => Ok(Endpoint::UdpIn(listen_address("udpin", rest)?)),
        "udpout" => Ok(Endpoint::UdpOut(remote_address("udpout", rest)?)),
        "tcp" | "tcpout" => Ok(Endpoint::TcpOut(remote_address("tcp", rest)?)),
        "tcpin" => Ok(Endpoint::TcpIn(listen_address("tcpin", rest)?)),
        "serial" => serial(rest),
        "udp" => Err(Reason::AmbiguousUdp(if rest.is_empty() {
            "HOST:PORT".to_owned()
        } else {
            rest.to_owned()
        })),
        // A path without a scheme has no colon, or one before its baud rate.
        _ if scheme.is_empty() || scheme.contains('/') => Err(Reason::NoScheme),
        other => Err(Reason::UnknownScheme(other.to_owned())),
    }
}

/// The address to listen on: an empty host means every interface.
fn listen_address(scheme: &'static str, text: &str) -> Result<Address, Reason> {
    let (host, port) = split_address(scheme, text)?;
    let host = if host.is_empty() { "0.0.0.0" } else { host };
    Ok(Address { host: host.to_owned(), port: parse_port(port, 0)? })
}

fn remote_address(scheme: &'static str, text: &str) -> Result<Address, Reason> {
    let (host, port) = split_address(scheme, text)?;
    if host.is_empty() {
        return Err(Reason::NoHost(scheme));
    }
    Ok(Address { host: host.to_owned(), port: parse_port(port, 1)? })
}

fn split_address<'t>(scheme: &'static str, text: &'t str) -> Result<(&'t str, &'t str), Reason> {
    let (host, port) = match text.strip_prefix('[') {
        Some(bracketed) => {
            let (host, rest) = bracketed.split_once(']').ok_or(Reason::Ipv6)?;
            if host.parse::<std::net::Ipv6Addr>().is_err() {
                return Err(Reason::Ipv6);
            }
            (host, rest.strip_prefix(':').ok_or(Reason::NoPort(scheme))?)
        }
        None => {
            let (host, port) = text.rsplit_once(':').ok_or(Reason::NoPort(scheme))?;
            if host.contains(':') {
                return Err(Reason::Ipv6);
            }
            let valid = |c: char| c.is_alphanumeric() || matches!(c, '.' | '-' | '_');
            if !host.chars().all(valid) {
                return Err(Reason::BadHost(host.to_owned()));
            }
            (host, port)
        }
    };
    if port.is_empty() { Err(Reason::NoPort(scheme)) } else { Ok((host, port)) }
}

fn parse_port(text: &str, min: u16) -> Result<u16, Reason> {
    let bad = || Reason::BadPort(text.to_owned(), min);
    let port = text.parse().map_err(|_| bad())?;
    if port < min { Err(bad()) } else { Ok(port) }
}

fn serial(text: &str) -> Result<Endpoint, Reason> {
    let (path, baud) = match text.rsplit_once(':') {
        Some(split) => split,
        None if text.is_empty() => return Err(Reason::NoPath),
        None => return Err(Reason::NoBaud(text.to_owned())),
    };
    if path.is_empty() {
        return Err(Reason::NoPath);
    }
    if baud.is_empty() || baud.contains('/') {
        // The last colon belongs to the path, as in /dev/serial/by-path/pci-0:1-if00.
        let path = if baud.is_empty() { path } else { text };
        return Err(Reason::NoBaud(path.to_owned()));
    }
    match baud.parse() {
        Ok(rate) if rate > 0 => Ok(Endpoint::Serial { path: path.to_owned(), baud: rate }),
        _ => Err(Reason::BadBaud(baud.to_owned())),
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UdpIn(address) => write!(f, "udpin:{address}"),
            Self::UdpOut(address) => write!(f, "udpout:{address}"),
            Self::TcpOut(address) => write!(f, "tcp:{address}"),
            Self::TcpIn(address) => write!(f, "tcpin:{address}"),
            // The parser takes two slashes after the scheme for a URL's.
            Self::Serial { path, baud } if path.starts_with("//") => {
                write!(f, "serial://{path}:{baud}")
            }
            Self::Serial { path, baud } => write!(f, "serial:{path}:{baud}"),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.host.contains(':') {
            write!(f, "[{}]:{}", self.host, self.port)
        } else {
            write!(f, "{}:{}", self.host, self.port)
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn address(host: &str, port: u16) -> Address {
        Address { host: host.to_owned(), port }
    }

    #[test]
    fn both_endpoint_spellings_are_parsed() {
        let cases = [
            ("udpin:0.0.0.0:14540", Endpoint::UdpIn(address("0.0.0.0", 14540))),
            ("udpin://0.0.0.0:14540", Endpoint::UdpIn(address("0.0.0.0", 14540))),
            ("udpin://:14540", Endpoint::UdpIn(address("0.0.0.0", 14540))),
            ("udpout://drone.local:14550", Endpoint::UdpOut(address("drone.local", 14550))),
            ("tcp:127.0.0.1:5760", Endpoint::TcpOut(address("127.0.0.1", 5760))),
            ("tcpout:127.0.0.1:5760", Endpoint::TcpOut(address("127.0.0.1", 5760))),
            ("tcpin://[::1]:0", Endpoint::TcpIn(address("::1", 0))),
        ];
        for (text, endpoint) in cases {
            assert_eq!(text.parse(), Ok(endpoint), "{text}");
        }
        let serial = Endpoint::Serial { path: "/dev/ttyACM0".to_owned(), baud: 921_600 };
        assert_eq!("serial:/dev/ttyACM0:921600".parse(), Ok(serial.clone()));
        assert_eq!("serial:///dev/ttyACM0:921600".parse(), Ok(serial));
    }

    #[test]
    fn serial_path_keeps_its_slashes() {
        for (text, path) in [
            ("serial:/dev/ttyACM0:57600", "/dev/ttyACM0"),
            ("serial:///dev/ttyACM0:57600", "/dev/ttyACM0"),
            ("serial:////dev/ttyACM0:57600", "//dev/ttyACM0"),
        ] {
            let endpoint = Endpoint::Serial { path: path.to_owned(), baud: 57600 };
            assert_eq!(text.parse().as_ref(), Ok(&endpoint), "{text}");
            assert_eq!(endpoint.to_string().parse().as_ref(), Ok(&endpoint), "{endpoint}");
        }
    }

    #[test]
    fn invalid_endpoint_error_suggests_a_spelling() {
        let cases = [
            ("udp:127.0.0.1:14540", "udpin:127.0.0.1:14540 to listen or udpout:127.0.0.1:14540"),
            ("udp://:14540", "udpin::14540 to listen or udpout::14540 to send"),
            ("serial:/dev/ttyACM0", "serial:/dev/ttyACM0:921600"),
            ("serial:/dev/ttyACM0:", "serial:/dev/ttyACM0:921600"),
            ("serial:/dev/serial/by-path/pci-0:1/if00", "baud rate is missing"),
            ("serial:/dev/ttyACM0:fast", "'fast' is not a baud rate"),
            ("serial:/dev/ttyACM0:0", "'0' is not a baud rate"),
            ("serial:", "serial port is missing"),
            ("/dev/ttyACM0", "no scheme"),
            ("/dev/ttyACM0:57600", "no scheme"),
            ("ws:localhost:80", "unknown scheme 'ws'"),
            ("udpin:0.0.0.0", "port is missing"),
            ("udpin:0.0.0.0:", "port is missing"),
            ("udpin:0.0.0.0:99999", "'99999' is not a port"),
            ("udpout:host:0", "from 1 to 65535"),
            ("udpout::14540", "host to send to is missing"),
            ("tcp:::1:5760", "brackets"),
            ("tcp:[::1]", "port is missing"),
            ("tcp:a b:5760", "'a b' is not a host"),
            ("", "no scheme"),
        ];
        for (text, expected) in cases {
            let message = text.parse::<Endpoint>().expect_err(text).to_string();
            assert!(message.contains(expected), "{text}: {message}");
        }
    }

    proptest! {
        #[test]
        fn endpoint_round_trips(
            scheme in prop::sample::select(vec!["udpin", "udpout", "tcp", "tcpin"]),
            host in "[a-z0-9][a-z0-9.-]{0,20}|\\[::[0-9a-f]{1,4}\\]",
            port in 1u16..,
        ) {
            let text = format!("{scheme}:{host}:{port}");
            let endpoint: Endpoint = text.parse().unwrap();
            prop_assert_eq!(endpoint.to_string(), text);
            let url: Endpoint = format!("{scheme}://{host}:{port}").parse().unwrap();
            prop_assert_eq!(url, endpoint);
        }

        #[test]
        fn arbitrary_text_never_panics(text in "\\PC{0,40}") {
            if let Ok(endpoint) = text.parse::<Endpoint>() {
                prop_assert_eq!(endpoint.to_string().parse(), Ok(endpoint));
            }
        }
    }
}
