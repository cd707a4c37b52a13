//! Formats of ULog: the layout of a topic's rows, as defined in the file.

use std::collections::BTreeMap;

/// Largest nesting depth of formats; real files are not deeper.
const DEPTH_MAX: usize = 8;
/// Length limit of a row: a message has two bytes for its length.
const ROW_MAX: usize = u16::MAX as usize;
/// Largest number of fields in a flattened row.
const FIELDS_MAX: usize = 4096;
/// Largest number of formats in a file.
const FORMATS_MAX: usize = 4096;

/// Type of a number in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Kind {
    fn of(name: &str) -> Option<Self> {
        Some(match name {
            "int8_t" => Self::I8,
            "uint8_t" | "bool" | "char" => Self::U8,
            "int16_t" => Self::I16,
            "uint16_t" => Self::U16,
            "int32_t" => Self::I32,
            "uint32_t" => Self::U32,
            "int64_t" => Self::I64,
            "uint64_t" => Self::U64,
            "float" => Self::F32,
            "double" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Decodes the number at the start of `bytes`.
    pub fn read(self, bytes: &[u8]) -> Option<f64> {
        macro_rules! number {
            ($kind:ty) => {
                <$kind>::from_le_bytes(*bytes.first_chunk()?) as f64
            };
        }
        Some(match self {
            Self::I8 => number!(i8),
            Self::U8 => number!(u8),
            Self::I16 => number!(i16),
            Self::U16 => number!(u16),
            Self::I32 => number!(i32),
            Self::U32 => number!(u32),
            Self::I64 => number!(i64),
            Self::U64 => number!(u64),
            Self::F32 => number!(f32),
            Self::F64 => number!(f64),
        })
    }
}

/// Position and type of a field in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub offset: usize,
    pub kind: Kind,
}

impl Place {
    /// The field's number; `None` if the row ends before it.
    pub fn read(self, row: &[u8]) -> Option<f64> {
        self.kind.read(row.get(self.offset..)?)
    }
}

/// All fields of a row. Nested fields and array elements have names such as `esc[0].esc_rpm`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Layout {
    fields: BTreeMap<String, Place>,
    /// Length of a row with and without the padding at its end, which is not written.
    full: usize,
    least: usize,
}

impl Layout {
    pub fn place(&self, field: &str) -> Option<Place> {
        self.fields.get(field).copied()
    }

    /// Whether a row can have this length in bytes.
    pub fn takes(&self, length: usize) -> bool {
        (self.least..=self.full).contains(&length)
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Field {
    type_name: String,
    name: String,
    /// Number of elements; `None` if the field is not an array.
    count: Option<usize>,
}

/// The formats that a file defines.
#[derive(Clone, Debug, Default)]
pub(super) struct Formats {
    formats: BTreeMap<String, Vec<Field>>,
}

impl Formats {
    /// Adds a definition such as `name:type field;type[4] field;`. Returns whether it is valid.
    pub fn define(&mut self, text: &str) -> bool {
        let Some((name, fields)) = text.split_once(':') else { return false };
        let fields: Option<Vec<Field>> =
            fields.split(';').filter(|field| !field.is_empty()).map(field).collect();
        let Some(fields) = fields else { return false };
        let is_new = !self.formats.contains_key(name);
        if !is_name(name) || is_new && self.formats.len() == FORMATS_MAX {
            return false;
        }
        match self.formats.get(name) {
            // A repeated definition is fine; a different one for the same name is not.
            Some(known) => *known == fields,
            None => {
                self.formats.insert(name.to_owned(), fields);
                true
            }
        }
    }

    /// The layout of a format; `None` if it is not completely defined.
    pub fn layout(&self, name: &str) -> Option<Layout> {
        let mut layout = Layout::default();
        self.append(&mut layout, name, "", 0)?;
        Some(layout)
    }

    fn append(&self, layout: &mut Layout, format: &str, prefix: &str, depth: usize) -> Option<()> {
        if depth > DEPTH_MAX {
            return None;
        }
        for Field { type_name, name, count } in self.formats.get(format)? {
            let is_padding = name.starts_with("_padding");
            if let (true, Some(kind)) = (is_padding, Kind::of(type_name)) {
                layout.full += kind.size() * count.unwrap_or(1);
            } else {
                for at in 0..count.unwrap_or(1) {
                    let name = match count {
                        Some(_) => format!("{prefix}{name}[{at}]"),
                        None => format!("{prefix}{name}"),
                    };
                    match Kind::of(type_name) {
                        Some(kind) => {
                            layout.fields.insert(name, Place { offset: layout.full, kind });
                            layout.full += kind.size();
                            layout.least = layout.full;
                        }
                        None => {
                            self.append(layout, type_name, &format!("{name}."), depth + 1)?;
                        }
                    }
                    if layout.full > ROW_MAX || layout.fields.len() > FIELDS_MAX {
                        return None;
                    }
                }
            }
        }
        (layout.full <= ROW_MAX).then_some(())
    }
}

/// Parses `type name` or `type[count] name`.
fn field(text: &str) -> Option<Field> {
    let (kind, name) = text.trim().split_once(' ')?;
    let (type_name, count) = match kind.split_once('[') {
        Some((kind, count)) => {
            let count: usize = count.strip_suffix(']')?.parse().ok()?;
            (kind, Some(count))
        }
        None => (kind, None),
    };
    let is_sound = is_name(type_name) && is_name(name) && count.is_none_or(|n| n <= ROW_MAX);
    is_sound.then(|| Field { type_name: type_name.to_owned(), name: name.to_owned(), count })
}

/// Whether a text can name a type, a topic, a field or a parameter.
pub(super) fn is_name(text: &str) -> bool {
    let is_plain = |c: u8| c.is_ascii_alphanumeric() || matches!(c, b'_' | b'-' | b'/' | b'.');
    !text.is_empty() && text.bytes().all(is_plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn formats(texts: &[&str]) -> Formats {
        let mut formats = Formats::default();
        assert!(texts.iter().all(|text| formats.define(text)));
        formats
    }

    #[test]
    fn nested_fields_and_arrays_are_laid_out_contiguously() {
        let formats = formats(&[
            "esc_report:uint64_t timestamp;float esc_rpm;uint8_t[4] _padding0;",
            "esc_status:uint64_t timestamp;esc_report[2] esc;uint8_t count;uint8_t[7] _padding0;",
        ]);
        let layout = formats.layout("esc_status").expect("a layout");
        let place = layout.place("esc[1].esc_rpm").expect("a field");
        assert_eq!(place, Place { offset: 8 + 16 + 8, kind: Kind::F32 });
        // The padding at the end is not written; the padding of elements is.
        assert!(layout.takes(41) && layout.takes(48) && !layout.takes(40) && !layout.takes(49));
        assert_eq!(layout.place("_padding0"), None);
    }

    #[test]
    fn recursive_oversized_or_incomplete_formats_have_no_layout() {
        let formats = formats(&[
            "loop:uint8_t x;loop[3] next;",
            "many:uint8_t[70000000000] x;uint8_t y;".replace("70000000000", "60000").as_str(),
            "open:missing x;",
            "empty:",
        ]);
        for name in ["loop", "many", "open", "unknown"] {
            assert_eq!(formats.layout(name), None, "{name}");
        }
        assert!(formats.layout("empty").is_some());
    }

    #[test]
    fn malformed_format_definitions_are_refused() {
        let mut formats = Formats::default();
        for text in
            ["", "name", "name:float", "na me:float x;", "n:float[x] y;", "n:float[99999] y;"]
        {
            assert!(!formats.define(text), "{text}");
        }
        assert!(formats.define("n:float x;") && formats.define("n:float x;"));
        assert!(!formats.define("n:double x;"));
    }
}
