//! Findings of an audit.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

/// The severity of a finding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Information that needs no action.
    Note,
    /// A flaw of the measurement: correct for it, and never take it for an effect of the vehicle.
    Measurement,
    /// A fault of the data: repair it, or leave the log out.
    Fault,
}

impl fmt::Display for Severity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Note => "note",
            Self::Measurement => "measurement",
            Self::Fault => "fault",
        })
    }
}

/// A finding of an audit.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Finding {
    /// Severity of the finding.
    pub severity: Severity,
    /// Name of the check, such as `gap` or `delay`.
    pub check: &'static str,
    /// Name of the stream, if the finding is about a single one.
    pub stream: Option<&'static str>,
    /// The measured number.
    pub found: f64,
    /// The expected number.
    pub expected: f64,
    /// Unit of both, empty for shares and counts.
    pub unit: &'static str,
    /// Description of the finding in words.
    pub what: String,
    /// What to do about the finding.
    pub advice: &'static str,
}

impl Finding {
    /// What was found, and in which stream.
    pub fn description(&self) -> String {
        match self.stream {
            Some(stream) => format!("{stream}: {}", self.what),
            None => self.what.clone(),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.severity, self.description(), self.advice)
    }
}
