//! Decodes any protobuf message into one row of named columns, using the descriptor in the log.

use std::collections::BTreeMap;

use foxglove::prost_types::field_descriptor_proto::{Label, Type};
use foxglove::prost_types::{DescriptorProto, FileDescriptorSet};
use prost::Message;
use serde::{Serialize, Serializer};

/// Largest nesting depth; deeper fields are omitted.
const DEPTH_MAX: usize = 8;

/// Why a message cannot be laid out in columns or decoded.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum DescriptorError {
    /// The schema record is not a descriptor of the message.
    #[error("the schema is not a protobuf descriptor of {name}")]
    Schema {
        /// Full name of the message.
        name: String,
    },
    /// The message's bytes do not fit its descriptor.
    #[error("message is not valid protobuf at byte {offset}")]
    Message {
        /// Byte offset of the error.
        offset: usize,
    },
}

/// A value in a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// The enclosing message is absent.
    Missing,
    /// A floating-point number; NaN if unknown.
    Float(f64),
    /// A signed integer or an enumeration's number.
    Signed(i64),
    /// An unsigned integer.
    Unsigned(u64),
    /// A boolean.
    Bool(bool),
    /// A string.
    Text(String),
    /// Raw bytes, written in hexadecimal.
    Bytes(Vec<u8>),
}

impl Serialize for Value {
    /// Serialises as in exported JSON: non-finite numbers are `null`, bytes are hexadecimal.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Missing => serializer.serialize_none(),
            Self::Float(x) if x.is_finite() => serializer.serialize_f64(*x),
            Self::Float(_) => serializer.serialize_none(),
            Self::Signed(x) => serializer.serialize_i64(*x),
            Self::Unsigned(x) => serializer.serialize_u64(*x),
            Self::Bool(x) => serializer.serialize_bool(*x),
            Self::Text(x) => serializer.serialize_str(x),
            Self::Bytes(x) => serializer.serialize_str(&hex(x)),
        }
    }
}

/// Formats `bytes` as lower-case hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    use std::fmt::Write;
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// The columns of a message type. Nested messages become columns with dotted names; repeated fields
/// are omitted, since they do not fit a row.
#[derive(Clone, Debug)]
pub struct Layout {
    columns: Vec<String>,
    root: Node,
}

#[derive(Clone, Debug, Default)]
struct Node {
    fields: BTreeMap<u32, Leaf>,
}

#[derive(Clone, Debug)]
enum Leaf {
    Scalar { column: usize, kind: Type },
    Message(Node),
}

impl Layout {
    /// The layout of message `name` in a serialised `FileDescriptorSet`.
    ///
    /// # Errors
    /// [`DescriptorError::Schema`] if the set has no such message.
    pub fn parse(name: &str, descriptor_set: &[u8]) -> Result<Self, DescriptorError> {
        let fail = || DescriptorError::Schema { name: name.into() };
        let set = FileDescriptorSet::decode(descriptor_set).map_err(|_| fail())?;
        let mut types = BTreeMap::new();
        for file in &set.file {
            let package = file.package();
            let scope = if package.is_empty() { String::new() } else { format!(".{package}") };
            file.message_type.iter().for_each(|m| collect(&scope, m, 0, &mut types));
        }
        let mut columns = Vec::new();
        let root = types.get(&format!(".{name}")).ok_or_else(fail)?;
        let root = build(root, "", &types, 0, &mut columns);
        Ok(Self { columns, root })
    }

    /// Names of the columns, in the order of the values in a row.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// Decodes `data` into `row`, one value for each column.
    ///
    /// # Errors
    /// [`DescriptorError::Message`]; `row` then holds the values before the error.
    pub fn decode(&self, data: &[u8], row: &mut Vec<Value>) -> Result<(), DescriptorError> {
        row.clear();
        row.resize(self.columns.len(), Value::Missing);
        let mut reader = Wire { data, offset: 0 };
        self.root
            .decode(&mut reader, data.len(), row)
            .ok_or(DescriptorError::Message { offset: reader.offset })
    }
}

/// Collects every message's descriptor by its full name, including nested ones.
fn collect<'a>(
    scope: &str,
    message: &'a DescriptorProto,
    depth: usize,
    types: &mut BTreeMap<String, &'a DescriptorProto>,
) {
    if depth > DEPTH_MAX {
        return;
    }
    let name = format!("{scope}.{}", message.name());
    message.nested_type.iter().for_each(|m| collect(&name, m, depth + 1, types));
    types.insert(name, message);
}

fn build(
    message: &DescriptorProto,
    prefix: &str,
    types: &BTreeMap<String, &DescriptorProto>,
    depth: usize,
    columns: &mut Vec<String>,
) -> Node {
    let mut node = Node::default();
    for field in &message.field {
        let Ok(number) = u32::try_from(field.number()) else { continue };
        if field.label() == Label::Repeated {
            continue;
        }
        let name = format!("{prefix}{}", field.name());
        let leaf = match field.r#type() {
            Type::Group => continue,
            Type::Message => match types.get(field.type_name()) {
                Some(nested) if depth < DEPTH_MAX => {
                    Leaf::Message(build(nested, &format!("{name}."), types, depth + 1, columns))
                }
                _ => continue,
            },
            kind => {
                columns.push(name);
                Leaf::Scalar { column: columns.len() - 1, kind }
            }
        };
        node.fields.insert(number, leaf);
    }
    node
}

impl Node {
    /// Returns `None` if the bytes do not fit the descriptor.
    fn decode(&self, wire: &mut Wire<'_>, end: usize, row: &mut [Value]) -> Option<()> {
        for leaf in self.fields.values() {
            if let Leaf::Scalar { column, kind } = leaf {
                row[*column] = default(*kind);
            }
        }
        while wire.offset < end {
            let key = wire.varint()?;
            let number = u32::try_from(key >> 3).ok()?;
            match (self.fields.get(&number), key & 7) {
                (Some(Leaf::Message(node)), 2) => {
                    let nested_end = wire.length(end)?;
                    node.decode(wire, nested_end, row)?;
                }
                (Some(Leaf::Scalar { column, kind }), wire_type) => {
                    row[*column] = wire.scalar(*kind, wire_type, end)?;
                }
                (_, wire_type) => wire.skip(wire_type, end)?,
            }
        }
        (wire.offset == end).then_some(())
    }
}

fn default(kind: Type) -> Value {
    match kind {
        Type::Double | Type::Float => Value::Float(0.0),
        Type::Bool => Value::Bool(false),
        Type::String => Value::Text(String::new()),
        Type::Bytes => Value::Bytes(Vec::new()),
        Type::Uint32 | Type::Uint64 | Type::Fixed32 | Type::Fixed64 => Value::Unsigned(0),
        _ => Value::Signed(0),
    }
}

/// Reads protobuf's wire format. Every read checks the bounds.
struct Wire<'a> {
    data: &'a [u8],
    offset: usize,
}

impl<'a> Wire<'a> {
    fn varint(&mut self) -> Option<u64> {
        let mut value = 0;
        for shift in (0..64).step_by(7) {
            let byte = *self.data.get(self.offset)?;
            self.offset += 1;
            value |= u64::from(byte & 0x7F) << shift;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
        None
    }

    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let bytes = self.data.get(self.offset..)?.first_chunk::<N>()?;
        self.offset += N;
        Some(*bytes)
    }

    /// End of the length-delimited field that starts here.
    fn length(&mut self, end: usize) -> Option<usize> {
        let length = usize::try_from(self.varint()?).ok()?;
        self.offset.checked_add(length).filter(|nested_end| *nested_end <= end)
    }

    fn slice(&mut self, end: usize) -> Option<&'a [u8]> {
        let nested_end = self.length(end)?;
        let bytes = self.data.get(self.offset..nested_end)?;
        self.offset = nested_end;
        Some(bytes)
    }

    fn skip(&mut self, wire_type: u64, end: usize) -> Option<()> {
        match wire_type {
            0 => self.varint().map(drop),
            1 => self.take::<8>().map(drop),
            2 => self.slice(end).map(drop),
            5 => self.take::<4>().map(drop),
            _ => None,
        }
    }

    fn scalar(&mut self, kind: Type, wire_type: u64, end: usize) -> Option<Value> {
        let zigzag = |x: u64| ((x >> 1) as i64) ^ -((x & 1) as i64);
        Some(match (kind, wire_type) {
            (Type::Double, 1) => Value::Float(f64::from_le_bytes(self.take()?)),
            (Type::Float, 5) => Value::Float(f32::from_le_bytes(self.take()?).into()),
            (Type::Fixed64, 1) => Value::Unsigned(u64::from_le_bytes(self.take()?)),
            (Type::Fixed32, 5) => Value::Unsigned(u32::from_le_bytes(self.take()?).into()),
            (Type::Sfixed64, 1) => Value::Signed(i64::from_le_bytes(self.take()?)),
            (Type::Sfixed32, 5) => Value::Signed(i32::from_le_bytes(self.take()?).into()),
            (Type::Uint64 | Type::Uint32, 0) => Value::Unsigned(self.varint()?),
            (Type::Int64 | Type::Int32 | Type::Enum, 0) => Value::Signed(self.varint()? as i64),
            (Type::Sint64 | Type::Sint32, 0) => Value::Signed(zigzag(self.varint()?)),
            (Type::Bool, 0) => Value::Bool(self.varint()? != 0),
            (Type::String, 2) => {
                Value::Text(String::from_utf8_lossy(self.slice(end)?).into_owned())
            }
            (Type::Bytes, 2) => Value::Bytes(self.slice(end)?.to_vec()),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::schema::{ControlMessage, Flat, StateMessage, descriptor};
    use foxglove::Encode;
    use foxglove::messages::{Pose, PoseInFrame, Vector3};
    use proptest::prelude::*;

    #[test]
    fn own_message_decodes_to_one_column_per_field() {
        let layout = Layout::parse(ControlMessage::NAME, &descriptor::<ControlMessage>()).unwrap();
        let message = ControlMessage {
            phase: "track".into(),
            error_n_m: f64::NAN,
            saturation: 5,
            ..Default::default()
        };
        let mut row = Vec::new();
        layout.decode(&message.encode_to_vec(), &mut row).unwrap();
        assert_eq!(layout.columns()[0], "phase");
        assert_eq!(row[0], Value::Text("track".into()));
        assert_eq!(row[3], Value::Unsigned(5));
        assert!(matches!(row[4], Value::Float(x) if x.is_nan()));
    }

    #[test]
    fn nested_message_is_flattened_and_absent_parts_are_missing() {
        let schema = PoseInFrame::get_schema().unwrap();
        let layout = Layout::parse("foxglove.PoseInFrame", &schema.data).unwrap();
        let position = Some(Vector3 { x: 1.0, y: 2.0, z: 3.0 });
        let message =
            PoseInFrame { pose: Some(Pose { position, orientation: None }), ..Default::default() };
        let mut row = Vec::new();
        layout.decode(&Message::encode_to_vec(&message), &mut row).unwrap();
        let at = |name: &str| {
            let column = layout.columns().iter().position(|c| c == name).unwrap();
            row[column].clone()
        };
        assert_eq!(at("pose.position.y"), Value::Float(2.0));
        assert_eq!(at("pose.orientation.w"), Value::Missing);
        assert_eq!(at("timestamp.seconds"), Value::Missing);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic_the_decoder(data in proptest::collection::vec(any::<u8>(), 0..200)) {
            let set = descriptor::<StateMessage>();
            let layout = Layout::parse(StateMessage::NAME, &set).unwrap();
            let _ = layout.decode(&data, &mut Vec::new());
            let _ = Layout::parse(StateMessage::NAME, &data);
        }
    }
}
