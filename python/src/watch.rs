//! Runs work without the interpreter's lock, in threads of this process, and ends it on Ctrl-C.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::errors::{exception, fault};

/// How often the waiting thread checks Python's signals.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Stack size of a worker, bytes: that of a main thread.
const STACK: usize = 8 << 20;

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

/// The thread pool of this process: a forked child does not inherit its parent's threads.
pub fn pool(threads: Option<usize>) -> anyhow::Result<Arc<ThreadPool>> {
    type Pools = Vec<(u32, Option<usize>, Arc<ThreadPool>)>;
    // Never dropped: in a child, a drop would wait for the parent's threads.
    static POOLS: Mutex<Pools> = Mutex::new(Vec::new());
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    let known = pools.iter().find(|(of, count, _)| *of == process && *count == threads);
    if let Some((.., pool)) = known {
        return Ok(Arc::clone(pool));
    }
    let builder = ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).stack_size(STACK);
    let pool = Arc::new(builder.build().context("cannot start threads")?);
    pools.push((process, threads, Arc::clone(&pool)));
    Ok(pool)
}

/// Runs `work` in `threads` threads, by default one for each core, and calls `progress` with
/// `(stage, done, of)`. Ctrl-C returns at once; the work ends at its next check.
pub fn watched<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&Watch) -> anyhow::Result<T> + Send + 'static,
) -> PyResult<T> {
    let pool = py.detach(|| pool(threads)).map_err(|error| exception(py, &error))?;
    let stop = Arc::new(AtomicBool::new(false));
    let (news, receiver) = sync_channel(64);
    // Nobody else locks it: a value used without the interpreter's lock must be `Sync`.
    let receiver = Mutex::new(receiver);
    let listen =
        || receiver.lock().unwrap_or_else(PoisonError::into_inner).recv_timeout(LOOK_EVERY);
    let (finished, result) = sync_channel(1);
    let watch = Watch { stop: Arc::clone(&stop), news };
    pool.spawn(move || {
        let done = catch_unwind(AssertUnwindSafe(|| work(&watch)));
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

/// Runs short work on every core without the interpreter's lock; a panic becomes an exception.
pub fn on_every_core<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let done = py.detach(|| {
        let pool = pool(None)?;
        Ok(catch_unwind(AssertUnwindSafe(|| pool.install(work))))
    });
    match done {
        Ok(Ok(done)) => Ok(done),
        Ok(Err(panic)) => Err(fault(panic.as_ref())),
        Err(error) => Err(exception(py, &error)),
    }
}
