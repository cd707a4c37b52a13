//! The program's memory.

/// Keeps what the program has in memory now, its code above all, from being evicted: a line in real
/// time that must read its code from disk again is late by a tenth of a second and more. Memory
/// that comes later is not locked.
///
/// Linux sets a limit (`ulimit -l`), and 8 MiB for a user is too little. The program then runs
/// without the lock, and says so in the debug log. Does nothing on other systems.
pub fn lock() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::mm::mlockall(rustix::mm::MlockAllFlags::CURRENT) {
        tracing::debug!(
            "the memory is not locked ({error}), so a machine short of memory may delay setpoints; \
             `ulimit -l unlimited` or CAP_IPC_LOCK permits it"
        );
    }
}
