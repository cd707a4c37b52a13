//! The stream of lines: UDP datagrams of JSON, one line for each body.
//!
//! ```text
//! {"body":"quad","t":12.345678,"p":[1.0,2.0,0.5],"q":[1.0,0.0,0.0,0.0]}
//! ```
//!
//! `docs/mocap.md` defines it.

use serde::Deserialize;

use super::sample::{Malformed, Sample};

/// Longest line, bytes.
pub const LINE_MAX: usize = 2048;
/// Longest name of a body, characters.
pub const NAME_MAX: usize = 64;

/// The keys of a line; others are ignored, so that a sender may add more.
#[derive(Deserialize)]
struct Line {
    body: String,
    t: f64,
    p: [f64; 3],
    q: [f64; 4],
    sent: Option<f64>,
    tracked: Option<bool>,
}

/// Decodes a datagram; `on` gets each of its lines in order.
pub fn decode(datagram: &[u8], mut on: impl FnMut(Result<Sample, Malformed>)) {
    for line in datagram.split(|byte| *byte == b'\n') {
        if !line.trim_ascii().is_empty() {
            on(sample(line));
        }
    }
}

fn sample(line: &[u8]) -> Result<Sample, Malformed> {
    if line.len() > LINE_MAX {
        return Err(Malformed(format!("a line of {} bytes, longer than {LINE_MAX}", line.len())));
    }
    let line: Line = serde_json::from_slice(line).map_err(|error| Malformed(error.to_string()))?;
    if line.body.is_empty() || line.body.chars().count() > NAME_MAX {
        return Err(Malformed(format!("body: expected a name of 1 to {NAME_MAX} characters")));
    }
    Ok(Sample {
        body: line.body,
        captured_s: line.t,
        sent_s: line.sent,
        position_m: line.p,
        rotation: line.q,
        is_tracked: line.tracked.unwrap_or(true),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(datagram: &[u8]) -> Vec<Result<Sample, Malformed>> {
        let mut all = Vec::new();
        decode(datagram, |line| all.push(line));
        all
    }

    #[test]
    fn datagram_lines_are_read_in_order() {
        let text = "{\"body\":\"a\",\"t\":1.5,\"p\":[1,2,3],\"q\":[1,0,0,0]}\r\n\n{\"body\":\"b\",\"t\":2,\
                    \"p\":[0,0,0],\"q\":[0,1,0,0],\"sent\":2.1,\"tracked\":false,\"note\":\"x\"}";
        let lines = read(text.as_bytes());
        let [Ok(a), Ok(b)] = lines.as_slice() else { panic!("{lines:?}") };
        assert_eq!((a.body.as_str(), a.captured_s, a.sent_s, a.is_tracked), ("a", 1.5, None, true));
        assert_eq!((a.position_m, a.rotation), ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0]));
        assert_eq!((b.body.as_str(), b.sent_s, b.is_tracked), ("b", Some(2.1), false));
    }

    #[test]
    fn malformed_line_is_refused_with_the_reason() {
        for (wrong, word) in [
            ("{\"body\":\"a\",\"t\":1,\"p\":[1,2],\"q\":[1,0,0,0]}", "length"),
            ("{\"body\":\"a\",\"t\":1,\"p\":[1,2,NaN],\"q\":[1,0,0,0]}", "expected"),
            ("{\"body\":\"a\",\"p\":[1,2,3],\"q\":[1,0,0,0]}", "`t`"),
            ("{\"body\":\"\",\"t\":1,\"p\":[1,2,3],\"q\":[1,0,0,0]}", "name"),
            ("quad 1 2 3", "expected"),
        ] {
            let lines = read(wrong.as_bytes());
            let [Err(error)] = lines.as_slice() else { panic!("{wrong}: {lines:?}") };
            assert!(error.to_string().contains(word), "{wrong}: {error}");
        }
        assert!(read(&vec![b'x'; LINE_MAX + 1])[0].is_err());
    }

    proptest! {
        #[test]
        fn line_round_trips(
            t in -1e9..1e9f64, p in prop::array::uniform3(-50.0..50.0f64),
            q in prop::array::uniform4(-1.0..1.0f64),
        ) {
            let line = serde_json::json!({"body": "quad", "t": t, "p": p, "q": q}).to_string();
            let lines = read(line.as_bytes());
            let [Ok(sample)] = lines.as_slice() else { panic!("{lines:?}") };
            prop_assert_eq!((sample.captured_s, sample.position_m, sample.rotation), (t, p, q));
        }

        #[test]
        fn arbitrary_bytes_never_panic_the_parser(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            decode(&bytes, |_| {});
        }
    }
}
