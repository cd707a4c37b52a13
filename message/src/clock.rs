//! Times on the two clocks, the host's and the vehicle's.

use std::ops::{Add, Sub};
use std::time::Duration;

/// Time on the host: nanoseconds since the Unix epoch. In flight it comes from the monotonic clock
/// with an offset fixed at start, so it never steps. In simulation it is the virtual clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HostTime {
    ns: u64,
}

impl HostTime {
    /// Creates a time from nanoseconds since the Unix epoch.
    pub const fn from_ns(ns: u64) -> Self {
        Self { ns }
    }

    /// Nanoseconds since the Unix epoch.
    pub const fn as_ns(self) -> u64 {
        self.ns
    }

    /// Time elapsed since `earlier`; zero if `earlier` is later.
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.ns.saturating_sub(earlier.ns))
    }
}

impl Add<Duration> for HostTime {
    type Output = Self;
    fn add(self, duration: Duration) -> Self {
        Self { ns: self.ns.saturating_add(duration.as_nanos() as u64) }
    }
}

impl Sub<Duration> for HostTime {
    type Output = Self;
    fn sub(self, duration: Duration) -> Self {
        Self { ns: self.ns.saturating_sub(duration.as_nanos() as u64) }
    }
}

/// Time on the vehicle: microseconds since its boot, as in `time_usec` and 1000 * `time_boot_ms`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VehicleTime {
    us: u64,
}

impl VehicleTime {
    /// Creates a time from microseconds since boot.
    pub const fn from_us(us: u64) -> Self {
        Self { us }
    }

    /// Creates a time from milliseconds since boot.
    pub const fn from_ms(ms: u32) -> Self {
        Self { us: ms as u64 * 1000 }
    }

    /// Microseconds since boot.
    pub const fn as_us(self) -> u64 {
        self.us
    }

    /// Seconds from `earlier` to this time; negative if `earlier` is later.
    pub fn seconds_since(self, earlier: Self) -> f64 {
        (self.us as f64 - earlier.us as f64) * 1e-6
    }
}
