//! A minimal vehicle, sufficient for the daemon to stream its hold setpoint.

use std::io::ErrorKind;
use std::net::UdpSocket;
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

use wire::dialect::*;
use wire::{Decoder, Encoder};

/// PX4's custom mode for HOLD.
const HOLD: u32 = 4 << 16 | 3 << 24;

/// A non-blocking socket to one port on loopback.
pub fn socket_to(port: u16) -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
    socket.connect(("127.0.0.1", port)).expect("connected");
    socket.set_nonblocking(true).expect("a socket that never blocks");
    socket
}

/// Waits for a datagram. The socket's own time-out would not do: the kernel rounds it up to its
/// tick of several milliseconds.
pub fn receive(
    socket: &UdpSocket,
    datagram: &mut [u8],
    until: Instant,
) -> Option<(usize, Instant)> {
    loop {
        let left = until.saturating_duration_since(Instant::now());
        let timeout = libc::timespec {
            tv_sec: left.as_secs() as libc::time_t,
            tv_nsec: left.subsec_nanos().into(),
        };
        let mut ready = libc::pollfd { fd: socket.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        // SAFETY: one descriptor, a time-out, no signal mask; all live until the call returns.
        unsafe { libc::ppoll(&mut ready, 1, &timeout, std::ptr::null()) };
        match socket.recv(datagram) {
            Ok(count) => return Some((count, Instant::now())),
            // Datagrams sent before the other end listened were refused.
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
            Err(_) if left.is_zero() => return None,
            Err(_) => {}
        }
    }
}

/// On the ground, disarmed, in HOLD; answers requests.
pub struct Vehicle {
    socket: UdpSocket,
    encoder: Encoder,
    decoder: Decoder,
    start: Instant,
    frame: Vec<u8>,
}

impl Vehicle {
    pub fn new(daemon_port: u16) -> Self {
        Self {
            socket: socket_to(daemon_port),
            encoder: Encoder::new(1, 1),
            decoder: Decoder::new(),
            start: Instant::now(),
            frame: Vec::with_capacity(512),
        }
    }

    /// The last frame sent.
    pub fn last_frame(&self) -> &[u8] {
        &self.frame
    }

    fn send(&mut self, message: &MavMessage) -> Instant {
        self.frame.clear();
        self.encoder.encode(message, &mut self.frame);
        let stamp = Instant::now();
        // Refused until the daemon listens.
        let _ = self.socket.send(&self.frame);
        stamp
    }

    fn time_us(&self) -> u64 {
        self.start.elapsed().as_micros() as u64 + 1_000_000
    }

    /// Sends the messages that are due once a second.
    pub fn send_slow_messages(&mut self) {
        self.send(&MavMessage::HEARTBEAT(HEARTBEAT_DATA {
            custom_mode: HOLD,
            mavtype: MavType::MAV_TYPE_QUADROTOR,
            autopilot: MavAutopilot::MAV_AUTOPILOT_PX4,
            base_mode: MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED,
            system_status: MavState::MAV_STATE_STANDBY,
            mavlink_version: 3,
        }));
        self.send(&MavMessage::CURRENT_MODE(CURRENT_MODE_DATA {
            custom_mode: HOLD,
            intended_custom_mode: HOLD,
            ..Default::default()
        }));
        self.send(&MavMessage::EXTENDED_SYS_STATE(EXTENDED_SYS_STATE_DATA {
            landed_state: MavLandedState::MAV_LANDED_STATE_ON_GROUND,
            ..Default::default()
        }));
    }

    /// Sends the state; returns the send time.
    pub fn send_odometry(&mut self) -> Instant {
        let message = MavMessage::ODOMETRY(ODOMETRY_DATA {
            time_usec: self.time_us(),
            frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            child_frame_id: MavFrame::MAV_FRAME_LOCAL_NED,
            q: [1.0, 0.0, 0.0, 0.0],
            ..Default::default()
        });
        self.send(&message)
    }

    /// Reads all pending messages; returns the number of setpoints among them.
    pub fn late_setpoints(&mut self) -> usize {
        std::iter::from_fn(|| self.await_setpoint(Instant::now())).count()
    }

    /// Reads until a setpoint arrives, and answers all other messages; returns its arrival time.
    pub fn await_setpoint(&mut self, until: Instant) -> Option<Instant> {
        let mut datagram = [0; 2048];
        loop {
            let (count, stamp) = receive(&self.socket, &mut datagram, until)?;
            self.decoder.push(&datagram[..count]);
            let mut is_setpoint = false;
            while let Some(frame) = self.decoder.next_frame() {
                match frame.message() {
                    Ok(MavMessage::SET_ATTITUDE_TARGET(_)) => is_setpoint = true,
                    Ok(message) => self.answer(&message),
                    Err(_) => {}
                }
            }
            if is_setpoint {
                return Some(stamp);
            }
        }
    }

    /// Waits for the daemon to stream: sends the state at its rate until a second's worth of
    /// setpoints has arrived. Returns whether that happened within `limit`.
    pub fn is_streamed_to(&mut self, period: Duration, limit: Duration) -> bool {
        let begun = Instant::now();
        let (mut answered, wanted) = (0, (1.0 / period.as_secs_f64()).ceil() as usize);
        let mut slow_due = begun;
        while begun.elapsed() < limit && answered < wanted {
            let tick = Instant::now();
            if slow_due <= tick {
                slow_due = tick + Duration::from_secs(1);
                self.send_slow_messages();
            }
            self.send_odometry();
            answered += usize::from(self.await_setpoint(tick + period).is_some());
            std::thread::sleep((tick + period).saturating_duration_since(Instant::now()));
        }
        answered >= wanted
    }

    fn answer(&mut self, message: &MavMessage) {
        match message {
            MavMessage::TIMESYNC(sync) if sync.tc1 == 0 => {
                let tc1 = self.time_us() as i64 * 1000;
                let reply = TIMESYNC_DATA { tc1, ts1: sync.ts1, ..Default::default() };
                self.send(&MavMessage::TIMESYNC(reply));
            }
            MavMessage::COMMAND_LONG(command) => {
                if command.command == MavCmd::MAV_CMD_REQUEST_MESSAGE && command.param1 == 148.0 {
                    let version = AUTOPILOT_VERSION_DATA {
                        vendor_id: 0x4457,
                        product_id: 1,
                        ..Default::default()
                    };
                    self.send(&MavMessage::AUTOPILOT_VERSION(version));
                }
                let ack = COMMAND_ACK_DATA { command: command.command, ..Default::default() };
                self.send(&MavMessage::COMMAND_ACK(ack));
            }
            _ => {}
        }
    }
}
