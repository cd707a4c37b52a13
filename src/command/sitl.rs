//! `downwash sitl`: the simulated vehicle on its links.

use sitl::cli::{SitlArgs, SitlError, Stop};

use super::setup::VehicleFile;
use super::{Exit, ExitContext};

pub(super) fn run(args: &SitlArgs) -> anyhow::Result<Exit> {
    // For what it says of numbers that do not fit each other.
    VehicleFile::load(&args.vehicle)?;
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
