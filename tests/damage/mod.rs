//! Telemetry logs made from a flight's records, and ways to damage them.

use std::fs;
use std::path::Path;

use downwash::log::record::Record;
use wire::tlog;

/// The flight's frames as entries of a telemetry log, each with its time in us.
pub fn entries(records: &[Record]) -> Vec<(u64, Vec<u8>)> {
    let entry = |record: &Record| match record {
        Record::Frame(frame) => Some((frame.host.as_ns() / 1000, frame.bytes().to_vec())),
        _ => None,
    };
    records.iter().filter_map(entry).collect()
}

/// Writes entries as a telemetry log.
pub fn write_tlog(path: &Path, entries: &[(u64, Vec<u8>)]) {
    let mut writer = tlog::Writer::new(Vec::new());
    for (time_us, bytes) in entries {
        writer.write(*time_us, bytes).expect("memory takes everything");
    }
    fs::write(path, writer.into_inner()).expect("a file");
}

/// Overwrites the payload of each frame of message `id`, in `count` entries from `from` on, with
/// `floats` and a valid checksum, as a vehicle with a failed estimator sends it.
pub fn spoil(
    entries: &mut [(u64, Vec<u8>)],
    id: u8,
    from: usize,
    count: usize,
    floats: f32,
) -> u64 {
    let mut spoiled = 0;
    for (_, bytes) in entries.iter_mut().skip(from).take(count) {
        if bytes[7..10] != [id, 0, 0] {
            continue;
        }
        let len = usize::from(bytes[1]);
        for at in (10 + 8..10 + len - 3).step_by(4) {
            bytes[at..at + 4].copy_from_slice(&floats.to_le_bytes());
        }
        spoiled += 1;
        sign(bytes);
    }
    spoiled
}

/// Sets the checksum of a MAVLink 2 frame to match its content.
pub fn sign(bytes: &mut [u8]) {
    use mavlink::Message;
    let end = bytes.len() - 2;
    let id = u32::from_le_bytes([bytes[7], bytes[8], bytes[9], 0]);
    let extra = wire::dialect::MavMessage::extra_crc(id);
    let crc = mavlink::calculate_crc(&bytes[1..end], extra).to_le_bytes();
    bytes[end..].copy_from_slice(&crc);
}

/// Shifts the vehicle's time stamps in its messages, from entry `from` on.
pub fn move_vehicle_clock(entries: &mut [(u64, Vec<u8>)], from: usize, by_ms: i64) {
    for (_, bytes) in entries.iter_mut().skip(from).filter(|(_, bytes)| bytes[5] == 1) {
        match bytes[7] {
            30..=32 => {
                let time = u32::from_le_bytes(bytes[10..14].try_into().expect("four bytes"));
                let moved = (i64::from(time) + by_ms) as u32;
                bytes[10..14].copy_from_slice(&moved.to_le_bytes());
            }
            105 | 119 => {
                let time = u64::from_le_bytes(bytes[10..18].try_into().expect("eight bytes"));
                let moved = time.wrapping_add_signed(by_ms * 1000);
                bytes[10..18].copy_from_slice(&moved.to_le_bytes());
            }
            _ if bytes[7..10] == [0x77, 0x01, 0] || bytes[7..10] == [0x4B, 0x01, 0] => {
                let time = u64::from_le_bytes(bytes[10..18].try_into().expect("eight bytes"));
                let moved = time.wrapping_add_signed(by_ms * 1000);
                bytes[10..18].copy_from_slice(&moved.to_le_bytes());
            }
            _ => continue,
        }
        sign(bytes);
    }
}
