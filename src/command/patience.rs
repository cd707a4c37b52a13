//! A notice from a command that is still silent after a while, such as one that reads a large log.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

use super::say;

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
        Self::told(QUIET, AGAIN, move |waited| {
            say(format_args!("... {what}, for {:.0} s so far", waited.as_secs_f64()));
        })
    }

    fn told(quiet: Duration, again: Duration, tell: impl Fn(Duration) + Send + 'static) -> Self {
        let (ended, waiting) = mpsc::channel::<()>();
        let telling = move || {
            let start = Instant::now();
            let mut pause = quiet;
            while waiting.recv_timeout(pause) == Err(RecvTimeoutError::Timeout) {
                tell(start.elapsed());
                pause = again;
            }
        };
        // If no thread can be started, there are no notices.
        let _ = thread::Builder::new().name("patience".into()).spawn(telling);
        Self { _ended: ended }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_wait_is_reported_repeatedly_until_done() {
        let (said, heard) = mpsc::channel();
        let pause = Duration::from_millis(1);
        let patience = Patience::told(pause, pause, move |waited| {
            let _ = said.send(waited);
        });
        let (first, second) = (heard.recv().expect("a word"), heard.recv().expect("another"));
        assert!(pause <= first && first < second);
        drop(patience);
        // The reporting thread ends and closes its end of the channel.
        while heard.recv().is_ok() {}
    }

    #[test]
    fn short_wait_is_not_reported() {
        let (said, heard) = mpsc::channel();
        let hour = Duration::from_secs(3600);
        drop(Patience::told(hour, hour, move |waited| {
            let _ = said.send(waited);
        }));
        assert!(heard.recv().is_err());
    }
}
