//! The vehicle's clock relative to the host's: it may run slow or fast, and stall briefly.

use crate::config::{ClockConfig, Stall};

/// Maps between vehicle time and host time, both in us since power-on.
#[derive(Clone, Debug, PartialEq)]
pub struct Clock {
    rate: f64,
    /// Stalls as (vehicle time of the stall, its length in host time), in us, in order.
    stalls: Vec<(u64, u64)>,
}

impl Clock {
    pub(crate) fn new(config: &ClockConfig) -> Self {
        let us = |seconds: f64| (seconds * 1e6).round() as u64;
        let stall = |stall: &Stall| (us(stall.at_s), us(stall.for_s));
        let mut stalls: Vec<_> = config.stalls.iter().map(stall).collect();
        stalls.sort_unstable();
        Self { rate: config.rate, stalls }
    }

    /// The first host time at which the vehicle's clock shows `vehicle_us`.
    pub fn host_us(&self, vehicle_us: u64) -> u64 {
        let stood: u64 =
            self.stalls.iter().filter(|(at, _)| *at < vehicle_us).map(|(_, length)| length).sum();
        (vehicle_us as f64 / self.rate).ceil() as u64 + stood
    }

    /// The vehicle's clock at a host time.
    pub fn vehicle_us(&self, host_us: u64) -> u64 {
        let mut running_us = host_us;
        for (at, length) in &self.stalls {
            let begins = (*at as f64 / self.rate).ceil() as u64;
            if running_us <= begins {
                break;
            }
            running_us = begins.max(running_us.saturating_sub(*length));
        }
        // The 1e-3 compensates for the rounding in `host_us`.
        (running_us as f64 * self.rate + 1e-3) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn clock(rate: f64, stalls: &[(f64, f64)]) -> Clock {
        let stalls = stalls.iter().map(|&(at_s, for_s)| Stall { at_s, for_s }).collect();
        Clock::new(&ClockConfig { rate, stalls })
    }

    #[test]
    fn ideal_clock_equals_the_host_clock() {
        let clock = clock(1.0, &[]);
        for us in [0, 1, 999, 123_456_789] {
            assert_eq!((clock.host_us(us), clock.vehicle_us(us)), (us, us));
        }
    }

    #[test]
    fn clock_stops_during_a_stall_and_resumes_after_it() {
        let clock = clock(1.0, &[(2.0, 0.4)]);
        assert_eq!(clock.vehicle_us(2_000_000), 2_000_000);
        assert_eq!(clock.vehicle_us(2_399_000), 2_000_000);
        assert_eq!(clock.vehicle_us(2_500_000), 2_100_000);
        assert_eq!(clock.host_us(2_000_000), 2_000_000);
        assert_eq!(clock.host_us(2_100_000), 2_500_000);
    }

    proptest! {
        #[test]
        fn host_us_inverts_vehicle_us(
            rate in 0.5f64..2.0, at in 0.0f64..5.0, length in 0.0f64..0.9, us in 0u64..10_000_000,
        ) {
            let clock = clock(rate, &[(at, length)]);
            let host = clock.host_us(us);
            prop_assert!(clock.vehicle_us(host) >= us);
            prop_assert!(host == 0 || clock.vehicle_us(host - 1) <= us);
        }
    }
}
