//! File transfer for a vehicle without files: it replies to every request, so a client falls back
//! at once instead of waiting for a time-out.

use wire::dialect::FILE_TRANSFER_PROTOCOL_DATA;

// Payload offsets and values of MAVLink's file transfer protocol.
const OPCODE: usize = 3;
const SIZE: usize = 4;
const REQUEST_OPCODE: usize = 5;
const DATA: usize = 12;
const ACK: u8 = 128;
const NAK: u8 = 129;
const UNKNOWN_COMMAND: u8 = 7;
const FILE_NOT_FOUND: u8 = 10;

/// The reply to a request from this system and component; `None` if `request` is itself a reply.
pub(super) fn answer(
    request: &FILE_TRANSFER_PROTOCOL_DATA,
    target_system: u8,
    target_component: u8,
) -> Option<FILE_TRANSFER_PROTOCOL_DATA> {
    let opcode = request.payload[OPCODE];
    let error = match opcode {
        ACK.. => return None,
        // None, TerminateSession, ResetSessions: nothing to do.
        0..=2 => None,
        // ListDirectory, OpenFileRO, CalcFileCRC32.
        3 | 4 | 14 => Some(FILE_NOT_FOUND),
        _ => Some(UNKNOWN_COMMAND),
    };
    let mut payload = [0; 251];
    let sequence = u16::from_le_bytes([request.payload[0], request.payload[1]]).wrapping_add(1);
    payload[..2].copy_from_slice(&sequence.to_le_bytes());
    payload[2] = request.payload[2];
    payload[OPCODE] = if error.is_some() { NAK } else { ACK };
    payload[SIZE] = u8::from(error.is_some());
    payload[REQUEST_OPCODE] = opcode;
    payload[DATA] = error.unwrap_or_default();
    Some(FILE_TRANSFER_PROTOCOL_DATA {
        target_network: 0,
        target_system,
        target_component,
        payload,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn open_is_refused_and_responses_are_ignored() {
        let mut request = FILE_TRANSFER_PROTOCOL_DATA { payload: [0; 251], ..Default::default() };
        request.payload[..4].copy_from_slice(&[255, 255, 3, 4]);
        let nak = answer(&request, 255, 190).unwrap();
        assert_eq!(nak.payload[..6], [0, 0, 3, NAK, 1, 4]);
        assert_eq!(nak.payload[DATA], FILE_NOT_FOUND);
        assert_eq!(answer(&nak, 1, 1), None);
    }
}
