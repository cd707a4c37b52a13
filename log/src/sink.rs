//! Where records go in flight: to a thread that writes them. In lockstep the [`LogWriter`] is used
//! as it is.

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

/// Records that wait for the writer's thread: two seconds' worth at the busiest, as a slow card
/// may take to sync.
const QUEUE: usize = 8192;
/// How often the writer's thread empties the queue. It sleeps in between rather than wait on the
/// channel, so that sending a record never has to wake a thread.
const DRAIN_PERIOD: Duration = Duration::from_millis(20);

/// Hears every record in the thread that writes the log, before the log does: a live view, a link
/// to others. It must not wait for anybody.
pub trait Listener: Send {
    /// Hears one record.
    fn hear(&mut self, record: &Record);

    /// What it has to say for the log, once.
    fn remark(&mut self) -> Option<Record> {
        None
    }
}

/// All that hear the records of a run.
pub type Listeners = Vec<Box<dyn Listener>>;

/// Takes records and never fails: after an error of the file, which is reported once, records are
/// discarded and flying goes on.
pub struct LogSink {
    queue: SyncSender<Record>,
    /// Counted here, read by the writer's thread.
    dropped: Arc<AtomicU64>,
    /// Counted by the writer's thread.
    failures: Arc<AtomicU64>,
    thread: JoinHandle<Result<Option<LogSummary>, LogError>>,
}

/// What the writer's thread writes to.
enum Target {
    One(Box<LogWriter>),
    PerFlight(Box<FlightLogs>),
}

impl LogSink {
    /// Writes in a thread of its own; [`LogSink::log`] then takes less than a microsecond and
    /// never blocks. A record that finds the queue full is dropped, counted, and the log says so.
    /// `listeners` hear all records, also after the file has failed.
    ///
    /// # Errors
    /// [`LogError::Create`] if the system gives no thread.
    pub fn threaded(writer: LogWriter, listeners: Listeners) -> Result<Self, LogError> {
        let path = writer.path().to_owned();
        Self::spawn(Target::One(Box::new(writer)), listeners)
            .map_err(|source| LogError::Create { path, source })
    }

    /// As [`LogSink::threaded`], with one log for each flight between [`Record::FlightBegins`] and
    /// [`Record::FlightEnds`], opened by `open` in the writer's thread.
    ///
    /// # Errors
    /// If the system gives no thread.
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

    /// Hands over `record`.
    pub fn log(&mut self, record: Record) {
        match self.queue.try_send(record) {
            // The thread ends early only after an error that it has reported.
            Ok(()) | Err(TrySendError::Disconnected(_)) => {}
            Err(TrySendError::Full(_)) => {
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Records dropped so far because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Logs that ended by an error so far.
    pub fn failures(&self) -> u64 {
        self.failures.load(Ordering::Relaxed)
    }

    /// Writes what is left and closes the file; `None` if there was no flight to keep a log of.
    ///
    /// # Errors
    /// The error that ended the log, now or earlier.
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
    tracing::error!("{error}; flying goes on without a log");
}

impl Target {
    /// An error ends a single log for good; the next flight gets a new one.
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

/// The writer's thread: until the sink is gone.
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
                    listeners.iter_mut().for_each(|listener| listener.hear(&record));
                    step(&mut file, failures, |target| target.write(record, failures));
                    while let Some(remark) = listeners.iter_mut().find_map(|it| it.remark()) {
                        listeners.iter_mut().for_each(|listener| listener.hear(&remark));
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
        // Nobody hears what is not written any more.
        if !is_open || (file.is_err() && listeners.is_empty()) {
            break;
        }
        thread::sleep(DRAIN_PERIOD);
    }
    file?.finish()
}

/// Does something to the file, unless it has failed before.
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

    /// A log on a pipe that breaks after the preamble, as a disk does when it is full.
    fn failing_writer() -> LogWriter {
        let (reader, writer) = pipe().expect("a pipe");
        let file = File::from(OwnedFd::from(writer));
        let (start, wall) = (HostTime::default(), Instant::now());
        let writer = LogWriter::on_file(file, "pipe".into(), &RunInfo::default(), start, wall)
            .expect("the pipe holds the preamble");
        drop(reader);
        writer
    }

    /// Metadata, which goes to the file at once, and is larger than the file's buffer.
    fn record() -> Record {
        Record::Facts(Box::new(BTreeMap::from([("key".into(), "x".repeat(20_000))])))
    }

    #[test]
    fn first_error_is_kept_and_more_is_taken() {
        let mut sink = LogSink::threaded(failing_writer(), Vec::new()).expect("a thread");
        (0..3).for_each(|_| sink.log(record()));
        let error = sink.finish().expect_err("the pipe is broken");
        assert!(matches!(&error, LogError::Write { .. }) && error.to_string().contains("pipe"));
    }
}
