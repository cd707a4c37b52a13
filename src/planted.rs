//! Bugs that tests plant, to see that a campaign finds them. Not part of the program.

use std::cell::Cell;

/// A bug.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Planted {
    /// The guard does not ask who permits.
    GuardRemoved,
    /// The guard does not bound the thrust.
    LimitsRemoved,
    /// The last setpoint is sent again while no state comes.
    SentAgain,
    /// Control goes on for twice as long after landing was asked for.
    DeadlineDoubled,
    /// A stall is one from twice its time on.
    StallDoubled,
    /// A word of the mode is believed, however old.
    OlderHeartbeat,
}

thread_local! {
    static PLANTED: Cell<Option<Planted>> = const { Cell::new(None) };
}

/// Plants a bug in this thread, or none.
pub fn plant(bug: Option<Planted>) {
    PLANTED.set(bug);
}

/// Whether this one is planted.
pub fn is(bug: Planted) -> bool {
    PLANTED.get() == Some(bug)
}
