//! The records of a log. They hold states and setpoints, independent of the code that computes
//! them.

use std::collections::BTreeMap;

use vehicle::frame::{Frd, Ned};
use wire::framing::Frame;

use message::clock::{HostTime, VehicleTime};
use message::setpoint::{Reference, Setpoint, State};

/// One record of a log.
///
/// The largest variants are about half a kilobyte and stored inline, so passing a record to the
/// writer's thread allocates nothing.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)]
pub enum Record {
    /// A MAVLink frame as sent or received.
    Frame(FrameRecord),
    /// One control tick.
    Tick(Tick),
    /// Accelerometer and gyro.
    Imu {
        /// Times of the record.
        stamp: Stamp,
        /// Specific force, m/s^2; (0, 0, -g) at hover.
        specific_force: Frd,
        /// Body rate, rad/s.
        body_rate: Frd,
    },
    /// Motor outputs in the vehicle's unit.
    Motors {
        /// Times of the record.
        stamp: Stamp,
        /// Outputs 1 to 4.
        outputs: [f32; 4],
    },
    /// Battery values, as far as known.
    Battery {
        /// Times of the record.
        stamp: Stamp,
        /// Pack voltage, V.
        voltage: Option<f64>,
        /// Current, A.
        current: Option<f64>,
        /// Remaining charge in 0..1.
        remaining: Option<f64>,
    },
    /// Counters of the link.
    Link {
        /// Time of the reading.
        host: HostTime,
        /// The counters.
        stats: LinkStats,
    },
    /// One exchange of TIMESYNC.
    Timesync {
        /// Time of the reply.
        host: HostTime,
        /// Result of the exchange.
        sample: TimesyncSample,
    },
    /// A line for people: a STATUSTEXT or an event of the daemon.
    Event {
        /// Times of the record.
        host: HostTime,
        /// Severity of the event.
        severity: Severity,
        /// Origin of the event.
        source: Source,
        /// Text of the event.
        text: String,
    },
    /// The simulator's true state.
    Truth {
        /// Times of the record.
        stamp: Stamp,
        /// True state and loads.
        truth: Truth,
    },
    /// Facts about the run that became known after the log was opened, such as the firmware's
    /// version. They add to the metadata record `run`.
    Facts(Box<BTreeMap<String, String>>),
    /// A flight begins at this time. A sink with one log per flight opens a log.
    FlightBegins(HostTime),
    /// The flight ends.
    FlightEnds,
}

/// Prefix of the keys in [`Record::Facts`] that hold vehicle parameters; the parameter's name
/// follows.
pub const PARAMETER_FACT: &str = "parameter.";

/// The vehicle parameter that a fact states, and its finite value.
pub fn stated_parameter(key: &str, value: &str) -> Option<(String, f64)> {
    let name = key.strip_prefix(PARAMETER_FACT)?;
    let value = value.parse().ok().filter(|value: &f64| value.is_finite())?;
    Some((name.to_owned(), value))
}

impl Record {
    /// The stamp, if the record is a sample from the vehicle.
    pub fn stamp_mut(&mut self) -> Option<&mut Stamp> {
        match self {
            Self::Tick(Tick { stamp, .. })
            | Self::Imu { stamp, .. }
            | Self::Motors { stamp, .. }
            | Self::Battery { stamp, .. }
            | Self::Truth { stamp, .. } => Some(stamp),
            _ => None,
        }
    }
}

/// Sample time and log time of a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Host time of arrival; the message's `log_time`.
    pub host: HostTime,
    /// Time of the sample on the vehicle's clock, if known.
    pub vehicle: Option<VehicleTime>,
    /// Time of the sample mapped to the host clock; the message's `publish_time`.
    pub sampled: HostTime,
}

impl Stamp {
    /// A stamp without a vehicle time.
    pub fn host(host: HostTime) -> Self {
        Self { host, vehicle: None, sampled: host }
    }

    /// A stamp of a sample taken at `vehicle` on the vehicle's clock and `sampled` on the host
    /// clock.
    pub fn new(host: HostTime, vehicle: VehicleTime, sampled: HostTime) -> Self {
        Self { host, vehicle: Some(vehicle), sampled }
    }

    /// Vehicle time in microseconds; 0 if unknown.
    pub fn vehicle_time_us(&self) -> u64 {
        self.vehicle.map_or(0, |t| t.as_us())
    }
}

/// One control tick: state, reference, feedback and setpoint.
#[derive(Clone, Copy, Debug)]
pub struct Tick {
    /// Times of the tick and of the state's sample.
    pub stamp: Stamp,
    /// The state that the tick used.
    pub state: State,
    /// The point on the reference, if the tick tracks one.
    pub reference: Option<Reference>,
    /// Desired position, m; replaces the reference's position in the error.
    pub desired: Option<Ned>,
    /// Radius of the tube around the reference, m; `None` without a tube.
    pub tube_radius_m: Option<f64>,
    /// The feedback's part of `u_hat`, which adds to the reference's feed-forward.
    pub feedback: Setpoint,
    /// The setpoint sent, after limits; `None` if the tick sent none.
    pub setpoint: Option<Setpoint>,
    /// Components of the setpoint that a limit clipped, one bit each in the order thrust, roll,
    /// pitch, yaw, roll rate, pitch rate, yaw rate. Bit 7: the position error was clipped.
    pub saturation: u32,
    /// Name of the flight state.
    pub phase: &'static str,
    /// Time along the trajectory in s; `None` while no trajectory is flown.
    pub trajectory_time: Option<f64>,
    /// Age of the state's sample when the tick ran, s.
    pub sample_age: f64,
}

/// Counters of the link. Rates cover the last reporting period; counts start at the link's start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkStats {
    /// Frames received, 1/s.
    pub rx_frames_hz: f64,
    /// Bytes received, 1/s.
    pub rx_bytes_per_s: f64,
    /// Frames sent, 1/s.
    pub tx_frames_hz: f64,
    /// Bytes sent, 1/s.
    pub tx_bytes_per_s: f64,
    /// Attitude messages (the source in use), 1/s.
    pub attitude_hz: f64,
    /// Position messages, 1/s.
    pub position_hz: f64,
    /// ODOMETRY, 1/s.
    pub odometry_hz: f64,
    /// Frames with a wrong checksum.
    pub crc_errors: u64,
    /// Gaps in the vehicle's sequence numbers, less frames that arrived late.
    pub lost_frames: u64,
    /// Frames with a message id that the dialect lacks.
    pub unknown_frames: u64,
    /// Bytes outside frames.
    pub unframed_bytes: u64,
    /// Frames of other systems and components.
    pub foreign_frames: u64,
    /// Frames with the vehicle's ids from a different peer.
    pub stray_frames: u64,
    /// Frames of the vehicle with impossible content.
    pub refused_frames: u64,
    /// Frames to the vehicle, or broadcast, that the transport dropped.
    pub dropped_frames: u64,
    /// Number of times the link was reopened.
    pub reconnects: u64,
    /// Latest round trip of TIMESYNC, s; NaN before the first.
    pub rtt_s: f64,
    /// Vehicle clock minus host clock, s; NaN before it is known.
    pub clock_offset_s: f64,
}

/// One exchange of TIMESYNC.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimesyncSample {
    /// Round trip, s.
    pub rtt_s: f64,
    /// Vehicle clock minus host clock from this exchange alone, s.
    pub measured_offset_s: f64,
    /// The estimate after this exchange, s.
    pub offset_s: f64,
    /// Whether the exchange was used.
    pub accepted: bool,
}

/// MAVLink's MAV_SEVERITY.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
#[allow(missing_docs)]
pub enum Severity {
    Emergency = 0,
    Alert = 1,
    Critical = 2,
    Error = 3,
    Warning = 4,
    Notice = 5,
    Info = 6,
    Debug = 7,
}

impl From<u8> for Severity {
    /// Converts the severity of a STATUSTEXT; unknown numbers become [`Severity::Debug`].
    fn from(severity: u8) -> Self {
        use Severity::*;
        [Emergency, Alert, Critical, Error, Warning, Notice, Info]
            .get(usize::from(severity))
            .copied()
            .unwrap_or(Debug)
    }
}

/// Origin of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The vehicle, in a STATUSTEXT.
    Vehicle,
    /// This program.
    Daemon,
}

impl Source {
    /// The name in the log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Daemon => "downwash",
        }
    }
}

/// The simulator's ground truth, which no sensor reports.
#[derive(Clone, Copy, Debug, Default)]
pub struct Truth {
    /// True state.
    pub state: State,
    /// Acceleration of the centre of mass in world axes, m/s^2.
    pub acceleration: Ned,
    /// Angular acceleration in body axes, rad/s^2.
    pub angular_acceleration: Frd,
    /// Thrust of each rotor, N.
    pub rotor_thrust: [f64; 4],
}

/// Direction of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the vehicle.
    Rx,
    /// To the vehicle.
    Tx,
}

/// Longest frame that a [`FrameRecord`] holds: signed MAVLink 2 with a 32-bit system id.
const FRAME_LEN_MAX: usize = 283;

/// A MAVLink frame with its header's fields, stored inline.
#[derive(Clone, Copy, Debug)]
pub struct FrameRecord {
    /// Direction of the frame.
    pub direction: Direction,
    /// Host time of reception or sending.
    pub host: HostTime,
    /// MAVLink message id.
    pub message_id: u32,
    /// Sender's system id.
    pub system: u32,
    /// Sender's component id.
    pub component: u8,
    /// Sender's sequence number.
    pub sequence: u8,
    len: u16,
    bytes: [u8; FRAME_LEN_MAX],
}

impl FrameRecord {
    /// Records a frame from the decoder.
    pub fn new(direction: Direction, host: HostTime, frame: &Frame) -> Self {
        let mut record = Self {
            direction,
            host,
            message_id: frame.id(),
            system: frame.system(),
            component: frame.component(),
            sequence: frame.sequence(),
            len: 0,
            bytes: [0; FRAME_LEN_MAX],
        };
        record.set_bytes(frame.bytes());
        record
    }

    /// Records a frame that this program encoded, with an 8-bit system id.
    ///
    /// Returns `None` if `bytes` is not one whole MAVLink frame according to its marker and length.
    pub fn from_bytes(direction: Direction, host: HostTime, bytes: &[u8]) -> Option<Self> {
        let (message_id, header, len) = match *bytes {
            [0xFD, payload, incompat, _, sequence, system, component, a, b, c, ..] => {
                let signature = if incompat & 1 != 0 { 13 } else { 0 };
                let id = u32::from_le_bytes([a, b, c, 0]);
                (id, (sequence, system, component), 12 + usize::from(payload) + signature)
            }
            [0xFE, payload, sequence, system, component, id, ..] => {
                (id.into(), (sequence, system, component), 8 + usize::from(payload))
            }
            _ => return None,
        };
        if bytes.len() != len {
            return None;
        }
        let (sequence, system, component) = header;
        let mut record = Self {
            direction,
            host,
            message_id,
            system: system.into(),
            component,
            sequence,
            len: 0,
            bytes: [0; FRAME_LEN_MAX],
        };
        record.set_bytes(bytes);
        Some(record)
    }

    /// The whole frame, as sent or received.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..usize::from(self.len)]
    }

    fn set_bytes(&mut self, bytes: &[u8]) {
        let len = bytes.len().min(FRAME_LEN_MAX);
        self.bytes[..len].copy_from_slice(&bytes[..len]);
        self.len = len as u16;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_header_is_parsed_from_bytes() {
        let mut bytes = vec![0xFD, 2, 0, 0, 7, 1, 191, 0x52, 0, 0, 0xAA, 0xBB, 0, 0];
        let frame = FrameRecord::from_bytes(Direction::Tx, HostTime::default(), &bytes).unwrap();
        assert_eq!((frame.message_id, frame.system, frame.component), (82, 1, 191));
        assert_eq!(frame.bytes(), bytes);
        bytes.pop();
        assert!(FrameRecord::from_bytes(Direction::Tx, HostTime::default(), &bytes).is_none());
        assert!(FrameRecord::from_bytes(Direction::Tx, HostTime::default(), &[]).is_none());
    }

    #[test]
    fn unknown_severity_becomes_debug() {
        assert_eq!(Severity::from(4), Severity::Warning);
        assert_eq!(Severity::from(200), Severity::Debug);
    }
}
