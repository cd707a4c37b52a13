//! Messages as frames.

use mavlink::{MAV_STX_V2, MAVLinkV1MessageRaw, MavHeader, MavlinkVersion, Message, MessageData};

use super::frame::checksum;
use crate::dialect::MavMessage;

/// Longest payload.
const PAYLOAD_LEN_MAX: usize = 255;

/// Writes messages as frames of one sender, counting its sequence.
#[derive(Clone, Debug)]
pub struct Encoder {
    header: MavHeader,
    version: MavlinkVersion,
}

impl Encoder {
    /// A sender of MAVLink 2 frames.
    pub fn new(system: u8, component: u8) -> Self {
        Self {
            header: MavHeader { system_id: system.into(), component_id: component, sequence: 0 },
            version: MavlinkVersion::V2,
        }
    }

    /// Speaks another protocol version from the next frame on.
    pub fn set_version(&mut self, version: MavlinkVersion) {
        self.version = version;
    }

    /// Appends `message` to `out` as one frame. Returns whether it could: MAVLink 1 has no room
    /// for message ids above 255.
    pub fn encode(&mut self, message: &MavMessage, out: &mut Vec<u8>) -> bool {
        match self.version {
            MavlinkVersion::V2 => {
                let id = message.message_id();
                self.write(id, MavMessage::extra_crc(id), out, |payload| {
                    message.ser(MavlinkVersion::V2, payload)
                });
            }
            MavlinkVersion::V1 if message.message_id() > u8::MAX.into() => return false,
            MavlinkVersion::V1 => {
                let mut raw = MAVLinkV1MessageRaw::new();
                raw.serialize_message(self.header, message);
                out.extend_from_slice(raw.raw_bytes());
            }
        }
        self.header.sequence = self.header.sequence.wrapping_add(1);
        true
    }

    /// As [`encode`](Self::encode), for a payload that the dialect's types cannot express, such as
    /// the acknowledgement of a command that it does not name.
    pub fn encode_data<D: MessageData>(&mut self, data: &D, out: &mut Vec<u8>) -> bool {
        match self.version {
            MavlinkVersion::V2 => {
                self.write(D::ID, D::EXTRA_CRC, out, |payload| {
                    data.ser(MavlinkVersion::V2, payload)
                });
            }
            MavlinkVersion::V1 if D::ID > u8::MAX.into() => return false,
            MavlinkVersion::V1 => {
                let mut raw = MAVLinkV1MessageRaw::new();
                raw.serialize_message_data(self.header, data);
                out.extend_from_slice(raw.raw_bytes());
            }
        }
        self.header.sequence = self.header.sequence.wrapping_add(1);
        true
    }

    /// Appends a MAVLink 2 frame whose payload `serialize` writes; it returns its length.
    fn write(
        &self,
        id: u32,
        extra_crc: u8,
        out: &mut Vec<u8>,
        serialize: impl FnOnce(&mut [u8]) -> usize,
    ) {
        let mut payload = [0; PAYLOAD_LEN_MAX];
        let len = serialize(&mut payload);
        let MavHeader { system_id, component_id, sequence } = self.header;
        let [a, b, c, _] = id.to_le_bytes();
        let start = out.len() + 1;
        out.extend([MAV_STX_V2, len as u8, 0, 0, sequence, system_id as u8, component_id, a, b, c]);
        out.extend_from_slice(&payload[..len]);
        let crc = checksum(&out[start..], extra_crc);
        out.extend(crc.to_le_bytes());
    }
}
