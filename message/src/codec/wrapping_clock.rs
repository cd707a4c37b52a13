//! Vehicle time from stamps of 32 bits, which wrap while the vehicle runs.

use crate::clock::VehicleTime;

/// A time stamp further behind the newest than this means a restarted vehicle, not a late frame, s.
const LATE_MAX_S: f64 = 10.0;
/// A larger stamp counts from 1970 and not from the vehicle's boot. MAVLink allows both in
/// `time_usec`, and has the receiver judge by the magnitude; no vehicle runs for ten years.
const SINCE_BOOT_MAX: VehicleTime = VehicleTime::from_us(10 * 365 * 86_400 * 1_000_000);

/// The newest vehicle time, which gives shorter stamps the bits that they lack.
#[derive(Debug, Default)]
pub(super) struct WrappingClock {
    latest: VehicleTime,
}

impl WrappingClock {
    /// Notes the time of a sample. A late frame changes nothing, and neither does a time since
    /// 1970, which says nothing about shorter stamps; a clock that is far behind has restarted.
    pub fn observe(&mut self, time: VehicleTime) {
        let is_late = time < self.latest && self.latest.seconds_since(time) < LATE_MAX_S;
        if !is_late && time <= SINCE_BOOT_MAX {
            self.latest = time;
        }
    }

    /// Whether any time was noted.
    pub fn is_known(&self) -> bool {
        self.latest > VehicleTime::default()
    }

    /// Extends a counter of microseconds, which wraps every 71.6 minutes.
    pub fn extend_us(&self, low: u32) -> VehicleTime {
        VehicleTime::from_us(unwrap(self.latest.as_us(), low, LATE_MAX_S * 1e6))
    }

    /// Extends a counter of milliseconds, which wraps every 49.7 days.
    pub fn extend_ms(&self, low: u32) -> VehicleTime {
        let ms = unwrap(self.latest.as_us() / 1000, low, LATE_MAX_S * 1e3);
        VehicleTime::from_us(ms.saturating_mul(1000))
    }
}

/// The value nearest to `latest` whose lower half is `low`. A value further back than `late_max`
/// means that the vehicle has restarted and counts from zero.
fn unwrap(latest: u64, low: u32, late_max: f64) -> u64 {
    let ahead = i64::from(low.wrapping_sub(latest as u32) as i32);
    match latest.checked_add_signed(ahead) {
        Some(value) if ahead as f64 >= -late_max => value,
        _ => low.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn microseconds_are_unwrapped_forwards_and_backwards() {
        let mut clock = WrappingClock::default();
        clock.observe(VehicleTime::from_us((1 << 32) + 1_000));
        let mut time = |low| {
            let time = clock.extend_us(low);
            clock.observe(time);
            time
        };
        assert_eq!(time(2_000), VehicleTime::from_us((1 << 32) + 2_000));
        assert_eq!(time(u32::MAX), VehicleTime::from_us((1 << 32) - 1));
    }

    #[test]
    fn boot_milliseconds_are_unwrapped_and_reset_by_a_reboot() {
        let mut clock = WrappingClock::default();
        let mut time = |ms: u64| {
            let time = clock.extend_ms(ms as u32);
            clock.observe(time);
            time.as_us() / 1000
        };
        let wrap = 1u64 << 32;
        for ms in [wrap - 20, wrap - 10, wrap, wrap + 10, wrap - 5, wrap + 60_000] {
            assert_eq!(time(ms), ms);
        }
        assert_eq!(time(3_000), 3_000, "rebooted since");
        assert_eq!(time(3_010), 3_010);
    }

    #[test]
    fn time_since_1970_does_not_extend_boot_milliseconds() {
        let mut clock = WrappingClock::default();
        // On both dates of a pair the lower half is on another side of the counter's middle.
        for unix_s in [1_700_000_000, 1_701_728_000] {
            for ms in [100_000, 100_020] {
                clock.observe(VehicleTime::from_us(unix_s * 1_000_000));
                let time = clock.extend_ms(ms);
                clock.observe(time);
                assert_eq!(time, VehicleTime::from_ms(ms), "{unix_s}");
            }
        }
    }
}
