//! The `downwash` command.

use std::process::ExitCode;

use clap::Parser;
use downwash::cli::Cli;
use downwash::command::{self, Exit};
use tracing_subscriber::EnvFilter;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let level = match cli.verbose {
        0 => "warn",
        1 => "info",
        _ => "debug",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    let exit = command::run(cli).unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        command::exit_of(&error)
    });
    if exit == Exit::Interrupted {
        eprintln!("interrupted");
    }
    exit.into()
}
