//! What is sent unasked, how often, and when the next one is due.

/// A message that can be streamed or asked for.
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

/// Shortest interval, us: 250 Hz, the rate of the estimate.
pub const INTERVAL_MIN_US: u64 = 4_000;

/// Never, as an interval or a due time.
const NEVER: u64 = u64::MAX;

const fn hz(rate: f64) -> u64 {
    if rate > 0.0 { (1e6 / rate) as u64 } else { NEVER }
}

/// Stream, message id and default interval: PX4's onboard link, as measured where it was measured.
/// Messages that share a stamp are sent in this order.
const TABLE: &[(Stream, u32, u64)] = &[
    (Stream::Heartbeat, 0, hz(1.0)),
    (Stream::AttitudeQuaternion, 31, hz(50.0)),
    (Stream::Attitude, 30, hz(100.0)),
    (Stream::HighresImu, 105, hz(50.0)),
    (Stream::LocalPositionNed, 32, hz(30.0)),
    (Stream::Odometry, 331, hz(30.0)),
    (Stream::ActuatorOutputStatus, 375, hz(0.0)),
    (Stream::AttitudeTarget, 83, hz(10.0)),
    (Stream::ServoOutputRaw, 36, hz(10.0)),
    (Stream::EscStatus, 291, hz(0.0)),
    (Stream::Timesync, 111, hz(10.0)),
    (Stream::GlobalPositionInt, 33, hz(10.0)),
    (Stream::VfrHud, 74, hz(10.0)),
    (Stream::Altitude, 141, hz(10.0)),
    (Stream::SysStatus, 1, hz(5.0)),
    (Stream::ExtendedSysState, 245, hz(5.0)),
    (Stream::GpsRawInt, 24, hz(5.0)),
    (Stream::SystemTime, 2, hz(1.0)),
    (Stream::BatteryStatus, 147, hz(0.5)),
    (Stream::CurrentMode, 436, hz(0.5)),
    (Stream::HomePosition, 242, hz(0.5)),
    (Stream::GpsGlobalOrigin, 49, hz(0.0)),
    (Stream::AutopilotVersion, 148, hz(0.0)),
    (Stream::ProtocolVersion, 300, hz(0.0)),
    (Stream::AvailableModes, 435, hz(0.0)),
];

impl Stream {
    /// The stream of a message id.
    pub fn from_id(id: u32) -> Option<Self> {
        TABLE.iter().find(|(_, known, _)| *known == id).map(|(stream, _, _)| *stream)
    }

    /// The message id.
    pub fn id(self) -> u32 {
        TABLE[self as usize].1
    }
}

/// Why an interval was not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IntervalError {
    /// Its interval is fixed.
    #[error("the interval of HEARTBEAT cannot be changed")]
    Fixed,
    /// No such stream.
    #[error("not a stream of this vehicle")]
    Unknown,
}

/// One peer's streams.
///
/// A message is due at whole multiples of its interval since boot, so that streams whose intervals
/// divide one another share their stamps.
#[derive(Clone, Debug)]
pub struct Schedule {
    intervals: [u64; TABLE.len()],
    due: [u64; TABLE.len()],
    next: u64,
}

impl Schedule {
    /// The default rates, beginning after `now_us`.
    pub fn new(now_us: u64) -> Self {
        let mut schedule =
            Self { intervals: [NEVER; TABLE.len()], due: [NEVER; TABLE.len()], next: NEVER };
        for (stream, _, interval) in TABLE {
            schedule.start(*stream, *interval, now_us);
        }
        // The first heartbeat introduces the vehicle.
        schedule.due[Stream::Heartbeat as usize] = now_us;
        schedule.next = now_us;
        schedule
    }

    fn start(&mut self, stream: Stream, interval: u64, now_us: u64) {
        self.intervals[stream as usize] = interval;
        self.due[stream as usize] = following(interval, now_us);
        self.next = self.due.iter().copied().min().unwrap_or(NEVER);
    }

    /// Sets the interval of message `id` as MAV_CMD_SET_MESSAGE_INTERVAL says it: microseconds, 0
    /// for the default, negative for never. Intervals below 4 ms become 4 ms.
    ///
    /// # Errors
    /// [`IntervalError`].
    pub fn set_interval(&mut self, id: u32, us: f32, now_us: u64) -> Result<(), IntervalError> {
        let stream = Stream::from_id(id).ok_or(IntervalError::Unknown)?;
        if stream == Stream::Heartbeat {
            return Err(IntervalError::Fixed);
        }
        let interval = if us == 0.0 || us.is_nan() {
            TABLE[stream as usize].2
        } else if us < 0.0 {
            NEVER
        } else {
            (f64::from(us).round() as u64).max(INTERVAL_MIN_US)
        };
        self.start(stream, interval, now_us);
        Ok(())
    }

    /// The interval of message `id` as MESSAGE_INTERVAL says it: microseconds, -1 for never sent
    /// unasked, 0 for not a stream.
    pub fn interval(&self, id: u32) -> i32 {
        Stream::from_id(id).map_or(0, |stream| match self.intervals[stream as usize] {
            NEVER => -1,
            interval => i32::try_from(interval).unwrap_or(i32::MAX),
        })
    }

    /// When the next message is due, us.
    pub fn next_us(&self) -> u64 {
        self.next
    }

    /// Calls `send` for each stream that is due at `now_us`, once however late it is.
    pub fn take_due(&mut self, now_us: u64, mut send: impl FnMut(Stream)) {
        if now_us < self.next {
            return;
        }
        self.next = NEVER;
        for (stream, _, _) in TABLE {
            let index = *stream as usize;
            if self.due[index] <= now_us {
                send(*stream);
                self.due[index] = following(self.intervals[index], now_us);
            }
            self.next = self.next.min(self.due[index]);
        }
    }
}

/// The first whole multiple of `interval` after `now_us`.
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
    fn streams_index_the_table() {
        for (index, (stream, id, _)) in TABLE.iter().enumerate() {
            assert_eq!(*stream as usize, index);
            assert_eq!(Stream::from_id(*id), Some(*stream));
        }
    }

    #[test]
    fn defaults_are_px4s() {
        for (stream, expected) in [
            (Stream::Heartbeat, 10),
            (Stream::Attitude, 1000),
            (Stream::AttitudeQuaternion, 500),
            (Stream::LocalPositionNed, 300),
            (Stream::Odometry, 300),
            (Stream::BatteryStatus, 5),
            (Stream::ActuatorOutputStatus, 0),
        ] {
            let sent = count(&mut Schedule::new(0), stream, 0, 10);
            assert!(sent.abs_diff(expected) <= 1, "{stream:?}: {sent}, expected {expected}");
        }
    }

    #[test]
    fn heartbeat_and_unknown_ids_keep_their_interval() {
        let mut schedule = Schedule::new(0);
        assert_eq!(schedule.set_interval(0, 1000.0, 0), Err(IntervalError::Fixed));
        assert_eq!(schedule.set_interval(9999, 1000.0, 0), Err(IntervalError::Unknown));
        assert_eq!(schedule.interval(0), 1_000_000);
        assert_eq!(schedule.interval(9999), 0);
        assert_eq!(schedule.interval(375), -1);
    }

    #[test]
    fn zero_restores_the_default_and_negative_stops() {
        let mut schedule = Schedule::new(0);
        schedule.set_interval(30, -1.0, 0).unwrap();
        assert_eq!(schedule.interval(30), -1);
        schedule.set_interval(30, 0.0, 0).unwrap();
        assert_eq!(schedule.interval(30), 10_000);
        schedule.set_interval(30, 100.0, 0).unwrap();
        assert_eq!(schedule.interval(30), 4_000, "not above 250 Hz");
    }

    proptest! {
        #[test]
        fn a_requested_rate_is_met(interval in 4_000u32..1_000_000, start in 0u64..5_000_000) {
            let mut schedule = Schedule::new(0);
            schedule.set_interval(331, interval as f32, start).unwrap();
            let sent = count(&mut schedule, Stream::Odometry, start, 20);
            let expected = 20_000_000 / interval as usize;
            prop_assert!(sent.abs_diff(expected) <= 1);
        }
    }
}
