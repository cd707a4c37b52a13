//! Why a vehicle file is refused.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::required::{self, MissingKey};

/// Why a vehicle file is refused.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// The file cannot be read.
    #[error("vehicle file {path}: {source}{}", cure(path, source))]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not TOML or JSON, or does not follow the schema.
    #[error("vehicle file {path}: {}{}", message.trim_end(), made_from(path))]
    Syntax {
        /// The file.
        path: PathBuf,
        /// The parser's message with the position.
        message: String,
    },
    /// A key is missing.
    #[error(
        "vehicle file {path}: {} has no key {key}: expected {expected}; add it there",
        table.as_deref().unwrap_or("the top level, before the first table,")
    )]
    Missing {
        /// The file.
        path: PathBuf,
        /// The table as written in the file; `None` at the top level.
        table: Option<String>,
        /// The key.
        key: &'static str,
        /// What the value means, with its unit.
        expected: &'static str,
    },
    /// A value is impossible.
    #[error("vehicle {vehicle}: {field}: expected {expected}, found {found}")]
    Value {
        /// The vehicle's name.
        vehicle: String,
        /// Path of the field in the file.
        field: String,
        /// The accepted values.
        expected: &'static str,
        /// The value found.
        found: String,
    },
}

/// What to do about a file that cannot be read.
fn cure(path: &Path, source: &std::io::Error) -> String {
    match source.kind() {
        ErrorKind::InvalidData => made_from(path),
        _ => shipped_names(path),
    }
}

/// Lists the shipped vehicles if `path` looks like such a name.
fn shipped_names(path: &Path) -> String {
    if path.extension().is_some() || path.components().count() > 1 {
        return String::new();
    }
    format!("; shipped vehicles are {}", super::SHIPPED.map(|shipped| shipped.name).join(", "))
}

/// How to make a vehicle file from `path`, if its name is one of parameters or of a flight log.
fn made_from(path: &Path) -> String {
    const SOURCES: [&str; 7] = ["params", "param", "parm", "ulg", "bin", "tlog", "mcap"];
    let extension = path.extension().and_then(|extension| extension.to_str());
    match extension.is_some_and(|extension| {
        SOURCES.iter().any(|source| source.eq_ignore_ascii_case(extension))
    }) {
        false => String::new(),
        true => {
            let path = path.display();
            format!("; `downwash vehicle init {path} -o vehicle.toml` makes a vehicle file from it")
        }
    }
}

impl VehicleError {
    pub(super) fn syntax(message: String) -> Self {
        Self::Syntax { path: PathBuf::from("(text)"), message }
    }

    /// The parser's message, or the missing key: the parser reports a missing key only at the start
    /// of the table that lacks it.
    pub(super) fn schema(
        message: String,
        file: impl FnOnce() -> Option<serde_json::Value>,
    ) -> Self {
        let is_missing = message.contains("missing field");
        match is_missing.then(file).flatten().as_ref().and_then(required::missing) {
            Some(MissingKey { table, key, expected }) => {
                Self::Missing { path: PathBuf::from("(text)"), table, key, expected }
            }
            None if message.contains("invalid length") && message.contains("rotors") => {
                Self::syntax(format!("{}; only quadrotors are supported", message.trim_end()))
            }
            None => Self::syntax(message),
        }
    }

    /// Adds the file's path to the error.
    pub(super) fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Syntax { message, .. } => Self::Syntax { path: path.to_owned(), message },
            Self::Missing { table, key, expected, .. } => {
                Self::Missing { path: path.to_owned(), table, key, expected }
            }
            Self::Value { vehicle, field, expected, found } => {
                let vehicle = format!("{vehicle} ({})", path.display());
                Self::Value { vehicle, field, expected, found }
            }
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_and_logs_are_named_as_sources_of_a_vehicle_file() {
        let syntax = |path: &str| {
            VehicleError::syntax("expected `=`\n".to_owned()).in_file(Path::new(path)).to_string()
        };
        let read = |path: &str, kind: ErrorKind| {
            VehicleError::Read { path: path.into(), source: kind.into() }.to_string()
        };
        for made in [syntax("a.params"), syntax("a.PARM"), read("a.ulg", ErrorKind::InvalidData)] {
            assert!(made.contains("; `downwash vehicle init a."), "{made}");
        }
        for other in [syntax("a.toml"), syntax("a"), read("a.ulg", ErrorKind::NotFound)] {
            assert!(!other.contains("vehicle init"), "{other}");
        }
        assert!(read("quad", ErrorKind::NotFound).contains("shipped vehicles"));
    }
}
