//! The BSON documents in which PX4 stores its parameters.

use super::{Set, name_of};

/// Whether a file looks like a document rather than text.
pub(super) fn is_document(bytes: &[u8]) -> bool {
    bytes.len() > 5 && bytes.last() == Some(&0) && bytes.get(..4).is_some_and(|b| b.contains(&0))
}

/// Parses a BSON document: its length, then elements of a type, a name and a value, then 0.
pub(super) fn read(bytes: &[u8]) -> Option<Set> {
    let mut rest = bytes.get(4..)?;
    let mut set = Set::default();
    for element in 1.. {
        let (kind, after) = rest.split_first()?;
        if *kind == 0 {
            break;
        }
        let end = after.iter().position(|byte| *byte == 0)?;
        let name = name_of(std::str::from_utf8(after.get(..end)?).ok()?)?;
        rest = after.get(end + 1..)?;
        let value = match kind {
            0x01 => f64::from_le_bytes(*rest.first_chunk::<8>()?),
            0x10 => f64::from(i32::from_le_bytes(*rest.first_chunk::<4>()?)),
            0x12 => i64::from_le_bytes(*rest.first_chunk::<8>()?) as f64,
            _ => return None,
        };
        rest = rest.get(if *kind == 0x10 { 4 } else { 8 }..)?;
        set.add(format!("element {element}"), name, &value.to_string());
    }
    Some(set)
}
