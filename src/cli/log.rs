//! Commands on flight logs.

use std::path::PathBuf;

use clap::{Subcommand, ValueEnum};

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
    /// Takes telemetry logs (.tlog), own logs (.mcap), logs of PX4 (.ulg) and ArduPilot (.bin), and
    /// tables (.csv), told by their content. A table needs a mapping file, which names columns,
    /// units, frames and orders; nothing of these is guessed. `--propose` prints one to start from.
    Import {
        /// Flight log.
        file: PathBuf,
        /// What the columns of a table are: a file (TOML), or the name of a shipped one
        /// (motion-capture, motive).
        #[arg(long, value_name = "MAP")]
        mapping: Option<PathBuf>,
        /// Which start of the vehicle, from 1, of a telemetry log that holds several [default: the
        /// one that flew longest].
        #[arg(long, value_name = "N")]
        boot: Option<usize>,
        /// Prints a mapping file for a table, by the names of its columns, and imports nothing.
        #[arg(long, conflicts_with_all = ["mapping", "boot", "out", "json"])]
        propose: bool,
        /// The log to write (.mcap).
        #[arg(short, long, value_name = "OUT", required_unless_present = "propose")]
        out: Option<PathBuf>,
        /// Prints what was found as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Says what is wrong with flight logs before any physics: gaps, frozen or impossible values,
    /// late or turned streams, biased sensors, flights that are there twice; and what the log's
    /// channels cannot show.
    Audit {
        /// Flight logs of any kind that `log import` takes.
        #[arg(required = true)]
        logs: Vec<PathBuf>,
        /// What the columns of a table are: a file (TOML), or the name of a shipped one
        /// (motion-capture, motive).
        #[arg(long, value_name = "MAP")]
        mapping: Option<PathBuf>,
        /// Ends with exit code 10 if anything this bad, or worse, is found.
        #[arg(long, value_enum)]
        fail_on: Option<FailOnFinding>,
        /// Prints what was found as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Writes the report on a flight, as one HTML file: path, errors, motors, pack, vibration,
    /// timing.
    ///
    /// Takes logs of this program's flights, and any other flight log that `log import` takes.
    Report {
        /// Flight log.
        file: PathBuf,
        /// What the columns of a table are: a file (TOML), or the name of a shipped one
        /// (motion-capture, motive).
        #[arg(long, value_name = "MAP")]
        mapping: Option<PathBuf>,
        /// Which start of the vehicle, from 1, of a telemetry log that holds several [default: the
        /// one that flew longest].
        #[arg(long, value_name = "N")]
        boot: Option<usize>,
        /// The report [default: beside the log, under its name].
        #[arg(short, long)]
        out: Option<PathBuf>,
        /// Prints the numbers as JSON.
        #[arg(long)]
        json: bool,
    },
}

/// Findings that end `log audit` with exit code 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FailOnFinding {
    /// Faults of the data.
    Fault,
    /// These, and flaws of the measurement.
    Measurement,
}

/// Forms of exported rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// Comma-separated values with a header.
    Csv,
    /// One JSON object a line; NaN is null.
    Jsonl,
}
