//! Why no vehicle is found, explained from how far its bytes get.

use super::session::Session;
use crate::clock::HostTime;

/// What is missing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Silence {
    /// Distinguishes one kind of silence from another.
    pub subject: String,
    /// What arrived, and what to check.
    pub line: String,
}

impl Silence {
    /// Explains the silence of a session without a vehicle.
    pub fn of(session: &Session, now: HostTime) -> Self {
        let received = session.received();
        let endpoint = session.endpoint().unwrap_or("the link");
        if let Some(id) = session.vehicle() {
            let silent_s = session.last_received().map_or(0.0, |at| now.since(at).as_secs_f64());
            let line = format!("nothing received from {id} for {silent_s:.0} s");
            return Self { subject: "lost".to_owned(), line };
        }
        if received.bytes == 0 {
            let line = format!(
                "0 bytes received on {endpoint}; check that the vehicle is on and sends to this \
                 port"
            );
            return Self { subject: "bytes".to_owned(), line };
        }
        if received.frames == 0 {
            let line = format!(
                "{} bytes received on {endpoint}, none of them MAVLink; check the baud rate, and \
                 that this is a MAVLink port",
                received.bytes
            );
            return Self { subject: "frames".to_owned(), line };
        }
        let rejected: u64 = session.rejected_frames().map(|(_, count)| count).sum();
        if rejected > 0 {
            let whys = session.rejected_frames().filter(|(_, count)| *count > 0);
            let whys: Vec<_> = whys.map(|(why, count)| format!("{count}: {why}")).collect();
            let line = format!(
                "{} frames received on {endpoint}, {rejected} of them rejected ({}), and no \
                 HEARTBEAT from an autopilot; check that the vehicle has the key in link.signing",
                received.frames,
                whys.join("; ")
            );
            return Self { subject: "unbelieved".to_owned(), line };
        }
        let of =
            session.requested_system().map_or(String::new(), |id| format!(" with system id {id}"));
        let senders: Vec<_> = session.senders().iter().map(ToString::to_string).collect();
        let line = format!(
            "{} frames received on {endpoint}, no HEARTBEAT from an autopilot{of}; senders: {}",
            received.frames,
            senders.join(", ")
        );
        Self { subject: format!("autopilot {senders:?}"), line }
    }
}
