//! Decodes the text of a table, in any encoding.

use std::io::{self, BufRead, BufReader, Cursor, Read};

use encoding_rs::{Encoding, UTF_16BE, UTF_16LE};
use encoding_rs_io::DecodeReaderBytesBuilder;

use super::super::read_ahead::read_ahead;

/// Number of bytes that determine the encoding.
const HEAD: usize = 4096;
/// Number of bytes that [`BufRead::fill_buf`] returns at least at the start.
const FIRST: usize = 16;
/// Length limit of a line above the table; a file with longer lines is not a table.
const LINE_MAX: u64 = 1 << 20;

/// Decodes bytes to UTF-8: by their byte order mark, or as UTF-16 if every second byte is zero.
/// Other bytes without a mark stay unchanged.
///
/// # Errors
/// Errors of `source`.
pub(in crate::import) fn decoded(mut source: impl Read) -> io::Result<impl BufRead> {
    let mut head = Vec::new();
    read_ahead(&mut source, &mut head, HEAD)?;
    let encoding = unmarked(&head);
    let bytes = Cursor::new(head).chain(source);
    let mut decoder =
        DecodeReaderBytesBuilder::new().encoding(encoding).strip_bom(true).build(bytes);
    // The decoder returns its first bytes one by one, too few to recognise a line.
    let mut first = Vec::new();
    read_ahead(&mut decoder, &mut first, FIRST)?;
    Ok(Cursor::new(first).chain(BufReader::with_capacity(1 << 16, decoder)))
}

/// Detects UTF-16 without a mark: text in Latin script has a zero in every second byte.
fn unmarked(head: &[u8]) -> Option<&'static Encoding> {
    let zeros = |from: usize| head.iter().skip(from).step_by(2).filter(|b| **b == 0).count();
    let is_most = |count: usize| head.len() >= 8 && 2 * count > head.len() / 2;
    match (is_most(zeros(0)), is_most(zeros(1))) {
        (true, false) => Some(UTF_16BE),
        (false, true) => Some(UTF_16LE),
        _ => None,
    }
}

/// Reads a line without its end and replaces bytes that are not UTF-8; `None` at the end.
///
/// # Errors
/// Errors of `source`.
pub(super) fn line(source: &mut impl BufRead) -> io::Result<Option<String>> {
    let mut bytes = Vec::new();
    if Read::take(&mut *source, LINE_MAX).read_until(b'\n', &mut bytes)? == 0 {
        return Ok(None);
    }
    let line = String::from_utf8_lossy(&bytes);
    Ok(Some(line.trim_end_matches(['\r', '\n']).to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoding_gives_the_same_text() {
        let text = "t;höhe\r\n0;1\r\n";
        let wide = |big: bool| {
            let bytes = |unit: u16| if big { unit.to_be_bytes() } else { unit.to_le_bytes() };
            text.encode_utf16().flat_map(bytes).collect::<Vec<u8>>()
        };
        let marked = |mark: &[u8], bytes: &[u8]| [mark, bytes].concat();
        for bytes in [
            text.as_bytes().to_vec(),
            marked(b"\xEF\xBB\xBF", text.as_bytes()),
            marked(b"\xFF\xFE", &wide(false)),
            marked(b"\xFE\xFF", &wide(true)),
            wide(false),
            wide(true),
        ] {
            let mut source = decoded(bytes.as_slice()).unwrap();
            assert_eq!(line(&mut source).unwrap().as_deref(), Some("t;höhe"));
            assert_eq!(line(&mut source).unwrap().as_deref(), Some("0;1"));
            assert_eq!(line(&mut source).unwrap(), None);
        }
    }
}
