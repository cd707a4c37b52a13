//! The capacity of a serial line: the requested telemetry, lowered until it fits.

use std::fmt;

use mavlink::Message;
use wire::dialect::MavMessage;
use wire::message_name;

use super::profile::MessageRate;

/// Share of a serial line above which rates fall short. Unrequested traffic needs the rest:
/// parameters, texts and the vehicle's own default streams.
pub const LINE_SHARE_MAX: f64 = 0.7;
/// Bytes of a MAVLink 2 frame around its payload.
const FRAME_OVERHEAD: usize = 12;
/// Bits on a serial line per byte: start, eight data, stop.
const BITS_PER_BYTE: f64 = 10.0;

const BATTERY_STATUS: u32 = 147;
const ATTITUDE_QUATERNION: u32 = 31;
const LOCAL_POSITION_NED: u32 = 32;
const SERVO_OUTPUT_RAW: u32 = 36;
const ATTITUDE_TARGET: u32 = 83;
const HIGHRES_IMU: u32 = 105;
const ODOMETRY: u32 = 331;
const ACTUATOR_OUTPUT_STATUS: u32 = 375;

/// Economies for a line that is too slow, applied in this order until the rest fits: the message
/// and the highest rate that is still requested, in Hz; 0 requests none. First what only the log
/// keeps, at rates that learning can work with. Then ODOMETRY, which repeats attitude and position
/// in 245 bytes. Last what drives the feedback. PX4 serves these rates exactly.
const ECONOMIES: &[(u32, f64)] = &[
    (HIGHRES_IMU, 100.0),
    (ACTUATOR_OUTPUT_STATUS, 50.0),
    (ODOMETRY, 0.0),
    (ATTITUDE_TARGET, 10.0),
    (HIGHRES_IMU, 50.0),
    (ACTUATOR_OUTPUT_STATUS, 25.0),
    (ATTITUDE_QUATERNION, 100.0),
    (SERVO_OUTPUT_RAW, 10.0),
    (HIGHRES_IMU, 25.0),
    (ACTUATOR_OUTPUT_STATUS, 10.0),
    (BATTERY_STATUS, 1.0),
    (ATTITUDE_QUATERNION, 50.0),
    (LOCAL_POSITION_NED, 50.0),
    (ATTITUDE_TARGET, 2.0),
    (HIGHRES_IMU, 0.0),
    (ACTUATOR_OUTPUT_STATUS, 0.0),
    (ATTITUDE_QUATERNION, 25.0),
    (LOCAL_POSITION_NED, 25.0),
    (ATTITUDE_TARGET, 0.0),
    (SERVO_OUTPUT_RAW, 2.0),
];

/// The messages to request over a serial line, and what they cost.
#[derive(Clone, Debug, PartialEq)]
pub struct LineBudget {
    /// Bits per second of the line.
    pub baud: u32,
    /// The messages to request.
    pub messages: Vec<MessageRate>,
    /// Share of the line that they use, frames included.
    pub share: f64,
    /// Share that the requested rates would have used.
    pub requested_share: f64,
    /// The lowered messages, with the rate that was requested, Hz.
    pub lowered: Vec<MessageRate>,
}

impl LineBudget {
    /// A budget of exactly the requested messages, whatever they cost.
    pub fn unlimited(requested: &[MessageRate], baud: u32) -> Self {
        let share = line_share(requested, baud);
        let (messages, lowered) = (requested.to_vec(), Vec::new());
        Self { baud, messages, share, requested_share: share, lowered }
    }

    /// Lowers the requested messages step by step until they use at most [`LINE_SHARE_MAX`] of the
    /// line, or until no economy is left.
    pub fn fit(requested: &[MessageRate], baud: u32) -> Self {
        let mut budget = Self::unlimited(requested, baud);
        for &(id, most_hz) in ECONOMIES {
            if budget.fits() {
                break;
            }
            for rate in budget.messages.iter_mut().filter(|rate| rate.id == id) {
                rate.hz = rate.hz.min(most_hz);
            }
            budget.share = line_share(&budget.messages, baud);
        }
        let pairs = requested.iter().zip(&budget.messages);
        budget.lowered = pairs.filter(|(w, now)| now.hz < w.hz).map(|(w, _)| *w).collect();
        budget.messages.retain(|rate| rate.hz > 0.0);
        budget
    }

    /// Whether the messages leave the rest of the line free.
    pub fn fits(&self) -> bool {
        self.share <= LINE_SHARE_MAX
    }

    /// Capacity of the line, bytes/s.
    pub fn bytes_per_s(&self) -> f64 {
        f64::from(self.baud) / BITS_PER_BYTE
    }

    /// The rate at which the messages carry the state, Hz.
    pub fn state_hz(&self) -> f64 {
        self.hz(ODOMETRY).max(self.hz(ATTITUDE_QUATERNION).min(self.hz(LOCAL_POSITION_NED)))
    }

    fn hz(&self, id: u32) -> f64 {
        self.messages.iter().find(|rate| rate.id == id).map_or(0.0, |rate| rate.hz)
    }
}

impl fmt::Display for LineBudget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (baud, percent) = (self.baud, 100.0 * self.requested_share);
        write!(f, "the desired telemetry takes {percent:.0} % of the serial line at {baud} baud")?;
        for (k, requested) in self.lowered.iter().enumerate() {
            let before = if k == 0 { "; requesting " } else { ", " };
            write!(f, "{before}{} at ", message_name(requested.id))?;
            write!(f, "{:.0} instead of {:.0} Hz", self.hz(requested.id), requested.hz)?;
        }
        if !self.lowered.is_empty() {
            write!(f, ": {:.0} %", 100.0 * self.share)?;
        }
        if !self.fits() {
            write!(f, "; rates will fall short: raise the baud rate")?;
        }
        Ok(())
    }
}

/// Bytes a second for attitude and position, each at `hz`.
pub fn state_bytes_per_s(hz: f64) -> f64 {
    (frame_len(ATTITUDE_QUATERNION) + frame_len(LOCAL_POSITION_NED)) as f64 * hz
}

/// The share of a serial line that messages at these rates use, frames included.
fn line_share(messages: &[MessageRate], baud: u32) -> f64 {
    let bits: f64 = messages
        .iter()
        .map(|rate| frame_len(rate.id) as f64 * BITS_PER_BYTE * rate.hz.max(0.0))
        .sum();
    bits / f64::from(baud.max(1))
}

/// Length of a message's frame with a full payload.
pub(super) fn frame_len(id: u32) -> usize {
    let mut payload = [0; 255];
    // MAVLink 1 keeps trailing zeros.
    let payload_len = MavMessage::default_message_from_id(id)
        .map_or(0, |message| message.ser(mavlink::MavlinkVersion::V1, &mut payload));
    FRAME_OVERHEAD + payload_len
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::profile::Profile;

    fn px4(baud: u32) -> LineBudget {
        LineBudget::fit(Profile::PX4.telemetry, baud)
    }

    /// Rates of attitude, position, ODOMETRY, inertial unit and motors.
    fn rates(budget: &LineBudget) -> [f64; 5] {
        let ids = [
            ATTITUDE_QUATERNION,
            LOCAL_POSITION_NED,
            ODOMETRY,
            HIGHRES_IMU,
            ACTUATOR_OUTPUT_STATUS,
        ];
        ids.map(|id| budget.hz(id))
    }

    #[test]
    fn px4_rates_follow_the_line_speed() {
        let cases = [
            (3_000_000, [250.0, 100.0, 100.0, 250.0, 100.0]),
            (921_600, [250.0, 100.0, 100.0, 100.0, 50.0]),
            (460_800, [250.0, 100.0, 0.0, 100.0, 50.0]),
            (115_200, [50.0, 50.0, 0.0, 25.0, 10.0]),
            (57_600, [25.0, 50.0, 0.0, 0.0, 0.0]),
        ];
        for (baud, expected) in cases {
            let budget = px4(baud);
            assert!(budget.fits(), "{baud}: {}", budget.share);
            assert_eq!(rates(&budget), expected, "{baud}");
        }
        // A fast line keeps everything that a slower one gives up.
        assert_eq!(px4(3_000_000).messages, Profile::PX4.telemetry);
        assert!(px4(3_000_000).lowered.is_empty());
    }

    #[test]
    fn every_profile_fits_usual_lines_and_keeps_attitude_and_position() {
        for profile in [Profile::PX4, Profile::BUNDLED, Profile::ARDUCOPTER, Profile::UNKNOWN] {
            let mut share_before = 0.0;
            for baud in [921_600, 460_800, 230_400, 115_200, 57_600] {
                let budget = LineBudget::fit(profile.telemetry, baud);
                assert!(budget.fits(), "{} {baud}: {}", profile.name, budget.share);
                assert!(budget.hz(ATTITUDE_QUATERNION) >= 25.0, "{} {baud}", profile.name);
                assert!(budget.hz(LOCAL_POSITION_NED) >= 25.0, "{} {baud}", profile.name);
                assert!(budget.requested_share > share_before);
                share_before = budget.requested_share;
            }
        }
    }

    #[test]
    fn feedback_keeps_its_rate_down_to_230400_baud() {
        for baud in [921_600, 460_800, 230_400] {
            let [attitude, position, ..] = rates(&px4(baud));
            assert!(attitude >= 100.0 && position >= 100.0, "{baud}");
        }
    }

    #[test]
    fn hopeless_line_is_reported_and_explicit_rates_are_kept() {
        let hopeless = px4(9600);
        assert!(!hopeless.fits());
        assert!(hopeless.to_string().ends_with("raise the baud rate"), "{hopeless}");
        let unlimited = LineBudget::unlimited(Profile::PX4.telemetry, 57_600);
        assert_eq!(unlimited.messages, Profile::PX4.telemetry);
        assert!(!unlimited.fits());
    }

    #[test]
    fn budget_message_names_lowered_rates() {
        let text = px4(921_600).to_string();
        assert!(text.contains("at 921600 baud"), "{text}");
        assert!(text.contains("HIGHRES_IMU at 100 instead of 250 Hz"), "{text}");
        assert!(text.contains("ACTUATOR_OUTPUT_STATUS at 50 instead of 100 Hz"), "{text}");
        assert!(!text.contains("ODOMETRY"), "{text}");
    }
}
