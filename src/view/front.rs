//! The front of the view: one port for the page and for Foxglove's protocol.

use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpSocket, TcpStream};

use super::relay::relay;
use crate::http::{self, Request, respond};

/// The page, which makes no further requests.
const PAGE: &str = include_str!("page.html");

/// Foxglove's application in a browser.
const FOXGLOVE: &str = "https://app.foxglove.dev";

/// Decides which clients may open a WebSocket. Any page in a browser on this machine can try. If
/// viewers may set something, only the page served here and Foxglove's succeed.
#[derive(Clone)]
pub(super) struct Gate {
    /// The host part of the requested address.
    host: String,
    /// Number of clients that the front currently relays, if viewers may set something.
    relayed: Option<Arc<AtomicUsize>>,
}

/// A relayed client; dropping it decrements the count.
struct Relayed(Option<Arc<AtomicUsize>>);

impl Gate {
    pub fn new(address: &str, relayed: Option<Arc<AtomicUsize>>) -> Self {
        Self { host: host_of(address).to_owned(), relayed }
    }

    fn admits(&self, request: &Request) -> bool {
        let Some(origin) = request.header("origin").filter(|_| self.relayed.is_some()) else {
            return true;
        };
        let Some(host) = request.header("host") else { return false };
        // A foreign host name may resolve to this machine.
        let name = host_of(host);
        let is_own = name == "localhost" || name == self.host || name.parse::<IpAddr>().is_ok();
        origin == FOXGLOVE || is_own && origin.strip_prefix("http://") == Some(host)
    }

    /// Counts a client while the result lives.
    fn count_relayed(&self) -> Relayed {
        if let Some(relayed) = &self.relayed {
            relayed.fetch_add(1, Ordering::AcqRel);
        }
        Relayed(self.relayed.clone())
    }
}

impl Drop for Relayed {
    fn drop(&mut self) {
        if let Some(relayed) = &self.0 {
            relayed.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

/// `HOST:PORT` without the port, and an IPv6 address without its brackets.
fn host_of(address: &str) -> &str {
    let host =
        address.rsplit_once(':').filter(|(host, _)| !host.contains(':') || host.ends_with(']'));
    host.map_or(address, |(host, _)| host).trim_matches(['[', ']'])
}

/// Answers requests until this is dropped; relays WebSockets to `inner`.
pub(super) async fn serve(listener: TcpListener, inner: SocketAddr, gate: Gate) {
    http::serve(listener, |stream| answer(stream, inner, gate.clone())).await;
}

async fn answer(mut stream: TcpStream, inner: SocketAddr, gate: Gate) -> io::Result<()> {
    stream.set_nodelay(true)?;
    match Request::read(&mut stream).await? {
        Some(request) if request.is_upgrade && !gate.admits(&request) => {
            let text = "with --view-write only this page, Foxglove and programs may connect\n";
            respond(&mut stream, "403 Forbidden", "text/plain", text).await
        }
        Some(Request { is_get: true, is_upgrade: true, head, .. }) => {
            let _relayed = gate.count_relayed();
            let socket = TcpSocket::new_v4()?;
            socket.set_recv_buffer_size(http::SOCKET_BUFFER)?;
            let mut server = socket.connect(inner).await?;
            server.set_nodelay(true)?;
            server.write_all(&head).await?;
            relay(stream, server).await
        }
        Some(Request { is_get: true, path, .. }) if path == "/" => {
            respond(&mut stream, "200 OK", "text/html", PAGE).await
        }
        Some(_) => {
            let text = "not found; the page is at /, Foxglove's WebSocket at the same address\n";
            respond(&mut stream, "404 Not Found", "text/plain", text).await
        }
        None => respond(&mut stream, "400 Bad Request", "text/plain", "no HTTP\n").await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writable_view_refuses_foreign_origins() {
        let request = |host: &str, origin: &str| {
            let head = format!("GET / HTTP/1.1\r\nHost: {host}\r\nORIGIN: {origin}\r\n\r\n");
            Request::parse(head.into_bytes()).expect("HTTP")
        };
        let plain = Request::parse(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n".to_vec()).expect("HTTP");
        let gate = Gate::new("lab:8765", Some(Arc::default()));
        let open = Gate::new("lab:8765", None);
        assert!(gate.admits(&plain), "programs send no Origin header");
        for (host, origin, expected) in [
            ("127.0.0.1:8765", "http://127.0.0.1:8765", true),
            ("localhost:8765", "http://localhost:8765", true),
            ("[::1]:8765", "http://[::1]:8765", true),
            ("lab:8765", "http://lab:8765", true),
            ("127.0.0.1:8765", "https://app.foxglove.dev", true),
            ("127.0.0.1:8765", "https://example.org", false),
            ("127.0.0.1:8765", "http://127.0.0.1:80", false),
            ("127.0.0.1:8765", "null", false),
            // A foreign name that resolves to this machine.
            ("example.org:8765", "http://example.org:8765", false),
        ] {
            let request = request(host, origin);
            assert_eq!(gate.admits(&request), expected, "{host} {origin}");
            assert!(open.admits(&request));
        }
    }
}
