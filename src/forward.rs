//! The fan-out: forwards the vehicle's frames to other ground stations, and forwards their frames
//! to the vehicle where a list allows it.
//!
//! Downwards, it takes records in the thread that writes the log. Upwards, its own thread reads
//! what the stations send, and the control thread takes the allowed frames from a short queue. None
//! of them waits for a station.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::net::{ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use mavlink::Message;
use wire::dialect::MavMessage;
use wire::{Decoder, Endpoint, Frame, message_name};

use crate::log::record::{Direction, Record};
use crate::log::sink::Listener;

/// Frames that may wait for the control thread; further ones are dropped.
const QUEUE: usize = 64;
/// Frames that the control thread takes at most in one turn.
const AT_ONCE: usize = 8;
/// Longest wait on silent stations.
const LOOK: Duration = Duration::from_millis(200);
/// Longest datagram.
const DATAGRAM: usize = 65_536;

/// Messages that only this program may send: a vehicle cannot have two controllers, and only the
/// owner may set up a key.
const OWN: [&str; 5] = [
    "SETUP_SIGNING",
    "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED",
    "SET_POSITION_TARGET_GLOBAL_INT",
    "SET_ACTUATOR_CONTROL_TARGET",
];

/// Why nothing can be forwarded.
#[derive(Debug, thiserror::Error)]
pub enum ForwardError {
    /// The endpoint is not of the form `udpout:HOST:PORT`.
    #[error("--forward {0}: expected udpout:HOST:PORT")]
    Endpoint(Endpoint),
    /// A name on the list is not that of a message.
    #[error("forward.allow: no message is called {0:?}; names are MAVLink's, such as HEARTBEAT")]
    Message(String),
    /// A message on the list is reserved for this program.
    #[error(
        "forward.allow: only this program may send {0} while it flies; remove it from the list"
    )]
    Own(String),
    /// The address does not resolve, or the system provides no socket.
    #[error("--forward {endpoint}: {source}")]
    Socket {
        /// The station's endpoint.
        endpoint: Endpoint,
        /// The system's reason.
        source: io::Error,
    },
    /// The system provides no thread.
    #[error("cannot start forwarding: {0}")]
    Thread(#[from] io::Error),
}

/// The messages that others may send to the vehicle.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AllowList(BTreeSet<u32>);

impl AllowList {
    /// Reads the list from MAVLink message names.
    ///
    /// # Errors
    /// [`ForwardError::Message`], [`ForwardError::Own`].
    pub fn new<S: AsRef<str>>(names: &[S]) -> Result<Self, ForwardError> {
        let id = |name: &S| {
            let name = name.as_ref();
            if OWN.contains(&name) {
                return Err(ForwardError::Own(name.to_owned()));
            }
            MavMessage::message_id_from_name(name)
                .ok_or_else(|| ForwardError::Message(name.to_owned()))
        };
        names.iter().map(id).collect::<Result<_, _>>().map(Self)
    }

    fn allows(&self, frame: &Frame) -> bool {
        self.0.contains(&frame.id())
    }
}

/// Sends the vehicle's frames to each station.
pub struct Forward {
    stations: Vec<Arc<UdpSocket>>,
    /// Ends the thread that reads from the stations.
    _upward: Upward,
}

/// The frames from stations for the vehicle, as the control thread takes them.
pub struct Guests(Receiver<Vec<u8>>);

struct Upward {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Forward {
    /// Opens a socket to each endpoint.
    ///
    /// # Errors
    /// [`ForwardError`].
    pub fn start(endpoints: &[Endpoint], allow: AllowList) -> Result<(Self, Guests), ForwardError> {
        let stations = endpoints.iter().map(station).collect::<Result<Vec<_>, _>>()?;
        let (queue, guests) = sync_channel(QUEUE);
        let is_over = Arc::new(AtomicBool::new(false));
        let (sockets, end) = (stations.clone(), Arc::clone(&is_over));
        let names: Vec<String> = endpoints.iter().map(ToString::to_string).collect();
        let thread = thread::Builder::new()
            .name("forward".into())
            .spawn(move || listen(&sockets, &names, &allow, &queue, &end))?;
        let upward = Upward { is_over, thread: Some(thread) };
        Ok((Self { stations, _upward: upward }, Guests(guests)))
    }
}

impl Drop for Upward {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn station(endpoint: &Endpoint) -> Result<Arc<UdpSocket>, ForwardError> {
    let Endpoint::UdpOut(address) = endpoint else {
        return Err(ForwardError::Endpoint(endpoint.clone()));
    };
    let open = || {
        let to = (address.host.as_str(), address.port)
            .to_socket_addrs()?
            .next()
            .ok_or_else(|| io::Error::new(io::ErrorKind::NotFound, "no such host"))?;
        let any = if to.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
        let socket = UdpSocket::bind(any)?;
        socket.connect(to)?;
        socket.set_nonblocking(true)?;
        Ok(Arc::new(socket))
    };
    open().map_err(|source| ForwardError::Socket { endpoint: endpoint.clone(), source })
}

impl Listener for Forward {
    fn on_record(&mut self, record: &Record) {
        if let Record::Frame(frame) = record
            && frame.direction == Direction::Rx
        {
            for station in &self.stations {
                // A missing station, or a full path to it, loses the frame.
                let _ = station.send(frame.bytes());
            }
        }
    }
}

impl Guests {
    /// The waiting frames, up to a few.
    pub fn take(&self) -> impl Iterator<Item = Vec<u8>> + '_ {
        self.0.try_iter().take(AT_ONCE)
    }
}

/// Reads what the stations send, until the fan-out ends.
fn listen(
    stations: &[Arc<UdpSocket>],
    names: &[String],
    allow: &AllowList,
    queue: &SyncSender<Vec<u8>>,
    is_over: &AtomicBool,
) {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let limit = Timespec { tv_sec: 0, tv_nsec: LOOK.subsec_nanos().into() };
    let mut buffer = vec![0; DATAGRAM];
    let mut decoder = Decoder::new();
    let mut refused = BTreeMap::new();
    while !is_over.load(Ordering::Acquire) {
        let mut looks: Vec<_> =
            stations.iter().map(|station| PollFd::new(station, PollFlags::IN)).collect();
        if poll(&mut looks, Some(&limit)).is_err() {
            thread::sleep(LOOK);
        }
        for (station, name) in stations.iter().zip(names) {
            // The error belongs to an earlier datagram that nobody received: the station is not up
            // yet.
            for _ in 0..QUEUE {
                let Ok(length) = station.recv(&mut buffer) else { break };
                let Some(datagram) = buffer.get(..length) else { break };
                decoder.datagram(datagram, |frame| {
                    if allow.allows(&frame) {
                        // A full queue drops the frame: MAVLink requests are repeated.
                        let _ = queue.try_send(frame.bytes().to_vec());
                    } else {
                        report_refused(&frame, name, &mut refused);
                    }
                });
            }
        }
    }
}

/// Reports once for each kind of message that it is not forwarded.
fn report_refused(frame: &Frame, name: &str, refused: &mut BTreeMap<u32, u64>) {
    let count = refused.entry(frame.id()).or_insert(0_u64);
    *count += 1;
    if *count == 1 {
        tracing::info!(
            "{} from {name} is not forwarded to the vehicle: forward.allow lacks it",
            message_name(frame.id())
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn allow_list_accepts_message_names_except_setpoints() {
        let list = AllowList::new(&["HEARTBEAT", "PARAM_REQUEST_READ"]).expect("names");
        assert_eq!(list.0, BTreeSet::from([0, 20]));
        for (wrong, text) in [("HEARTBEET", "no message"), ("SET_ATTITUDE_TARGET", "remove it")] {
            let error = AllowList::new(&[wrong]).expect_err(wrong).to_string();
            assert!(error.contains(text) && error.contains(wrong), "{error}");
        }
    }

    #[test]
    fn forwarding_requires_a_udpout_endpoint() {
        for wrong in ["udpin:127.0.0.1:14550", "tcp:127.0.0.1:5760"] {
            let endpoint: Endpoint = wrong.parse().expect("an endpoint");
            let error = Forward::start(&[endpoint], AllowList::default()).err().expect(wrong);
            assert!(error.to_string().contains("expected udpout:HOST:PORT"), "{error}");
        }
    }
}
