//! Drives a station in real time: one thread with its own runtime, from socket to socket.

use std::io;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use sd_notify::NotifyState;
use tokio::time::timeout_at;

use crate::clock::HostTime;
use crate::forward::Guests;
use crate::guard::STALL;
use crate::link::connection::{Connection, Input};
use crate::link::tee::TeeThread;
use crate::log::LogSink;
use crate::memory;
use crate::station::{End, PAUSE, Station, Status};
use crate::view::Changes;

/// Period at which the status is refreshed.
const STATUS_PERIOD: Duration = Duration::from_millis(100);
/// Period at which the control loop feeds the watchdog of systemd.
const WATCHDOG_PERIOD: Duration = Duration::from_millis(500);
/// Time from a request to stop until the process ends, even if the flight has not landed.
const STOP_LIMIT: Duration = Duration::from_secs(90);
/// Longest datagram, and most bytes taken from a stream at once.
const BUFFER_LEN: usize = 65_536;

/// Longest time spent on unread input: a flood cannot be caught up with.
const CATCH_UP_LIMIT: Duration = Duration::from_millis(200);

/// A clock that never steps and runs on while the machine is suspended. It starts at the wall
/// clock's time.
#[derive(Clone, Copy, Debug)]
pub struct HostClock {
    started: Duration,
    epoch: HostTime,
}

/// Time since boot, suspensions included.
#[cfg(target_os = "linux")]
fn since_boot() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    Duration::new(now.tv_sec.try_into().unwrap_or(0), now.tv_nsec.try_into().unwrap_or(0))
}

/// Time since the first call. On these systems it stops during a suspension.
#[cfg(not(target_os = "linux"))]
fn since_boot() -> Duration {
    static FIRST: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    FIRST.elapsed()
}

impl HostClock {
    /// A clock that starts at the wall clock's present time.
    pub fn start() -> Self {
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let epoch = HostTime::from_ns(since_epoch.as_nanos() as u64);
        Self { started: since_boot(), epoch }
    }

    /// Host time now.
    pub fn now(&self) -> HostTime {
        self.epoch + since_boot().saturating_sub(self.started)
    }

    /// The instant at which the clock reads `time`.
    fn instant(&self, time: HostTime) -> Instant {
        Instant::now() + time.since(self.now())
    }
}

/// The state that the control thread shares with the thread that watches it. The control thread
/// never waits for it.
#[derive(Debug, Default)]
struct Shared {
    /// Written by the control thread, which skips an update while it is being read.
    status: Mutex<Status>,
    /// Requests to stop so far.
    stops: AtomicU8,
}

/// A station that runs in its own thread.
pub struct Running {
    shared: Arc<Shared>,
    thread: JoinHandle<(Station, Finished)>,
}

/// How a run ended.
pub struct Finished {
    /// The station's own verdict; `None` if it reached none in time after a request to stop.
    pub end: Option<End>,
    /// The log's summary of itself.
    pub log: Result<Option<crate::log::writer::LogSummary>, crate::log::writer::LogError>,
    /// The number of entries missing from the telemetry log, if one was requested.
    pub tlog: Option<io::Result<u64>>,
}

/// The outputs and inputs of the control thread besides the link.
pub struct Outlets {
    /// Takes every byte of the link.
    pub tee: Option<TeeThread>,
    /// Takes every record.
    pub sink: LogSink,
    /// Frames from other ground stations for the vehicle.
    pub guests: Option<Guests>,
    /// What viewers may change.
    pub changes: Option<Changes>,
}

/// Locks the memory and starts the control thread. It ends when the station's flight has ended and nothing more is to be
/// recorded, or after [`Running::stop`].
///
/// # Errors
/// If the system provides no thread or no runtime.
pub fn start(
    mut station: Station,
    clock: HostClock,
    connection: Connection,
    outlets: Outlets,
) -> io::Result<Running> {
    memory::lock();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let shared = Arc::new(Shared::default());
    let seen = Arc::clone(&shared);
    let thread = thread::Builder::new().name("control".into()).spawn(move || {
        let Outlets { tee, sink, guests, changes } = outlets;
        let shared = &*seen;
        let mut control = Control { clock, connection, tee, sink, guests, changes, shared };
        let end = runtime.block_on(control.run(&mut station));
        let log = control.sink.finish();
        let tlog = control.tee.map(TeeThread::finish);
        (station, Finished { end, log, tlog })
    })?;
    Ok(Running { shared, thread })
}

impl Running {
    /// Requests the end of the flight: the vehicle lands. A second request stops the stream at
    /// once.
    pub fn stop(&self) {
        self.shared.stops.fetch_add(1, Ordering::AcqRel);
    }

    /// Whether the thread has ended, even by a panic.
    pub fn is_done(&self) -> bool {
        self.thread.is_finished()
    }

    /// The latest status.
    pub fn status(&self) -> Status {
        self.shared.status.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Waits for the thread to end.
    pub fn join(self) -> Finished {
        match self.thread.join() {
            Ok((_, finished)) => finished,
            Err(panic) => std::panic::resume_unwind(panic),
        }
    }
}

/// The control thread.
struct Control<'a> {
    clock: HostClock,
    connection: Connection,
    tee: Option<TeeThread>,
    sink: LogSink,
    guests: Option<Guests>,
    changes: Option<Changes>,
    shared: &'a Shared,
}

impl Control<'_> {
    /// Runs until the flight is over. In each turn it reads bytes, sends at most one setpoint, and
    /// only then writes the log.
    async fn run(&mut self, station: &mut Station) -> Option<End> {
        let mut buffer = vec![0; BUFFER_LEN];
        let mut status_due = self.clock.now();
        let mut watchdog_due = status_due;
        let mut stops = 0;
        let mut stop_limit: Option<HostTime> = None;
        let mut turn = self.clock.now();
        let _ = sd_notify::notify(&[NotifyState::Ready]);
        loop {
            let deadline = station.next_deadline(self.clock.now());
            let input = self.next_input(&mut buffer, self.clock.instant(deadline)).await;
            let mut now = self.clock.now();
            let pause = now.since(turn);
            if pause > PAUSE {
                self.catch_up(station, input, &mut buffer).await;
                now = self.clock.now();
                station.resumed(now, pause);
            } else if let Some(input) = input {
                self.take(station, now, input, &buffer);
            }
            turn = now;
            if now >= deadline {
                station.poll(now);
            }
            if let Some(guests) = &self.guests {
                guests.take().for_each(|frame| station.forward(&frame));
            }
            self.send(station, now);
            station.take_records(|record| self.sink.log(record));
            if now >= status_due {
                status_due = now + STATUS_PERIOD;
                // One at a time, so that no viewer fills the log with what it asks for.
                if let Some(requested) = self.changes.as_ref().and_then(Changes::take) {
                    station.adjust(now, &requested);
                }
                if let Ok(mut status) = self.shared.status.try_lock() {
                    *status = Status {
                        updated: Some(now),
                        log_dropped: self.sink.dropped(),
                        log_failures: self.sink.failures(),
                        ..station.status()
                    };
                }
            }
            if now >= watchdog_due {
                watchdog_due = now + WATCHDOG_PERIOD;
                let _ = sd_notify::notify(&[NotifyState::Watchdog]);
            }
            let requested = self.shared.stops.load(Ordering::Acquire);
            if requested > stops {
                stops = requested;
                if stops == 1 {
                    stop_limit = Some(now + STOP_LIMIT);
                    station.land(now);
                    self.send(station, now);
                }
            }
            let out_of_time = stop_limit.is_some_and(|limit| now >= limit);
            if station.is_over() || stops > 1 || out_of_time {
                station.take_records(|record| self.sink.log(record));
                let _ = sd_notify::notify(&[NotifyState::Stopping]);
                return station.end().cloned();
            }
        }
    }

    /// Waits for input until the deadline, which is never far away.
    async fn next_input(&mut self, buffer: &mut [u8], deadline: Instant) -> Option<Input> {
        // A datagram wait leaves the runtime nothing else to do. With cold caches, as after the 10
        // ms between two samples, the runtime takes longer from the system's wake-up to the
        // receiving call than the control path takes from there to the setpoint.
        if self.connection.can_wait() {
            return self
                .connection
                .wait(buffer, deadline.saturating_duration_since(Instant::now()));
        }
        timeout_at(deadline.into(), self.connection.recv(buffer)).await.ok()
    }

    /// Reads what was left unread during a pause of this process, before anything is judged by the
    /// clock: a mode change by the pilot may be in it.
    async fn catch_up(
        &mut self,
        station: &mut Station,
        mut input: Option<Input>,
        buffer: &mut [u8],
    ) {
        let began = self.clock.now();
        while let Some(next) = input {
            let now = self.clock.now();
            match next {
                Input::Bytes { peer, len } => {
                    let bytes = &buffer[..len];
                    station.catch_up(now, peer, bytes, self.connection.is_datagram());
                    if let Some(tee) = &mut self.tee {
                        tee.received(now, peer, bytes, self.connection.is_datagram());
                    }
                }
                other => self.take(station, now, other, buffer),
            }
            if now.since(began) > CATCH_UP_LIMIT {
                return;
            }
            input = self.next_input(buffer, Instant::now() + Duration::from_millis(2)).await;
        }
    }

    fn take(&mut self, station: &mut Station, now: HostTime, input: Input, buffer: &[u8]) {
        match input {
            Input::Bytes { peer, len } => {
                let bytes = &buffer[..len];
                station.receive(now, peer, bytes, self.connection.is_datagram());
                self.send(station, now);
                // Other peers, however many, do not displace the vehicle.
                self.connection.keep(station.vehicle_peer());
                if let Some(tee) = &mut self.tee {
                    tee.received(now, peer, bytes, self.connection.is_datagram());
                }
            }
            Input::Opened => station.opened(now),
            // Opening is retried until it succeeds.
            Input::Failed { error, .. } => station.not_opened(now, error.to_string()),
            Input::Lost(error) => {
                station.closed(now, &error.to_string());
                if let Some(tee) = &mut self.tee {
                    tee.transport_closed(now);
                }
            }
            Input::PeerOpened(_) => {}
            Input::PeerClosed(peer) => {
                station.peer_closed(now, peer);
                if let Some(tee) = &mut self.tee {
                    tee.peer_closed(now, peer);
                }
            }
        }
    }

    /// Sends the station's frames made at `now`. A frame made before a stall of this process does
    /// not leave after it.
    fn send(&mut self, station: &mut Station, now: HostTime) {
        let Self { clock, connection, tee, .. } = self;
        station.transmit(now, |peer, frame| {
            let is_taken = clock.now().since(now) <= STALL && connection.send(peer, frame);
            if let Some(tee) = tee.as_mut().filter(|_| is_taken) {
                tee.sent(now, frame);
            }
            is_taken
        });
    }
}
