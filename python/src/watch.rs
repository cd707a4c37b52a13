//! Runs work without the interpreter's lock, in threads of this process, and ends it on Ctrl-C.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use pyo3::prelude::*;

use crate::errors::{exception, fault};
use crate::pool::Lease;

/// How often the waiting thread checks Python's signals.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// The worker's side of a watch: it checks whether to stop and reports progress.
#[derive(Clone)]
pub struct Watch {
    stop: Arc<AtomicBool>,
    news: SyncSender<News>,
}

/// A progress report: a stage with the steps done and their total.
struct News {
    stage: String,
    done: u64,
    of: u64,
}

impl Watch {
    /// The stop flag, which Ctrl-C sets.
    pub fn stop(&self) -> &Arc<AtomicBool> {
        &self.stop
    }

    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Reports progress.
    pub fn report(&self, stage: &str, done: u64, of: u64) {
        // Nobody listens after Ctrl-C.
        let _ = self.news.send(News { stage: stage.to_owned(), done, of });
    }
}

/// Runs `work` in `threads` threads, by default one for each core, and calls `progress` with
/// `(stage, done, of)`. Ctrl-C returns at once; the work ends at its next check.
pub fn watched<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Watch) -> anyhow::Result<T> + Send + 'static,
) -> PyResult<T> {
    let lease = py.detach(|| Lease::take(threads)).map_err(|error| exception(py, &error))?;
    let stop = Arc::new(AtomicBool::new(false));
    let (news, receiver) = sync_channel(64);
    // Nobody else locks it: a value used without the interpreter's lock must be `Sync`.
    let receiver = Mutex::new(receiver);
    let listen =
        || receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(LOOK_EVERY);
    let (finished, result) = sync_channel(1);
    let watch = Watch { stop: Arc::clone(&stop), news };
    let pool = lease.pool();
    pool.spawn(move || {
        let done = catch_unwind(AssertUnwindSafe(|| work(&watch)));
        // After Ctrl-C the caller is gone, and its pool is busy up to here.
        drop(lease);
        // Dropping the sender ends the progress reports after the result is sent.
        let _ = finished.send(done);
        drop(watch);
    });
    // Calls Python with the interpreter's lock and waits without it.
    let stopped = loop {
        match py.detach(listen) {
            Ok(News { stage, done, of }) => {
                let called = progress.map(|progress| progress.call1(py, (stage, done, of)));
                if let Some(Err(error)) = called {
                    break Some(error);
                }
            }
            Err(RecvTimeoutError::Disconnected) => break None,
            Err(RecvTimeoutError::Timeout) => {}
        }
        if let Err(error) = py.check_signals() {
            break Some(error);
        }
    };
    if let Some(error) = stopped {
        stop.store(true, Ordering::Relaxed);
        return Err(error);
    }
    match result.recv() {
        Ok(Ok(done)) => done.map_err(|error| exception(py, &error)),
        Ok(Err(panic)) => Err(fault(panic.as_ref())),
        Err(_) => Err(fault(&"a thread ended early")),
    }
}

/// Runs work that borrows, on every core without the interpreter's lock; a panic becomes an exception.
/// Ctrl-C sets the flag that the work is given, and this returns when the work has ended.
pub fn on_every_core<T: Send>(
    py: Python<'_>,
    work: impl FnOnce(&AtomicBool) -> T + Send,
) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    let done = py.detach(|| {
        let lease =
            Lease::take(None).map_err(|error| Python::attach(|py| exception(py, &error)))?;
        thread::scope(|scope| {
            let (finished, result) = sync_channel(1);
            let (stop, pool) = (&stop, lease.pool());
            scope.spawn(move || {
                let work = AssertUnwindSafe(|| pool.install(|| work(stop)));
                let _ = finished.send(catch_unwind(work));
            });
            loop {
                match result.recv_timeout(LOOK_EVERY) {
                    Ok(done) => break Ok(done),
                    Err(RecvTimeoutError::Disconnected) => {
                        break Ok(Err(Box::new("a thread ended early") as _));
                    }
                    Err(RecvTimeoutError::Timeout) => {
                        if let Err(error) = Python::attach(|py| py.check_signals()) {
                            stop.store(true, Ordering::Relaxed);
                            break Err(error);
                        }
                    }
                }
            }
        })
    })?;
    done.map_err(|panic| fault(panic.as_ref()))
}
