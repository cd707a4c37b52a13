//! The `downwash` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    downwash::command::main(std::env::args_os()).into()
}
