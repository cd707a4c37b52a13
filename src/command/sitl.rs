//! `downwash sitl`: the simulated vehicle on its links.

use sitl::cli::{SitlArgs, SitlError, Stop};

use super::{Exit, ExitContext};

pub(super) fn run(args: &SitlArgs) -> anyhow::Result<Exit> {
    match sitl::cli::run(args) {
        Ok(Stop::Interrupt) => Ok(Exit::Interrupted),
        Ok(Stop::Terminate) => Ok(Exit::Ok),
        Err(error) => {
            let exit = match error {
                SitlError::Link(_) => Exit::Link,
                SitlError::Runtime(_) => Exit::Failure,
                _ => Exit::Usage,
            };
            Err(error).or_exit(exit)
        }
    }
}
