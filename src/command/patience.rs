//! A word to whoever waits for a command that has nothing to say yet, as while it reads a large log.

use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread;
use std::time::{Duration, Instant};

use super::say;

/// So long nobody wonders.
const QUIET: Duration = Duration::from_millis(2500);
/// So long after each word.
const AGAIN: Duration = Duration::from_secs(30);

/// Says on stderr what takes long, until it is dropped.
pub(super) struct Patience {
    /// Ends the waiting by being dropped.
    _ended: Sender<()>,
}

impl Patience {
    /// For what is done from now on, as "reading flight.ulg".
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
        // Where no thread can be had, the command is silent.
        let _ = thread::Builder::new().name("patience".into()).spawn(telling);
        Self { _ended: ended }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_long_is_said_and_said_again_until_it_is_done() {
        let (said, heard) = mpsc::channel();
        let pause = Duration::from_millis(1);
        let patience = Patience::told(pause, pause, move |waited| {
            let _ = said.send(waited);
        });
        let (first, second) = (heard.recv().expect("a word"), heard.recv().expect("another"));
        assert!(pause <= first && first < second);
        drop(patience);
        // The teller ends, and its end of the channel with it.
        while heard.recv().is_ok() {}
    }

    #[test]
    fn what_is_soon_done_is_not_said() {
        let (said, heard) = mpsc::channel();
        let hour = Duration::from_secs(3600);
        drop(Patience::told(hour, hour, move |waited| {
            let _ = said.send(waited);
        }));
        assert!(heard.recv().is_err());
    }
}
