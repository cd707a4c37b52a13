//! Detection of changes of a vehicle.

use std::path::PathBuf;

use downwash::cli::OnsetArgs;
use downwash::command::{self, changed};
use pyo3::prelude::*;

use crate::errors::{exception, wrong};
use crate::watch::watched;

/// The changes found, with their report.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Changes {
    changes: command::Changes,
}

#[pymethods]
impl Changes {
    fn to_json(&self, py: Python<'_>) -> PyResult<String> {
        self.changes.to_json().map_err(|error| exception(py, &error))
    }

    fn to_html(&self) -> String {
        self.changes.to_html()
    }

    fn to_text(&self) -> String {
        self.changes.to_text()
    }
}

/// Searches logs for changes of the vehicle, given the vehicle file at `vehicle`.
#[pyfunction]
pub fn onset(
    py: Python<'_>,
    vehicle: PathBuf,
    logs: Vec<PathBuf>,
    mapping: Option<PathBuf>,
    false_alarm_h: Option<f64>,
) -> PyResult<Changes> {
    let mut args = OnsetArgs { mapping, ..OnsetArgs::new(logs, vehicle) };
    args.false_alarm_h = false_alarm_h.unwrap_or(args.false_alarm_h);
    if !(args.false_alarm_h.is_finite() && args.false_alarm_h > 0.0) {
        let found = args.false_alarm_h;
        return Err(wrong(format!("false_alarm_h: expected hours above 0, found {found}")));
    }
    let changes = watched(py, None, None, move |_| changed(&args))?;
    Ok(Changes { changes })
}
