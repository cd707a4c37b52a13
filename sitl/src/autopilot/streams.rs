//! Streams: which messages are sent unsolicited, at which rates, and when the next is due.

/// A message that can be streamed or requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "each is the MAVLink message of that name")]
pub enum Stream {
    Heartbeat,
    AttitudeQuaternion,
    Attitude,
    HighresImu,
    LocalPositionNed,
    Odometry,
    ActuatorOutputStatus,
    AttitudeTarget,
    ServoOutputRaw,
    EscStatus,
    Timesync,
    GlobalPositionInt,
    VfrHud,
    Altitude,
    SysStatus,
    ExtendedSysState,
    GpsRawInt,
    SystemTime,
    BatteryStatus,
    CurrentMode,
    HomePosition,
    GpsGlobalOrigin,
    AutopilotVersion,
    ProtocolVersion,
    AvailableModes,
}

/// Interval or due time that means never.
const NEVER: u64 = u64::MAX;

const fn hz(rate: f64) -> u64 {
    if rate > 0.0 { (1e6 / rate) as u64 } else { NEVER }
}

/// Every stream and its message id. Messages with the same time stamp are sent in this order.
const TABLE: &[(Stream, u32)] = &[
    (Stream::Heartbeat, 0),
    (Stream::AttitudeQuaternion, 31),
    (Stream::Attitude, 30),
    (Stream::HighresImu, 105),
    (Stream::LocalPositionNed, 32),
    (Stream::Odometry, 331),
    (Stream::ActuatorOutputStatus, 375),
    (Stream::AttitudeTarget, 83),
    (Stream::ServoOutputRaw, 36),
    (Stream::EscStatus, 291),
    (Stream::Timesync, 111),
    (Stream::GlobalPositionInt, 33),
    (Stream::VfrHud, 74),
    (Stream::Altitude, 141),
    (Stream::SysStatus, 1),
    (Stream::ExtendedSysState, 245),
    (Stream::GpsRawInt, 24),
    (Stream::SystemTime, 2),
    (Stream::BatteryStatus, 147),
    (Stream::CurrentMode, 436),
    (Stream::HomePosition, 242),
    (Stream::GpsGlobalOrigin, 49),
    (Stream::AutopilotVersion, 148),
    (Stream::ProtocolVersion, 300),
    (Stream::AvailableModes, 435),
];

/// An autopilot's rules for its streams.
#[derive(Debug)]
pub struct StreamRules {
    /// Default rates in Hz.
    defaults: &'static [(Stream, f64)],
    /// Streams that the autopilot lacks; requests are refused.
    absent: &'static [Stream],
    /// Streams that are never sent, although requests are accepted.
    silent: &'static [Stream],
    /// The granted interval in us for a requested one; `None` refuses the request.
    granted: fn(Stream, u64) -> Option<u64>,
}

/// Default rates of PX4's onboard link, measured where possible.
const PX4_DEFAULTS: &[(Stream, f64)] = &[
    (Stream::Heartbeat, 1.0),
    (Stream::AttitudeQuaternion, 50.0),
    (Stream::Attitude, 100.0),
    (Stream::HighresImu, 50.0),
    (Stream::LocalPositionNed, 30.0),
    (Stream::Odometry, 30.0),
    (Stream::AttitudeTarget, 10.0),
    (Stream::ServoOutputRaw, 10.0),
    (Stream::Timesync, 10.0),
    (Stream::GlobalPositionInt, 10.0),
    (Stream::VfrHud, 10.0),
    (Stream::Altitude, 10.0),
    (Stream::SysStatus, 5.0),
    (Stream::ExtendedSysState, 5.0),
    (Stream::GpsRawInt, 5.0),
    (Stream::SystemTime, 1.0),
    (Stream::BatteryStatus, 0.5),
    (Stream::CurrentMode, 0.5),
    (Stream::HomePosition, 0.5),
];

/// The bundled vehicle: every stream at any rate up to 250 Hz, the rate of the estimate.
pub static BUNDLED: StreamRules = StreamRules {
    defaults: PX4_DEFAULTS,
    absent: &[],
    silent: &[],
    granted: |_, interval| Some(interval.max(4_000)),
};

/// PX4: above 100 Hz, intervals are multiples of the 250 Hz loop's period. The estimate is
/// published at 125 Hz at most, the mode at 2 Hz.
pub static PX4: StreamRules = StreamRules {
    defaults: PX4_DEFAULTS,
    absent: &[],
    silent: &[Stream::EscStatus],
    granted: |stream, interval| {
        let shortest = match stream {
            Stream::CurrentMode => 500_000,
            Stream::Odometry | Stream::LocalPositionNed => 8_000,
            _ => 4_000,
        };
        let rounded = if interval < 10_000 { interval.div_ceil(4_000) * 4_000 } else { interval };
        Some(rounded.clamp(shortest, NEVER))
    },
};

/// ArduCopter: only HEARTBEAT and a rare TIMESYNC by default. Intervals are whole milliseconds, and
/// rates are at most 0.8 of the 400 Hz loop rate.
pub static ARDUCOPTER: StreamRules = StreamRules {
    defaults: &[(Stream::Heartbeat, 1.0), (Stream::Timesync, 0.12)],
    absent: &[
        Stream::Odometry,
        Stream::ActuatorOutputStatus,
        Stream::EscStatus,
        Stream::Timesync,
        Stream::CurrentMode,
        Stream::Altitude,
    ],
    silent: &[],
    granted: |_, interval| {
        let rounded = interval / 1_000 * 1_000;
        (rounded >= 3_000).then_some(rounded)
    },
};

impl StreamRules {
    fn default_interval(&self, stream: Stream) -> u64 {
        let default = self.defaults.iter().find(|(known, _)| *known == stream);
        default.map_or(NEVER, |(_, rate)| hz(*rate))
    }

    /// Whether the autopilot has this stream.
    pub fn has(&self, stream: Stream) -> bool {
        !self.absent.contains(&stream)
    }
}

impl Stream {
    /// The stream with this message id.
    pub fn from_id(id: u32) -> Option<Self> {
        TABLE.iter().find(|(_, known)| *known == id).map(|(stream, _)| *stream)
    }

    /// The stream's message id.
    pub fn id(self) -> u32 {
        TABLE[self as usize].1
    }
}

/// Why an interval cannot be changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IntervalError {
    /// The interval of HEARTBEAT is fixed.
    #[error("the interval of HEARTBEAT cannot be changed")]
    Fixed,
    /// The message is not a stream of this autopilot.
    #[error("not a stream of this vehicle")]
    Unknown,
    /// The interval is shorter than the autopilot allows.
    #[error("too often for this vehicle")]
    TooOften,
}

/// The streams of one peer.
///
/// A message is due at integer multiples of its interval since boot, so streams whose intervals
/// divide one another share their time stamps.
#[derive(Clone, Debug)]
pub struct Schedule {
    rules: &'static StreamRules,
    intervals: [u64; TABLE.len()],
    due: [u64; TABLE.len()],
    next: u64,
}

impl Schedule {
    /// Creates a schedule with the default rates of `rules`, starting after `now_us`.
    pub fn new(rules: &'static StreamRules, now_us: u64) -> Self {
        let mut schedule =
            Self { rules, intervals: [NEVER; TABLE.len()], due: [NEVER; TABLE.len()], next: NEVER };
        for (stream, _) in TABLE {
            schedule.start(*stream, rules.default_interval(*stream), now_us);
        }
        // The first heartbeat is due at once and announces the vehicle.
        schedule.due[Stream::Heartbeat as usize] = now_us;
        schedule.next = now_us;
        schedule
    }

    fn start(&mut self, stream: Stream, interval: u64, now_us: u64) {
        self.intervals[stream as usize] = interval;
        self.due[stream as usize] = following(interval, now_us);
        self.next = self.due.iter().copied().min().unwrap_or(NEVER);
    }

    /// Sets the interval of message `id`, in the encoding of MAV_CMD_SET_MESSAGE_INTERVAL:
    /// microseconds, 0 for the default, negative for never. The rules may grant a different
    /// interval.
    ///
    /// # Errors
    /// [`IntervalError`] if the interval cannot be changed.
    pub fn set_interval(&mut self, id: u32, us: f32, now_us: u64) -> Result<(), IntervalError> {
        let stream = Stream::from_id(id).filter(|stream| self.rules.has(*stream));
        let stream = stream.ok_or(IntervalError::Unknown)?;
        if stream == Stream::Heartbeat {
            return Err(IntervalError::Fixed);
        }
        let interval = if us == 0.0 || us.is_nan() {
            self.rules.default_interval(stream)
        } else if us < 0.0 || self.rules.silent.contains(&stream) {
            NEVER
        } else {
            let requested_us = f64::from(us).round() as u64;
            (self.rules.granted)(stream, requested_us).ok_or(IntervalError::TooOften)?
        };
        self.start(stream, interval, now_us);
        Ok(())
    }

    /// The interval of message `id`, in the encoding of MESSAGE_INTERVAL: microseconds, -1 for not
    /// streamed, 0 for not a stream.
    pub fn interval(&self, id: u32) -> i32 {
        Stream::from_id(id).map_or(0, |stream| match self.intervals[stream as usize] {
            NEVER => -1,
            interval => i32::try_from(interval).unwrap_or(i32::MAX),
        })
    }

    /// Time at which the next message is due, us.
    pub fn next_us(&self) -> u64 {
        self.next
    }

    /// Calls `send` once for each stream that is due at `now_us`, however late it is.
    pub fn take_due(&mut self, now_us: u64, mut send: impl FnMut(Stream)) {
        if now_us < self.next {
            return;
        }
        self.next = NEVER;
        for (stream, _) in TABLE {
            let index = *stream as usize;
            if self.due[index] <= now_us {
                send(*stream);
                self.due[index] = following(self.intervals[index], now_us);
            }
            self.next = self.next.min(self.due[index]);
        }
    }
}

/// The first integer multiple of `interval` after `now_us`.
fn following(interval: u64, now_us: u64) -> u64 {
    if interval == NEVER { NEVER } else { (now_us / interval + 1) * interval }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn count(schedule: &mut Schedule, stream: Stream, from_us: u64, seconds: u64) -> usize {
        let mut count = 0;
        for now in (from_us..from_us + seconds * 1_000_000).step_by(1000) {
            schedule.take_due(now, |due| count += usize::from(due == stream));
        }
        count
    }

    #[test]
    fn stream_discriminants_index_the_table() {
        for (index, (stream, id)) in TABLE.iter().enumerate() {
            assert_eq!(*stream as usize, index);
            assert_eq!(Stream::from_id(*id), Some(*stream));
        }
    }

    #[test]
    fn default_intervals_match_px4() {
        for (stream, expected) in [
            (Stream::Heartbeat, 10),
            (Stream::Attitude, 1000),
            (Stream::AttitudeQuaternion, 500),
            (Stream::LocalPositionNed, 300),
            (Stream::Odometry, 300),
            (Stream::BatteryStatus, 5),
            (Stream::ActuatorOutputStatus, 0),
        ] {
            let sent = count(&mut Schedule::new(&BUNDLED, 0), stream, 0, 10);
            assert!(sent.abs_diff(expected) <= 1, "{stream:?}: {sent}, expected {expected}");
        }
    }

    #[test]
    fn heartbeat_and_unknown_intervals_cannot_be_set() {
        let mut schedule = Schedule::new(&BUNDLED, 0);
        assert_eq!(schedule.set_interval(0, 1000.0, 0), Err(IntervalError::Fixed));
        assert_eq!(schedule.set_interval(9999, 1000.0, 0), Err(IntervalError::Unknown));
        assert_eq!(schedule.interval(0), 1_000_000);
        assert_eq!(schedule.interval(9999), 0);
        assert_eq!(schedule.interval(375), -1);
    }

    #[test]
    fn zero_interval_restores_default_and_negative_stops() {
        let mut schedule = Schedule::new(&BUNDLED, 0);
        schedule.set_interval(30, -1.0, 0).unwrap();
        assert_eq!(schedule.interval(30), -1);
        schedule.set_interval(30, 0.0, 0).unwrap();
        assert_eq!(schedule.interval(30), 10_000);
        schedule.set_interval(30, 100.0, 0).unwrap();
        assert_eq!(schedule.interval(30), 4_000, "capped at 250 Hz");
    }

    proptest! {
        #[test]
        fn requested_rate_is_met(interval in 4_000u32..1_000_000, start in 0u64..5_000_000) {
            let mut schedule = Schedule::new(&BUNDLED, 0);
            schedule.set_interval(331, interval as f32, start).unwrap();
            let sent = count(&mut schedule, Stream::Odometry, start, 20);
            let expected = 20_000_000 / interval as usize;
            prop_assert!(sent.abs_diff(expected) <= 1);
        }
    }
}
