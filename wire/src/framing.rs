//! Incremental MAVLink framing, sans I/O: it turns bytes into checked frames and messages into
//! bytes.

mod decoder;
mod encoder;
mod frame;

pub use decoder::{Decoder, DecoderStats};
pub use encoder::Encoder;
pub use frame::{Frame, message_name};
pub(crate) use frame::{Front, Signature, front};

#[cfg(test)]
mod tests {
    use mavlink::consts::v2;
    use mavlink::{MAV_STX_V2, MavlinkVersion, Message};
    use proptest::prelude::*;

    use super::*;
    use crate::dialect::*;

    fn attitude(number: u32) -> MavMessage {
        let data = ATTITUDE_DATA { time_boot_ms: number, yaw: 1.5, ..Default::default() };
        MavMessage::ATTITUDE(data)
    }

    fn encoded(number: u32, version: MavlinkVersion) -> Vec<u8> {
        let mut encoder = Encoder::new(1, 2);
        encoder.set_version(version);
        let mut bytes = Vec::new();
        assert!(encoder.encode(&attitude(number), &mut bytes));
        bytes
    }

    fn drain(decoder: &mut Decoder) -> Vec<Frame> {
        std::iter::from_fn(|| decoder.next_frame()).collect()
    }

    #[test]
    fn frames_of_both_versions_round_trip() {
        let mut decoder = Decoder::new();
        for version in [MavlinkVersion::V1, MavlinkVersion::V2] {
            let bytes = encoded(7, version);
            decoder.push(&bytes);
            let frame = decoder.next_frame().unwrap();
            assert_eq!(frame.bytes(), bytes);
            assert_eq!((frame.system(), frame.component(), frame.sequence()), (1, 2, 0));
            assert_eq!(frame.message().unwrap(), attitude(7));
            let parsed = Frame::parse(&bytes).unwrap();
            assert_eq!((parsed.bytes(), parsed.id()), (frame.bytes(), frame.id()));
            assert!(Frame::parse(&bytes[1..]).is_none() && Frame::parse(&[]).is_none());
            assert!(Frame::parse(&bytes[..bytes.len() - 1]).is_none());
            assert!(Frame::parse(&[&bytes[..], &[0]].concat()).is_none());
        }
        assert_eq!(decoder.stats().frames, 2);
        assert_eq!(decoder.stats().unframed_bytes, 0);
    }

    #[test]
    fn signed_frame_is_decoded() {
        let mut bytes = encoded(1, MavlinkVersion::V2);
        let crc_start = bytes.len() - 2;
        bytes[2] |= v2::IFLAG_SIGNED;
        let extra_crc = MavMessage::extra_crc(30);
        let crc = mavlink::calculate_crc(&bytes[1..crc_start], extra_crc).to_le_bytes();
        bytes[crc_start..].copy_from_slice(&crc);
        bytes.extend([7; v2::SIGNATURE_SIZE]);
        let mut decoder = Decoder::new();
        decoder.push(&bytes);
        assert_eq!(decoder.next_frame().unwrap().bytes(), bytes);
        assert_eq!(front(&bytes), Front::Frame(bytes.len()));
    }

    #[test]
    fn message_ids_beyond_mavlink_1_are_not_encoded() {
        let mut encoder = Encoder::new(1, 1);
        encoder.set_version(MavlinkVersion::V1);
        let mut bytes = Vec::new();
        assert!(!encoder.encode(&MavMessage::ODOMETRY(Default::default()), &mut bytes));
        assert!(bytes.is_empty());
    }

    #[test]
    fn sequence_number_wraps() {
        let mut encoder = Encoder::new(1, 1);
        let mut decoder = Decoder::new();
        for k in 0..300u32 {
            let mut bytes = Vec::new();
            encoder.encode(&attitude(k), &mut bytes);
            decoder.push(&bytes);
            assert_eq!(u32::from(decoder.next_frame().unwrap().sequence()), k % 256);
        }
    }

    #[test]
    fn checksum_errors_and_unknown_ids_are_counted_separately() {
        let mut broken = encoded(1, MavlinkVersion::V2);
        *broken.last_mut().unwrap() ^= 1;
        let unknown = [MAV_STX_V2, 1, 0, 0, 0, 1, 1, 0xFF, 0xFF, 0x70, 9, 0, 0];
        let good = encoded(2, MavlinkVersion::V2);
        let mut decoder = Decoder::new();
        decoder.push(&[&broken[..], &unknown, &good].concat());
        assert_eq!(drain(&mut decoder).len(), 1);
        let stats = decoder.stats();
        assert_eq!((stats.frames, stats.crc_errors, stats.unknown), (1, 1, 1));
        assert_eq!(stats.unframed_bytes as usize, broken.len() + unknown.len());
    }

    #[test]
    fn truncated_datagram_does_not_swallow_the_next() {
        let frame = encoded(1, MavlinkVersion::V2);
        let mut decoder = Decoder::new();
        for cut in 0..frame.len() {
            decoder.datagram(&frame[..cut], |_| panic!("there was no whole frame"));
            let mut frames = 0;
            decoder.datagram(&frame, |_| frames += 1);
            assert_eq!(frames, 1, "after a cut at {cut}");
        }
    }

    #[test]
    fn frame_after_a_false_start_is_found_at_datagram_end() {
        // The marker and length byte claim more than the datagram has.
        let mut datagram = vec![MAV_STX_V2, 255, 0];
        datagram.extend(encoded(3, MavlinkVersion::V2));
        let mut decoder = Decoder::new();
        let mut frames = 0;
        decoder.datagram(&datagram, |_| frames += 1);
        assert_eq!(frames, 1);
    }

    /// An ATTITUDE frame with its payload cut or padded to `len`. Its length byte and checksum are
    /// recomputed, so the framing is valid.
    fn resized(version: MavlinkVersion, len: u8) -> Vec<u8> {
        let mut bytes = encoded(1, version);
        let header = if version == MavlinkVersion::V2 { 10 } else { 6 };
        bytes.resize(header + usize::from(len), 0x55);
        bytes[1] = len;
        let crc = mavlink::calculate_crc(&bytes[1..], MavMessage::extra_crc(30));
        bytes.extend(crc.to_le_bytes());
        bytes
    }

    #[test]
    fn payloads_of_any_length_are_framed_and_never_panic() {
        for version in [MavlinkVersion::V1, MavlinkVersion::V2] {
            for len in 0..=u8::MAX {
                let bytes = resized(version, len);
                let mut decoder = Decoder::new();
                decoder.push(&bytes);
                let frame = decoder.next_frame().expect("its checksum is right");
                assert_eq!((frame.bytes(), frame.payload().len()), (&bytes[..], len.into()));
                // Missing bytes are zero and surplus bytes are ignored, as in MAVLink 2.
                assert!(frame.message().is_ok(), "{version:?} {len}");
                assert_eq!(decoder.stats().unframed_bytes, 0);
            }
        }
    }

    #[test]
    fn wrong_length_byte_fails_the_checksum_and_decoding_recovers() {
        let next = encoded(2, MavlinkVersion::V2);
        for version in [MavlinkVersion::V1, MavlinkVersion::V2] {
            let honest = encoded(1, version);
            for claimed in (0..=u8::MAX).filter(|&claimed| claimed != honest[1]) {
                let mut bytes = honest.clone();
                bytes[1] = claimed;
                bytes.extend(&next);
                let mut decoder = Decoder::new();
                decoder.push(&bytes);
                let mut frames = drain(&mut decoder);
                decoder.end_datagram(|frame| frames.push(frame));
                assert_eq!(frames.len(), 1, "{version:?} {claimed}");
                assert_eq!(frames[0].bytes(), next);
                let stats = decoder.stats();
                assert!(stats.crc_errors >= 1, "{version:?} {claimed}");
                assert_eq!(stats.unframed_bytes as usize, honest.len());
            }
        }
    }

    #[test]
    fn truncated_signed_frame_is_dropped_and_decoding_recovers() {
        let mut signed = resized(MavlinkVersion::V2, 28);
        let crc_start = signed.len() - 2;
        signed[2] |= v2::IFLAG_SIGNED;
        let crc = mavlink::calculate_crc(&signed[1..crc_start], MavMessage::extra_crc(30));
        signed[crc_start..].copy_from_slice(&crc.to_le_bytes());
        signed.extend([7; v2::SIGNATURE_SIZE]);
        let next = encoded(2, MavlinkVersion::V2);
        let mut decoder = Decoder::new();
        for cut in 1..signed.len() {
            let dropped_before = decoder.stats().unframed_bytes;
            decoder.push(&signed[..cut]);
            decoder.end_datagram(|_| panic!("cut at {cut} it is no frame"));
            assert_eq!((decoder.stats().unframed_bytes - dropped_before) as usize, cut);
            decoder.push(&next);
            let frame = decoder.next_frame().expect("whole");
            assert_eq!(frame.bytes(), next, "after a cut at {cut}");
        }
    }

    #[derive(Clone, Debug)]
    enum Piece {
        Frame(Vec<u8>),
        Garbage(Vec<u8>),
    }

    fn any_piece() -> impl Strategy<Value = Piece> {
        prop_oneof![
            any::<u32>().prop_map(|n| Piece::Frame(encoded(n, MavlinkVersion::V1))),
            any::<u32>().prop_map(|n| Piece::Frame(encoded(n, MavlinkVersion::V2))),
            prop::collection::vec(any::<u8>(), 0..300).prop_map(Piece::Garbage),
        ]
    }

    proptest! {
        #[test]
        fn every_frame_is_found_amid_garbage_and_any_chunking(
            pieces in prop::collection::vec(any_piece(), 0..20),
            chunk in 1usize..400,
        ) {
            let wire: Vec<u8> = pieces
                .iter()
                .flat_map(|piece| match piece {
                    Piece::Frame(bytes) | Piece::Garbage(bytes) => bytes.iter().copied(),
                })
                .collect();
            let mut decoder = Decoder::new();
            let mut frames = Vec::new();
            for chunk in wire.chunks(chunk) {
                decoder.push(chunk);
                frames.extend(drain(&mut decoder));
            }
            decoder.end_datagram(|frame| frames.push(frame));
            let sent: Vec<_> = pieces
                .iter()
                .filter_map(|piece| match piece {
                    Piece::Frame(bytes) => Some(bytes.clone()),
                    Piece::Garbage(_) => None,
                })
                .collect();
            let found: Vec<_> = frames.iter().map(|frame| frame.bytes().to_vec()).collect();
            prop_assert_eq!(&found, &sent);
            let stats = decoder.stats();
            let framed: usize = frames.iter().map(|frame| frame.bytes().len()).sum();
            prop_assert_eq!(stats.bytes as usize, wire.len());
            prop_assert_eq!(stats.unframed_bytes as usize, wire.len() - framed);
            // The same bytes as one datagram.
            let (mut decoder, mut found) = (Decoder::new(), Vec::new());
            decoder.datagram(&wire, |frame| found.push(frame.bytes().to_vec()));
            prop_assert_eq!(found, sent);
            prop_assert_eq!((decoder.stats().bytes, decoder.stats().unframed_bytes), (stats.bytes, stats.unframed_bytes));
        }

        #[test]
        fn front_agrees_with_the_decoder(
            bytes in prop::collection::vec(any::<u8>(), 0..300),
            number in any::<u32>(),
        ) {
            let frame = encoded(number, MavlinkVersion::V2);
            let with_tail = [&frame[..], &bytes].concat();
            prop_assert_eq!(front(&with_tail), Front::Frame(frame.len()));
            for cut in 0..frame.len() {
                prop_assert_eq!(front(&frame[..cut]), Front::Incomplete);
            }
            let _ = front(&bytes);
        }
    }
}
