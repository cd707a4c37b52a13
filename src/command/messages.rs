//! Messages on stderr, from any thread, without waiting for the terminal.

use std::io::{self, Write};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;

use tracing_subscriber::fmt::MakeWriter;

use super::status_line;

/// Messages that may wait to be printed; those beyond are dropped.
const QUEUE_LEN: usize = 1024;
/// At the end, time to print what waits.
const FLUSH_LIMIT: Duration = Duration::from_millis(500);

enum Item {
    Text(Vec<u8>),
    Flush(SyncSender<()>),
}

/// The way to stderr for `tracing`. A thread of its own prints, so that a terminal that is stopped
/// by Ctrl-S, or a pipe that nobody reads, does not hold up the control loop.
#[derive(Clone)]
pub struct Messages {
    queue: SyncSender<Item>,
}

impl Messages {
    /// Starts the thread that prints.
    ///
    /// # Errors
    /// If the system gives no thread.
    pub fn start() -> io::Result<Self> {
        let (queue, items) = sync_channel(QUEUE_LEN);
        thread::Builder::new().name("messages".into()).spawn(move || print(&items))?;
        Ok(Self { queue })
    }

    /// Waits until all messages so far are printed, though not for long.
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
            // Nobody to tell when stderr is gone.
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
