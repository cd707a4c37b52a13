//! The command line: raw flags only. Each command checks them and does the work.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};

/// Flies MAVLink quadrotors and keeps the logs that explain what happened.
///
/// Results go to stdout, progress and messages to stderr. Exit codes: 0 done, 1 failed while
/// running, 2 bad flags or files, 3 no vehicle heard or link lost, 4 preflight or vehicle refused,
/// 5 flight ended early by a safety reaction or by the pilot, 130 interrupted after a clean stop.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// More messages on stderr (twice: even more). RUST_LOG overrides.
    #[arg(short, long, action = clap::ArgAction::Count, global = true)]
    pub verbose: u8,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Flies the bundled vehicle once, in lockstep, and writes a report, its numbers and the log.
    Demo(DemoArgs),
    /// Connects to a vehicle, flies one trajectory from take-off to landing, and logs it.
    Fly(FlyArgs),
    /// Runs for long: streams a hold, and flies whenever the pilot switches the vehicle to OFFBOARD.
    Daemon(DaemonArgs),
    /// Runs the bundled vehicle on MAVLink links.
    Sitl(sitl::cli::SitlArgs),
    /// Reads flight logs.
    #[command(subcommand)]
    Log(LogCommand),
    /// Shows every setting and where its value comes from.
    Config(ConfigArgs),
}

/// Flags of `demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for report.html, summary.json and the flight log; made if missing.
    #[arg(long, default_value = "demo-out")]
    pub out: PathBuf,
    /// Vehicle file [default: a built-in nano quadrotor].
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Trajectory file [default: the built-in sinusoid-yaw].
    #[arg(long)]
    pub trajectory: Option<PathBuf>,
    /// The simulated vehicle's own configuration: sensors, pack, start.
    #[arg(long)]
    pub sitl_config: Option<PathBuf>,
    /// An effect of the simulated vehicle that the daemon does not know: id:key=value,...
    #[arg(long, value_name = "EFFECT")]
    pub effect: Vec<String>,
    /// Seed of noise, delays and gusts.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `fly`.
#[derive(Debug, Args)]
pub struct FlyArgs {
    /// Trajectory file (TOML or CSV).
    pub trajectory: PathBuf,
    /// Where the vehicle is: udpin:HOST:PORT, udpout:, tcp:, tcpin: or serial:DEVICE:BAUD.
    #[arg(long, value_name = "URL")]
    pub connect: Option<String>,
    /// Vehicle file.
    #[arg(long)]
    pub vehicle: Option<PathBuf>,
    /// Folder for the flight log.
    #[arg(long)]
    pub log_dir: Option<PathBuf>,
    /// Also writes every byte of the link to this .tlog.
    #[arg(long)]
    pub tlog: Option<PathBuf>,
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints the flight's summary as JSON.
    #[arg(long)]
    pub json: bool,
}

/// Flags of `daemon`.
#[derive(Debug, Args)]
pub struct DaemonArgs {
    /// Configuration file: vehicle, trajectory, connect, and more.
    #[arg(long)]
    pub config: PathBuf,
    /// Also writes every byte of the link to this .tlog.
    #[arg(long)]
    pub tlog: Option<PathBuf>,
}

/// Commands on flight logs.
#[derive(Debug, Subcommand)]
pub enum LogCommand {
    /// What is in a log, also in one that was cut short.
    Info {
        /// Flight logs (.mcap).
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// Prints one JSON object a file.
        #[arg(long)]
        json: bool,
    },
    /// Writes a topic as CSV or as JSON lines.
    Export {
        /// Flight log (.mcap).
        file: PathBuf,
        /// Topic, such as /state [default: every flat topic, one file each into the folder --out].
        #[arg(long)]
        topic: Option<String>,
        /// Form of the rows.
        #[arg(long, value_enum, default_value_t = ExportFormat::Csv)]
        format: ExportFormat,
        /// File for one topic, folder for all [default: stdout for one topic].
        #[arg(short, long)]
        out: Option<PathBuf>,
    },
    /// Reads any flight log, and writes it as one of this program's, each stream at its own rate.
    ///
    /// Takes telemetry logs (.tlog), own logs (.mcap) and tables (.csv), told by their content. A
    /// table needs a mapping file, which names columns, units, frames and orders; nothing of these
    /// is guessed, and config/mappings/motion-capture.toml is one to start from.
    Import {
        /// Flight log.
        file: PathBuf,
        /// What the columns of a table are (TOML).
        #[arg(long, value_name = "MAP")]
        mapping: Option<PathBuf>,
        /// The log to write (.mcap).
        #[arg(short, long, value_name = "OUT")]
        out: PathBuf,
        /// Prints what was found as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Writes the report on a flight: path, tracking error, setpoints and timing, as one HTML file.
    Report {
        /// Flight log (.mcap).
        file: PathBuf,
        /// The report [default: beside the log, under its name].
        #[arg(short, long)]
        out: Option<PathBuf>,
        /// Prints the numbers as JSON.
        #[arg(long)]
        json: bool,
    },
}

/// Forms of exported rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// Comma-separated values with a header.
    Csv,
    /// One JSON object a line; NaN is null.
    Jsonl,
}

/// Flags of `config`.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    /// Configuration file.
    #[arg(long)]
    pub config: Option<PathBuf>,
    /// Prints one JSON object.
    #[arg(long)]
    pub json: bool,
}
