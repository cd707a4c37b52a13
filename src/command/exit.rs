//! Exit codes, stable and documented in the README.

use std::process::ExitCode;

/// How a command ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Done.
    Ok,
    /// Something failed while running.
    Failure,
    /// Bad flags, configuration, vehicle file, trajectory file or log.
    Usage,
    /// No vehicle was heard, or the link was lost.
    Link,
    /// The vehicle may not or would not be flown: preflight, arming or mode refused.
    Refused,
    /// The flight was ended early: a safety reaction, or the pilot took over.
    Aborted,
    /// No plan was found that may be flown.
    NoPlan,
    /// A check that was asked for failed.
    Check,
    /// Ended by Ctrl-C or SIGTERM, after a clean stop.
    Interrupted,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

impl Exit {
    /// The process's exit code.
    pub fn code(self) -> u8 {
        match self {
            Exit::Ok => 0,
            Exit::Failure => 1,
            Exit::Usage => 2,
            Exit::Link => 3,
            Exit::Refused => 4,
            Exit::Aborted => 5,
            Exit::NoPlan => 6,
            Exit::Check => 10,
            Exit::Interrupted => 130,
        }
    }
}
