//! MAV_CMD requests: COMMAND_LONG, COMMAND_INT and their acknowledgement.
//!
//! They are decoded from the payload's bytes, because a command number that the dialect lacks must
//! get the reply "unsupported" too.

use mavlink::error::ParserError;
use mavlink::{MavlinkVersion, MessageData};
use wire::Frame;
use wire::dialect::{
    COMMAND_ACK_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA, MavCmd, MavMessage, MavResult,
};

/// A request from either message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Command number on the wire.
    pub number: u16,
    /// The command; `None` if the dialect lacks the number.
    pub id: Option<MavCmd>,
    /// Parameters 1 to 7; 5 and 6 are integers in COMMAND_INT.
    pub params: [f32; 7],
    /// Target system, 0 for all.
    pub target_system: u8,
    /// Target component, 0 for all.
    pub target_component: u8,
}

impl Command {
    /// The request in `frame`, if it is a COMMAND_LONG or COMMAND_INT.
    pub fn from_frame(frame: &Frame) -> Option<Self> {
        let integers = match frame.id() {
            COMMAND_LONG_DATA::ID => false,
            COMMAND_INT_DATA::ID => true,
            _ => return None,
        };
        // MAVLink 2 truncates trailing zeros. Both messages have the same layout up to byte 32.
        let mut bytes = [0; 32];
        let payload = frame.payload();
        let len = payload.len().min(bytes.len());
        bytes[..len].copy_from_slice(&payload[..len]);
        let words: [[u8; 4]; 7] = std::array::from_fn(|i| {
            [bytes[4 * i], bytes[4 * i + 1], bytes[4 * i + 2], bytes[4 * i + 3]]
        });
        let mut params = words.map(f32::from_le_bytes);
        if integers {
            params[4] = i32::from_le_bytes(words[4]) as f32;
            params[5] = i32::from_le_bytes(words[5]) as f32;
        }
        let number = u16::from_le_bytes([bytes[28], bytes[29]]);
        Some(Self {
            number,
            id: match frame.message() {
                Ok(MavMessage::COMMAND_LONG(message)) => Some(message.command),
                Ok(MavMessage::COMMAND_INT(message)) => Some(message.command),
                _ => None,
            },
            params,
            target_system: bytes[30],
            target_component: bytes[31],
        })
    }

    /// Parameter `n`, counted from 1 as in MAVLink's tables.
    pub fn param(&self, n: usize) -> f32 {
        self.params[n - 1]
    }
}

/// COMMAND_ACK with a numeric command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acknowledgement {
    /// Number of the command.
    pub command: u16,
    /// Result of the command.
    pub result: MavResult,
    /// System that sent the request.
    pub target_system: u8,
    /// Component that sent the request.
    pub target_component: u8,
}

impl MessageData for Acknowledgement {
    type Message = MavMessage;
    const ID: u32 = COMMAND_ACK_DATA::ID;
    const NAME: &'static str = COMMAND_ACK_DATA::NAME;
    const EXTRA_CRC: u8 = COMMAND_ACK_DATA::EXTRA_CRC;
    const ENCODED_LEN: usize = COMMAND_ACK_DATA::ENCODED_LEN;

    fn ser(&self, version: MavlinkVersion, payload: &mut [u8]) -> usize {
        let known = COMMAND_ACK_DATA {
            result: self.result,
            target_system: self.target_system,
            target_component: self.target_component,
            ..Default::default()
        };
        let mut bytes = [0; 255];
        let len = known.ser(version, &mut bytes).max(2);
        bytes[..2].copy_from_slice(&self.command.to_le_bytes());
        payload[..len].copy_from_slice(&bytes[..len]);
        len
    }

    fn deser(version: MavlinkVersion, payload: &[u8]) -> Result<Self, ParserError> {
        let known = COMMAND_ACK_DATA::deser(version, payload)?;
        Ok(Self {
            command: known.command as u16,
            result: known.result,
            target_system: known.target_system,
            target_component: known.target_component,
        })
    }
}
