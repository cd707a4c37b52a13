//! Commands on flight logs.

use std::path::PathBuf;

use clap::{Args, Subcommand, ValueEnum};

use crate::log::import::Choice;

/// Commands on flight logs.
#[derive(Debug, Subcommand)]
pub enum LogCommand {
    /// Shows what a log contains, even if it was cut short.
    Info {
        /// Flight logs (.mcap).
        #[arg(required = true)]
        files: Vec<PathBuf>,
        /// Prints one JSON object per file.
        #[arg(long)]
        json: bool,
    },
    /// Exports a topic as CSV or as JSON lines.
    Export {
        /// Flight log (.mcap).
        file: PathBuf,
        /// Topic, such as /state [default: every flat topic, one file each into the folder --out].
        #[arg(long)]
        topic: Option<String>,
        /// Format of the rows.
        #[arg(long, value_enum, default_value_t = ExportFormat::Csv)]
        format: ExportFormat,
        /// File for one topic, folder for all [default: stdout for one topic].
        #[arg(short, long)]
        out: Option<PathBuf>,
    },
    /// Converts any flight log to this program's format, each stream at its own rate.
    ///
    /// Reads telemetry logs (.tlog), downwash logs (.mcap), logs of PX4 (.ulg) and ArduPilot
    /// (.bin), and tables (.csv), recognised by their content. A table needs a mapping file, which
    /// states columns, units, frames and orders; none of these is guessed. `--propose` prints one
    /// to start from.
    Import {
        /// Flight log.
        file: PathBuf,
        /// The flight to read of it.
        #[command(flatten)]
        choice: FlightChoiceArgs,
        /// Prints a mapping file for a table, proposed from its column names, and imports nothing.
        #[arg(long, conflicts_with_all = ["mapping", "boot", "system", "out", "json"])]
        propose: bool,
        /// The log to write (.mcap).
        #[arg(short, long, value_name = "OUT", required_unless_present = "propose")]
        out: Option<PathBuf>,
        /// Prints what was found as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Checks flight logs before any physics: finds gaps, frozen or impossible values, late or
    /// turned streams, biased sensors and duplicate flights, and states what the log's channels
    /// cannot show.
    Audit {
        /// Flight logs of any format that `log import` reads.
        #[arg(required = true)]
        logs: Vec<PathBuf>,
        /// Mapping of a table's columns: a TOML file, or the name of a shipped one (motion-capture,
        /// motive).
        #[arg(long, value_name = "MAP")]
        mapping: Option<PathBuf>,
        /// Exits with code 10 if it finds anything this bad or worse.
        #[arg(long, value_enum)]
        fail_on: Option<FailOnFinding>,
        /// Prints what was found as JSON.
        #[arg(long)]
        json: bool,
    },
    /// Writes the report on a flight as one HTML file: path, errors, motors, battery, vibration,
    /// timing.
    ///
    /// Reads logs of downwash flights, and any other flight log that `log import` reads.
    Report {
        /// Flight log.
        file: PathBuf,
        /// The flight to read of it.
        #[command(flatten)]
        choice: FlightChoiceArgs,
        /// The report to write [default: next to the log, with its name].
        #[arg(short, long)]
        out: Option<PathBuf>,
        /// Prints the numbers as JSON.
        #[arg(long)]
        json: bool,
    },
}

/// The flight to read of a log.
#[derive(Debug, Args)]
pub struct FlightChoiceArgs {
    /// Mapping of a table's columns: a TOML file, or the name of a shipped one (motion-capture,
    /// motive).
    #[arg(long, value_name = "MAP")]
    mapping: Option<PathBuf>,
    /// Which boot of the vehicle to read, from 1, if a log holds several [default: the one that
    /// flew longest].
    #[arg(long, value_name = "N")]
    boot: Option<usize>,
    /// System id of the vehicle to read, if telemetry holds several [default: the one that sent
    /// most among those that flew].
    #[arg(long, value_name = "ID")]
    system: Option<u8>,
}

impl FlightChoiceArgs {
    /// The options of the importer.
    pub fn choice(&self) -> Choice<'_> {
        Choice { mapping: self.mapping.as_deref(), boot: self.boot, system: self.system }
    }
}

/// Findings that end `log audit` with exit code 10.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FailOnFinding {
    /// Faults of the data.
    Fault,
    /// These, and errors of the measurement.
    Measurement,
}

/// Forms of exported rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// Comma-separated values with a header.
    Csv,
    /// One JSON object per line; NaN is null.
    Jsonl,
}
