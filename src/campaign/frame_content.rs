//! The content of frames on the wire, as far as faults and judge need it.

use wire::dialect::*;
use wire::signing::{Key, Signer, Stamp};
use wire::{Encoder, Frame};

/// Message ids.
pub const HEARTBEAT: u32 = 0;
pub const SET_ATTITUDE_TARGET: u32 = 82;
pub const COMMAND_LONG: u32 = 76;
const ATTITUDE: u32 = 30;
const ATTITUDE_QUATERNION: u32 = 31;
const LOCAL_POSITION_NED: u32 = 32;
const ODOMETRY: u32 = 331;
pub const CURRENT_MODE: u32 = 436;

/// Message id of a frame.
pub fn id(frame: &[u8]) -> Option<u32> {
    match *frame {
        [0xFD, _, _, _, _, _, _, a, b, c, ..] => Some(u32::from_le_bytes([a, b, c, 0])),
        [0xFE, _, _, _, _, id, ..] => Some(id.into()),
        _ => None,
    }
}

/// Whether the frame carries the state.
pub fn is_state(frame: &[u8]) -> bool {
    matches!(id(frame), Some(ATTITUDE | ATTITUDE_QUATERNION | LOCAL_POSITION_NED | ODOMETRY))
}

/// Whether the frame carries the mode.
pub fn is_mode(frame: &[u8]) -> bool {
    matches!(id(frame), Some(HEARTBEAT | CURRENT_MODE))
}

/// The message of one whole frame.
pub fn message(frame: &[u8]) -> Option<MavMessage> {
    Frame::parse(frame)?.message().ok()
}

/// The mode that a frame reports, and whether the motors are armed.
pub fn reported_mode(frame: &[u8]) -> Option<(u32, Option<bool>)> {
    if !is_mode(frame) {
        return None;
    }
    match message(frame)? {
        MavMessage::HEARTBEAT(data) => {
            let armed = data.base_mode.contains(MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED);
            Some((data.custom_mode, Some(armed)))
        }
        MavMessage::CURRENT_MODE(data) => Some((data.custom_mode, None)),
        _ => None,
    }
}

/// A frame with the ids, the number and the stamp of another, so that no gap remains. A signed
/// frame is signed again with `key`, because the vehicle itself is at fault.
pub fn in_place_of(frame: &[u8], message: &MavMessage, key: &Key) -> Vec<u8> {
    let Some(original) = Frame::parse(frame) else { return frame.to_vec() };
    let mut encoder = Encoder::new(original.system() as u8, original.component());
    encoder.set_sequence(original.sequence());
    encoder.set_signer(original.signed_at().map(|(link, at)| {
        let before = Stamp::from_ticks(at.ticks().saturating_sub(1));
        Signer::new(key.clone(), link, before)
    }));
    let mut bytes = Vec::new();
    encoder.encode(message, &mut bytes);
    bytes
}
