//! Encodes messages as frames.

use mavlink::consts::v2;
use mavlink::{MAV_STX_V2, MAVLinkV1MessageRaw, MavHeader, MavlinkVersion, Message, MessageData};

use super::frame::checksum;
use crate::dialect::MavMessage;
use crate::signing::Signer;

/// Length limit of a payload in bytes.
const PAYLOAD_LEN_MAX: usize = 255;

/// Encodes messages as frames of one sender and counts its sequence numbers.
#[derive(Clone, Debug)]
pub struct Encoder {
    header: MavHeader,
    version: MavlinkVersion,
    signer: Option<Signer>,
}

impl Encoder {
    /// Creates an encoder of unsigned MAVLink 2 frames.
    pub fn new(system: u8, component: u8) -> Self {
        Self {
            header: MavHeader { system_id: system.into(), component_id: component, sequence: 0 },
            version: MavlinkVersion::V2,
            signer: None,
        }
    }

    /// Sets the sequence number of the next frame.
    pub fn set_sequence(&mut self, sequence: u8) {
        self.header.sequence = sequence;
    }

    /// Switches the protocol version from the next frame on. With a signer, it stays MAVLink 2.
    pub fn set_version(&mut self, version: MavlinkVersion) {
        if self.signer.is_none() {
            self.version = version;
        }
    }

    /// Signs every frame from the next on; `None` stops signing.
    pub fn set_signer(&mut self, signer: Option<Signer>) {
        if signer.is_some() {
            self.version = MavlinkVersion::V2;
        }
        self.signer = signer;
    }

    /// The signer of the frames, if any.
    pub fn signer(&mut self) -> Option<&mut Signer> {
        self.signer.as_mut()
    }

    /// Appends `message` to `out` as one frame. Returns false if MAVLink 1 cannot carry it, because
    /// its id is above 255.
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
    /// the acknowledgement of a command that the dialect lacks.
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

    /// Appends a MAVLink 2 frame. `serialize` writes the payload and returns its length.
    fn write(
        &mut self,
        id: u32,
        extra_crc: u8,
        out: &mut Vec<u8>,
        serialize: impl FnOnce(&mut [u8]) -> usize,
    ) {
        let mut payload = [0; PAYLOAD_LEN_MAX];
        let len = serialize(&mut payload);
        let MavHeader { system_id, component_id, sequence } = self.header;
        let [a, b, c, _] = id.to_le_bytes();
        let start = out.len();
        let flags = if self.signer.is_some() { v2::IFLAG_SIGNED } else { 0 };
        let [system, len_byte] = [system_id as u8, len as u8];
        out.extend([MAV_STX_V2, len_byte, flags, 0, sequence, system, component_id, a, b, c]);
        out.extend_from_slice(&payload[..len]);
        let crc = checksum(&out[start + 1..], extra_crc);
        out.extend(crc.to_le_bytes());
        if let Some(signer) = &mut self.signer {
            signer.sign(out, start);
        }
    }
}
