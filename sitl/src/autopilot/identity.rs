//! What the vehicle says it is and can do.

use wire::dialect::*;

use super::Mode;

/// What AUTOPILOT_VERSION says about the vehicle: it takes attitude, rates and thrust together, as
/// a PD.
pub const VENDOR_ID: u16 = 0x4457;
/// See [`VENDOR_ID`].
pub const PRODUCT_ID: u16 = 1;

/// Version that the vehicle reports, major, minor, patch, and 255 for a release: the PX4 whose
/// protocol it follows.
const FLIGHT_SW_VERSION: u32 = u32::from_be_bytes([1, 17, 0, 255]);

/// AUTOPILOT_VERSION.
pub fn autopilot_version() -> AUTOPILOT_VERSION_DATA {
    AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MISSION_INT
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        flight_sw_version: FLIGHT_SW_VERSION,
        vendor_id: VENDOR_ID,
        product_id: PRODUCT_ID,
        uid: u64::from(VENDOR_ID) << 16 | u64::from(PRODUCT_ID),
        ..Default::default()
    }
}

/// AVAILABLE_MODES of the mode at `index` (from 1, as the message counts).
pub fn available_mode(index: usize) -> Option<MavMessage> {
    let mode = Mode::ALL.get(index.checked_sub(1)?)?;
    let mut properties = MavModeProperty::empty();
    properties.set(MavModeProperty::MAV_MODE_PROPERTY_AUTO_MODE, *mode != Mode::Position);
    Some(MavMessage::AVAILABLE_MODES(AVAILABLE_MODES_DATA {
        custom_mode: mode.custom_mode(),
        properties,
        number_modes: Mode::ALL.len() as u8,
        mode_index: index as u8,
        standard_mode: mode.standard_mode(),
        mode_name: mode.to_string().as_str().into(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_is_available_and_no_more() {
        assert!(available_mode(0).is_none());
        assert!((1..=Mode::ALL.len()).all(|index| available_mode(index).is_some()));
        assert!(available_mode(Mode::ALL.len() + 1).is_none());
    }
}
