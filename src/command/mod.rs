//! The commands: validated options, then work, then an exit code.

mod audience;
mod audit;
mod campaign;
mod collect;
mod compare;
mod config;
mod course;
mod daemon;
mod demo;
mod demo_diagnose;
mod diagnose;
mod doctor;
mod exam;
mod exit;
mod fleet;
mod fly;
mod goal_file;
mod import;
mod improved;
mod inspect;
mod interruption;
mod lap_course;
mod link_parameters;
mod listen;
mod log;
mod logs;
mod messages;
mod mocap;
mod model;
mod onset;
mod output;
mod patience;
mod plan;
mod progress;
mod reference;
mod replay;
mod rows;
mod schema;
mod screen;
mod screen_content;
mod screen_layout;
mod sent_thrust;
mod setup;
mod signing;
mod signing_state;
mod simulate;
mod simulation;
mod sitl;
mod status_line;
mod stop;
mod summary;
mod sweep;
mod train;
mod tube;
mod vehicle;
mod vehicle_file;

use std::ffi::OsString;
use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use anyhow::Context;
use clap::Parser;
use serde::Serialize;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::time::uptime;

use crate::cli::{Cli, Command};
use crate::log::partial::PartialFile;
pub use audit::{AuditSummary, audit};
pub use compare::{Compared, compared, entry};
pub use course::Course;
pub use diagnose::{Finding, find};
pub use exit::Exit;
use interruption::Interruption;
use messages::Messages;
pub use model::{EvaluationSummary, Info as ModelInfo, evaluated};
pub use onset::{Changes, changed};
pub use plan::{
    CLOSING_SHARE, Fastest, PlanModel, SEARCH_SHARE, plan_fastest, plan_trajectory, sha256_of,
};
pub use simulate::{Inputs, Row, Simulation, configuration};
pub use simulation::Truth;
pub use sweep::{Sweep, SweepSummary};
pub use train::{Learning, Resume, Trained, learn};
pub use vehicle::{Made, make};
pub use vehicle_file::VehicleFile;

/// The path of this program, if it is not the process's own executable.
static PROGRAM: OnceLock<PathBuf> = OnceLock::new();

/// Sets the file that starts this program, for another program that uses its functions. Only the
/// first call counts.
pub fn set_program(program: PathBuf) {
    PROGRAM.get_or_init(|| program);
}

/// The file that starts this program.
fn program() -> anyhow::Result<PathBuf> {
    match PROGRAM.get() {
        Some(program) => Ok(program.clone()),
        None => std::env::current_exe().context("this program's own file"),
    }
}

/// The whole program, for these arguments, the first of which is its name. Help, the version and
/// wrong flags end the process. `program` is the file that starts it, if another program runs it.
pub fn main(program: Option<PathBuf>, args: impl IntoIterator<Item = OsString>) -> Exit {
    if let Some(program) = program {
        set_program(program);
    }
    let cli = Cli::parse_from(args);
    let messages = match Messages::start() {
        Ok(messages) => messages,
        Err(error) => {
            eprintln!("error: cannot start a thread: {error}");
            return Exit::Failure;
        }
    };
    // A flight prints events; other commands print only warnings.
    let is_flight = matches!(cli.command, Command::Fly(_) | Command::Daemon(_));
    // The stations of a campaign print nothing: there are thousands, and a judge reports on them.
    let is_judged = matches!(cli.command, Command::Campaign(_)) && cli.verbose == 0;
    let level = if is_judged {
        "off"
    } else {
        ["warn", "info", "debug"][usize::from(cli.verbose).saturating_add(is_flight.into()).min(2)]
    };
    let filter = EnvFilter::try_from_default_env()
        .unwrap_or_else(|_| EnvFilter::new(format!("{level},foxglove=off")));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_target(false)
        .with_timer(uptime())
        .with_ansi(io::stderr().is_terminal())
        .with_writer(messages.clone())
        .init();
    let result = run(cli);
    messages.flush();
    let exit = result.unwrap_or_else(|error| {
        eprintln!("error: {}", error_text(&error));
        exit_of(&error)
    });
    if exit == Exit::Interrupted {
        eprintln!("interrupted");
    }
    exit
}

/// Runs the command.
///
/// # Errors
/// The error with its context; [`exit_of`] finds the exit code in it.
fn run(cli: Cli) -> anyhow::Result<Exit> {
    match cli.command {
        // These fly or simulate a vehicle, and handle signals themselves.
        Command::Fly(args) => fly::run(&args, Interruption::watch()?),
        Command::Collect(args) => collect::run(&args, Interruption::watch()?),
        Command::Daemon(args) => daemon::run(&args, Interruption::watch()?),
        Command::Doctor(args) => {
            Interruption::watch()?;
            end_on_broken_pipe();
            doctor::run(&args)
        }
        Command::Inspect(args) => {
            Interruption::watch()?;
            end_on_broken_pipe();
            inspect::run(&args)
        }
        Command::Mocap(args) => mocap::run(&args, Interruption::watch()?),
        Command::Sitl(args) => sitl::run(&args),
        Command::Replay(args) => replay::run(&args, Interruption::watch()?),
        Command::Demo(args) => demo::run(&args, &Interruption::watch()?),
        Command::Simulate(args) => {
            Interruption::watch()?;
            simulate::run(&args)
        }
        Command::Campaign(args) => campaign::run(&args, &Interruption::watch()?),
        Command::Sweep(args) => sweep::run(&args, &Interruption::watch()?),
        Command::Train(args) => train::run(&args, &Interruption::watch()?),
        Command::Plan(args) => plan::run(&args, &Interruption::watch()?),
        Command::Tube(command) => tube::run(&command, &Interruption::watch()?),
        Command::Exam(args) => exam::run(&args, &Interruption::watch()?),
        Command::Onset(args) => {
            Interruption::watch()?;
            onset::run(&args)
        }
        Command::Diagnose(args) => {
            let interruption = Interruption::watch()?;
            match &args.fleet {
                Some(source) => fleet::run(&args, source, &interruption),
                None => diagnose::run(&args),
            }
        }
        Command::Log(command) => {
            Interruption::watch()?;
            end_on_broken_pipe();
            log::run(command)
        }
        Command::Compare(args) => {
            Interruption::watch()?;
            end_on_broken_pipe();
            compare::run(&args)
        }
        Command::Model(command) => {
            Interruption::watch()?;
            end_on_broken_pipe();
            model::run(command)
        }
        Command::Vehicle(command) => {
            Interruption::watch()?;
            end_on_broken_pipe();
            vehicle::run(command)
        }
        Command::Signing(command) => {
            Interruption::watch()?;
            signing::run(&command)
        }
        Command::Config(args) => {
            end_on_broken_pipe();
            config::run(&args)
        }
        Command::Reference(args) => {
            end_on_broken_pipe();
            reference::run(&args)
        }
        Command::Schema(args) => {
            end_on_broken_pipe();
            schema::run(&args)
        }
    }
}

/// An error that ends the command with a certain exit code.
#[derive(Debug, thiserror::Error)]
#[error("{}", error_text(error))]
struct Failed {
    exit: Exit,
    error: anyhow::Error,
}

/// Attaches an exit code to an error.
trait ExitContext<T> {
    /// Ends the command with `exit` on an error.
    fn or_exit(self, exit: Exit) -> anyhow::Result<T>;
}

impl<T, E: Into<anyhow::Error>> ExitContext<T> for Result<T, E> {
    fn or_exit(self, exit: Exit) -> anyhow::Result<T> {
        self.map_err(|error| Failed { exit, error: error.into() }.into())
    }
}

/// An error with its causes. A text that two neighbours contain appears once: many errors name
/// their cause or their file themselves.
pub fn error_text(error: &anyhow::Error) -> String {
    let mut causes: Vec<String> = Vec::new();
    for cause in error.chain().map(ToString::to_string) {
        match causes.last_mut() {
            Some(last) if last.contains(&cause) => {}
            Some(last) if cause.contains(last.as_str()) => *last = cause,
            _ => causes.push(cause),
        }
    }
    causes.join(": ")
}

/// The exit code of an error: the one attached to it, else [`Exit::Failure`].
pub fn exit_of(error: &anyhow::Error) -> Exit {
    error.downcast_ref::<Failed>().map_or(Exit::Failure, |failed| failed.exit)
}

/// Ends a command when the reader of its output goes away, as `head` does. A flight must go on
/// without a reader, so commands that fly do not call this.
fn end_on_broken_pipe() {
    // SAFETY: restores the system's default action; no handler of ours is involved.
    unsafe { libc::signal(libc::SIGPIPE, libc::SIG_DFL) };
}

/// Writes a line to stderr, and ignores a missing reader.
fn print_status(line: std::fmt::Arguments<'_>) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Prints results on stdout.
fn print_text(text: &str) -> anyhow::Result<()> {
    io::stdout().lock().write_all(text.as_bytes()).context("standard output")
}

/// Prints one JSON object on stdout.
fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    let mut out = io::stdout().lock();
    serde_json::to_writer(&mut out, value).context("standard output")?;
    writeln!(out).context("standard output")
}

/// Writes a regular file whole or not at all. Writes to anything else, such as a pipe, directly.
fn write_file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let write = || {
        let mut file = PartialFile::create(path)?;
        file.write_all(bytes)?;
        file.finish()
    };
    write().with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[cfg(unix)]
    #[test]
    fn output_to_a_pipe_keeps_the_pipe() -> anyhow::Result<()> {
        use std::ffi::CString;
        use std::os::unix::ffi::OsStrExt;
        use std::os::unix::fs::FileTypeExt;

        let folder = std::env::temp_dir().join(format!("downwash-pipe-{}", std::process::id()));
        fs::create_dir_all(&folder)?;
        let pipe = folder.join("pipe");
        let name = CString::new(pipe.as_os_str().as_bytes())?;
        // SAFETY: the name is a NUL-terminated string.
        assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read(pipe)
        });
        let written = write_file(&pipe, b"results");
        let kind = fs::metadata(&pipe)?.file_type();
        if !kind.is_fifo() {
            // Lets the reader end if nobody writes.
            fs::remove_dir_all(&folder)?;
            panic!("{written:?}: the pipe became {kind:?}");
        }
        let read = reader.join().expect("the reader ends")?;
        fs::remove_dir_all(&folder)?;
        written?;
        assert_eq!(read, b"results");
        Ok(())
    }

    #[test]
    fn error_text_is_not_repeated() {
        let cause = || anyhow::anyhow!("no such file").context("a.toml: no such file");
        assert_eq!(error_text(&cause()), "a.toml: no such file");
        assert_eq!(error_text(&cause().context("a.toml")), "a.toml: no such file");
        assert_eq!(error_text(&cause().context("b.toml")), "b.toml: a.toml: no such file");
    }
}
