//! One frame: where it begins and ends, and whether its checksum is right.

use mavlink::consts::v2;
use mavlink::error::ParserError;
use mavlink::{
    MAV_STX, MAV_STX_V2, MAVLinkMessageRaw, MAVLinkV1MessageRaw, MAVLinkV2MessageRaw,
    MavlinkVersion, Message,
};

use crate::dialect::MavMessage;
use crate::signing::Stamp;

/// One frame whose checksum is right.
pub struct Frame {
    pub(super) raw: MAVLinkMessageRaw,
}

impl Frame {
    /// The frame that `bytes` are, such as an entry of a log. `None` unless they are one whole
    /// frame of a message that the dialect has, its checksum right.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        Self::at_front(bytes).filter(|frame| frame.bytes().len() == bytes.len())
    }

    /// The frame at the front of `bytes`, if a whole and sound one is there.
    pub(super) fn at_front(bytes: &[u8]) -> Option<Self> {
        let (version, len) = extent(bytes).ok()?;
        let (raw, check) = raw(version, bytes.get(..len)?);
        (check == Check::Passed).then_some(Self { raw })
    }

    /// MAVLink message id.
    pub fn id(&self) -> u32 {
        self.raw.message_id()
    }

    /// Sender's system id.
    pub fn system(&self) -> u32 {
        self.raw.system_id()
    }

    /// Sender's component id.
    pub fn component(&self) -> u8 {
        self.raw.component_id()
    }

    /// Sender's sequence number, wrapping at 256.
    pub fn sequence(&self) -> u8 {
        self.raw.sequence()
    }

    /// Protocol version of the frame.
    pub fn version(&self) -> MavlinkVersion {
        self.raw.version()
    }

    /// Whether its sender signs its messages (MAVLink 2). A
    /// [`Verifier`](crate::signing::Verifier) checks the signature.
    pub fn is_signed(&self) -> bool {
        self.bytes().get(2).is_some_and(|flags| {
            self.version() == MavlinkVersion::V2 && flags & v2::IFLAG_SIGNED != 0
        })
    }

    /// The number of the sender's link and the stamp, where it is signed. Neither is checked.
    pub fn signed_at(&self) -> Option<(u8, Stamp)> {
        self.signature().map(|signature| (signature.link, signature.stamp))
    }

    /// The signature that its sender gave it, which is not checked yet.
    pub(crate) fn signature(&self) -> Option<Signature<'_>> {
        if !self.is_signed() {
            return None;
        }
        let (rest, hash) = self.bytes().split_last_chunk()?;
        let (_, [link, stamp @ ..]) = rest.split_last_chunk::<7>()?;
        Some(Signature { link: *link, stamp: Stamp::from_bytes(*stamp), signed: rest, hash: *hash })
    }

    /// The whole frame as it was on the wire, signature included.
    pub fn bytes(&self) -> &[u8] {
        match &self.raw {
            MAVLinkMessageRaw::V1(raw) => raw.raw_bytes(),
            MAVLinkMessageRaw::V2(raw) => raw.raw_bytes(),
        }
    }

    /// Payload bytes, trailing zeros of MAVLink 2 cut off as on the wire.
    pub fn payload(&self) -> &[u8] {
        self.raw.payload()
    }

    /// Decodes the payload.
    ///
    /// # Errors
    /// [`ParserError`] if the payload does not fit the message, such as an enum value that the
    /// dialect does not have. The frame itself was intact.
    pub fn message(&self) -> Result<MavMessage, ParserError> {
        MavMessage::parse(self.version(), self.id(), self.payload())
    }
}

/// The end of a signed frame.
pub(crate) struct Signature<'a> {
    /// The sender's number of the link.
    pub(crate) link: u8,
    pub(crate) stamp: Stamp,
    /// What the hash is of.
    pub(crate) signed: &'a [u8],
    pub(crate) hash: [u8; 6],
}

/// The checksum of a frame's bytes after its marker: CRC-16/MCRF4XX, closed by the message's own
/// byte. It needs no table: one would be fetched anew for every frame that comes after a pause.
pub(super) fn checksum(bytes: &[u8], extra_crc: u8) -> u16 {
    bytes.iter().chain([&extra_crc]).fold(0xFFFF, |crc: u16, byte| {
        let low = byte ^ crc as u8;
        let low = u16::from(low ^ (low << 4));
        (crc >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
    })
}

/// What the first bytes of a slice are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Front {
    /// A frame of this length, its checksum right.
    Frame(usize),
    /// What would be a frame of this length, of a message id that the dialect does not have.
    Unknown(usize),
    /// The start of a frame, perhaps: more bytes are needed to tell.
    Incomplete,
    /// No frame.
    Other,
}

/// Looks for a frame at the front of `bytes`.
pub(crate) fn front(bytes: &[u8]) -> Front {
    let (version, len) = match extent(bytes) {
        Ok(extent) => extent,
        Err(front) => return front,
    };
    let Some(bytes) = bytes.get(..len) else {
        return Front::Incomplete;
    };
    match raw(version, bytes).1 {
        Check::Passed => Front::Frame(len),
        Check::Failed => Front::Other,
        Check::Unknown => Front::Unknown(len),
    }
}

/// Version and length of what would be a frame at the front of `bytes`, or why there is none.
fn extent(bytes: &[u8]) -> Result<(MavlinkVersion, usize), Front> {
    const V1_OVERHEAD: usize = 8;
    const V2_OVERHEAD: usize = 12;
    match *bytes {
        [] | [MAV_STX | MAV_STX_V2] | [MAV_STX_V2, _] => Err(Front::Incomplete),
        [MAV_STX, payload, ..] => Ok((MavlinkVersion::V1, V1_OVERHEAD + usize::from(payload))),
        [MAV_STX_V2, payload, flags, ..] if flags & !v2::SUPPORTED_IFLAGS == 0 => {
            let system =
                if flags & v2::IFLAG_SYSID32 == 0 { 0 } else { v2::SYSID32_EXTRA_HEADER_SIZE };
            let signature = if flags & v2::IFLAG_SIGNED == 0 { 0 } else { v2::SIGNATURE_SIZE };
            Ok((MavlinkVersion::V2, V2_OVERHEAD + usize::from(payload) + system + signature))
        }
        _ => Err(Front::Other),
    }
}

/// What a frame's checksum says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Check {
    Passed,
    Failed,
    /// The dialect does not have the message, so that it cannot be checked.
    Unknown,
}

/// The bytes of what would be a frame, and whether its checksum is right.
fn raw(version: MavlinkVersion, bytes: &[u8]) -> (MAVLinkMessageRaw, Check) {
    let check = |id: u32, stated: u16, end: usize| match known_extra_crc(id) {
        Some(extra_crc) if stated == checksum(&bytes[1..end], extra_crc) => Check::Passed,
        Some(_) => Check::Failed,
        None => Check::Unknown,
    };
    // The checksum is over everything between the marker and itself.
    match version {
        MavlinkVersion::V1 => {
            let mut raw = MAVLinkV1MessageRaw::new();
            raw.as_mut_slice()[..bytes.len()].copy_from_slice(bytes);
            let check = check(raw.message_id().into(), raw.checksum(), bytes.len() - 2);
            (MAVLinkMessageRaw::V1(raw), check)
        }
        MavlinkVersion::V2 => {
            let mut raw = MAVLinkV2MessageRaw::new();
            raw.as_mut_slice()[..bytes.len()].copy_from_slice(bytes);
            let end = 1 + raw.header().len() + raw.payload().len();
            let check = check(raw.message_id(), raw.checksum(), end);
            (MAVLinkMessageRaw::V2(raw), check)
        }
    }
}

/// The checksum seed of a message id that the dialect has.
pub(super) fn known_extra_crc(id: u32) -> Option<u8> {
    let extra_crc = MavMessage::extra_crc(id);
    // Zero is what an unknown id gives, and what a few known ids have.
    let known = extra_crc != 0 || MavMessage::default_message_from_id(id).is_some();
    known.then_some(extra_crc)
}
