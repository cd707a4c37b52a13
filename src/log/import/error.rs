//! Why a file is not a flight.

use std::io;
use std::path::{Path, PathBuf};

/// Why a file could not be imported at all. Damage within a log is no error.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is something else.
    #[error("{} is no flight log: expected {EXPECTED}, found {found}", path.display())]
    NotALog {
        /// The file.
        path: PathBuf,
        /// What it looks like.
        found: String,
    },
}

/// What is read.
const EXPECTED: &str = "a flight log of this program (.mcap) or a telemetry log (.tlog)";

impl ImportError {
    pub(super) fn not_a_log(path: &Path, found: String) -> Self {
        Self::NotALog { path: path.to_owned(), found }
    }
}
