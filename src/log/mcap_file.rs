//! An MCAP file that only ever grows at its end.
//!
//! Messages are encoded straight into the chunk that is being filled, which is compressed in one
//! go. The `mcap` crate's writer hands every field of a message's header to the compressor on its
//! own, which took a quarter of a lockstep flight. That crate reads the files, here and in the
//! tests.
//!
//! Source: the MCAP specification, version 0, <https://mcap.dev/spec>.

use std::collections::BTreeMap;
use std::io::{self, Write};

use lz4::liblz4::ContentChecksum;
use lz4::{BlockSize, EncoderBuilder};
use mcap::MAGIC;
use mcap::records::op;

/// A chunk is closed when it has grown beyond this. What a reader must hold in memory.
const CHUNK_BYTES: usize = 256 * 1024;
/// Takes about half the time of zstd's level 1; the files are a fifth larger.
const COMPRESSION: &str = "lz4";

/// When a message was logged and published, ns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Times {
    pub log: u64,
    pub publish: u64,
}

/// A channel, and what its messages were so far.
#[derive(Debug, Default)]
struct Channel {
    messages: u64,
    /// Log time and offset of the messages in the open chunk.
    index: Vec<(u64, u64)>,
}

/// Records that the summary at the end of the file repeats or adds, of one kind.
#[derive(Debug)]
struct Group {
    opcode: u8,
    records: Vec<u8>,
    count: u32,
}

impl Group {
    fn new(opcode: u8) -> Self {
        Self { opcode, records: Vec::new(), count: 0 }
    }

    fn add(&mut self, content: impl FnOnce(&mut Vec<u8>)) {
        record(&mut self.records, self.opcode, content);
        self.count += 1;
    }
}

/// Writes an MCAP file. After an error it is of no more use; what was written can be read.
#[derive(Debug)]
pub(super) struct McapFile<W> {
    out: W,
    offset: u64,
    channels: Vec<Channel>,
    chunk: Vec<u8>,
    compressed: Vec<u8>,
    scratch: Vec<u8>,
    /// First and last log time, of the open chunk and of the file.
    chunk_span: Option<(u64, u64)>,
    span: Option<(u64, u64)>,
    schemas: Group,
    channel_records: Group,
    chunks: Group,
    attachments: Group,
    metadata: Group,
}

impl<W: Write> McapFile<W> {
    /// Starts a file.
    pub fn new(out: W, library: &str) -> io::Result<Self> {
        let mut file = Self {
            out,
            offset: 0,
            channels: Vec::new(),
            chunk: Vec::with_capacity(CHUNK_BYTES + CHUNK_BYTES / 8),
            compressed: Vec::new(),
            scratch: Vec::new(),
            chunk_span: None,
            span: None,
            schemas: Group::new(op::SCHEMA),
            channel_records: Group::new(op::CHANNEL),
            chunks: Group::new(op::CHUNK_INDEX),
            attachments: Group::new(op::ATTACHMENT_INDEX),
            metadata: Group::new(op::METADATA_INDEX),
        };
        file.raw(MAGIC)?;
        file.write(op::HEADER, |out| {
            string(out, "");
            string(out, library);
        })?;
        Ok(file)
    }

    /// Adds a channel of protobuf messages, and returns its number.
    pub fn add_channel(&mut self, topic: &str, schema: &str, descriptor: &[u8]) -> io::Result<u16> {
        let number = u16::try_from(self.channels.len()).map_err(io::Error::other)?;
        let schema_id = number + 1; // Zero means that there is none.
        let starts = (self.schemas.records.len(), self.channel_records.records.len());
        self.schemas.add(|out| {
            out.extend(schema_id.to_le_bytes());
            string(out, schema);
            string(out, "protobuf");
            bytes(out, descriptor);
        });
        self.channel_records.add(|out| {
            out.extend(number.to_le_bytes());
            out.extend(schema_id.to_le_bytes());
            string(out, topic);
            string(out, "protobuf");
            map(out, &BTreeMap::new());
        });
        for record in [&self.schemas.records[starts.0..], &self.channel_records.records[starts.1..]]
        {
            self.out.write_all(record)?;
            self.offset += record.len() as u64;
        }
        self.channels.push(Channel::default());
        Ok(number)
    }

    /// Adds named facts.
    pub fn add_metadata(&mut self, name: &str, facts: &BTreeMap<String, String>) -> io::Result<()> {
        self.close_chunk()?;
        let start = self.offset;
        self.write(op::METADATA, |out| {
            string(out, name);
            map(out, facts);
        })?;
        let length = self.offset - start;
        self.metadata.add(|out| {
            out.extend(start.to_le_bytes());
            out.extend(length.to_le_bytes());
            string(out, name);
        });
        Ok(())
    }

    /// Adds a file within the file, made at `time`.
    pub fn attach(
        &mut self,
        time: u64,
        name: &str,
        media_type: &str,
        data: &[u8],
    ) -> io::Result<()> {
        self.close_chunk()?;
        let start = self.offset;
        self.write(op::ATTACHMENT, |out| {
            let from = out.len();
            out.extend(time.to_le_bytes());
            out.extend(time.to_le_bytes());
            string(out, name);
            string(out, media_type);
            out.extend((data.len() as u64).to_le_bytes());
            out.extend(data);
            let checksum = crc32fast::hash(&out[from..]);
            out.extend(checksum.to_le_bytes());
        })?;
        let length = self.offset - start;
        self.attachments.add(|out| {
            for value in [start, length, time, time, data.len() as u64] {
                out.extend(value.to_le_bytes());
            }
            string(out, name);
            string(out, media_type);
        });
        Ok(())
    }

    /// Adds a message, whose body `encode` appends. Its sequence number is that of the channel.
    pub fn put(
        &mut self,
        channel: u16,
        times: Times,
        encode: impl FnOnce(&mut Vec<u8>),
    ) -> io::Result<()> {
        let Some(known) = self.channels.get_mut(usize::from(channel)) else {
            return Err(io::Error::other(format!("channel {channel} was not added")));
        };
        known.index.push((times.log, self.chunk.len() as u64));
        record(&mut self.chunk, op::MESSAGE, |out| {
            let mut head = [0; 22];
            head[0..2].copy_from_slice(&channel.to_le_bytes());
            head[2..6].copy_from_slice(&(known.messages as u32).to_le_bytes());
            head[6..14].copy_from_slice(&times.log.to_le_bytes());
            head[14..22].copy_from_slice(&times.publish.to_le_bytes());
            out.extend_from_slice(&head);
            encode(out);
        });
        known.messages += 1;
        self.chunk_span = Some(wider(self.chunk_span, (times.log, times.log)));
        if self.chunk.len() > CHUNK_BYTES { self.close_chunk() } else { Ok(()) }
    }

    /// Hands everything to the system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.close_chunk()?;
        self.out.flush()
    }

    /// Writes the summary and the end of the file.
    pub fn finish(mut self) -> io::Result<()> {
        self.close_chunk()?;
        // No checksum over the data: every chunk and attachment has its own.
        self.write(op::DATA_END, |out| out.extend(0u32.to_le_bytes()))?;
        let start = self.offset;
        let mut statistics = Group::new(op::STATISTICS);
        statistics.add(|out| self.statistics(out));
        let mut summary = Vec::new();
        let mut offsets = Vec::new();
        let groups = [
            &self.schemas,
            &self.channel_records,
            &statistics,
            &self.chunks,
            &self.attachments,
            &self.metadata,
        ];
        for group in groups.into_iter().filter(|group| group.count > 0) {
            let (at, length) = (start + summary.len() as u64, group.records.len() as u64);
            summary.extend_from_slice(&group.records);
            record(&mut offsets, op::SUMMARY_OFFSET, |out| {
                out.push(group.opcode);
                out.extend(at.to_le_bytes());
                out.extend(length.to_le_bytes());
            });
        }
        let offsets_start = start + summary.len() as u64;
        summary.extend(offsets);
        record(&mut summary, op::FOOTER, |out| {
            out.extend(start.to_le_bytes());
            out.extend(offsets_start.to_le_bytes());
            out.extend([0; 4]);
        });
        // The checksum is over the summary and the footer in front of the checksum.
        let end = summary.len() - 4;
        let checksum = crc32fast::hash(&summary[..end]);
        summary[end..].copy_from_slice(&checksum.to_le_bytes());
        self.raw(&summary)?;
        self.raw(MAGIC)?;
        self.out.flush()
    }

    fn statistics(&self, out: &mut Vec<u8>) {
        let (first, last) = self.span.unwrap_or_default();
        let total: u64 = self.channels.iter().map(|channel| channel.messages).sum();
        out.extend(total.to_le_bytes());
        out.extend((self.schemas.count as u16).to_le_bytes());
        for group in [&self.channel_records, &self.attachments, &self.metadata, &self.chunks] {
            out.extend(group.count.to_le_bytes());
        }
        out.extend(first.to_le_bytes());
        out.extend(last.to_le_bytes());
        let counts = (0u16..).zip(&self.channels).filter(|(_, channel)| channel.messages > 0);
        list(out, |out| {
            for (number, channel) in counts {
                out.extend(number.to_le_bytes());
                out.extend(channel.messages.to_le_bytes());
            }
        });
    }

    /// Compresses and writes the open chunk, and the index of its messages.
    fn close_chunk(&mut self) -> io::Result<()> {
        let Some((first, last)) = self.chunk_span.take() else { return Ok(()) };
        self.span = Some(wider(self.span, (first, last)));
        self.compressed.clear();
        let mut encoder = EncoderBuilder::new()
            .block_size(BlockSize::Max256KB)
            .checksum(ContentChecksum::NoChecksum)
            .build(std::mem::take(&mut self.compressed))?;
        let result = encoder.write_all(&self.chunk);
        let (compressed, end) = encoder.finish();
        self.compressed = compressed;
        result.and(end)?;

        let start = self.offset;
        let (size, compressed_size) = (self.chunk.len() as u64, self.compressed.len() as u64);
        let mut head = Vec::with_capacity(64);
        for value in [first, last, size] {
            head.extend(value.to_le_bytes());
        }
        head.extend(crc32fast::hash(&self.chunk).to_le_bytes());
        string(&mut head, COMPRESSION);
        head.extend(compressed_size.to_le_bytes());
        self.out.write_all(&[op::CHUNK])?;
        self.out.write_all(&(head.len() as u64 + compressed_size).to_le_bytes())?;
        self.out.write_all(&head)?;
        self.out.write_all(&self.compressed)?;
        self.offset += 9 + head.len() as u64 + compressed_size;
        self.chunk.clear();

        let length = self.offset - start;
        let mut places = Vec::new();
        self.scratch.clear();
        for (number, channel) in (0u16..).zip(&mut self.channels) {
            if channel.index.is_empty() {
                continue;
            }
            places.push((number, self.offset + self.scratch.len() as u64));
            record(&mut self.scratch, op::MESSAGE_INDEX, |out| {
                out.extend(number.to_le_bytes());
                list(out, |out| {
                    for (time, offset) in channel.index.drain(..) {
                        out.extend_from_slice(&time.to_le_bytes());
                        out.extend_from_slice(&offset.to_le_bytes());
                    }
                });
            });
        }
        self.out.write_all(&self.scratch)?;
        let index_length = self.scratch.len() as u64;
        self.offset += index_length;
        self.chunks.add(|out| {
            for value in [first, last, start, length] {
                out.extend(value.to_le_bytes());
            }
            list(out, |out| {
                for (number, at) in places {
                    out.extend(number.to_le_bytes());
                    out.extend(at.to_le_bytes());
                }
            });
            out.extend(index_length.to_le_bytes());
            string(out, COMPRESSION);
            out.extend(compressed_size.to_le_bytes());
            out.extend(size.to_le_bytes());
        });
        Ok(())
    }

    fn write(&mut self, opcode: u8, content: impl FnOnce(&mut Vec<u8>)) -> io::Result<()> {
        self.scratch.clear();
        record(&mut self.scratch, opcode, content);
        self.out.write_all(&self.scratch)?;
        self.offset += self.scratch.len() as u64;
        Ok(())
    }

    fn raw(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.out.write_all(bytes)?;
        self.offset += bytes.len() as u64;
        Ok(())
    }
}

/// A record: opcode, length, content.
fn record(out: &mut Vec<u8>, opcode: u8, content: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let at = out.len();
    out.extend_from_slice(&[0; 8]);
    content(out);
    let length = (out.len() - at - 8) as u64;
    out[at..at + 8].copy_from_slice(&length.to_le_bytes());
}

/// A list: length in bytes, elements.
fn list(out: &mut Vec<u8>, elements: impl FnOnce(&mut Vec<u8>)) {
    let at = out.len();
    out.extend_from_slice(&[0; 4]);
    elements(out);
    let length = (out.len() - at - 4) as u32;
    out[at..at + 4].copy_from_slice(&length.to_le_bytes());
}

fn bytes(out: &mut Vec<u8>, content: &[u8]) {
    list(out, |out| out.extend_from_slice(content));
}

fn string(out: &mut Vec<u8>, text: &str) {
    bytes(out, text.as_bytes());
}

fn map(out: &mut Vec<u8>, entries: &BTreeMap<String, String>) {
    list(out, |out| {
        for (key, value) in entries {
            string(out, key);
            string(out, value);
        }
    });
}

fn wider(span: Option<(u64, u64)>, (first, last): (u64, u64)) -> (u64, u64) {
    span.map_or((first, last), |(from, to)| (from.min(first), to.max(last)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the `mcap` crate finds in the file, by its index and by reading through.
    #[test]
    fn the_reference_implementation_reads_every_part() {
        let mut out = Vec::new();
        let mut file = McapFile::new(&mut out, "test").unwrap();
        let facts = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
        file.add_metadata("run", &facts).unwrap();
        file.attach(5, "a.toml", "application/toml", b"x = 1\n").unwrap();
        let channels = ["/a", "/b"].map(|topic| file.add_channel(topic, "p.M", b"d").unwrap());
        for number in 0..20_000u64 {
            let times = Times { log: 1000 + number, publish: number };
            let channel = channels[usize::from(number % 3 == 0)];
            file.put(channel, times, |out| out.extend(number.to_le_bytes())).unwrap();
            if number == 10 {
                file.flush().unwrap();
            }
        }
        file.finish().unwrap();

        let summary = mcap::Summary::read(&out).unwrap().unwrap();
        let stats = summary.stats.as_ref().unwrap();
        assert_eq!((stats.message_count, stats.channel_count, stats.schema_count), (20_000, 2, 2));
        assert_eq!((stats.message_start_time, stats.message_end_time), (1000, 20_999));
        assert_eq!(stats.channel_message_counts[&1], 6667);
        assert_eq!((summary.attachment_indexes.len(), summary.metadata_indexes.len()), (1, 1));
        assert!(summary.chunk_indexes.len() > 2);
        let attachment = mcap::read::attachment(&out, &summary.attachment_indexes[0]).unwrap();
        assert_eq!(&attachment.data[..], b"x = 1\n");
        let metadata = mcap::read::metadata(&out, &summary.metadata_indexes[0]).unwrap();
        assert_eq!(metadata.metadata, facts);

        let linear = mcap::MessageStream::new(&out).unwrap().map(|message| message.unwrap());
        let mut read = 0;
        for (number, message) in (0u64..).zip(linear) {
            assert_eq!(message.data[..], number.to_le_bytes());
            assert_eq!((message.log_time, message.publish_time), (1000 + number, number));
            assert_eq!(message.channel.topic, ["/a", "/b"][usize::from(number % 3 == 0)]);
            read += 1;
        }
        assert_eq!(read, 20_000);
        let mut indexed = 0;
        for chunk in &summary.chunk_indexes {
            for (channel, entries) in summary.read_message_indexes(&out, chunk).unwrap() {
                for entry in entries {
                    let message = summary.seek_message(&out, chunk, &entry).unwrap();
                    assert_eq!((message.log_time, &message.channel), (entry.log_time, &channel));
                    indexed += 1;
                }
            }
            // Seeking decompresses the chunk for every message: one chunk is enough.
            if indexed > 0 {
                break;
            }
        }
        assert_eq!(indexed, 11);
    }

    #[test]
    fn an_empty_file_is_valid() {
        let mut out = Vec::new();
        McapFile::new(&mut out, "test").unwrap().finish().unwrap();
        assert_eq!(mcap::Summary::read(&out).unwrap().unwrap().stats.unwrap().message_count, 0);
    }
}
