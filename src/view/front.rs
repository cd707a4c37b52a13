//! The front of the view: one port for the page and for Foxglove's protocol.

use std::io;
use std::net::SocketAddr;

use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpSocket, TcpStream};

use super::relay::relay;
use crate::http::{self, Request, respond};

/// The page, whole: it asks nobody for anything else.
const PAGE: &str = include_str!("page.html");

/// Answers requests until this is dropped; WebSockets are led to `inner`.
pub(super) async fn serve(listener: TcpListener, inner: SocketAddr) {
    http::serve(listener, |stream| answer(stream, inner)).await;
}

async fn answer(mut stream: TcpStream, inner: SocketAddr) -> io::Result<()> {
    stream.set_nodelay(true)?;
    match Request::read(&mut stream).await? {
        Some(Request { is_get: true, is_upgrade: true, head, .. }) => {
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
            let text = "there is the page, at /, and Foxglove's WebSocket, at the same address\n";
            respond(&mut stream, "404 Not Found", "text/plain", text).await
        }
        None => respond(&mut stream, "400 Bad Request", "text/plain", "no HTTP\n").await,
    }
}
