//! Exports topics as CSV or JSON Lines.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::ser::{SerializeMap, Serializer};

use super::descriptor::{DescriptorError, Layout, Value, hex};
use super::name::sanitised;
use super::partial::PartialFile;
use super::reader::{Channel, LogReader, Message, ReadError};

/// Output format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Comma-separated values with a header line. NaN is written `NaN`; a missing value is empty.
    Csv,
    /// One JSON object per line; NaN and infinities are `null`.
    JsonLines,
}

impl Format {
    fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::JsonLines => "jsonl",
        }
    }
}

/// Why an export fails.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The log cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The output file cannot be created or renamed.
    #[error("cannot write {}: {source}", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// Writing to the output failed.
    #[error("cannot write the export: {0}")]
    Write(#[from] io::Error),
    /// The log has no such topic.
    #[error("no topic {topic} in the log; it has {}", known_topics(known))]
    NoTopic {
        /// The requested topic.
        topic: String,
        /// The topics of the log.
        known: Vec<String>,
    },
    /// The topic's messages are not protobuf.
    #[error("topic {topic} is encoded as {encoding:?}; only protobuf can be exported")]
    Encoding {
        /// The topic.
        topic: String,
        /// Its message encoding.
        encoding: String,
    },
    /// The topic's schema or one of its messages is broken.
    #[error("topic {topic}: {source}")]
    Descriptor {
        /// The topic.
        topic: String,
        /// Why.
        source: DescriptorError,
    },
}

fn known_topics(known: &[String]) -> String {
    if known.is_empty() { "none".to_owned() } else { known.join(", ") }
}

/// Writes every message of `topic` to `out` and returns their number.
///
/// # Errors
/// [`ExportError`]; a truncated log is not an error.
pub fn export_topic<R: Read>(
    reader: &mut LogReader<R>,
    topic: &str,
    format: Format,
    out: &mut impl Write,
) -> Result<u64, ExportError> {
    let mut known = BTreeSet::new();
    let mut table = None;
    let mut rows = 0;
    while let Some(message) = reader.next_message()? {
        if message.channel.topic != topic {
            if !known.contains(&message.channel.topic) {
                known.insert(message.channel.topic.clone());
            }
            continue;
        }
        let table = match &mut table {
            Some(table) => table,
            None => table.insert(Table::new(&message.channel, format, out)?),
        };
        table.write(&message, out)?;
        rows += 1;
    }
    out.flush()?;
    if table.is_none() {
        let known = known.into_iter().collect();
        return Err(ExportError::NoTopic { topic: topic.into(), known });
    }
    Ok(rows)
}

/// Writes one file for each protobuf topic into `directory`, named after the topic, and returns
/// each file with its number of rows. Skips topics in other encodings. Replaces existing files once
/// all are complete.
///
/// # Errors
/// [`ExportError`]; also if every topic is in another encoding.
pub fn export_all<R: Read>(
    reader: &mut LogReader<R>,
    directory: &Path,
    format: Format,
) -> Result<Vec<(PathBuf, u64)>, ExportError> {
    fs::create_dir_all(directory)
        .map_err(|source| ExportError::Create { path: directory.into(), source })?;
    let mut outputs: BTreeMap<String, Output> = BTreeMap::new();
    let mut names = BTreeSet::new();
    let mut foreign: Option<Arc<Channel>> = None;
    while let Some(message) = reader.next_message()? {
        let channel = &message.channel;
        if channel.message_encoding != "protobuf" {
            foreign.get_or_insert_with(|| channel.clone());
            continue;
        }
        if !outputs.contains_key(&channel.topic) {
            let name = file_name(&channel.topic, &mut names);
            let path = directory.join(format!("{name}.{}", format.extension()));
            let mut file = PartialFile::create(&path)
                .map_err(|source| ExportError::Create { path: path.clone(), source })?;
            let table = Table::new(channel, format, &mut file)?;
            outputs.insert(channel.topic.clone(), Output { path, file, table, rows: 0 });
        }
        if let Some(Output { file, table, rows, .. }) = outputs.get_mut(&channel.topic) {
            table.write(&message, file)?;
            *rows += 1;
        }
    }
    if let Some(channel) = foreign.filter(|_| outputs.is_empty()) {
        let (topic, encoding) = (channel.topic.clone(), channel.message_encoding.clone());
        return Err(ExportError::Encoding { topic, encoding });
    }
    let mut written = Vec::new();
    for Output { path, file, rows, .. } in outputs.into_values() {
        file.finish().map_err(|source| ExportError::Create { path: path.clone(), source })?;
        written.push((path, rows));
    }
    Ok(written)
}

/// A file name for a topic that differs from those in `taken`, also where case does not count, and
/// is added to them.
fn file_name(topic: &str, taken: &mut BTreeSet<String>) -> String {
    let stem = sanitised(topic);
    let (mut name, mut number) = (stem.clone(), 1_u64);
    while !taken.insert(name.to_lowercase()) {
        number += 1;
        name = format!("{stem}-{number}");
    }
    name
}

/// The file of one topic.
struct Output {
    path: PathBuf,
    file: PartialFile,
    table: Table,
    rows: u64,
}

/// The output of one topic.
struct Table {
    topic: String,
    format: Format,
    layout: Layout,
    row: Vec<Value>,
}

impl Table {
    /// Starts the table, with its header line.
    fn new(
        channel: &Arc<Channel>,
        format: Format,
        out: &mut impl Write,
    ) -> Result<Self, ExportError> {
        let topic = channel.topic.clone();
        if channel.message_encoding != "protobuf" {
            let encoding = channel.message_encoding.clone();
            return Err(ExportError::Encoding { topic, encoding });
        }
        let layout = match Layout::parse(&channel.schema, &channel.schema_data) {
            Ok(layout) => layout,
            Err(source) => return Err(ExportError::Descriptor { topic, source }),
        };
        if format == Format::Csv {
            write!(out, "log_time_ns,publish_time_ns")?;
            for column in layout.columns() {
                write!(out, ",{column}")?;
            }
            writeln!(out)?;
        }
        Ok(Self { topic, format, layout, row: Vec::new() })
    }

    fn write(&mut self, message: &Message<'_>, out: &mut impl Write) -> Result<(), ExportError> {
        self.layout
            .decode(message.data, &mut self.row)
            .map_err(|source| ExportError::Descriptor { topic: self.topic.clone(), source })?;
        match self.format {
            Format::Csv => self.write_csv(message, out)?,
            Format::JsonLines => self.write_json(message, out)?,
        }
        Ok(())
    }

    fn write_csv(&self, message: &Message<'_>, out: &mut impl Write) -> io::Result<()> {
        write!(out, "{},{}", message.log_time.as_ns(), message.publish_time.as_ns())?;
        for value in &self.row {
            match value {
                Value::Missing => write!(out, ",")?,
                Value::Float(x) => write!(out, ",{x}")?,
                Value::Signed(x) => write!(out, ",{x}")?,
                Value::Unsigned(x) => write!(out, ",{x}")?,
                Value::Bool(x) => write!(out, ",{x}")?,
                Value::Bytes(x) => write!(out, ",{}", hex(x))?,
                Value::Text(x) if x.contains([',', '"', '\n', '\r']) => {
                    write!(out, ",\"{}\"", x.replace('"', "\"\""))?;
                }
                Value::Text(x) => write!(out, ",{x}")?,
            }
        }
        writeln!(out)
    }

    fn write_json(&self, message: &Message<'_>, out: &mut impl Write) -> io::Result<()> {
        let mut serializer = serde_json::Serializer::new(&mut *out);
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("log_time_ns", &message.log_time.as_ns())?;
        map.serialize_entry("publish_time_ns", &message.publish_time.as_ns())?;
        for (column, value) in self.layout.columns().iter().zip(&self.row) {
            map.serialize_entry(column, value)?;
        }
        map.end()?;
        writeln!(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_with_similar_names_get_different_files() {
        let mut taken = BTreeSet::new();
        let topics = ["/imu/data", "/imu_data", "/IMU/data", "/imu-data-2", "/state"];
        let names = topics.map(|topic| file_name(topic, &mut taken));
        assert_eq!(names, ["imu-data", "imu-data-2", "IMU-data-3", "imu-data-2-2", "state"]);
    }
}
