//! Relays between one viewer and Foxglove's server. Messages that the viewer does not read in time
//! are dropped, the oldest first, instead of waiting in the system's buffers until they are stale.

use std::collections::VecDeque;
use std::io;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::time::timeout;

/// Bytes of topics that wait for a viewer: some two seconds of a busy flight.
const DATA_MAX: usize = 256 * 1024;
/// Bytes of everything else, mostly schemas. A viewer with more of these waiting is disconnected.
const OTHER_MAX: usize = 4 * 1024 * 1024;
/// Bytes passed to the system at once.
const AT_ONCE: usize = 16 * 1024;
/// Largest answer to a handshake, bytes.
const HEAD_LEN_MAX: usize = 4096;
/// Time to deliver the server's last messages.
const LAST_LIMIT: Duration = Duration::from_secs(1);
/// Largest frame, bytes.
const FRAME_LEN_MAX: usize = 16 * 1024 * 1024;

/// Relays until one side closes.
pub(super) async fn relay<C, S>(client: C, server: S) -> io::Result<()>
where
    C: AsyncRead + AsyncWrite + Unpin,
    S: AsyncRead + AsyncWrite + Unpin,
{
    let (mut from_client, mut to_client) = tokio::io::split(client);
    let (mut from_server, mut to_server) = tokio::io::split(server);
    let mut from_server_buffer = Vec::with_capacity(AT_ONCE);
    let mut from_client_buffer = [0; AT_ONCE];
    let (mut splitter, mut backlog) = (Splitter::default(), Backlog::default());
    let mut outgoing = Outgoing::default();
    loop {
        outgoing.refill(&mut backlog);
        tokio::select! {
            length = from_server.read_buf(&mut from_server_buffer) => {
                if length? == 0 {
                    // The last messages include the reason for closing.
                    let last = async {
                        while outgoing.refill(&mut backlog) {
                            to_client.write_all(outgoing.rest()).await?;
                            outgoing.advance(usize::MAX);
                        }
                        to_client.shutdown().await
                    };
                    return timeout(LAST_LIMIT, last).await?;
                }
                splitter.push(&from_server_buffer, &mut backlog)?;
                from_server_buffer.clear();
            }
            length = to_client.write(outgoing.rest()), if !outgoing.rest().is_empty() => {
                outgoing.advance(length?);
            }
            length = from_client.read(&mut from_client_buffer) => match length? {
                0 => return Ok(()),
                length => to_server.write_all(&from_client_buffer[..length]).await?,
            },
        }
    }
}

/// Bytes on their way out.
#[derive(Default)]
struct Outgoing {
    bytes: Vec<u8>,
    sent: usize,
}

impl Outgoing {
    fn rest(&self) -> &[u8] {
        self.bytes.get(self.sent..).unwrap_or_default()
    }

    fn advance(&mut self, length: usize) {
        self.sent = self.sent.saturating_add(length).min(self.bytes.len());
    }

    /// Takes the next waiting bytes once all earlier ones have left. Returns whether any are left.
    fn refill(&mut self, backlog: &mut Backlog) -> bool {
        if self.rest().is_empty() {
            self.bytes.clear();
            self.sent = 0;
            while self.bytes.len() < AT_ONCE
                && let Some(frame) = backlog.pop()
            {
                self.bytes.extend_from_slice(&frame);
            }
        }
        !self.rest().is_empty()
    }
}

/// Frames that wait, in order.
#[derive(Debug, Default)]
struct Backlog {
    frames: VecDeque<Waiting>,
    data: usize,
    other: usize,
}

#[derive(Debug)]
struct Waiting {
    bytes: Vec<u8>,
    /// Whether it may be dropped.
    is_data: bool,
}

impl Backlog {
    fn push(&mut self, bytes: Vec<u8>, is_data: bool) -> io::Result<()> {
        let sum = if is_data { &mut self.data } else { &mut self.other };
        *sum += bytes.len();
        self.frames.push_back(Waiting { bytes, is_data });
        while self.data > DATA_MAX
            && let Some(oldest) = self.frames.iter().position(|frame| frame.is_data)
            && let Some(lost) = self.frames.remove(oldest)
        {
            self.data -= lost.bytes.len();
        }
        if self.other > OTHER_MAX {
            return Err(io::Error::other("the viewer does not read"));
        }
        Ok(())
    }

    fn pop(&mut self) -> Option<Vec<u8>> {
        let Waiting { bytes, is_data } = self.frames.pop_front()?;
        let sum = if is_data { &mut self.data } else { &mut self.other };
        *sum -= bytes.len();
        Some(bytes)
    }
}

/// Splits a server's bytes: the answer to the handshake, then WebSocket frames.
#[derive(Debug, Default)]
struct Splitter {
    rest: Vec<u8>,
    has_answered: bool,
}

impl Splitter {
    fn push(&mut self, bytes: &[u8], backlog: &mut Backlog) -> io::Result<()> {
        self.rest.extend_from_slice(bytes);
        let mut at = 0;
        if !self.has_answered {
            const END: &[u8] = b"\r\n\r\n";
            let end = self.rest.windows(END.len()).position(|part| part == END);
            match end {
                Some(end) => {
                    at = end + END.len();
                    self.has_answered = true;
                    backlog.push(self.rest[..at].to_vec(), false)?;
                }
                None if self.rest.len() > HEAD_LEN_MAX => {
                    return Err(io::ErrorKind::InvalidData.into());
                }
                None => return Ok(()),
            }
        }
        while let Some(frame) = Frame::find(&self.rest[at..])? {
            let end = at + frame.length;
            backlog.push(self.rest[at..end].to_vec(), frame.is_data)?;
            at = end;
        }
        self.rest.drain(..at);
        Ok(())
    }
}

/// A whole frame, header included.
#[derive(Debug, PartialEq, Eq)]
struct Frame {
    length: usize,
    /// Whether it is a topic's message in Foxglove's protocol: binary, with a first byte of 1.
    is_data: bool,
}

impl Frame {
    /// The frame at the beginning of `bytes`, if it is complete. A server's frames are not masked.
    fn find(bytes: &[u8]) -> io::Result<Option<Self>> {
        const FIN_AND_BINARY: u8 = 0x82;
        let (Some(&first), Some(&short)) = (bytes.first(), bytes.get(1)) else { return Ok(None) };
        let (header, payload) = match short & 0x7F {
            126 => match bytes.get(2..).and_then(|rest| rest.first_chunk()) {
                Some(length) => (4, Some(usize::from(u16::from_be_bytes(*length)))),
                None => return Ok(None),
            },
            127 => match bytes.get(2..).and_then(|rest| rest.first_chunk()) {
                Some(length) => (10, usize::try_from(u64::from_be_bytes(*length)).ok()),
                None => return Ok(None),
            },
            length => (2, Some(length.into())),
        };
        let payload = payload
            .filter(|payload| *payload <= FRAME_LEN_MAX)
            .ok_or_else(|| io::Error::from(io::ErrorKind::InvalidData))?;
        let length = header + payload;
        let is_data = first == FIN_AND_BINARY && payload > 0 && bytes.get(header) == Some(&1);
        Ok((bytes.len() >= length).then_some(Self { length, is_data }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(first: u8, payload: &[u8]) -> Vec<u8> {
        let mut bytes = vec![first];
        match payload.len() {
            length @ ..126 => bytes.push(length as u8),
            length @ ..65536 => {
                bytes.push(126);
                bytes.extend((length as u16).to_be_bytes());
            }
            length => {
                bytes.push(127);
                bytes.extend((length as u64).to_be_bytes());
            }
        }
        bytes.extend_from_slice(payload);
        bytes
    }

    #[test]
    fn frames_are_reassembled_from_any_chunking() {
        let data = [vec![1; 5], vec![1; 125], vec![1; 126], vec![1; 70_000]];
        let mut all = b"HTTP/1.1 101 Switching Protocols\r\nA: b\r\n\r\n".to_vec();
        let head = all.len();
        all.extend(frame(0x81, b"{}"));
        data.iter().for_each(|payload| all.extend(frame(0x82, payload)));
        for step in [1, 7, 1000, all.len()] {
            let (mut splitter, mut backlog) = (Splitter::default(), Backlog::default());
            for part in all.chunks(step) {
                splitter.push(part, &mut backlog).expect("frames");
            }
            let found: Vec<_> = std::iter::from_fn(|| backlog.pop()).collect();
            assert_eq!(found.concat(), all);
            assert_eq!((found.len(), found[0].len()), (6, head));
            assert_eq!((backlog.data, backlog.other), (0, 0));
        }
    }

    #[test]
    fn backlog_drops_only_the_oldest_data() {
        let mut backlog = Backlog::default();
        for number in 0..2000_u32 {
            let mut payload = vec![1; 300];
            payload[1..5].copy_from_slice(&number.to_le_bytes());
            backlog.push(payload, true).expect("taken");
            if number % 500 == 0 {
                backlog.push(vec![0; 100], false).expect("taken");
            }
        }
        let kept: Vec<_> = std::iter::from_fn(|| backlog.pop()).collect();
        assert_eq!(kept.iter().filter(|frame| frame[0] == 0).count(), 4);
        let data: Vec<_> = kept.iter().filter(|frame| frame[0] == 1).collect();
        assert_eq!(data.len(), DATA_MAX / 300);
        assert_eq!(data.last().expect("data")[1..5], 1999_u32.to_le_bytes());
    }

    #[test]
    fn viewer_that_stops_reading_is_disconnected() {
        let mut backlog = Backlog::default();
        let pushed = (0..).map(|_| backlog.push(vec![0; 100_000], false)).find_map(Result::err);
        assert!(pushed.is_some());
    }

    #[test]
    fn invalid_frame_ends_the_connection() {
        let mut splitter = Splitter { has_answered: true, ..Splitter::default() };
        let huge = [0x82, 127, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF];
        assert!(splitter.push(&huge, &mut Backlog::default()).is_err());
        let mut splitter = Splitter::default();
        assert!(splitter.push(&[b'a'; HEAD_LEN_MAX + 1], &mut Backlog::default()).is_err());
    }
}
