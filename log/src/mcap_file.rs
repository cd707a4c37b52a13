//! An append-only MCAP file: the `mcap` crate's writer with the settings of flight logs.

use std::collections::BTreeMap;
use std::io::{self, Write};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};

use super::encoder::Times;

/// Size at which a chunk is closed. A reader must hold one chunk in memory.
const CHUNK_BYTES: u64 = 256 * 1024;
/// A message costs about 0.4 us with zstd at level 1 and 0.5 us with LZ4, whose files are a third
/// larger. The crate passes every header field to the compressor separately, which costs LZ4 more.
const COMPRESSION: Compression = Compression::Zstd;
const COMPRESSION_LEVEL: u32 = 1;

/// Writes an MCAP file. After an error it cannot be used any more; the data before it remains
/// readable.
pub(super) struct McapFile<W: Write> {
    writer: Writer<NoSeek<W>>,
    channels: BTreeMap<u16, Written>,
    body: Vec<u8>,
}

/// State of a channel.
#[derive(Clone, Copy, Debug, Default)]
struct Written {
    /// Number of messages, which is the next sequence number.
    messages: u32,
    /// The latest `publish_time`, ns.
    published: u64,
}

impl<W: Write> McapFile<W> {
    /// Starts a file.
    pub fn new(out: W, library: &str) -> io::Result<Self> {
        let writer = WriteOptions::new()
            .library(library)
            .compression(Some(COMPRESSION))
            .compression_level(COMPRESSION_LEVEL)
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES))
            // Writes a chunk at once, so a crash leaves whole chunks.
            .disable_seeking(true)
            .create(NoSeek::new(out))
            .map_err(as_io)?;
        Ok(Self { writer, channels: BTreeMap::new(), body: Vec::new() })
    }

    /// Adds a channel of protobuf messages and returns its id.
    pub fn add_channel(&mut self, topic: &str, schema: &str, descriptor: &[u8]) -> io::Result<u16> {
        const ENCODING: &str = "protobuf";
        let schema = self.writer.add_schema(schema, ENCODING, descriptor).map_err(as_io)?;
        self.writer.add_channel(schema, topic, ENCODING, &BTreeMap::new()).map_err(as_io)
    }

    /// Adds a metadata record.
    pub fn add_metadata(&mut self, name: &str, facts: &BTreeMap<String, String>) -> io::Result<()> {
        let metadata = Metadata { name: name.into(), metadata: facts.clone() };
        self.writer.write_metadata(&metadata).map_err(as_io)
    }

    /// Adds an attachment, created at `time`.
    pub fn attach(
        &mut self,
        time: u64,
        name: &str,
        media_type: &str,
        data: &[u8],
    ) -> io::Result<()> {
        let attachment = Attachment {
            log_time: time,
            create_time: time,
            name: name.into(),
            media_type: media_type.into(),
            data: data.into(),
        };
        self.writer.attach(&attachment).map_err(as_io)
    }

    /// Adds a message, whose body `encode` appends. Sequence numbers count within the channel.
    ///
    /// The estimate of the vehicle's clock changes in flight, so a later sample may map to an
    /// earlier time. Readers such as Rerun treat times that go back as damage. There `publish_time`
    /// stays constant, and the message still has the vehicle's time.
    pub fn put(
        &mut self,
        channel: u16,
        times: Times,
        encode: impl FnOnce(&mut Vec<u8>),
    ) -> io::Result<()> {
        self.body.clear();
        encode(&mut self.body);
        let written = self.channels.entry(channel).or_default();
        written.published = written.published.max(times.publish.as_ns());
        let header = MessageHeader {
            channel_id: channel,
            sequence: written.messages,
            log_time: times.log.as_ns(),
            publish_time: written.published,
        };
        written.messages = written.messages.wrapping_add(1);
        self.writer.write_to_known_channel(&header, &self.body).map_err(as_io)
    }

    /// Closes the chunk and passes everything to the system.
    pub fn flush(&mut self) -> io::Result<()> {
        self.writer.flush().map_err(as_io)
    }

    /// Writes the summary and the end of the file.
    pub fn finish(mut self) -> io::Result<()> {
        self.writer.finish().map_err(as_io)?;
        self.writer.into_inner().flush()
    }
}

fn as_io(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        error => io::Error::other(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use message::clock::HostTime;

    /// Checks the file with the `mcap` crate, by index and sequentially.
    #[test]
    fn reference_mcap_reader_reads_every_part() {
        let mut out = Vec::new();
        let mut file = McapFile::new(&mut out, "test").unwrap();
        let facts = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
        file.add_metadata("run", &facts).unwrap();
        file.attach(5, "a.toml", "application/toml", b"x = 1\n").unwrap();
        let channels = ["/a", "/b"].map(|topic| file.add_channel(topic, "p.M", b"d").unwrap());
        for number in 0..20_000u64 {
            let at = HostTime::from_ns;
            let times = Times { log: at(1000 + number), publish: at(number) };
            let channel = channels[usize::from(number % 3 == 0)];
            file.put(channel, times, |out| out.extend(number.to_le_bytes())).unwrap();
            if number == 10 {
                file.flush().unwrap();
            }
        }
        file.finish().unwrap();

        let summary = mcap::Summary::read(&out).unwrap().unwrap();
        let stats = summary.stats.as_ref().unwrap();
        assert_eq!((stats.message_count, stats.channel_count, stats.schema_count), (20_000, 2, 1));
        assert_eq!((stats.message_start_time, stats.message_end_time), (1000, 20_999));
        assert_eq!(stats.channel_message_counts[&channels[1]], 6667);
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
    fn empty_file_is_valid() {
        let mut out = Vec::new();
        McapFile::new(&mut out, "test").unwrap().finish().unwrap();
        assert_eq!(mcap::Summary::read(&out).unwrap().unwrap().stats.unwrap().message_count, 0);
    }

    #[test]
    fn publish_time_never_decreases_on_a_channel() {
        let mut out = Vec::new();
        let mut file = McapFile::new(&mut out, "test").unwrap();
        let channels = ["/a", "/b"].map(|topic| file.add_channel(topic, "p.M", b"d").unwrap());
        for (channel, publish) in [(0, 10), (0, 30), (1, 5), (0, 20), (0, 40)] {
            let times = Times { log: HostTime::from_ns(50), publish: HostTime::from_ns(publish) };
            file.put(channels[channel], times, |_| {}).unwrap();
        }
        file.finish().unwrap();
        let messages = mcap::MessageStream::new(&out).unwrap();
        let times: Vec<_> = messages.map(|message| message.unwrap().publish_time).collect();
        assert_eq!(times, [10, 30, 5, 30, 40]);
    }
}
