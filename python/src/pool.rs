//! Thread pools, one for each call at a time: in a shared pool the short call of one Python thread would
//! wait until the long call of another has ended.

use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Stack size of a worker, bytes: that of a main thread.
const STACK: usize = 8 << 20;
/// Most pools that wait for the next call; further ones end.
const IDLE_MAX: usize = 4;

/// Pools that no call uses.
static IDLE: Mutex<Vec<Pool>> = Mutex::new(Vec::new());

#[derive(Clone)]
struct Pool {
    /// The process that started the threads: a forked child does not inherit them.
    process: u32,
    /// As requested: `None` for one for each core.
    threads: Option<usize>,
    pool: Arc<ThreadPool>,
}

/// A pool in use by one call, which is idle again after a drop.
pub struct Lease(Pool);

impl Lease {
    /// Takes an idle pool of so many threads, by default one for each core, or starts one.
    pub fn take(threads: Option<usize>) -> anyhow::Result<Self> {
        let process = std::process::id();
        let mut idle = IDLE.lock().unwrap_or_else(PoisonError::into_inner);
        let fits = |pool: &Pool| pool.process == process && pool.threads == threads;
        if let Some(at) = idle.iter().rposition(fits) {
            return Ok(Self(idle.remove(at)));
        }
        drop(idle);
        let builder = ThreadPoolBuilder::new().num_threads(threads.unwrap_or(0)).stack_size(STACK);
        let pool = Arc::new(builder.build().context("cannot start threads")?);
        Ok(Self(Pool { process, threads, pool }))
    }

    /// The pool.
    pub fn pool(&self) -> Arc<ThreadPool> {
        Arc::clone(&self.0.pool)
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        let mut idle = IDLE.lock().unwrap_or_else(PoisonError::into_inner);
        idle.push(self.0.clone());
        // A child never drops its parent's pools: it would wait for locks of threads that it does not have.
        let own = |pool: &&Pool| pool.process == self.0.process;
        if idle.iter().filter(own).count() > IDLE_MAX
            && let Some(oldest) = idle.iter().position(|pool| own(&pool))
        {
            let ended = idle.remove(oldest);
            drop(idle);
            drop(ended);
        }
    }
}
