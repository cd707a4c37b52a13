//! Reads flight logs, also those that a crash cut short or a disk damaged.

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

/// No record of a flight log is longer, compressed or not; keeps a damaged length from asking for
/// all of the memory.
const RECORD_LEN_MAX: u64 = 64 << 20;
/// Bytes that are packed in one, at most, beside one chunk of the largest size: logs of flights have
/// two to twenty.
const PACKED_MAX: u64 = 200;
/// Damages that are described; the rest are counted.
const DAMAGES_DESCRIBED: usize = 16;
/// Opcode and length.
const RECORD_HEAD: usize = 9;

/// Why a log could not be read at all. Damage within a log is not an error: see [`Ending`].
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file could not be opened.
    #[error("cannot open the log {}: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file holds nothing.
    #[error(
        "the log {} holds nothing: {bytes} bytes; it was cut short before its first record",
        path.display()
    )]
    Empty {
        /// The file.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// Reading failed.
    #[error("cannot read the log: {0}")]
    Io(#[from] io::Error),
    /// The file is something else.
    #[error("not an MCAP file: expected it to start with {:02x?}, found {found:02x?}", mcap::MAGIC)]
    NotMcap {
        /// How it starts.
        found: Vec<u8>,
    },
}

/// A topic with the type of its messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Topic.
    pub topic: String,
    /// Full name of the message's type, empty if the channel has none.
    pub schema: String,
    /// How the schema is written: `protobuf`, `jsonschema`, ...
    pub schema_encoding: String,
    /// The schema itself.
    pub schema_data: Vec<u8>,
    /// How messages are written.
    pub message_encoding: String,
}

/// One message.
#[derive(Clone, Debug, PartialEq)]
pub struct Message<'a> {
    /// Its topic and type.
    pub channel: Arc<Channel>,
    /// Host time.
    pub log_time: HostTime,
    /// Vehicle time of the sample, mapped to the host clock.
    pub publish_time: HostTime,
    /// The body.
    pub data: &'a [u8],
}

impl Message<'_> {
    /// The message as `M`, or `None` if it is of another type or does not decode.
    pub fn decode<M: Flat>(&self) -> Option<M> {
        (self.channel.schema == M::NAME).then(|| M::decode(self.data).ok()).flatten()
    }
}

/// A file inside the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogAttachment {
    /// Name.
    pub name: String,
    /// Content.
    pub data: Vec<u8>,
}

/// How a log ended, known once the last message is read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ending {
    /// Whether the log was closed properly. A crash leaves it unfinished.
    pub finished: bool,
    /// Parts that were damaged and left out, in words; at most 16.
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

/// Reads messages in the order of the file, in memory bounded by one chunk.
///
/// A chunk whose checksum is wrong is left out whole, and reading goes on behind it. A log that
/// ends anywhere yields everything up to its last whole chunk.
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
    /// Bytes that were packed in the chunks until now, as they say.
    unpacked: u64,
    done: bool,
}

/// The chunk that is being read: its records are taken out of `LogReader::record`.
struct Chunk {
    reader: LinearReader,
    fed: usize,
    offset: u64,
}

/// Header of a message whose data lie in `LogReader::body`.
struct Head {
    channel: Arc<Channel>,
    log_time: u64,
    publish_time: u64,
}

impl LogReader<BufReader<File>> {
    /// Opens a log.
    ///
    /// # Errors
    /// [`ReadError`] if the file cannot be read, holds nothing, or is no MCAP.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let file =
            File::open(path).map_err(|source| ReadError::Open { path: path.to_owned(), source })?;
        let there = file.metadata()?;
        if there.is_file() && there.len() < (mcap::MAGIC.len() + RECORD_HEAD) as u64 {
            return Err(ReadError::Empty { path: path.to_owned(), bytes: there.len() });
        }
        Self::new(BufReader::with_capacity(1 << 16, file))
    }
}

impl<R: Read> LogReader<R> {
    /// Reads from `source`, which is best buffered.
    ///
    /// # Errors
    /// [`ReadError::NotMcap`] unless `source` starts as an MCAP file does, or is cut off within
    /// that start.
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

    /// The next message, or `None` at the end.
    ///
    /// # Errors
    /// [`ReadError::Io`].
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

    /// Facts about the run, from the metadata records `run` read so far, the later ones winning.
    pub fn run(&self) -> &BTreeMap<String, String> {
        &self.run
    }

    /// Files inside the log, of those read so far.
    pub fn attachments(&self) -> &[LogAttachment] {
        &self.attachments
    }

    /// How the log ended. Final once [`LogReader::next_message`] has returned `None`.
    pub fn ending(&self) -> &Ending {
        &self.ending
    }

    /// Fills `buffer` as far as the source goes.
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

    /// Reads one record of the file's top level.
    fn next_record(&mut self) -> Result<Option<Head>, ReadError> {
        let offset = self.offset;
        let mut head = [0; RECORD_HEAD];
        if self.read_up_to(&mut head)? < RECORD_HEAD {
            self.done = true;
            return Ok(None);
        }
        let [opcode, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let wanted = matches!(
            opcode,
            op::CHUNK | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA | op::ATTACHMENT
        );
        // The buffer grows with what is there, not with what the length claims.
        self.record.clear();
        self.record.extend_from_slice(&head);
        let got = if wanted && length <= RECORD_LEN_MAX {
            self.source.by_ref().take(length).read_to_end(&mut self.record)? as u64
        } else {
            io::copy(&mut self.source.by_ref().take(length), &mut io::sink())?
        };
        self.offset += got;
        if got < length {
            self.done = true;
            return Ok(None);
        }
        if wanted && length > RECORD_LEN_MAX {
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
            _ if !wanted => Ok(None),
            _ => {
                let record = std::mem::take(&mut self.record);
                let head = self.accept(opcode, &record[RECORD_HEAD..], offset);
                self.record = record;
                Ok(head)
            }
        }
    }

    /// Why the chunk in `record` cannot be handed on. A compressed one's records come in time, as
    /// many bytes as it says; so that a file costs no more than its length may, it must not say too
    /// many.
    fn check_chunk(&mut self) -> Result<(), &'static str> {
        let chunk = mcap::parse_record(op::CHUNK, &self.record[RECORD_HEAD..]);
        let Ok(Record::Chunk { header, data }) = chunk else { return Ok(()) };
        if header.compression.is_empty() {
            let fills = lengths::records_fill(&data);
            return fills.then_some(()).ok_or("its records do not fill it");
        }
        let unpacked = self.unpacked.saturating_add(header.uncompressed_size);
        let most = RECORD_LEN_MAX + self.offset.saturating_mul(PACKED_MAX);
        if header.uncompressed_size > RECORD_LEN_MAX || unpacked > most {
            return Err("too much is packed in it");
        }
        self.unpacked = unpacked;
        Ok(())
    }

    /// Reads past the summary, which repeats what was read, to see whether the file is complete.
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

    /// The next message of `chunk`; `None` at its end or where it is damaged.
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

    /// Takes in a record; `Some` if it is a message.
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
