//! The vehicle's identity and capabilities.

use wire::dialect::*;

use super::Mode;
use super::personality::Personality;

/// Vendor id in AUTOPILOT_VERSION. It marks a vehicle that takes attitude, rates and thrust
/// together, with a PD law.
pub const VENDOR_ID: u16 = 0x4457;
/// Product id in AUTOPILOT_VERSION; see [`VENDOR_ID`].
pub const PRODUCT_ID: u16 = 1;

/// Reported version as major, minor, patch, and 255 for a release: the PX4 version whose protocol
/// it follows.
pub(super) const PX4_VERSION: u32 = u32::from_be_bytes([1, 17, 0, 255]);

/// AUTOPILOT_VERSION of the bundled vehicle.
pub fn bundled_version() -> AUTOPILOT_VERSION_DATA {
    AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        flight_sw_version: PX4_VERSION,
        vendor_id: VENDOR_ID,
        product_id: PRODUCT_ID,
        uid: u64::from(VENDOR_ID) << 16 | u64::from(PRODUCT_ID),
        ..Default::default()
    }
}

/// AVAILABLE_MODES of the mode at `index` (from 1, as the message counts).
pub(super) fn available_mode(personality: &dyn Personality, index: usize) -> Option<MavMessage> {
    let modes = personality.modes();
    let mode = *modes.get(index.checked_sub(1)?)?;
    let mut properties = MavModeProperty::empty();
    let by_sticks = matches!(mode, Mode::Position | Mode::Altitude | Mode::Stabilized);
    properties.set(MavModeProperty::MAV_MODE_PROPERTY_AUTO_MODE, !by_sticks);
    Some(MavMessage::AVAILABLE_MODES(AVAILABLE_MODES_DATA {
        custom_mode: personality.custom_mode(mode),
        properties,
        number_modes: modes.len() as u8,
        mode_index: index as u8,
        standard_mode: personality.standard_mode(mode),
        mode_name: personality.mode_name(mode).into(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::autopilot::personality;
    use crate::config::Autopilot;

    #[test]
    fn exactly_the_modes_of_the_autopilot_are_available() {
        for autopilot in [Autopilot::Bundled, Autopilot::Px4, Autopilot::Arducopter] {
            let personality = personality::of(autopilot);
            let count = personality.modes().len();
            assert!(available_mode(personality, 0).is_none());
            assert!((1..=count).all(|index| available_mode(personality, index).is_some()));
            assert!(available_mode(personality, count + 1).is_none());
        }
    }
}
