//! `downwash sitl`: the simulated vehicle on its links.

use sitl::cli::SitlArgs;

use super::Exit;

pub(super) fn run(args: &SitlArgs) -> anyhow::Result<Exit> {
    Ok(match sitl::cli::run(args) {
        Ok(()) => Exit::Ok,
        Err(error) => return Err(error.into()),
    })
}
