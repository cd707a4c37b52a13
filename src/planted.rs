//! Bugs that tests plant to check that a campaign finds them. Not part of the program.

use std::cell::Cell;

/// A bug.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Planted {
    /// The guard ignores whether setpoints are permitted.
    GuardRemoved,
    /// The guard does not bound the thrust.
    LimitsRemoved,
    /// The last setpoint is sent again while no state arrives.
    SentAgain,
    /// Control continues twice as long after the request to land.
    DeadlineDoubled,
    /// A stall counts as one only from twice its limit on.
    StallDoubled,
    /// A mode report is accepted however old it is.
    OlderHeartbeat,
}

thread_local! {
    static PLANTED: Cell<Option<Planted>> = const { Cell::new(None) };
}

/// Plants a bug in this thread, or removes it.
pub fn plant(bug: Option<Planted>) {
    PLANTED.set(bug);
}

/// Whether this bug is planted in this thread.
pub fn is(bug: Planted) -> bool {
    PLANTED.get() == Some(bug)
}
