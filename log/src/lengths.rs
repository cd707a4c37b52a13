//! Checks of lengths inside MCAP records. Version 0.26 of the `mcap` crate trusts them, and a
//! length that is too large overflows or panics there.

/// Size of a record's opcode and length.
const RECORD_HEAD: usize = 9;
/// Size of log time and creation time, before an attachment's name.
const ATTACHMENT_TIMES: usize = 16;

/// Whether records fill `chunk`, the uncompressed content of a chunk, exactly.
pub(super) fn records_fill(mut chunk: &[u8]) -> bool {
    while !chunk.is_empty() {
        let Some(([_, length @ ..], rest)) = chunk.split_first_chunk::<RECORD_HEAD>() else {
            return false;
        };
        let rest = usize::try_from(u64::from_le_bytes(*length)).ok().and_then(|n| rest.get(n..));
        let Some(rest) = rest else { return false };
        chunk = rest;
    }
    true
}

/// Whether an attachment's name, media type and data leave room for its checksum.
pub(super) fn attachment_fits(body: &[u8]) -> bool {
    let rest = body.get(ATTACHMENT_TIMES..);
    let rest = rest.and_then(after_text).and_then(after_text);
    let Some((length, rest)) = rest.and_then(|rest| rest.split_first_chunk()) else { return false };
    let checksum = usize::try_from(u64::from_le_bytes(*length)).ok().and_then(|n| rest.get(n..));
    checksum.is_some_and(|checksum| checksum.len() >= size_of::<u32>())
}

/// Skips a length-prefixed text.
fn after_text(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.get(usize::try_from(u32::from_le_bytes(*length)).ok()?..)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(length: u64, body: &[u8]) -> Vec<u8> {
        [&[5], &length.to_le_bytes()[..], body].concat()
    }

    #[test]
    fn records_must_fill_a_chunk_exactly() {
        let two = [record(3, b"abc"), record(0, b"")].concat();
        assert!(records_fill(&two) && records_fill(b""));
        for wrong in [record(4, b"abc"), record(u64::MAX, b"abc"), record(2, b"abc")] {
            assert!(!records_fill(&wrong));
        }
        assert!(!records_fill(&two[..two.len() - 1]));
    }

    #[test]
    fn attachment_lengths_must_fit_the_record_exactly() {
        let name = [&3_u32.to_le_bytes()[..], b"abc"].concat();
        let whole = |length: u64| {
            let length = length.to_le_bytes();
            [&[0; ATTACHMENT_TIMES][..], &name, &name, &length, b"data", &[0; 4]].concat()
        };
        assert!(attachment_fits(&whole(4)) && attachment_fits(&whole(0)));
        assert!(!attachment_fits(&whole(5)) && !attachment_fits(&whole(u64::MAX)));
        for length in 0..whole(4).len() {
            assert!(!attachment_fits(&whole(4)[..length]));
        }
    }
}
