//! The simulated vehicle as a standalone program.

use std::process::ExitCode;

use clap::Parser;

#[derive(Parser)]
#[command(name = "downwash-sitl", version, about = "A simulated quadrotor on MAVLink links")]
struct Command {
    #[command(flatten)]
    args: sitl::cli::SitlArgs,
}

fn main() -> ExitCode {
    match sitl::cli::run(&Command::parse().args) {
        Ok(stop) => stop.exit_code(),
        Err(error) => {
            eprintln!("error: {error}");
            error.exit_code()
        }
    }
}
