//! A notice from a command that is still silent after a while, such as one that reads a large log.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

use super::print_status;

/// Time until the first notice.
const QUIET: Duration = Duration::from_millis(2500);
/// Time between notices.
const AGAIN: Duration = Duration::from_secs(30);

/// Names the slow step on stderr, until it is dropped.
pub(super) struct Patience {
    /// Dropping it ends the thread.
    _ended: Sender<()>,
}

impl Patience {
    /// Starts waiting for the step `what`, such as "reading flight.ulg".
    pub fn with(what: String) -> Self {
        Self::with_report(QUIET, AGAIN, move |waited| {
            print_status(format_args!("... {what}, for {:.0} s so far", waited.as_secs_f64()));
        })
    }

    fn with_report(
        quiet: Duration,
        again: Duration,
        report: impl Fn(Duration) + Send + 'static,
    ) -> Self {
        let (ended, waiting) = mpsc::channel::<()>();
        let reporting = move || {
            let start = Instant::now();
            let mut pause = quiet;
            while waiting.recv_timeout(pause) == Err(RecvTimeoutError::Timeout) {
                report(start.elapsed());
                pause = again;
            }
        };
        // If no thread can be started, there are no notices.
        let _ = thread::Builder::new().name("patience".into()).spawn(reporting);
        Self { _ended: ended }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_wait_is_reported_repeatedly_until_done() {
        let (sender, receiver) = mpsc::channel();
        let pause = Duration::from_millis(1);
        let patience = Patience::with_report(pause, pause, move |waited| {
            let _ = sender.send(waited);
        });
        let (first, second) = (receiver.recv().expect("a word"), receiver.recv().expect("another"));
        assert!(pause <= first && first < second);
        drop(patience);
        // The reporting thread ends and closes its end of the channel.
        while receiver.recv().is_ok() {}
    }

    #[test]
    fn short_wait_is_not_reported() {
        let (sender, receiver) = mpsc::channel();
        let hour = Duration::from_secs(3600);
        drop(Patience::with_report(hour, hour, move |waited| {
            let _ = sender.send(waited);
        }));
        assert!(receiver.recv().is_err());
    }
}
