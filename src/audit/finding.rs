//! What an audit finds.

use std::fmt;

use schemars::JsonSchema;
use serde::Serialize;

/// How bad a finding is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, JsonSchema, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Worth to know; nothing need be done.
    Note,
    /// Of the measurement: to be corrected for, and never taken for an effect of the vehicle.
    Measurement,
    /// Of the data: to be mended, or the log left out.
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

/// Something found.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Finding {
    /// How bad it is.
    pub severity: Severity,
    /// What was checked, as `gap` or `delay`.
    pub check: &'static str,
    /// The stream, where it is one.
    pub stream: Option<&'static str>,
    /// The number found.
    pub found: f64,
    /// The number expected.
    pub expected: f64,
    /// Unit of both, empty for shares and counts.
    pub unit: &'static str,
    /// What was found, for a person.
    pub what: String,
    /// What to do about it.
    pub advice: &'static str,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.severity)?;
        if let Some(stream) = self.stream {
            write!(f, "{stream}: ")?;
        }
        write!(f, "{}; {}", self.what, self.advice)
    }
}
