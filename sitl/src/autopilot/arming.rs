//! Arming checks and the reasons for a refusal.

/// The inputs of the arming checks.
#[derive(Clone, Copy, Debug)]
pub struct Preflight {
    /// Angle between body down and world down, rad.
    pub tilt: f64,
    /// Largest tilt allowed, rad.
    pub tilt_max: f64,
    /// Remaining charge, 0..1.
    pub battery: f64,
    /// Whether the estimate is finite.
    pub estimate_ok: bool,
    /// Whether the vehicle is on the ground.
    pub landed: bool,
    /// Whether the mode can start a flight.
    pub mode_can_arm: bool,
    /// Whether the mode needs setpoints and none arrive.
    pub stream_missing: bool,
    /// Whether a ground station is required and none is connected.
    pub ground_station_missing: bool,
}

/// Charge below which arming is refused.
const BATTERY_MIN: f64 = 0.10;

/// Why the vehicle refuses to arm, disarm or change its mode.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The estimate is not finite.
    #[error("no valid estimate of attitude and position")]
    Estimate,
    /// The vehicle is in the air, for example after a forced disarming.
    #[error("vehicle is not landed")]
    NotLanded,
    /// The vehicle is not level.
    #[error("vehicle is not level: tilted by {degrees:.0} degrees")]
    NotLevel {
        /// Tilt in degrees.
        degrees: f64,
    },
    /// The charge is too low.
    #[error("battery too low: {percent:.0} %")]
    Battery {
        /// Remaining charge in percent.
        percent: f64,
    },
    /// The mode ends flights: Land or Return.
    #[error("mode {mode} cannot start a flight")]
    Mode {
        /// The active mode.
        mode: super::Mode,
    },
    /// OFFBOARD without setpoints.
    #[error("no offboard signal: stream SET_ATTITUDE_TARGET first")]
    NoOffboardSignal,
    /// NAV_DLL_ACT requires a ground station.
    #[error("no connection to the ground control station")]
    NoGroundStation,
    /// Disarming in the air needs the force code.
    #[error("vehicle is in the air")]
    InAir,
}

impl Preflight {
    /// The most serious reason not to arm in `mode`, if any.
    pub fn refusal(&self, mode: super::Mode) -> Option<Refusal> {
        let checks = [
            (!self.estimate_ok, Refusal::Estimate),
            (!self.landed, Refusal::NotLanded),
            (
                // A NaN tilt does not count as level.
                self.tilt.is_nan() || self.tilt > self.tilt_max,
                Refusal::NotLevel { degrees: self.tilt.to_degrees() },
            ),
            (self.battery < BATTERY_MIN, Refusal::Battery { percent: self.battery * 100.0 }),
            (!self.mode_can_arm, Refusal::Mode { mode }),
            (self.stream_missing, Refusal::NoOffboardSignal),
            (self.ground_station_missing, Refusal::NoGroundStation),
        ];
        checks.into_iter().find_map(|(fails, refusal)| fails.then_some(refusal))
    }
}

#[cfg(test)]
mod tests {
    use super::super::Mode;
    use super::*;

    const READY: Preflight = Preflight {
        tilt: 0.0,
        tilt_max: 0.3,
        battery: 1.0,
        estimate_ok: true,
        landed: true,
        mode_can_arm: true,
        stream_missing: false,
        ground_station_missing: false,
    };

    #[test]
    fn every_arming_check_has_its_message() {
        assert_eq!(READY.refusal(Mode::Hold), None);
        let cases = [
            (Preflight { tilt: 0.5, ..READY }, "not level: tilted by 29 degrees"),
            (Preflight { tilt: f64::NAN, ..READY }, "not level"),
            (Preflight { battery: 0.04, ..READY }, "battery too low: 4 %"),
            (Preflight { landed: false, ..READY }, "not landed"),
            (Preflight { stream_missing: true, ..READY }, "no offboard signal"),
            (Preflight { mode_can_arm: false, ..READY }, "mode Hold cannot start a flight"),
            (Preflight { ground_station_missing: true, ..READY }, "ground control station"),
            (Preflight { estimate_ok: false, ..READY }, "no valid estimate"),
        ];
        for (preflight, words) in cases {
            let refusal = preflight.refusal(Mode::Hold).expect(words).to_string();
            assert!(refusal.contains(words), "{refusal}");
        }
    }
}
