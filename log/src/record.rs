//! What may be logged. The log knows states and setpoints, never who computed them.

use std::collections::BTreeMap;

use vehicle::frame::{Frd, Ned};
use wire::framing::Frame;

use message::clock::{HostTime, VehicleTime};
use message::setpoint::{Reference, Setpoint, State};

/// One thing to log.
///
/// The largest variants are about half a kilobyte and are stored inline, so that handing a record
/// to the writer's thread allocates nothing.
#[derive(Clone, Debug)]
#[allow(clippy::large_enum_variant)]
pub enum Record {
    /// A MAVLink frame as it was on the wire.
    Frame(FrameRecord),
    /// One control tick.
    Tick(Tick),
    /// Accelerometer and gyro.
    Imu {
        /// When.
        stamp: Stamp,
        /// Specific force, m/s^2; (0, 0, -g) at hover.
        specific_force: Frd,
        /// Body rate, rad/s.
        body_rate: Frd,
    },
    /// Motor outputs in the vehicle's own unit.
    Motors {
        /// When.
        stamp: Stamp,
        /// Outputs 1 to 4.
        outputs: [f32; 4],
    },
    /// The battery, each value where known.
    Battery {
        /// When.
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
        /// When they were read.
        host: HostTime,
        /// The counters.
        stats: LinkStats,
    },
    /// One exchange of TIMESYNC.
    Timesync {
        /// When the answer came.
        host: HostTime,
        /// What it said.
        sample: TimesyncSample,
    },
    /// A line for people: STATUSTEXT, or the daemon's own.
    Event {
        /// When.
        host: HostTime,
        /// How grave.
        severity: Severity,
        /// Who says so.
        source: Source,
        /// The line.
        text: String,
    },
    /// The simulator's true state.
    Truth {
        /// When.
        stamp: Stamp,
        /// The truth.
        truth: Truth,
    },
    /// Facts about the run that were learned after the log was opened, such as the firmware's
    /// version. They add to the metadata record `run`.
    Facts(Box<BTreeMap<String, String>>),
    /// A flight begins, at this time: a sink that keeps one log a flight opens one.
    FlightBegins(HostTime),
    /// The flight is over.
    FlightEnds,
}

/// Keys of [`Record::Facts`] that are the vehicle's parameters begin so; their names follow.
pub const PARAMETER_FACT: &str = "parameter.";

impl Record {
    /// The stamp of a record that is a sample of the vehicle's.
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

/// When a sample was taken and when it was logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stamp {
    /// Host time of arrival; the message's `log_time`.
    pub host: HostTime,
    /// The vehicle's own time of the sample, where it has one.
    pub vehicle: Option<VehicleTime>,
    /// The vehicle's time mapped to the host clock; the message's `publish_time`.
    pub sampled: HostTime,
}

impl Stamp {
    /// A stamp of something that the vehicle did not stamp.
    pub fn host(host: HostTime) -> Self {
        Self { host, vehicle: None, sampled: host }
    }

    /// A stamp of a sample taken at `vehicle`, which is `sampled` on the host clock.
    pub fn new(host: HostTime, vehicle: VehicleTime, sampled: HostTime) -> Self {
        Self { host, vehicle: Some(vehicle), sampled }
    }

    /// Microseconds of the vehicle's clock, 0 where the vehicle did not stamp the sample.
    pub fn vehicle_time_us(&self) -> u64 {
        self.vehicle.map_or(0, |t| t.as_us())
    }
}

/// One control tick: what was known, wanted and sent.
#[derive(Clone, Copy, Debug)]
pub struct Tick {
    /// Time of the tick, and of the state's sample.
    pub stamp: Stamp,
    /// The state that the tick used.
    pub state: State,
    /// The point of the reference, if there is one to follow.
    pub reference: Option<Reference>,
    /// Where the vehicle is wanted, if that is known.
    pub desired: Option<Ned>,
    /// The feedback's share of `u_hat`: what it adds to the reference's feed-forward.
    pub feedback: Setpoint,
    /// What was sent, after limits; `None` if the tick sent nothing.
    pub setpoint: Option<Setpoint>,
    /// Which components of the setpoint a limit cut, one bit each in the order thrust, roll,
    /// pitch, yaw, roll rate, pitch rate, yaw rate; bit 7 says that the position error was cut.
    pub saturation: u32,
    /// Name of the flight state.
    pub phase: &'static str,
    /// Time along the trajectory in s; `None` while none is being flown.
    pub trajectory_time: Option<f64>,
    /// Age of the state's sample when the tick ran, s.
    pub sample_age: f64,
}

/// Counters of the link; rates are over the last reporting period, counts since the start.
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
    /// Frames whose checksum was wrong.
    pub crc_errors: u64,
    /// Frames missing from the vehicle's sequence numbers, less those that came late.
    pub lost_frames: u64,
    /// Frames of a message that the dialect does not have.
    pub unknown_frames: u64,
    /// Bytes that belonged to no frame.
    pub unframed_bytes: u64,
    /// Frames of other systems and components.
    pub foreign_frames: u64,
    /// Frames with the vehicle's ids that came another way than the vehicle's.
    pub stray_frames: u64,
    /// Frames of the vehicle whose content could not be true.
    pub refused_frames: u64,
    /// Frames to the vehicle, or to all, that the transport did not take.
    pub dropped_frames: u64,
    /// Times the link was opened again.
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
    /// Vehicle clock minus host clock by this exchange alone, s.
    pub measured_offset_s: f64,
    /// The estimate after this exchange, s.
    pub offset_s: f64,
    /// Whether the exchange was used.
    pub accepted: bool,
}

/// MAV_SEVERITY.
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
    /// The severity of a STATUSTEXT; numbers beyond the enumeration are [`Severity::Debug`].
    fn from(severity: u8) -> Self {
        use Severity::*;
        [Emergency, Alert, Critical, Error, Warning, Notice, Info]
            .get(usize::from(severity))
            .copied()
            .unwrap_or(Debug)
    }
}

/// Who wrote an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The vehicle, by STATUSTEXT.
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

/// What the simulator knows and no sensor says.
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

/// Which way a frame went.
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
    /// Which way it went.
    pub direction: Direction,
    /// When it came or went.
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
    /// A frame that the decoder found.
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

    /// A frame as this program encoded it, with an 8-bit system id.
    ///
    /// Returns `None` if `bytes` is not one whole MAVLink frame by its marker and length.
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

    /// The whole frame.
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
    fn frame_header_is_read_from_the_bytes() {
        let mut bytes = vec![0xFD, 2, 0, 0, 7, 1, 191, 0x52, 0, 0, 0xAA, 0xBB, 0, 0];
        let frame = FrameRecord::from_bytes(Direction::Tx, HostTime::default(), &bytes).unwrap();
        assert_eq!((frame.message_id, frame.system, frame.component), (82, 1, 191));
        assert_eq!(frame.bytes(), bytes);
        bytes.pop();
        assert!(FrameRecord::from_bytes(Direction::Tx, HostTime::default(), &bytes).is_none());
        assert!(FrameRecord::from_bytes(Direction::Tx, HostTime::default(), &[]).is_none());
    }

    #[test]
    fn severity_beyond_the_enumeration_is_debug() {
        assert_eq!(Severity::from(4), Severity::Warning);
        assert_eq!(Severity::from(200), Severity::Debug);
    }
}
