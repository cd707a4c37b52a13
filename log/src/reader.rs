//! Reads flight logs, including truncated and damaged ones.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use message::clock::HostTime;

use super::lengths;
use super::schema::Flat;

/// Length limit of a record, compressed or not. It prevents a damaged length from claiming all the
/// memory.
const RECORD_LEN_MAX: u64 = 64 << 20;
/// Largest overall compression ratio, beyond one chunk of the largest size. Flight logs have 2 to
/// 20.
const PACKED_MAX: u64 = 200;
/// Number of damages described; the rest are only counted.
const DAMAGES_DESCRIBED: usize = 16;
/// Size of a record's opcode and length.
const RECORD_HEAD: usize = 9;

/// Why a log cannot be read at all. Damage within a log is not an error: see [`Ending`].
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be opened.
    #[error("cannot open the log {}: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is too short for a record.
    #[error(
        "the log {} has no record: expected at least {} bytes, found {bytes}; it was cut short \
         before its first record",
        path.display(),
        mcap::MAGIC.len() + RECORD_HEAD
    )]
    Empty {
        /// The file.
        path: PathBuf,
        /// Size of the file in bytes.
        bytes: u64,
    },
    /// Reading failed.
    #[error("cannot read the log: {0}")]
    Io(#[from] io::Error),
    /// The file is not an MCAP file.
    #[error("not an MCAP file: expected it to start with {:02x?}, found {found:02x?}", mcap::MAGIC)]
    NotMcap {
        /// First bytes of the file.
        found: Vec<u8>,
    },
}

/// A topic with its message type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Name of the topic.
    pub topic: String,
    /// Full name of the message type; empty if the channel has no schema.
    pub schema: String,
    /// Encoding of the schema, such as `protobuf` or `jsonschema`.
    pub schema_encoding: String,
    /// Content of the schema.
    pub schema_data: Vec<u8>,
    /// Encoding of the messages, such as `protobuf`.
    pub message_encoding: String,
}

/// One message of a log.
#[derive(Clone, Debug, PartialEq)]
pub struct Message<'a> {
    /// Topic and type of the message.
    pub channel: Arc<Channel>,
    /// Host time of the record.
    pub log_time: HostTime,
    /// Vehicle time of the sample, mapped to the host clock.
    pub publish_time: HostTime,
    /// Encoded body.
    pub data: &'a [u8],
}

impl Message<'_> {
    /// Decodes the message as `M`; `None` if it has a different type or does not decode.
    pub fn decode<M: Flat>(&self) -> Option<M> {
        (self.channel.schema == M::NAME).then(|| M::decode(self.data).ok()).flatten()
    }
}

/// A file attached to the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogAttachment {
    /// Name.
    pub name: String,
    /// Content.
    pub data: Vec<u8>,
}

/// How a log ends, known once the last message is read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ending {
    /// Whether the log was closed properly. A crash leaves it unfinished.
    pub finished: bool,
    /// Descriptions of damaged parts that were skipped; at most 16.
    pub damages: Vec<String>,
    /// Number of damaged parts.
    pub damaged: u64,
}

impl Ending {
    fn damage(&mut self, text: String) {
        self.damaged += 1;
        if self.damages.len() < DAMAGES_DESCRIBED {
            self.damages.push(text);
        }
    }
}

/// Reads messages in file order, in memory bounded by one chunk.
///
/// It skips a chunk with a wrong checksum and continues after it. A truncated log yields everything
/// up to its last whole chunk.
pub struct LogReader<R> {
    source: R,
    offset: u64,
    record: Vec<u8>,
    chunk: Option<Chunk>,
    body: Vec<u8>,
    schemas: BTreeMap<u16, (String, String, Vec<u8>)>,
    channels: BTreeMap<u16, Arc<Channel>>,
    run: BTreeMap<String, String>,
    attachments: Vec<LogAttachment>,
    ending: Ending,
    /// Declared uncompressed size of the chunks so far, bytes.
    unpacked: u64,
    done: bool,
}

/// The current chunk; its bytes are in `LogReader::record`.
struct Chunk {
    reader: LinearReader,
    fed: usize,
    offset: u64,
}

/// Header of a message whose data is in `LogReader::body`.
struct Head {
    channel: Arc<Channel>,
    log_time: u64,
    publish_time: u64,
}

impl LogReader<BufReader<File>> {
    /// Opens a log.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, is empty, or is not an MCAP file.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let file =
            File::open(path).map_err(|source| ReadError::Open { path: path.to_owned(), source })?;
        let there = file.metadata()?;
        // A short file of another kind is no log that was cut short.
        let reader = Self::new(BufReader::with_capacity(1 << 16, file))?;
        if there.is_file() && there.len() < (mcap::MAGIC.len() + RECORD_HEAD) as u64 {
            return Err(ReadError::Empty { path: path.to_owned(), bytes: there.len() });
        }
        Ok(reader)
    }
}

impl<R: Read> LogReader<R> {
    /// Reads from `source`, which should be buffered.
    ///
    /// # Errors
    /// [`ReadError::NotMcap`] unless `source` starts with MCAP's magic bytes or is cut off within
    /// them; [`ReadError::Io`].
    pub fn new(source: R) -> Result<Self, ReadError> {
        let mut reader = Self {
            source,
            offset: 0,
            record: Vec::new(),
            chunk: None,
            body: Vec::new(),
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            run: BTreeMap::new(),
            attachments: Vec::new(),
            ending: Ending::default(),
            unpacked: 0,
            done: false,
        };
        let mut magic = [0; mcap::MAGIC.len()];
        let got = reader.read_up_to(&mut magic)?;
        if !mcap::MAGIC.starts_with(&magic[..got]) {
            return Err(ReadError::NotMcap { found: magic[..got].to_vec() });
        }
        reader.done = got < magic.len();
        Ok(reader)
    }

    /// Returns the next message, or `None` at the end.
    ///
    /// # Errors
    /// [`ReadError::Io`] if the source fails.
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, ReadError> {
        loop {
            let head = match self.chunk.take() {
                Some(mut chunk) => match self.next_in_chunk(&mut chunk) {
                    Some(head) => {
                        self.chunk = Some(chunk);
                        Some(head)
                    }
                    None => continue,
                },
                None if self.done => return Ok(None),
                None => self.next_record()?,
            };
            if let Some(Head { channel, log_time, publish_time }) = head {
                return Ok(Some(Message {
                    channel,
                    log_time: HostTime::from_ns(log_time),
                    publish_time: HostTime::from_ns(publish_time),
                    data: &self.body,
                }));
            }
        }
    }

    /// Facts about the run, from the metadata records `run` read so far. Later values override
    /// earlier ones.
    pub fn run(&self) -> &BTreeMap<String, String> {
        &self.run
    }

    /// Attachments read so far.
    pub fn attachments(&self) -> &[LogAttachment] {
        &self.attachments
    }

    /// How the log ends. Final once [`LogReader::next_message`] has returned `None`.
    pub fn ending(&self) -> &Ending {
        &self.ending
    }

    /// Fills `buffer` until it is full or the source ends.
    fn read_up_to(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut got = 0;
        while got < buffer.len() {
            match self.source.read(&mut buffer[got..]) {
                Ok(0) => break,
                Ok(n) => got += n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        self.offset += got as u64;
        Ok(got)
    }

    /// Reads one top-level record of the file.
    fn next_record(&mut self) -> Result<Option<Head>, ReadError> {
        let offset = self.offset;
        let mut head = [0; RECORD_HEAD];
        if self.read_up_to(&mut head)? < RECORD_HEAD {
            self.done = true;
            return Ok(None);
        }
        let [opcode, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let is_read = matches!(
            opcode,
            op::CHUNK | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA | op::ATTACHMENT
        );
        // The buffer grows with the data read, not with the claimed length.
        self.record.clear();
        self.record.extend_from_slice(&head);
        let got = if is_read && length <= RECORD_LEN_MAX {
            self.source.by_ref().take(length).read_to_end(&mut self.record)? as u64
        } else {
            io::copy(&mut self.source.by_ref().take(length), &mut io::sink())?
        };
        self.offset += got;
        if got < length {
            self.done = true;
            return Ok(None);
        }
        if is_read && length > RECORD_LEN_MAX {
            self.ending.damage(format!("record of {length} bytes at byte {offset}: too long"));
            return Ok(None);
        }
        match opcode {
            op::CHUNK => {
                if let Err(why) = self.check_chunk() {
                    self.ending.damage(format!("chunk at byte {offset}: {why}"));
                    return Ok(None);
                }
                let options = LinearReaderOptions::default()
                    .with_skip_start_magic(true)
                    .with_skip_end_magic(true)
                    .with_prevalidate_chunk_crcs(true)
                    .with_record_length_limit(RECORD_LEN_MAX as usize);
                let reader = LinearReader::new_with_options(options);
                self.chunk = Some(Chunk { reader, fed: 0, offset });
                Ok(None)
            }
            op::DATA_END => {
                self.finish()?;
                Ok(None)
            }
            _ if !is_read => Ok(None),
            _ => {
                let record = std::mem::take(&mut self.record);
                let head = self.accept(opcode, &record[RECORD_HEAD..], offset);
                self.record = record;
                Ok(head)
            }
        }
    }

    /// Checks the chunk in `record` before decoding. The declared size of a compressed chunk bounds
    /// what decompression yields, so it must be in proportion to the file's length.
    fn check_chunk(&mut self) -> Result<(), &'static str> {
        let chunk = mcap::parse_record(op::CHUNK, &self.record[RECORD_HEAD..]);
        let Ok(Record::Chunk { header, data }) = chunk else { return Ok(()) };
        if header.compression.is_empty() {
            let fills = lengths::records_fill(&data);
            return fills.then_some(()).ok_or("its records do not match its length");
        }
        let unpacked = self.unpacked.saturating_add(header.uncompressed_size);
        let most = RECORD_LEN_MAX + self.offset.saturating_mul(PACKED_MAX);
        if header.uncompressed_size > RECORD_LEN_MAX || unpacked > most {
            return Err("it unpacks to too much data");
        }
        self.unpacked = unpacked;
        Ok(())
    }

    /// Skips the summary, which repeats earlier records, to check whether the file is complete.
    fn finish(&mut self) -> Result<(), ReadError> {
        self.done = true;
        let mut head = [0; RECORD_HEAD];
        while self.read_up_to(&mut head)? == RECORD_HEAD {
            let [opcode, length @ ..] = head;
            let length = u64::from_le_bytes(length);
            let got = io::copy(&mut self.source.by_ref().take(length), &mut io::sink())?;
            if got < length {
                break;
            }
            if opcode == op::FOOTER {
                let mut magic = [0; mcap::MAGIC.len()];
                let got = self.read_up_to(&mut magic)?;
                self.ending.finished = magic[..got] == *mcap::MAGIC;
                break;
            }
        }
        Ok(())
    }

    /// The next message of `chunk`; `None` at its end or at damage.
    fn next_in_chunk(&mut self, chunk: &mut Chunk) -> Option<Head> {
        let record = std::mem::take(&mut self.record);
        let head = loop {
            match chunk.reader.next_event() {
                Some(Ok(LinearReadEvent::ReadRequest(need))) => {
                    let rest = &record[chunk.fed..];
                    let n = need.min(rest.len());
                    chunk.reader.insert(n).get_mut(..n)?.copy_from_slice(&rest[..n]);
                    chunk.reader.notify_read(n);
                    chunk.fed += n;
                }
                Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                    if let Some(head) = self.accept(opcode, data, chunk.offset) {
                        break Some(head);
                    }
                }
                Some(Err(error)) => {
                    self.ending.damage(format!("chunk at byte {}: {error}", chunk.offset));
                    break None;
                }
                None => break None,
            }
        };
        self.record = record;
        head
    }

    /// Processes a record; returns `Some` if it is a message.
    fn accept(&mut self, opcode: u8, data: &[u8], offset: u64) -> Option<Head> {
        if opcode == op::ATTACHMENT && !lengths::attachment_fits(data) {
            self.ending.damage(format!("attachment at byte {offset}: longer than its record"));
            return None;
        }
        let record = match mcap::parse_record(opcode, data) {
            Ok(record) => record,
            Err(error) => {
                self.ending.damage(format!("record at byte {offset}: {error}"));
                return None;
            }
        };
        match record {
            Record::Schema { header, data } => {
                self.schemas.insert(header.id, (header.name, header.encoding, data.into_owned()));
            }
            Record::Channel(channel) => {
                let (schema, schema_encoding, schema_data) =
                    self.schemas.get(&channel.schema_id).cloned().unwrap_or_default();
                let (topic, message_encoding) = (channel.topic, channel.message_encoding);
                let known =
                    Channel { topic, schema, schema_encoding, schema_data, message_encoding };
                self.channels.insert(channel.id, Arc::new(known));
            }
            Record::Message { header, data } => {
                let Some(channel) = self.channels.get(&header.channel_id) else {
                    let id = header.channel_id;
                    self.ending.damage(format!("message at byte {offset}: unknown channel {id}"));
                    return None;
                };
                self.body.clear();
                self.body.extend_from_slice(&data);
                return Some(Head {
                    channel: Arc::clone(channel),
                    log_time: header.log_time,
                    publish_time: header.publish_time,
                });
            }
            Record::Metadata(metadata) if metadata.name == "run" => {
                self.run.extend(metadata.metadata);
            }
            Record::Attachment { header, data, .. } => {
                self.attachments.push(LogAttachment { name: header.name, data: data.into_owned() });
            }
            _ => {}
        }
        None
    }
}
