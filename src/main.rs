//! The `downwash` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    downwash::command::main(None, std::env::args_os()).into()
}
