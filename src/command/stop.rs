//! Requests of the user, or of a service manager, to stop.

use std::time::Duration;

use anyhow::Context;
use tokio::runtime::Runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::Interruption;

/// The origin of a request to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stop {
    /// Ctrl-C.
    Interrupt,
    /// SIGTERM.
    Terminate,
}

/// The requests to stop a flight since this was created. None is lost while nobody waits, as
/// between two flights. Several of one kind at once count as one.
pub(super) struct StopSignals {
    runtime: Runtime,
    interrupt: Signal,
    terminate: Signal,
    first: Option<Stop>,
}

impl StopSignals {
    /// From now on these signals do not end the program by themselves, as under `preparation`.
    pub fn after(preparation: Option<Interruption>) -> anyhow::Result<Self> {
        let signals = Self::new()?;
        // In this order, no signal is lost between the two.
        if let Some(preparation) = preparation {
            preparation.hand_over();
        }
        Ok(signals)
    }

    fn new() -> anyhow::Result<Self> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .context("cannot start the runtime that watches signals")?;
        let watch = |kind| {
            let _inside = runtime.enter();
            signal(kind).context("cannot watch signals")
        };
        let (interrupt, terminate) =
            (watch(SignalKind::interrupt())?, watch(SignalKind::terminate())?);
        Ok(Self { runtime, interrupt, terminate, first: None })
    }

    /// Waits for the next request, for at most `period`.
    pub fn wait(&mut self, period: Duration) -> Option<Stop> {
        let Self { runtime, interrupt, terminate, first } = self;
        let requested = runtime.block_on(async {
            tokio::select! {
                _ = interrupt.recv() => Some(Stop::Interrupt),
                _ = terminate.recv() => Some(Stop::Terminate),
                () = tokio::time::sleep(period) => None,
            }
        });
        *first = first.or(requested);
        requested
    }

    /// Adds a request by key.
    pub fn request(&mut self, stop: Stop) {
        self.first = self.first.or(Some(stop));
    }

    /// The first request, of all that [`wait`](Self::wait) has seen and
    /// [`request`](Self::request) was given.
    pub fn first(&self) -> Option<Stop> {
        self.first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stop_request_is_kept_while_nobody_waits() {
        let mut signals = StopSignals::new().expect("signals");
        assert_eq!(signals.wait(Duration::from_millis(1)), None);
        // SAFETY: sends this process a signal that it handles.
        assert_eq!(unsafe { libc::raise(libc::SIGTERM) }, 0);
        assert_eq!(signals.wait(Duration::from_secs(10)), Some(Stop::Terminate));
        assert_eq!(signals.wait(Duration::from_millis(1)), None, "once");
        assert_eq!(signals.first(), Some(Stop::Terminate));
    }
}
