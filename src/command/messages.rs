//! Messages on stderr, from any thread, without waiting for the terminal.

use std::io::{self, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use tracing_subscriber::fmt::MakeWriter;

use super::status_line;

/// Number of messages that may wait to be printed; further ones are dropped.
const QUEUE_LEN: usize = 1024;
/// Time at the end to print waiting messages.
const FLUSH_LIMIT: Duration = Duration::from_millis(500);

enum Item {
    Text(Vec<u8>),
    Flush(SyncSender<()>),
}

/// The writer of `tracing` to stderr. Its own thread prints, so that a terminal stopped by Ctrl-S,
/// or a pipe that nobody reads, does not block the control loop.
#[derive(Clone)]
pub struct Messages {
    queue: SyncSender<Item>,
}

impl Messages {
    /// Starts the thread that prints.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn start() -> io::Result<Self> {
        let (queue, items) = sync_channel(QUEUE_LEN);
        thread::Builder::new().name("messages".into()).spawn(move || print(&items))?;
        Ok(Self { queue })
    }

    /// Waits until all messages so far are printed, for a limited time.
    pub fn flush(&self) {
        let (done, wait) = sync_channel(1);
        if self.queue.try_send(Item::Flush(done)).is_ok() {
            // An error means that nobody reads stderr: nothing more to do.
            let _ = wait.recv_timeout(FLUSH_LIMIT);
        }
    }
}

fn print(items: &Receiver<Item>) {
    for item in items {
        match item {
            // A write error means that stderr is gone: nothing is left to report to.
            Item::Text(text) => drop(status_line::print_above(&text)),
            Item::Flush(done) => drop(done.try_send(())),
        }
    }
}

impl<'a> MakeWriter<'a> for Messages {
    type Writer = Line<'a>;

    fn make_writer(&'a self) -> Line<'a> {
        Line { queue: &self.queue }
    }
}

/// Takes one formatted message.
pub struct Line<'a> {
    queue: &'a SyncSender<Item>,
}

impl Write for Line<'_> {
    fn write(&mut self, text: &[u8]) -> io::Result<usize> {
        // A full queue drops the message; the flight log has it.
        let _ = self.queue.try_send(Item::Text(text.to_vec()));
        Ok(text.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
