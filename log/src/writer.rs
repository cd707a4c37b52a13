//! Writes one flight's MCAP file.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use message::clock::HostTime;
use prost::Message;
use vehicle::frame::Frd;

use super::encoder::{Definition, Encoder, MessageSink, Times, Topic};
use super::mcap_file::McapFile;
use super::name;
use super::record::Record;

/// Version of topics, schemas and units, in the metadata record `run`.
pub const LOG_VERSION: &str = "1";

/// Metadata of a run.
#[derive(Clone, Debug, Default)]
pub struct RunInfo {
    /// Name of the vehicle; part of the file's name.
    pub vehicle: String,
    /// Name of the run, such as the trajectory's; part of the file's name.
    pub run: String,
    /// This program's version.
    pub tool_version: String,
    /// Git revision of this program, if known.
    pub git_revision: Option<String>,
    /// Whether this program simulates the vehicle in lockstep.
    pub simulated: bool,
    /// Seed of the simulation.
    pub seed: Option<u64>,
    /// The vehicle's autopilot, as it reports it.
    pub autopilot: Option<String>,
    /// MAVLink dialect of the frames.
    pub dialect: String,
    /// The resolved configuration, as TOML.
    pub config: String,
    /// Name and content of the vehicle file.
    pub vehicle_file: Option<(String, String)>,
    /// Rotor positions in body axes, m, for the 3D view. Without them, no shape is drawn.
    pub rotors: Vec<Frd>,
    /// Further metadata by key.
    pub extra: BTreeMap<String, String>,
}

impl RunInfo {
    fn metadata(&self) -> BTreeMap<String, String> {
        let mut entries = self.extra.clone();
        let mut put = |key: &str, value: &str| entries.insert(key.into(), value.into());
        put("log_version", LOG_VERSION);
        put("frames", "world NED, body FRD; foxglove.* topics: map ENU, base_link FLU");
        put("units", "SI, radians");
        put("tool", "downwash");
        put("tool_version", &self.tool_version);
        put("vehicle", &self.vehicle);
        put("run", &self.run);
        // Over a link, a simulated vehicle looks like a real one.
        put("source", if self.simulated { "sim" } else { "link" });
        put("dialect", &self.dialect);
        if let Some(revision) = &self.git_revision {
            put("git_revision", revision);
        }
        if let Some(seed) = self.seed {
            put("seed", &seed.to_string());
        }
        if let Some(autopilot) = &self.autopilot {
            put("autopilot", autopilot);
        }
        entries
    }
}

/// Why a log cannot be opened or written.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The directory or the file cannot be created.
    #[error("cannot create the log {}: {source}; choose another folder", path.display())]
    Create {
        /// The file or directory.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A write failed, as on a full disk. The log accepts no more data.
    #[error("cannot write the log {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

/// Summary of a finished log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogSummary {
    /// The file.
    pub path: PathBuf,
    /// Number of messages written, over all topics.
    pub messages: u64,
    /// Number of records dropped because the writer could not keep up.
    pub dropped: u64,
}

/// Period between syncs. A crash loses at most this much wall time.
const SYNC_PERIOD: Duration = Duration::from_secs(1);

/// Writes records to one MCAP file.
///
/// The file has its final name from the start and only grows at its end. A crash leaves whole
/// chunks, with everything up to the last sync of [`LogWriter::sync_if_due`] on disk. A message's
/// content depends on the records only, never on the wall clock.
pub struct LogWriter {
    path: PathBuf,
    mcap: McapFile<BufWriter<File>>,
    file: File,
    /// Channel ids, in the order of [`Topic::ALL`].
    channels: Vec<u16>,
    messages: u64,
    synced: Instant,
    unsynced: bool,
    encoder: Encoder,
}

impl LogWriter {
    /// Creates `<directory>/YYYY-MM-DDTHH-MM-SSZ_<vehicle>_<run>.mcap`, and the directory if it is
    /// missing. It never overwrites a file: it adds `-2`, `-3` ... if the name is taken.
    ///
    /// `start` is the start of the run on the host's clock, `wall` the present wall clock.
    ///
    /// # Errors
    /// [`LogError`] if the file cannot be created or its header cannot be written.
    pub fn create(
        directory: &Path,
        info: &RunInfo,
        start: HostTime,
        wall: Instant,
    ) -> Result<Self, LogError> {
        let (file, path) = create_file(directory, &name::stem(start, &info.vehicle, &info.run))?;
        Self::on_file(file, path, info, start, wall)
    }

    /// Starts a log on an empty file.
    pub(super) fn on_file(
        file: File,
        path: PathBuf,
        info: &RunInfo,
        start: HostTime,
        wall: Instant,
    ) -> Result<Self, LogError> {
        let fail = |source| LogError::Write { path: path.clone(), source };
        let sync_handle =
            file.try_clone().map_err(|source| LogError::Create { path: path.clone(), source })?;
        let library = format!("downwash {}", info.tool_version);
        let mut mcap = McapFile::new(BufWriter::new(file), &library).map_err(fail)?;
        let channels = write_preamble(&mut mcap, info, start).map_err(fail)?;
        Ok(Self {
            path,
            mcap,
            file: sync_handle,
            channels,
            messages: 0,
            synced: wall,
            unsynced: true,
            encoder: Encoder::new(&info.rotors),
        })
    }

    /// Path of the log file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Encodes `record` and appends its messages.
    ///
    /// # Errors
    /// [`LogError::Write`]; every later call fails too.
    pub fn write(&mut self, record: &Record) -> Result<(), LogError> {
        self.unsynced = true;
        self.put_record(record).map_err(|source| self.failed(source))
    }

    /// Closes the chunk, flushes and syncs the file to disk, at most once per second of wall time.
    ///
    /// # Errors
    /// [`LogError::Write`] if flushing or syncing fails.
    pub fn sync_if_due(&mut self, wall: Instant) -> Result<(), LogError> {
        if !self.unsynced || wall.saturating_duration_since(self.synced) < SYNC_PERIOD {
            return Ok(());
        }
        self.synced = wall;
        self.unsynced = false;
        self.mcap.flush().map_err(|source| self.failed(source))?;
        self.file.sync_data().map_err(|source| self.failed(source))
    }

    /// Writes the index and closes the file.
    ///
    /// # Errors
    /// [`LogError::Write`]; earlier data remains readable.
    pub fn finish(self) -> Result<LogSummary, LogError> {
        let Self { path, mcap, file, messages, .. } = self;
        match mcap.finish().and_then(|()| file.sync_all()) {
            Ok(()) => Ok(LogSummary { path, messages, dropped: 0 }),
            Err(source) => Err(LogError::Write { path, source }),
        }
    }

    fn failed(&self, source: io::Error) -> LogError {
        LogError::Write { path: self.path.clone(), source }
    }

    fn put_record(&mut self, record: &Record) -> Result<(), io::Error> {
        if let Record::Facts(entries) = record {
            return self.mcap.add_metadata("run", entries);
        }
        let Self { encoder, mcap, channels, messages, .. } = self;
        encoder.encode(record, &mut ToFile { mcap, channels, messages })
    }
}

/// Writes messages to their channels in the file.
struct ToFile<'a> {
    mcap: &'a mut McapFile<BufWriter<File>>,
    channels: &'a [u16],
    messages: &'a mut u64,
}

impl MessageSink for ToFile<'_> {
    fn put(&mut self, topic: Topic, times: Times, message: &impl Message) -> io::Result<()> {
        let channel = self.channels[topic as usize];
        self.mcap.put(channel, times, |out| message.encode_raw(out))?;
        *self.messages += 1;
        Ok(())
    }
}

/// Creates the first free name of `stem`, `stem-2`, `stem-3` ... in `directory`.
fn create_file(directory: &Path, stem: &str) -> Result<(File, PathBuf), LogError> {
    fs::create_dir_all(directory)
        .map_err(|source| LogError::Create { path: directory.to_owned(), source })?;
    let path = directory.join(format!("{stem}.mcap"));
    create_numbered(&path).map_err(|source| LogError::Create { path, source })
}

/// Creates a new file at `path`. Appends a number to the name if the file exists, since it may hold
/// a flight.
///
/// # Errors
/// No file can be created.
pub fn create_numbered(path: &Path) -> io::Result<(File, PathBuf)> {
    let stem = path.file_stem().unwrap_or_default();
    let mut number = 1u32;
    loop {
        let mut at = path.to_owned();
        if number > 1 {
            let mut name = stem.to_owned();
            name.push(format!("-{number}"));
            if let Some(extension) = path.extension() {
                name.push(".");
                name.push(extension);
            }
            at.set_file_name(name);
        }
        match OpenOptions::new().write(true).create_new(true).open(&at) {
            Ok(file) => return Ok((file, at)),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists && number < 10_000 => number += 1,
            Err(source) => return Err(source),
        }
    }
}

/// Writes metadata, attachments and every channel; returns the channel ids.
fn write_preamble(
    mcap: &mut McapFile<impl io::Write>,
    info: &RunInfo,
    start: HostTime,
) -> io::Result<Vec<u16>> {
    mcap.add_metadata("run", &info.metadata())?;
    let config = ("config.toml", info.config.as_str());
    let vehicle = info.vehicle_file.as_ref().map(|(name, text)| (name.as_str(), text.as_str()));
    for (name, text) in [Some(config), vehicle].into_iter().flatten() {
        let media_type =
            if name.ends_with(".json") { "application/json" } else { "application/toml" };
        mcap.attach(start.as_ns(), name, media_type, text.as_bytes())?;
    }
    let channels = Topic::ALL.map(|topic| {
        let Definition { topic, schema, descriptor } = topic.definition();
        mcap.add_channel(topic, schema, &descriptor)
    });
    let channels = channels.into_iter().collect::<io::Result<Vec<_>>>()?;
    mcap.flush()?;
    Ok(channels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flight_over_a_link_is_not_labelled_real() {
        let source =
            |simulated| RunInfo { simulated, ..RunInfo::default() }.metadata()["source"].clone();
        assert_eq!([source(true), source(false)], ["sim", "link"]);
    }

    #[test]
    fn existing_file_is_never_overwritten() {
        let name = format!("downwash-numbered-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        fs::create_dir_all(&folder).unwrap();
        for expected in [["a.tlog", "a-2.tlog", "a-3.tlog"], ["a", "a-2", "a-3"]] {
            let path = folder.join(expected[0]);
            let names = [(); 3].map(|()| create_numbered(&path).unwrap().1);
            assert_eq!(names, expected.map(|name| folder.join(name)));
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
