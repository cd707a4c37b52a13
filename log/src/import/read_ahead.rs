//! Bytes of a source, some ahead of where they are read.

use std::io::{self, ErrorKind, Read};

/// Adds bytes of `source` to `buffer` until it holds `size`, or the source ends; whether it ended.
///
/// # Errors
/// Those of the source; what was read before stays in the buffer.
pub(super) fn read_ahead(
    source: &mut impl Read,
    buffer: &mut Vec<u8>,
    size: usize,
) -> io::Result<bool> {
    let mut end = buffer.len();
    buffer.resize(size.max(end), 0);
    let mut outcome = Ok(false);
    while end < buffer.len() {
        match source.read(&mut buffer[end..]) {
            Ok(0) => {
                outcome = Ok(true);
                break;
            }
            Ok(count) => end += count,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => {
                outcome = Err(error);
                break;
            }
        }
    }
    buffer.truncate(end);
    outcome
}
