//! Exit codes, stable and documented.

use std::process::ExitCode;

/// Declares each exit code once: its name, its number and its meaning.
macro_rules! exits {
    ($($(#[doc = $meaning:literal])+ $name:ident = $code:literal,)+) => {
        /// How a command ended.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Exit {
            $($(#[doc = $meaning])+ $name = $code,)+
        }

        impl Exit {
            /// Every code with its meaning.
            pub(super) const MEANINGS: &[(u8, &str)] = &[$(($code, concat!($($meaning),+)),)+];
        }
    };
}

exits! {
    /// Done.
    Ok = 0,
    /// Something failed while running.
    Failure = 1,
    /// Bad flags, configuration, vehicle, trajectory or log file.
    Usage = 2,
    /// No vehicle was found, or the link was lost.
    Link = 3,
    /// The vehicle was refused, or would be (`fly --check` and `doctor`): preflight, mode or arming
    /// refused; two autopilots on the link; a form of poses that it does not accept (`mocap`).
    Refused = 4,
    /// The flight ended early: a safety reaction, or the pilot took over.
    Aborted = 5,
    /// No flyable plan was found; what was found is written.
    NoPlan = 6,
    /// A requested check failed: `log audit --fail-on`, `diagnose --fail-on`,
    /// `onset --fail-on-change`, `exam --fail-on-miss`, `compare --baseline`, `vehicle check`,
    /// `tube check`, `campaign`.
    Check = 10,
    /// Interrupted by Ctrl-C or SIGTERM: a command that flies no vehicle ends within two seconds
    /// and keeps its finished work; one that flies lands first. A lost link, a pilot's takeover or
    /// a safety reaction meanwhile has its own code. SIGTERM ends `daemon`, `mocap` and `sitl`
    /// with 0.
    Interrupted = 130,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

impl Exit {
    /// The process's exit code.
    pub fn code(self) -> u8 {
        self as u8
    }
}
