//! STATUSTEXT: long texts come in chunks of 50 bytes.

use wire::dialect::STATUSTEXT_DATA;

/// Length limit of a text in bytes: 256 chunks, the range of the chunk number.
const TEXT_MAX: usize = 256 * 50;

/// Joins the chunks of a text.
#[derive(Debug, Default)]
pub(crate) struct TextAssembler {
    id: u16,
    next_chunk: u8,
    bytes: Vec<u8>,
}

impl TextAssembler {
    /// Adds a chunk and returns the whole text once its last chunk arrives. Drops an incomplete
    /// text when another begins; a lost chunk leaves dots.
    pub(crate) fn push(&mut self, data: &STATUSTEXT_DATA) -> Option<String> {
        let chunk: &[u8] = &data.text[..];
        let len = chunk.iter().position(|&byte| byte == 0).unwrap_or(chunk.len());
        let is_last = len < chunk.len();
        let chunk = chunk.get(..len)?;
        if data.id == 0 {
            return Some(clean(chunk));
        }
        if data.id != self.id || data.chunk_seq == 0 {
            self.id = data.id;
            self.next_chunk = 0;
            self.bytes.clear();
        }
        if data.chunk_seq != self.next_chunk {
            self.bytes.extend_from_slice(b"...");
        }
        self.bytes.extend_from_slice(chunk);
        self.next_chunk = data.chunk_seq.wrapping_add(1);
        if !is_last && self.bytes.len() < TEXT_MAX {
            return None;
        }
        let text = clean(&self.bytes);
        *self = Self::default();
        Some(text)
    }
}

/// Trims the end: PX4 appends a tab to texts that also exist as events.
fn clean(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(id: u16, chunk_seq: u8, text: &str) -> STATUSTEXT_DATA {
        STATUSTEXT_DATA { id, chunk_seq, text: text.into(), ..Default::default() }
    }

    #[test]
    fn single_chunk_text_is_complete() {
        let mut texts = TextAssembler::default();
        let text = texts.push(&chunk(0, 0, "Arming denied: high throttle\t"));
        assert_eq!(text.as_deref(), Some("Arming denied: high throttle"));
    }

    #[test]
    fn chunks_are_joined_and_a_lost_chunk_is_marked() {
        let full = "x".repeat(50);
        let mut texts = TextAssembler::default();
        assert_eq!(texts.push(&chunk(7, 0, &full)), None);
        assert_eq!(texts.push(&chunk(7, 1, "end\t")), Some(format!("{full}end")));
        assert_eq!(texts.push(&chunk(8, 0, &full)), None);
        assert_eq!(texts.push(&chunk(8, 2, "end")), Some(format!("{full}...end")));
    }

    #[test]
    fn unfinished_text_is_dropped_for_the_next() {
        let mut texts = TextAssembler::default();
        assert_eq!(texts.push(&chunk(1, 0, &"a".repeat(50))), None);
        assert_eq!(texts.push(&chunk(2, 0, "b")), Some("b".to_owned()));
    }
}
