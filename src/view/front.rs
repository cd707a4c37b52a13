//! The front of the view: one port for the page and for Foxglove's protocol, few connections,
//! short requests.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpSocket, TcpStream, lookup_host};
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};

use super::relay::relay;

/// The page, whole: it asks nobody for anything else.
const PAGE: &str = include_str!("page.html");
/// Connections at once. A viewer needs one, a browser up to six while it loads.
const CONNECTIONS_MAX: usize = 32;
/// A request's head is no longer, and takes no longer.
const HEAD_LEN_MAX: usize = 8192;
const HEAD_LIMIT: Duration = Duration::from_secs(3);
/// What the system may hold for a viewer that does not read: what is older is of no use to it.
const SOCKET_BUFFER: u32 = 64 * 1024;
/// After a failure to accept, as where no file descriptor is left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Listens on `HOST:PORT`.
pub(super) async fn bind(address: &str) -> io::Result<TcpListener> {
    let mut failure = io::Error::new(io::ErrorKind::NotFound, "no such host");
    for at in lookup_host(address).await? {
        let socket = if at.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
        #[cfg(unix)]
        socket.set_reuseaddr(true)?;
        // Accepted sockets have it from the listening one.
        socket.set_send_buffer_size(SOCKET_BUFFER)?;
        match socket.bind(at).and_then(|()| socket.listen(64)) {
            Ok(listener) => return Ok(listener),
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// Answers requests until this is dropped; WebSockets are led to `inner`.
pub(super) async fn serve(listener: TcpListener, inner: SocketAddr) {
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(ACCEPT_PAUSE).await;
            continue;
        };
        // Beyond that many the connection is closed at once.
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        tokio::spawn(async move {
            // Whatever ends a viewer's connection is its own affair.
            let _ = answer(stream, inner).await;
            drop(place);
        });
    }
}

async fn answer(mut stream: TcpStream, inner: SocketAddr) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let head = timeout(HEAD_LIMIT, read_head(&mut stream)).await??;
    match Request::parse(&head) {
        Some(Request::WebSocket) => {
            let socket = TcpSocket::new_v4()?;
            socket.set_recv_buffer_size(SOCKET_BUFFER)?;
            let mut server = socket.connect(inner).await?;
            server.set_nodelay(true)?;
            server.write_all(&head).await?;
            relay(stream, server).await
        }
        Some(Request::Page) => respond(&mut stream, "200 OK", "text/html", PAGE).await,
        Some(Request::Other) => {
            let text = "there is the page, at /, and Foxglove's WebSocket, at the same address\n";
            respond(&mut stream, "404 Not Found", "text/plain", text).await
        }
        None => respond(&mut stream, "400 Bad Request", "text/plain", "no HTTP\n").await,
    }
}

/// The head of a request, and whatever came with it.
async fn read_head(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut head = Vec::with_capacity(1024);
    while !head.windows(4).any(|end| end == b"\r\n\r\n") && head.len() < HEAD_LEN_MAX {
        if stream.read_buf(&mut head).await? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
    }
    Ok(head)
}

async fn respond(stream: &mut TcpStream, status: &str, kind: &str, body: &str) -> io::Result<()> {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}; charset=utf-8\r\nContent-Length: {}\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n\
         Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; \
         style-src 'unsafe-inline'; img-src data:; connect-src 'self' ws: wss:\r\n\
         Connection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).await?;
    stream.write_all(body.as_bytes()).await?;
    stream.shutdown().await
}

/// What a client asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Request {
    Page,
    WebSocket,
    Other,
}

impl Request {
    /// Reads a request's head; `None` if it is none.
    fn parse(head: &[u8]) -> Option<Self> {
        let text = String::from_utf8_lossy(head);
        let (head, _) = text.split_once("\r\n\r\n")?;
        let mut lines = head.split("\r\n");
        let mut words = lines.next()?.split(' ');
        let (method, target, version) = (words.next()?, words.next()?, words.next()?);
        if !version.starts_with("HTTP/1.") {
            return None;
        }
        let upgrades = |line: &str| {
            line.split_once(':').is_some_and(|(name, value)| {
                name.eq_ignore_ascii_case("upgrade")
                    && value.trim().eq_ignore_ascii_case("websocket")
            })
        };
        let path = target.split('?').next()?;
        Some(match method {
            "GET" if lines.any(upgrades) => Self::WebSocket,
            "GET" if path == "/" => Self::Page,
            _ => Self::Other,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_the_page_a_websocket_or_nothing() {
        let parse = |text: &str| Request::parse(text.as_bytes());
        let page = "GET /?dark HTTP/1.1\r\nHost: a\r\n\r\n";
        assert_eq!(parse(page), Some(Request::Page));
        let upgrade = "GET / HTTP/1.1\r\nhost: a\r\nupgrade: WebSocket\r\n\r\n";
        assert_eq!(parse(upgrade), Some(Request::WebSocket));
        assert_eq!(parse("POST / HTTP/1.1\r\n\r\n"), Some(Request::Other));
        assert_eq!(parse("GET /x HTTP/1.1\r\n\r\n"), Some(Request::Other));
        for none in ["", "GET / HTTP/1.1\r\n", "\r\n\r\n", "GET /\r\n\r\n", "A B C\r\n\r\n"] {
            assert_eq!(parse(none), None, "{none:?}");
        }
    }
}
