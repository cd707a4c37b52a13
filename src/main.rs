//! The `downwash` command.

use std::io::IsTerminal;
use std::process::ExitCode;

use clap::Parser;
use downwash::cli::{Cli, Command};
use downwash::command::{self, Exit, Messages};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::time::uptime;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let messages = match Messages::start() {
        Ok(messages) => messages,
        Err(error) => {
            eprintln!("error: cannot start a thread: {error}");
            return Exit::Failure.into();
        }
    };
    // Who flies a vehicle is told what happens; elsewhere only what is wrong.
    let told = matches!(cli.command, Command::Fly(_) | Command::Daemon(_));
    let level =
        ["warn", "info", "debug"][usize::from(cli.verbose).saturating_add(told.into()).min(2)];
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_target(false)
        .with_timer(uptime())
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(messages.clone())
        .init();
    let result = command::run(cli);
    messages.flush();
    let exit = result.unwrap_or_else(|error| {
        eprintln!("error: {}", command::in_words(&error));
        command::exit_of(&error)
    });
    if exit == Exit::Interrupted {
        eprintln!("interrupted");
    }
    exit.into()
}
