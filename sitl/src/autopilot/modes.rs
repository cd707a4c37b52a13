//! Flight modes and PX4's encoding of them on the wire.

use std::fmt;

use wire::dialect::{MavModeFlag, MavStandardMode};

/// A flight mode of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    /// Hold position; the sticks move it (POSCTL).
    Position,
    /// Climb to the take-off altitude, then [`Mode::Hold`] (AUTO.TAKEOFF).
    Takeoff,
    /// Stay in place (AUTO.LOITER).
    Hold,
    /// Return to the position of arming and land (AUTO.RTL).
    Return,
    /// Descend in place, touch down and disarm (AUTO.LAND).
    Land,
    /// Follow SET_ATTITUDE_TARGET (OFFBOARD).
    Offboard,
    /// The sticks set tilt and climb rate (ALTCTL).
    Altitude,
    /// The sticks set tilt and thrust (STABILIZED).
    Stabilized,
}

const AUTO: u8 = 4;

impl Mode {
    /// Every mode; PX4 supports them all.
    pub const ALL: [Self; 8] = [
        Self::Position,
        Self::Takeoff,
        Self::Hold,
        Self::Return,
        Self::Land,
        Self::Offboard,
        Self::Altitude,
        Self::Stabilized,
    ];

    /// The modes of the bundled vehicle, in the order of AVAILABLE_MODES.
    pub const BUNDLED: [Self; 6] =
        [Self::Position, Self::Takeoff, Self::Hold, Self::Return, Self::Land, Self::Offboard];

    const fn main_and_sub(self) -> (u8, u8) {
        match self {
            Self::Position => (3, 0),
            Self::Takeoff => (AUTO, 2),
            Self::Hold => (AUTO, 3),
            Self::Return => (AUTO, 5),
            Self::Land => (AUTO, 6),
            Self::Offboard => (6, 0),
            Self::Altitude => (2, 0),
            Self::Stabilized => (7, 0),
        }
    }

    /// The mode with PX4's main and sub mode numbers, the parameters of MAV_CMD_DO_SET_MODE; `None`
    /// for a mode that is not simulated.
    pub fn from_main_and_sub(main: u8, sub: u8) -> Option<Self> {
        // As in PX4, the sub mode is ignored for a mode without sub modes.
        Self::ALL.into_iter().find(|mode| {
            let (mode_main, mode_sub) = mode.main_and_sub();
            mode_main == main && (main != AUTO || mode_sub == sub)
        })
    }

    /// PX4's `custom_mode`: main mode << 16 | sub mode << 24.
    pub const fn custom_mode(self) -> u32 {
        let (main, sub) = self.main_and_sub();
        u32::from_le_bytes([0, 0, main, sub])
    }

    /// HEARTBEAT's `base_mode`.
    pub fn base_mode(self, armed: bool) -> MavModeFlag {
        let stabilized = MavModeFlag::MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            | MavModeFlag::MAV_MODE_FLAG_STABILIZE_ENABLED;
        let mode = match self {
            Self::Position | Self::Altitude | Self::Stabilized => {
                stabilized | MavModeFlag::MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
            }
            Self::Offboard => stabilized | MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED,
            Self::Takeoff | Self::Hold | Self::Return | Self::Land => {
                stabilized
                    | MavModeFlag::MAV_MODE_FLAG_GUIDED_ENABLED
                    | MavModeFlag::MAV_MODE_FLAG_AUTO_ENABLED
            }
        };
        if armed { mode | MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED } else { mode }
    }

    /// CURRENT_MODE's `standard_mode`.
    pub const fn standard_mode(self) -> MavStandardMode {
        match self {
            Self::Position => MavStandardMode::MAV_STANDARD_MODE_POSITION_HOLD,
            Self::Takeoff => MavStandardMode::MAV_STANDARD_MODE_TAKEOFF,
            Self::Return => MavStandardMode::MAV_STANDARD_MODE_SAFE_RECOVERY,
            Self::Land => MavStandardMode::MAV_STANDARD_MODE_LAND,
            Self::Altitude => MavStandardMode::MAV_STANDARD_MODE_ALTITUDE_HOLD,
            Self::Hold | Self::Offboard | Self::Stabilized => {
                MavStandardMode::MAV_STANDARD_MODE_NON_STANDARD
            }
        }
    }

    /// PX4's name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Position => "Position",
            Self::Takeoff => "Takeoff",
            Self::Hold => "Hold",
            Self::Return => "Return",
            Self::Land => "Land",
            Self::Offboard => "Offboard",
            Self::Altitude => "Altitude",
            Self::Stabilized => "Stabilized",
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn custom_modes_match_px4() {
        assert_eq!(Mode::Offboard.custom_mode(), 0x0006_0000);
        assert_eq!(Mode::Hold.custom_mode(), 0x0304_0000);
        assert_eq!(Mode::Return.custom_mode(), 0x0504_0000);
        assert_eq!(Mode::Land.custom_mode(), 0x0604_0000);
        assert_eq!(Mode::Takeoff.custom_mode(), 0x0204_0000);
        assert_eq!(Mode::Position.custom_mode(), 0x0003_0000);
    }

    #[test]
    fn custom_modes_round_trip() {
        for mode in Mode::ALL {
            let [_, _, main, sub] = mode.custom_mode().to_le_bytes();
            assert_eq!(Mode::from_main_and_sub(main, sub), Some(mode));
        }
        assert_eq!(Mode::from_main_and_sub(AUTO, 4), None, "AUTO.MISSION");
        assert_eq!(Mode::from_main_and_sub(1, 0), None, "MANUAL");
    }
}
