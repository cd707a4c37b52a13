//! Reads ahead from a source into a buffer.

use std::io::{self, ErrorKind, Read};

/// Fills `buffer` from `source` up to `size` bytes. Returns whether the source ended.
///
/// # Errors
/// Errors of the source; bytes read before stay in the buffer.
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
