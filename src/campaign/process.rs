//! The station's process, which can be stopped, killed and restarted.

use std::io;
use std::process::{Child, Command, ExitStatus};

/// A running station; dropping it kills it.
pub(super) struct Process {
    child: Child,
    is_stopped: bool,
}

impl Process {
    /// Starts the process.
    ///
    /// # Errors
    /// The program cannot be started.
    pub fn start(command: &mut Command) -> io::Result<Self> {
        Ok(Self { child: command.spawn()?, is_stopped: false })
    }

    /// The exit status, once the process ended.
    ///
    /// # Errors
    /// The process cannot be waited for.
    pub fn ended(&mut self) -> io::Result<Option<ExitStatus>> {
        self.child.try_wait()
    }

    /// Whether the process is stopped.
    pub fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// Stops the process or lets it run on, with SIGSTOP and SIGCONT.
    pub fn hold(&mut self, is_stopped: bool) {
        if std::mem::replace(&mut self.is_stopped, is_stopped) != is_stopped {
            self.signal(if is_stopped { libc::SIGSTOP } else { libc::SIGCONT });
        }
    }

    /// Asks it to land and to end, like Ctrl-C.
    pub fn request_end(&mut self) {
        self.signal(libc::SIGINT);
    }

    fn signal(&mut self, signal: libc::c_int) {
        let Ok(id) = libc::pid_t::try_from(self.child.id()) else { return };
        // A process that has ended keeps its id until it is waited for.
        if matches!(self.child.try_wait(), Ok(None)) {
            // SAFETY: a call without memory; the process is this one's child and was not waited
            // for.
            unsafe { libc::kill(id, signal) };
        }
    }

    /// Sends SIGKILL, and waits until the process is gone.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}
