//! The sink of records in flight: a thread that writes them. In lockstep, [`LogWriter`] is used
//! directly.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use message::clock::HostTime;

use super::flights::{FlightLogs, OpenLog};
use super::record::{Record, Severity, Source, Tick};
use super::writer::{LogError, LogSummary, LogWriter};

/// Capacity of the queue to the writer's thread: two seconds at the highest rate, the time that a
/// slow card may take to sync.
const QUEUE: usize = 8192;
/// Period at which the writer's thread drains the queue. It sleeps in between instead of waiting on
/// the channel, so sending a record never wakes a thread.
const DRAIN_PERIOD: Duration = Duration::from_millis(20);

/// Receives every record in the writer's thread, before the log: a live view, or a link to others.
/// It must not block.
pub trait Listener: Send {
    /// Receives one record.
    fn on_record(&mut self, record: &Record);

    /// Takes a record that the listener adds to the log, if any.
    fn remark(&mut self) -> Option<Record> {
        None
    }
}

/// All listeners of a run.
pub type Listeners = Vec<Box<dyn Listener>>;

/// Accepts records and never fails. After a file error, which it reports once, it discards records
/// and the flight continues.
pub struct LogSink {
    queue: SyncSender<Record>,
    /// Records dropped; incremented here, read by the writer's thread.
    dropped: Arc<AtomicU64>,
    /// Failed logs; incremented by the writer's thread.
    failures: Arc<AtomicU64>,
    thread: JoinHandle<Result<Option<LogSummary>, LogError>>,
}

/// Destination of the writer's thread.
enum Target {
    One(Box<LogWriter>),
    PerFlight(Box<FlightLogs>),
}

impl LogSink {
    /// Writes in a separate thread; [`LogSink::log`] then takes less than a microsecond and never
    /// blocks. If the queue is full, it drops and counts the record, and the log reports it.
    /// `listeners` receive all records that pass the queue, even after the file has failed.
    ///
    /// # Errors
    /// [`LogError::Create`] if the thread cannot be started.
    pub fn threaded(writer: LogWriter, listeners: Listeners) -> Result<Self, LogError> {
        let path = writer.path().to_owned();
        Self::spawn(Target::One(Box::new(writer)), listeners)
            .map_err(|source| LogError::Create { path, source })
    }

    /// As [`LogSink::threaded`], with one log for each flight between [`Record::FlightBegins`] and
    /// [`Record::FlightEnds`], opened by `open` in the writer's thread.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn per_flight(open: OpenLog, listeners: Listeners) -> io::Result<Self> {
        Self::spawn(Target::PerFlight(Box::new(FlightLogs::new(open))), listeners)
    }

    fn spawn(target: Target, listeners: Listeners) -> io::Result<Self> {
        let (queue, records) = sync_channel(QUEUE);
        let dropped = Arc::new(AtomicU64::new(0));
        let counter = Arc::clone(&dropped);
        let failures = Arc::new(AtomicU64::new(0));
        let failed = Arc::clone(&failures);
        let thread = thread::Builder::new()
            .name("log".into())
            .spawn(move || drain(target, listeners, &records, &counter, &failed))?;
        Ok(Self { queue, dropped, failures, thread })
    }

    /// Queues `record`, or drops it if the queue is full.
    pub fn log(&mut self, record: Record) {
        match self.queue.try_send(record) {
            // The thread ends early only after reporting an error.
            Ok(()) | Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => {
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Number of records dropped so far because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Number of logs that have failed so far.
    pub fn failures(&self) -> u64 {
        self.failures.load(Ordering::Relaxed)
    }

    /// Writes the remaining records and closes the file. Returns `None` if there was no flight to
    /// log.
    ///
    /// # Errors
    /// The error that ended the log.
    pub fn finish(self) -> Result<Option<LogSummary>, LogError> {
        let Self { queue, dropped, thread, .. } = self;
        drop(queue);
        match thread.join() {
            Ok(result) => result.map(|summary| {
                let dropped = dropped.load(Ordering::Relaxed);
                summary.map(|summary| LogSummary { dropped, ..summary })
            }),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}

fn report(error: &LogError, failures: &AtomicU64) {
    failures.fetch_add(1, Ordering::Relaxed);
    tracing::error!("{error}; the flight continues without a log");
}

impl Target {
    /// An error ends a single log for good; with one log per flight, the next flight gets a new
    /// one.
    fn write(&mut self, record: Record, failures: &AtomicU64) -> Result<(), LogError> {
        match self {
            Self::One(writer) => writer.write(&record),
            Self::PerFlight(logs) => {
                if let Err(error) = logs.write(record) {
                    report(&error, failures);
                    logs.abandon();
                }
                Ok(())
            }
        }
    }

    fn sync_if_due(&mut self, wall: Instant, failures: &AtomicU64) -> Result<(), LogError> {
        match self {
            Self::One(writer) => writer.sync_if_due(wall),
            Self::PerFlight(logs) => {
                if let Err(error) = logs.sync_if_due(wall) {
                    report(&error, failures);
                    logs.abandon();
                }
                Ok(())
            }
        }
    }

    fn finish(self) -> Result<Option<LogSummary>, LogError> {
        match self {
            Self::One(writer) => writer.finish().map(Some),
            Self::PerFlight(logs) => logs.finish(),
        }
    }
}

/// Body of the writer's thread; runs until the sink is dropped.
fn drain(
    target: Target,
    mut listeners: Listeners,
    records: &Receiver<Record>,
    dropped: &AtomicU64,
    failures: &AtomicU64,
) -> Result<Option<LogSummary>, LogError> {
    let mut file = Ok(target);
    let mut reported = 0;
    let mut latest = HostTime::default();
    loop {
        let is_open = loop {
            match records.try_recv() {
                Ok(record) => {
                    latest = host_time(&record).unwrap_or(latest);
                    listeners.iter_mut().for_each(|listener| listener.on_record(&record));
                    step(&mut file, failures, |target| target.write(record, failures));
                    while let Some(remark) = listeners.iter_mut().find_map(|it| it.remark()) {
                        listeners.iter_mut().for_each(|listener| listener.on_record(&remark));
                        step(&mut file, failures, |target| target.write(remark, failures));
                    }
                }
                Err(TryRecvError::Empty) => break true,
                Err(TryRecvError::Disconnected) => break false,
            }
        };
        let total = dropped.load(Ordering::Relaxed);
        if total > reported {
            let text = format!("log: {} records dropped, the disk is too slow", total - reported);
            tracing::warn!("{text}");
            reported = total;
            let severity = Severity::Warning;
            let record = Record::Event { host: latest, severity, source: Source::Daemon, text };
            step(&mut file, failures, |target| target.write(record, failures));
        }
        step(&mut file, failures, |target| target.sync_if_due(Instant::now(), failures));
        // Without file and listeners, nothing receives the records.
        if !is_open || (file.is_err() && listeners.is_empty()) {
            break;
        }
        thread::sleep(DRAIN_PERIOD);
    }
    file?.finish()
}

/// Applies an action to the file, unless it has already failed.
fn step(
    file: &mut Result<Target, LogError>,
    failures: &AtomicU64,
    action: impl FnOnce(&mut Target) -> Result<(), LogError>,
) {
    if let Ok(target) = file
        && let Err(error) = action(target)
    {
        report(&error, failures);
        *file = Err(error);
    }
}

fn host_time(record: &Record) -> Option<HostTime> {
    match record {
        Record::Frame(frame) => Some(frame.host),
        Record::Tick(Tick { stamp, .. })
        | Record::Imu { stamp, .. }
        | Record::Motors { stamp, .. }
        | Record::Battery { stamp, .. }
        | Record::Truth { stamp, .. } => Some(stamp.host),
        Record::Link { host, .. } | Record::Timesync { host, .. } | Record::Event { host, .. } => {
            Some(*host)
        }
        Record::FlightBegins(host) => Some(*host),
        Record::Facts(_) | Record::FlightEnds => None,
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use crate::RunInfo;
    use std::collections::BTreeMap;
    use std::fs::File;
    use std::io::pipe;
    use std::os::fd::OwnedFd;

    /// A log on a pipe that breaks after the preamble, like a full disk.
    fn failing_writer() -> LogWriter {
        let (reader, writer) = pipe().expect("a pipe");
        let file = File::from(OwnedFd::from(writer));
        let (start, wall) = (HostTime::default(), Instant::now());
        let writer = LogWriter::on_file(file, "pipe".into(), &RunInfo::default(), start, wall)
            .expect("the pipe holds the preamble");
        drop(reader);
        writer
    }

    /// Metadata, which is written at once and exceeds the file's buffer.
    fn record() -> Record {
        Record::Facts(Box::new(BTreeMap::from([("key".into(), "x".repeat(20_000))])))
    }

    #[test]
    fn first_write_error_is_kept_and_later_records_are_accepted() {
        let mut sink = LogSink::threaded(failing_writer(), Vec::new()).expect("a thread");
        (0..3).for_each(|_| sink.log(record()));
        let error = sink.finish().expect_err("the pipe is broken");
        assert!(matches!(&error, LogError::Write { .. }) && error.to_string().contains("pipe"));
    }
}
