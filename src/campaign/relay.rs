//! The socket on loopback between the link's faults and the station's process.

use std::io;
use std::net::{Ipv4Addr, UdpSocket};
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// Interval at which the relay checks whether the station listens.
const LOOK: Duration = Duration::from_millis(5);
/// Longest datagram.
const DATAGRAM_MAX: usize = 65_536;

/// A socket to the station. Its frames carry the kernel's time of receipt, so that a busy machine
/// does not affect the judgement of either end.
pub(super) struct Relay {
    socket: UdpSocket,
    station_port: u16,
    began: SystemTime,
    buffer: Vec<u8>,
}

impl Relay {
    /// Opens the socket, and finds a port for the station.
    ///
    /// # Errors
    /// The system provides no socket.
    pub fn open() -> io::Result<Self> {
        let free = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        let station_port = free.local_addr()?.port();
        socket.connect((Ipv4Addr::LOCALHOST, station_port))?;
        stamped(&socket)?;
        let buffer = vec![0; DATAGRAM_MAX];
        Ok(Self { socket, station_port, began: SystemTime::now(), buffer })
    }

    /// Waits until the station listens, which is time 0.
    ///
    /// # Errors
    /// The station does not listen within `limit`.
    pub fn await_station(&mut self, limit: Duration) -> io::Result<()> {
        let started = Instant::now();
        // If nothing listens at the port, the send after an empty datagram is refused.
        while self.is_refused() {
            if started.elapsed() > limit {
                let message = "it does not listen on its port";
                return Err(io::Error::new(io::ErrorKind::TimedOut, message));
            }
        }
        self.began = SystemTime::now();
        Ok(())
    }

    fn is_refused(&self) -> bool {
        let refused = |result: io::Result<usize>| {
            result.is_err_and(|error| error.kind() == io::ErrorKind::ConnectionRefused)
        };
        let before = refused(self.socket.send(&[]));
        std::thread::sleep(LOOK);
        refused(self.socket.send(&[])) || before
    }

    /// The port on which the station is to listen.
    pub fn station_port(&self) -> u16 {
        self.station_port
    }

    /// Start of the time, since 1970: when the station began to listen.
    pub fn began(&self) -> Duration {
        self.began.duration_since(UNIX_EPOCH).unwrap_or_default()
    }

    /// Time since then, us.
    pub fn now_us(&self) -> u64 {
        self.us(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default())
    }

    fn us(&self, since_epoch: Duration) -> u64 {
        since_epoch.saturating_sub(self.began()).as_micros() as u64
    }

    /// Sends a frame to the station. If nothing listens it is lost, as on any link.
    pub fn send(&self, frame: &[u8]) {
        let _ = self.socket.send(frame);
    }

    /// Passes every datagram from the station to `deliver`, with the time at which it was sent, us.
    ///
    /// # Errors
    /// The socket is no longer usable.
    pub fn take(&mut self, mut deliver: impl FnMut(u64, &[u8])) -> io::Result<()> {
        loop {
            match receive(&self.socket, &mut self.buffer) {
                Ok((len, at)) => {
                    let sent_us = at.map_or_else(|| self.now_us(), |at| self.us(at));
                    deliver(sent_us, self.buffer.get(..len).unwrap_or_default());
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(()),
                // The station does not run yet, or no longer.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Waits until the station sends something, or until `until_us`.
    pub fn wait(&self, until_us: u64) {
        let wait = Duration::from_micros(until_us.saturating_sub(self.now_us()));
        let limit = Timespec { tv_sec: wait.as_secs() as i64, tv_nsec: wait.subsec_nanos().into() };
        // A signal ends the wait early, which does no harm.
        let _ = poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&limit));
    }
}

#[cfg(target_os = "linux")]
fn stamped(socket: &UdpSocket) -> io::Result<()> {
    let on: libc::c_int = 1;
    let len = size_of_val(&on) as libc::socklen_t;
    // SAFETY: the descriptor is open, and the option's value is an int of the length given.
    let result = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_TIMESTAMPNS,
            (&raw const on).cast(),
            len,
        )
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// A datagram's length, and the time at which the kernel took it, since 1970.
#[cfg(target_os = "linux")]
fn receive(socket: &UdpSocket, buffer: &mut [u8]) -> io::Result<(usize, Option<Duration>)> {
    let mut part = libc::iovec { iov_base: buffer.as_mut_ptr().cast(), iov_len: buffer.len() };
    let mut control = [0_u64; 8];
    // SAFETY: zeros are a valid header, and its pointers refer to memory that outlives the call.
    let (len, header) = unsafe {
        let mut header: libc::msghdr = std::mem::zeroed();
        header.msg_iov = &raw mut part;
        header.msg_iovlen = 1;
        header.msg_control = control.as_mut_ptr().cast();
        header.msg_controllen = size_of_val(&control) as _;
        (libc::recvmsg(socket.as_raw_fd(), &raw mut header, libc::MSG_DONTWAIT), header)
    };
    let Ok(len) = usize::try_from(len) else { return Err(io::Error::last_os_error()) };
    // SAFETY: the kernel has filled the header's control buffer, and these stay within it.
    let at = unsafe {
        let first = libc::CMSG_FIRSTHDR(&raw const header);
        let is_stamp = !first.is_null()
            && (*first).cmsg_level == libc::SOL_SOCKET
            && (*first).cmsg_type == libc::SCM_TIMESTAMPNS;
        is_stamp.then(|| libc::CMSG_DATA(first).cast::<libc::timespec>().read_unaligned())
    };
    let at = at.map(|at| {
        Duration::new(at.tv_sec.try_into().unwrap_or(0), at.tv_nsec.try_into().unwrap_or(0))
    });
    Ok((len, at))
}

#[cfg(not(target_os = "linux"))]
fn stamped(socket: &UdpSocket) -> io::Result<()> {
    socket.set_nonblocking(true)
}

#[cfg(not(target_os = "linux"))]
fn receive(socket: &UdpSocket, buffer: &mut [u8]) -> io::Result<(usize, Option<Duration>)> {
    socket.recv(buffer).map(|len| (len, None))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unread_datagram_keeps_its_send_time() {
        let mut relay = Relay::open().expect("a socket");
        let station =
            UdpSocket::bind((Ipv4Addr::LOCALHOST, relay.station_port())).expect("its port");
        relay.await_station(Duration::from_secs(5)).expect("it listens");
        relay.send(b"word");
        let mut buffer = [0; 8];
        let (len, from) = loop {
            let (len, from) = station.recv_from(&mut buffer).expect("a datagram");
            if len > 0 {
                break (len, from);
            }
        };
        assert_eq!(&buffer[..len], b"word");
        let before_us = relay.now_us();
        station.send_to(b"answer", from).expect("it goes");
        let after_us = relay.now_us();
        while relay.now_us() < after_us + 20_000 {
            relay.wait(after_us + 20_000);
        }
        let mut taken = Vec::new();
        relay.take(|at_us, bytes| taken.push((at_us, bytes.to_vec()))).expect("a socket");
        let [(at_us, bytes)] = &taken[..] else { panic!("{taken:?}") };
        assert_eq!(bytes, b"answer");
        // The wall clock may be slewed meanwhile.
        let limit = if cfg!(target_os = "linux") { 5_000 } else { 25_000 };
        assert!((before_us..after_us + limit).contains(at_us), "{before_us} {at_us} {after_us}");
    }
}
