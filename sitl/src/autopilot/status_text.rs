//! Texts for people as STATUSTEXT messages.

use wire::dialect::*;

/// Splits a text into STATUSTEXT messages. `id` links the chunks; a single message has id 0.
pub fn status_text(
    severity: MavSeverity,
    text: &str,
    id: u16,
) -> impl Iterator<Item = MavMessage> + '_ {
    const CHUNK: usize = 50;
    let id = if text.len() > CHUNK { id.max(1) } else { 0 };
    text.as_bytes().chunks(CHUNK).enumerate().map(move |(sequence, chunk)| {
        let mut data = [0; CHUNK];
        data[..chunk.len()].copy_from_slice(chunk);
        MavMessage::STATUSTEXT(STATUSTEXT_DATA {
            severity,
            text: data.into(),
            id,
            chunk_seq: sequence as u8,
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_long_texts_are_chunked() {
        let long = "x".repeat(120);
        let chunks: Vec<_> = status_text(MavSeverity::MAV_SEVERITY_INFO, &long, 7).collect();
        assert_eq!(chunks.len(), 3);
        let MavMessage::STATUSTEXT(last) = &chunks[2] else { panic!("not a text") };
        assert_eq!(
            (last.id, last.chunk_seq, last.text.to_str()),
            (7, 2, Ok("x".repeat(20).as_str()))
        );
        let mut short = status_text(MavSeverity::MAV_SEVERITY_INFO, "hi", 7);
        let Some(MavMessage::STATUSTEXT(only)) = short.next() else { panic!("not a text") };
        assert_eq!(only.id, 0);
        assert!(short.next().is_none());
    }
}
