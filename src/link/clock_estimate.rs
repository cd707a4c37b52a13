//! The estimate of the vehicle's clock: a line over the host's clock, and its error.

use crate::clock::{HostTime, VehicleTime};

/// Largest skew that is followed, vehicle seconds per host second less one. Simulators that run
/// late have several per cent; crystals have 0.01 %.
pub(super) const SKEW_MAX: f64 = 0.06;
/// Tolerated contradiction between two bounds on an offset, ns: stamps in whole milliseconds, and
/// the time from the stamp to the wire.
pub(super) const TOLERANCE_NS: f64 = 20e6;

/// The vehicle's clock as a line over the host's clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockEstimate {
    /// Vehicle time minus host time at `at`, ns.
    pub offset_ns: i64,
    /// Host time at which the line is anchored.
    pub at: HostTime,
    /// Vehicle seconds per host second, less one.
    pub skew: f64,
    /// Half the width of the interval that contains the true offset, ns; unknown for
    /// [`ClockSource::Arrival`].
    pub error_ns: Option<u64>,
    /// The source of the estimate.
    pub source: ClockSource,
}

/// The source of a [`ClockEstimate`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockSource {
    /// Answers to TIMESYNC.
    Timesync,
    /// The minimum delay of stamped messages.
    Arrival,
}

impl ClockEstimate {
    /// Host time at which the vehicle's clock reads `time`; `None` before the epoch.
    pub fn to_host(&self, time: VehicleTime) -> Option<HostTime> {
        u64::try_from(self.host_ns(time)).ok().map(HostTime::from_ns)
    }

    /// The reading of the vehicle's clock at `host`; zero before it was switched on.
    pub fn to_vehicle(&self, host: HostTime) -> VehicleTime {
        let since = ns_between(self.at, host);
        let ns = (host.as_ns() as i64)
            .saturating_add(self.offset_ns)
            .saturating_add((since * self.skew) as i64);
        VehicleTime::from_us(u64::try_from(ns).unwrap_or(0) / 1000)
    }

    pub(super) fn host_ns(&self, time: VehicleTime) -> i64 {
        let unskewed = nanoseconds(time).saturating_sub(self.offset_ns);
        let since = unskewed.saturating_sub(self.at.as_ns() as i64) as f64;
        unskewed.saturating_sub((since * self.skew / (1.0 + self.skew)) as i64)
    }
}

pub(super) fn nanoseconds(time: VehicleTime) -> i64 {
    i64::try_from(time.as_us()).unwrap_or(i64::MAX).saturating_mul(1000)
}

/// Nanoseconds from `earlier` to `later`, negative in reverse order.
pub(super) fn ns_between(earlier: HostTime, later: HostTime) -> f64 {
    (later.as_ns() as i64).saturating_sub(earlier.as_ns() as i64) as f64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn clock_conversions_are_inverse(
            offset_s in -1.6e9..-1.0e9f64, skew in -0.05..0.05f64, since_ms in 0..600_000u64,
        ) {
            let at = HostTime::from_ns(1_700_000_000_000_000_000);
            let line = ClockEstimate {
                offset_ns: (offset_s * 1e9) as i64,
                at,
                skew,
                error_ns: None,
                source: ClockSource::Arrival,
            };
            let host = HostTime::from_ns(at.as_ns() + since_ms * 1_000_000);
            let back = line.to_host(line.to_vehicle(host)).expect("after the epoch");
            prop_assert!(ns_between(back, host).abs() < 2000.0);
        }
    }
}
