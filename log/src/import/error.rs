//! Why a file cannot be imported.

use std::io;
use std::path::{Path, PathBuf};

/// Why a file cannot be imported at all. Damage within a log is not an error.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is not a flight log.
    #[error("{} is not a flight log: expected {EXPECTED}, found {found}", path.display())]
    NotALog {
        /// The file.
        path: PathBuf,
        /// What the file appears to be.
        found: String,
    },
    /// The file has no data of a flight.
    #[error("{}: nothing in this {format} file can be used: {why}", path.display())]
    Nothing {
        /// The file.
        path: PathBuf,
        /// Format of the file.
        format: &'static str,
        /// Why it has none.
        why: String,
    },
    /// The file does not have the chosen boot.
    #[error(
        "{}: this file has {boots} boots of the vehicle; expected one from 1 to {boots} (--boot), \
         found {boot}",
        path.display()
    )]
    NoBoot {
        /// The file.
        path: PathBuf,
        /// The requested number.
        boot: usize,
        /// Number of boots in the file.
        boots: usize,
    },
    /// The log has no vehicle with the chosen system id.
    #[error("{}: no vehicle with the system id {system} (--system): {found}", path.display())]
    NoSystem {
        /// The file.
        path: PathBuf,
        /// The requested id.
        system: u8,
        /// The vehicles of the log.
        found: String,
    },
    /// The file is a table and no mapping file was given.
    #[error(
        "{} is a table: expected a mapping file that states its columns (--mapping MAP.toml); \
         `downwash log import --propose {}` prints one to start from",
        path.display(),
        path.display()
    )]
    NoMapping {
        /// The table.
        path: PathBuf,
    },
    /// A mapping file was given for a log that is not a table.
    #[error(
        "{} is a {format} log, which needs no mapping file: leave out --mapping or --propose",
        path.display()
    )]
    NotATable {
        /// The log.
        path: PathBuf,
        /// Format of the file.
        format: &'static str,
    },
    /// The mapping file is invalid.
    #[error("mapping file {}: {message}", path.display())]
    Mapping {
        /// The mapping file.
        path: PathBuf,
        /// What is wrong, and what to write instead.
        message: String,
    },
    /// The mapping does not fit the table.
    #[error("mapping file {} for {}: {message}", mapping.display(), path.display())]
    Unmapped {
        /// The table.
        path: PathBuf,
        /// The mapping file.
        mapping: PathBuf,
        /// What is missing, and what to write.
        message: String,
    },
}

/// The supported formats.
const EXPECTED: &str = "a log of this program (.mcap), a telemetry log (.tlog), a log of PX4 (.ulg) or \
                        ArduPilot (.bin), or a table (.csv)";

impl ImportError {
    pub(super) fn not_a_log(path: &Path, found: String) -> Self {
        Self::NotALog { path: path.to_owned(), found }
    }
}
