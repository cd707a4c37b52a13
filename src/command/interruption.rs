//! Ctrl-C and SIGTERM while no vehicle is flown: the command ends within two seconds.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use anyhow::Context;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::{Handle, Signals};

use super::{Exit, print_status};
use crate::log::partial;

/// Time that a command may take to keep its work after a signal.
pub(super) const GRACE: Duration = Duration::from_millis(1200);

/// Whether the end of the command is requested.
pub(super) struct Interruption {
    requested: Arc<AtomicBool>,
    looked_for: Arc<AtomicBool>,
    signals: Handle,
}

impl Interruption {
    /// From now on the first signal ends the program with [`Exit::Interrupted`]: at once, or after
    /// at most [`GRACE`] if the command checks [`flag`](Self::flag). The second signal ends it at
    /// once. Incomplete files are removed.
    pub fn watch() -> anyhow::Result<Self> {
        let mut signals = Signals::new([SIGINT, SIGTERM]).context("cannot watch for Ctrl-C")?;
        let (requested, looked_for) = (Arc::default(), Arc::default());
        let this = Self {
            requested: Arc::clone(&requested),
            looked_for: Arc::clone(&looked_for),
            signals: signals.handle(),
        };
        let waiting = move || {
            let mut signals = signals.forever();
            if signals.next().is_none() {
                return;
            }
            requested.store(true, Ordering::Relaxed);
            if looked_for.load(Ordering::Relaxed) {
                let limit = thread::Builder::new().name("grace".into()).spawn(|| {
                    thread::sleep(GRACE);
                    end();
                });
                if limit.is_ok() {
                    signals.next();
                }
            }
            end();
        };
        thread::Builder::new()
            .name("signals".into())
            .spawn(waiting)
            .context("cannot watch for Ctrl-C")?;
        Ok(this)
    }

    /// Set by the first signal. The caller must check it often, and end the command soon after.
    pub fn flag(&self) -> Arc<AtomicBool> {
        self.looked_for.store(true, Ordering::Relaxed);
        Arc::clone(&self.requested)
    }

    /// From now on leaves the signals to whoever watches them.
    pub fn hand_over(self) {
        self.signals.close();
    }
}

/// Ends the program as interrupted, without its incomplete files.
pub(super) fn end() {
    partial::discard_unfinished();
    print_status(format_args!("interrupted"));
    std::process::exit(Exit::Interrupted.code().into());
}
