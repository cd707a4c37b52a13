//! The part of HTTP that a page and a status need: few connections, short requests, one answer
//! each.

use std::future::Future;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpSocket, TcpStream, lookup_host};
use tokio::sync::Semaphore;
use tokio::time::{sleep, timeout};

/// Connections at once. A viewer needs one, a browser up to six while it loads.
const CONNECTIONS_MAX: usize = 32;
/// Longest head of a request, and the time it may take.
const HEAD_LEN_MAX: usize = 8192;
const HEAD_LIMIT: Duration = Duration::from_secs(3);
/// Bytes that the system may hold for a client that does not read: older data is of no use to it.
pub(crate) const SOCKET_BUFFER: u32 = 64 * 1024;
/// Pause after a failed accept, such as when no file descriptor is left.
const ACCEPT_PAUSE: Duration = Duration::from_millis(200);

/// Listens on `HOST:PORT`.
pub(crate) async fn bind(address: &str) -> io::Result<TcpListener> {
    let mut failure = io::Error::new(io::ErrorKind::NotFound, "no such host");
    for at in lookup_host(address).await? {
        let socket = if at.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
        #[cfg(unix)]
        socket.set_reuseaddr(true)?;
        // Accepted sockets inherit this from the listening socket.
        socket.set_send_buffer_size(SOCKET_BUFFER)?;
        match socket.bind(at).and_then(|()| socket.listen(64)) {
            Ok(listener) => return Ok(listener),
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// Answers connections until this is dropped.
pub(crate) async fn serve<F>(listener: TcpListener, answer: impl Fn(TcpStream) -> F)
where
    F: Future<Output = io::Result<()>> + Send + 'static,
{
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(ACCEPT_PAUSE).await;
            continue;
        };
        // Connections beyond the limit are closed at once.
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let answer = answer(stream);
        tokio::spawn(async move {
            // A client's failure concerns only its own connection.
            let _ = answer.await;
            drop(place);
        });
    }
}

/// A request's head.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Request {
    pub(crate) is_get: bool,
    /// The path without the query.
    pub(crate) path: String,
    /// Whether it requests a WebSocket.
    pub(crate) is_upgrade: bool,
    /// All bytes received.
    pub(crate) head: Vec<u8>,
}

impl Request {
    /// Reads a request's head, and whatever comes with it; `None` if it is not HTTP.
    pub(crate) async fn read(stream: &mut TcpStream) -> io::Result<Option<Self>> {
        let head = timeout(HEAD_LIMIT, read_head(stream)).await??;
        Ok(Self::parse(head))
    }

    /// A header's value, by its name in lower case.
    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        let end = self.head.windows(4).position(|end| end == b"\r\n\r\n")?;
        let lines = self.head.get(..end)?.split(|byte| *byte == b'\n').skip(1);
        lines.filter_map(|line| std::str::from_utf8(line).ok()?.split_once(':')).find_map(
            |(found, value)| found.trim().eq_ignore_ascii_case(name).then(|| value.trim()),
        )
    }

    pub(crate) fn parse(head: Vec<u8>) -> Option<Self> {
        let all = String::from_utf8_lossy(&head);
        let (text, _) = all.split_once("\r\n\r\n")?;
        let mut lines = text.split("\r\n");
        let mut fields = lines.next()?.split(' ');
        let (method, target, version) = (fields.next()?, fields.next()?, fields.next()?);
        if !version.starts_with("HTTP/1.") {
            return None;
        }
        let upgrades = |line: &str| {
            line.split_once(':').is_some_and(|(name, value)| {
                name.eq_ignore_ascii_case("upgrade")
                    && value.trim().eq_ignore_ascii_case("websocket")
            })
        };
        let path = target.split('?').next()?.to_owned();
        let (is_get, is_upgrade) = (method == "GET", lines.any(upgrades));
        Some(Self { is_get, path, is_upgrade, head })
    }
}

async fn read_head(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut head = Vec::with_capacity(1024);
    while !head.windows(4).any(|end| end == b"\r\n\r\n") && head.len() < HEAD_LEN_MAX {
        if stream.read_buf(&mut head).await? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
    }
    Ok(head)
}

/// Sends one answer and closes. `kind` is the media type of text in UTF-8.
pub(crate) async fn respond(
    stream: &mut TcpStream,
    status: &str,
    kind: &str,
    body: &str,
) -> io::Result<()> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn request_parses_as_page_websocket_or_nothing() {
        let parse = |text: &str| {
            let request = Request::parse(text.as_bytes().to_vec())?;
            Some((request.is_get, request.path, request.is_upgrade))
        };
        let page = "GET /?dark HTTP/1.1\r\nHost: a\r\n\r\n";
        assert_eq!(parse(page), Some((true, "/".to_owned(), false)));
        let upgrade = "GET / HTTP/1.1\r\nhost: a\r\nupgrade: WebSocket\r\n\r\n";
        assert_eq!(parse(upgrade), Some((true, "/".to_owned(), true)));
        assert_eq!(parse("POST / HTTP/1.1\r\n\r\n"), Some((false, "/".to_owned(), false)));
        assert_eq!(parse("GET /x HTTP/1.1\r\n\r\n"), Some((true, "/x".to_owned(), false)));
        for none in ["", "GET / HTTP/1.1\r\n", "\r\n\r\n", "GET /\r\n\r\n", "A B C\r\n\r\n"] {
            assert_eq!(parse(none), None, "{none:?}");
        }
    }
}
