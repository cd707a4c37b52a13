//! One frame: its extent, fields and checksum.

use mavlink::consts::v2;
use mavlink::error::ParserError;
use mavlink::{
    MAV_STX, MAV_STX_V2, MAVLinkMessageRaw, MAVLinkV1MessageRaw, MAVLinkV2MessageRaw,
    MavlinkVersion, Message,
};

use crate::dialect::MavMessage;
use crate::signing::Stamp;

/// One frame with a valid checksum.
pub struct Frame {
    pub(super) raw: MAVLinkMessageRaw,
}

impl Frame {
    /// Parses `bytes` as one frame, such as an entry of a log. Returns `None` unless they are
    /// exactly one frame with a known message id and a valid checksum.
    pub fn parse(bytes: &[u8]) -> Option<Self> {
        Self::at_front(bytes).filter(|frame| frame.bytes().len() == bytes.len())
    }

    /// The frame at the front of `bytes`, if it is complete and valid.
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

    /// Whether the frame carries a signature (MAVLink 2). A [`Verifier`](crate::signing::Verifier)
    /// checks it.
    pub fn is_signed(&self) -> bool {
        self.bytes().get(2).is_some_and(|flags| {
            self.version() == MavlinkVersion::V2 && flags & v2::IFLAG_SIGNED != 0
        })
    }

    /// The link id and stamp of a signed frame, both unverified.
    pub fn signed_at(&self) -> Option<(u8, Stamp)> {
        self.signature().map(|signature| (signature.link, signature.stamp))
    }

    /// The frame's signature, unverified.
    pub(crate) fn signature(&self) -> Option<Signature<'_>> {
        if !self.is_signed() {
            return None;
        }
        let (rest, hash) = self.bytes().split_last_chunk()?;
        let (_, [link, stamp @ ..]) = rest.split_last_chunk::<7>()?;
        Some(Signature { link: *link, stamp: Stamp::from_bytes(*stamp), signed: rest, hash: *hash })
    }

    /// The whole frame as received, signature included.
    pub fn bytes(&self) -> &[u8] {
        match &self.raw {
            MAVLinkMessageRaw::V1(raw) => raw.raw_bytes(),
            MAVLinkMessageRaw::V2(raw) => raw.raw_bytes(),
        }
    }

    /// Payload bytes as received; MAVLink 2 truncates trailing zeros.
    pub fn payload(&self) -> &[u8] {
        self.raw.payload()
    }

    /// Decodes the payload.
    ///
    /// # Errors
    /// [`ParserError`] if the payload does not fit the message, such as an enum value that the
    /// dialect lacks. The frame itself is intact.
    pub fn message(&self) -> Result<MavMessage, ParserError> {
        MavMessage::parse(self.version(), self.id(), self.payload())
    }
}

/// The signature at the end of a frame.
pub(crate) struct Signature<'a> {
    /// Link id, chosen by the sender.
    pub(crate) link: u8,
    pub(crate) stamp: Stamp,
    /// The bytes that the hash covers.
    pub(crate) signed: &'a [u8],
    pub(crate) hash: [u8; 6],
}

/// The checksum of a frame's bytes after its marker: CRC-16/MCRF4XX, followed by the message's
/// extra byte. It uses no table, which would be out of the cache for every frame after a pause.
pub(super) fn checksum(bytes: &[u8], extra_crc: u8) -> u16 {
    bytes.iter().chain([&extra_crc]).fold(0xFFFF, |crc: u16, byte| {
        let low = byte ^ crc as u8;
        let low = u16::from(low ^ (low << 4));
        (crc >> 8) ^ (low << 8) ^ (low << 3) ^ (low >> 4)
    })
}

/// The result of a search at the front of a slice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Front {
    /// A frame of this length with a valid checksum.
    Frame(usize),
    /// A possible frame of this length with a message id that the dialect lacks.
    Unknown(usize),
    /// Possibly the start of a frame; more bytes are needed.
    Incomplete,
    /// Not a frame.
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

/// Version and length of a possible frame at the front of `bytes`, or why there is none.
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

/// The result of a checksum check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Check {
    Passed,
    Failed,
    /// The dialect lacks the message, so the checksum cannot be checked.
    Unknown,
}

/// Copies a possible frame and checks its checksum.
fn raw(version: MavlinkVersion, bytes: &[u8]) -> (MAVLinkMessageRaw, Check) {
    let check = |id: u32, stated: u16, end: usize| match known_extra_crc(id) {
        Some(extra_crc) if stated == checksum(&bytes[1..end], extra_crc) => Check::Passed,
        Some(_) => Check::Failed,
        None => Check::Unknown,
    };
    // The checksum covers everything between the marker and itself.
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

/// The name of a message in the dialect, or its number.
pub fn message_name(id: u32) -> String {
    MavMessage::default_message_from_id(id)
        .map_or_else(|| format!("message {id}"), |message| message.message_name().to_owned())
}

/// The checksum's extra byte for a message id; `None` if the dialect lacks the message.
pub(super) fn known_extra_crc(id: u32) -> Option<u8> {
    let extra_crc = MavMessage::extra_crc(id);
    // An unknown id yields zero, and so do a few known ids.
    let known = extra_crc != 0 || MavMessage::default_message_from_id(id).is_some();
    known.then_some(extra_crc)
}
