//! The definitions in a DataFlash log: the bytes of each message (FMT), and the units of its fields
//! (FMTU, UNIT, MULT).

use std::collections::BTreeMap;

use crate::import::RPM;

/// Length of a message's header: two marks and its type.
pub(super) const HEAD: usize = 3;
/// Type of the message that defines all messages, including itself.
pub(super) const FMT: u8 = 128;
/// Length of that message, header included.
pub(super) const FMT_LENGTH: usize = HEAD + 86;

/// A field of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Field {
    name: String,
    format: u8,
    offset: usize,
}

/// The fields of one type of message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub name: String,
    /// Length of a message, header included.
    pub length: usize,
    fields: Vec<Field>,
}

impl Layout {
    /// Parses the body of a FMT message: the type that it defines, and the layout. `None` if it
    /// contradicts itself.
    pub fn parse(body: &[u8]) -> Option<(u8, Self)> {
        let (&[kind, length], rest) = body.split_first_chunk()?;
        let (name, rest) = rest.split_at_checked(4)?;
        let (format, columns) = rest.split_at_checked(16)?;
        let (name, format, columns) = (text(name)?, text(format)?, text(columns.get(..64)?)?);
        let names: Vec<&str> = columns.split(',').filter(|name| !name.is_empty()).collect();
        if names.len() != format.len() || name.is_empty() {
            return None;
        }
        let mut fields = Vec::with_capacity(names.len());
        let mut offset = 0;
        for (field, format) in names.into_iter().zip(format.bytes()) {
            fields.push(Field { name: field.to_owned(), format, offset });
            offset += size(format)?;
        }
        let length = usize::from(length);
        let fits = length == HEAD + offset;
        fits.then(|| (kind, Self { name: name.to_owned(), length, fields }))
    }

    /// Finds a field by the first of several names that it had over the years.
    pub fn field(&self, names: &[&str]) -> Option<Access> {
        let at = names.iter().find_map(|name| self.fields.iter().position(|f| f.name == *name))?;
        let Field { format, offset, .. } = self.fields[at];
        Some(Access { at, format, offset })
    }
}

/// Place and format of a field in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Access {
    at: usize,
    format: u8,
    offset: usize,
}

impl Access {
    /// Whether the format is an integer without a scale.
    pub fn is_integer(self) -> bool {
        matches!(self.format, b'b' | b'B' | b'h' | b'H' | b'i' | b'I')
    }

    /// Whether the format is hundredths in a signed integer of 16 bits.
    pub fn is_short_hundredths(self) -> bool {
        self.format == b'c'
    }

    /// The field's number in the unit of its label, before multipliers.
    pub fn number(self, body: &[u8]) -> Option<f64> {
        let bytes = body.get(self.offset..)?;
        macro_rules! number {
            ($kind:ty) => {
                <$kind>::from_le_bytes(*bytes.first_chunk()?) as f64
            };
        }
        Some(match self.format {
            b'b' => number!(i8),
            b'B' | b'M' => number!(u8),
            b'h' => number!(i16),
            b'H' => number!(u16),
            b'i' => number!(i32),
            b'I' => number!(u32),
            b'q' => number!(i64),
            b'Q' => number!(u64),
            b'f' => number!(f32),
            b'd' => number!(f64),
            b'g' => half(u16::from_le_bytes(*bytes.first_chunk()?)),
            b'c' => number!(i16) * 0.01,
            b'C' => number!(u16) * 0.01,
            b'e' => number!(i32) * 0.01,
            b'E' => number!(u32) * 0.01,
            b'L' => number!(i32) * 1e-7,
            _ => return None,
        })
    }

    /// The field's text.
    pub fn text(self, body: &[u8]) -> Option<&str> {
        let length = match self.format {
            b'n' => 4,
            b'N' => 16,
            b'Z' => 64,
            _ => return None,
        };
        text(body.get(self.offset..self.offset + length)?)
    }
}

/// Length of a field in bytes.
fn size(format: u8) -> Option<usize> {
    Some(match format {
        b'b' | b'B' | b'M' => 1,
        b'h' | b'H' | b'c' | b'C' | b'g' => 2,
        b'i' | b'I' | b'e' | b'E' | b'L' | b'f' | b'n' => 4,
        b'q' | b'Q' | b'd' => 8,
        b'N' => 16,
        b'Z' | b'a' => 64,
        _ => return None,
    })
}

/// A zero-terminated text; a text that fills its field has no zero.
fn text(bytes: &[u8]) -> Option<&str> {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    let text = std::str::from_utf8(&bytes[..end]).ok()?;
    (!text.chars().any(char::is_control)).then_some(text)
}

/// A number in IEEE 754 half precision.
fn half(bits: u16) -> f64 {
    let sign = if bits & 0x8000 == 0 { 1.0 } else { -1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1F), f64::from(bits & 0x3FF));
    sign * match exponent {
        0 => fraction * 2f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        exponent => (1.0 + fraction / 1024.0) * 2f64.powi(exponent - 15),
    }
}

/// The units of the fields that a log states.
#[derive(Clone, Debug, Default)]
pub(super) struct Units {
    labels: BTreeMap<u8, String>,
    multipliers: BTreeMap<u8, f64>,
    /// The ids of each field's unit and multiplier, by type of message.
    fields: BTreeMap<u8, (Vec<u8>, Vec<u8>)>,
}

impl Units {
    pub fn add_label(&mut self, id: f64, label: &str) {
        self.labels.insert(id as u8, label.to_owned());
    }

    pub fn add_multiplier(&mut self, id: f64, multiplier: f64) {
        self.multipliers.insert(id as u8, multiplier);
    }

    pub fn add_fields(&mut self, kind: f64, units: &str, multipliers: &str) {
        let entry = (units.bytes().collect(), multipliers.bytes().collect());
        self.fields.insert(kind as u8, entry);
    }

    /// Drops what is known of the fields of a type of message.
    pub fn forget_fields(&mut self, kind: u8) {
        self.fields.remove(&kind);
    }

    /// The factor from a field's number to SI, if the log states it; else `default_factor`, as in
    /// logs before 2018.
    pub fn factor(&self, kind: u8, access: Access, default_factor: f64) -> f64 {
        let stated = || {
            let (units, multipliers) = self.fields.get(&kind)?;
            let unit = match self.labels.get(units.get(access.at)?)?.as_str() {
                "deg" | "degheading" | "deg/s" => 1f64.to_radians(),
                "rad" | "rad/s" | "m" | "m/s" | "m/s/s" | "V" | "s" => 1.0,
                "rpm" => RPM,
                _ => return None,
            };
            // These formats include their multiplier.
            let has_own = matches!(access.format, b'c' | b'C' | b'e' | b'E' | b'L');
            let multiplier = self.multipliers.get(multipliers.get(access.at)?);
            let multiplier = multiplier.copied().filter(|m| *m != 0.0 && m.is_finite() && !has_own);
            Some(unit * multiplier.map_or(1.0, decimal))
        };
        stated().unwrap_or(default_factor)
    }
}

/// The exact power of ten that a multiplier in single precision stands for, if it is one.
fn decimal(multiplier: f64) -> f64 {
    let power = 10f64.powi(multiplier.abs().log10().round() as i32).copysign(multiplier);
    if (multiplier - power).abs() < 1e-6 * power.abs() { power } else { multiplier }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn definition(kind: u8, length: u8, name: &str, format: &str, columns: &str) -> Vec<u8> {
        let mut body = vec![kind, length];
        for (text, size) in [(name, 4), (format, 16), (columns, 64)] {
            let mut bytes = text.as_bytes().to_vec();
            bytes.resize(size, 0);
            body.extend(bytes);
        }
        body
    }

    #[test]
    fn fields_are_found_by_name_and_decoded_by_format() {
        let body = definition(7, 3 + 8 + 2 + 2 + 4, "TEST", "Qcgn", "TimeUS,A,B,Name");
        let (kind, layout) = Layout::parse(&body).expect("a layout");
        assert_eq!((kind, layout.name.as_str()), (7, "TEST"));
        let row = [
            &12_u64.to_le_bytes()[..],
            &(-250_i16).to_le_bytes(),
            &0xC500_u16.to_le_bytes(),
            b"ab\0\0",
        ];
        let row = row.concat();
        let number = |name: &str| layout.field(&[name]).expect("a field").number(&row);
        assert_eq!(number("TimeUS"), Some(12.0));
        assert_eq!(number("A"), Some(-2.5));
        assert_eq!(number("B"), Some(-5.0));
        assert_eq!(layout.field(&["Old", "Name"]).expect("a field").text(&row), Some("ab"));
        assert_eq!(layout.field(&["Old"]), None);
        assert_eq!(layout.field(&["B"]).expect("a field").number(&row[..10]), None);
    }

    #[test]
    fn inconsistent_definitions_are_refused() {
        for wrong in [
            definition(7, 12, "TEST", "Qc", "TimeUS,A"),
            definition(7, 13, "TEST", "Qc", "TimeUS"),
            definition(7, 13, "TEST", "Q?", "TimeUS,A"),
            definition(7, 13, "", "Qc", "TimeUS,A"),
            definition(7, 13, "TEST", "Qc", "TimeUS,A")[..80].to_vec(),
        ] {
            assert_eq!(Layout::parse(&wrong), None);
        }
    }

    #[test]
    fn unit_factors_come_from_the_log() {
        let body = definition(7, 3 + 8 + 4 + 2, "TEST", "Qfc", "TimeUS,A,B");
        let (kind, layout) = Layout::parse(&body).expect("a layout");
        let (a, b) = (layout.field(&["A"]).expect("a"), layout.field(&["B"]).expect("b"));
        let mut units = Units::default();
        assert_eq!(units.factor(kind, a, 5.0), 5.0);
        units.add_label(f64::from(b'k'), "deg/s");
        units.add_multiplier(f64::from(b'B'), f64::from(0.01_f32));
        units.add_fields(7.0, "skk", "FBB");
        assert_eq!(units.factor(kind, a, 5.0), 1f64.to_radians() * 0.01);
        assert_eq!(units.factor(kind, b, 5.0), 1f64.to_radians());
    }
}
