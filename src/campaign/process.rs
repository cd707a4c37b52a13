//! The station's process, which is stopped, killed and started again.

use std::io;
use std::process::{Child, Command, ExitStatus};

/// A running station. It is killed with this.
pub(super) struct Process {
    child: Child,
    is_stopped: bool,
}

impl Process {
    /// Starts it.
    ///
    /// # Errors
    /// If there is no such program.
    pub fn start(command: &mut Command) -> io::Result<Self> {
        Ok(Self { child: command.spawn()?, is_stopped: false })
    }

    /// How it ended, if it has.
    ///
    /// # Errors
    /// If it cannot be waited for.
    pub fn ended(&mut self) -> io::Result<Option<ExitStatus>> {
        self.child.try_wait()
    }

    /// Whether it stands still.
    pub fn is_stopped(&self) -> bool {
        self.is_stopped
    }

    /// It stands still, or runs on: SIGSTOP and SIGCONT.
    pub fn hold(&mut self, is_stopped: bool) {
        if std::mem::replace(&mut self.is_stopped, is_stopped) != is_stopped {
            self.signal(if is_stopped { libc::SIGSTOP } else { libc::SIGCONT });
        }
    }

    /// Asks it to land and to end, as Ctrl-C does.
    pub fn ask_to_end(&mut self) {
        self.signal(libc::SIGINT);
    }

    fn signal(&mut self, signal: libc::c_int) {
        let Ok(id) = libc::pid_t::try_from(self.child.id()) else { return };
        // One that has ended has its id until it was waited for.
        if matches!(self.child.try_wait(), Ok(None)) {
            // SAFETY: a call without memory; the process is this one's child and was not waited for.
            unsafe { libc::kill(id, signal) };
        }
    }

    /// SIGKILL, and waits until it is gone.
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
