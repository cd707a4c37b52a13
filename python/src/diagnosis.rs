//! Diagnoses of flight logs.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use downwash::cli::DiagnoseArgs;
use downwash::command::{Finding, find};
use pyo3::prelude::*;
use vehicle::effects::EffectId;

use crate::errors::{exception, wrong};
use crate::watch::watched;

/// The result of a diagnosis, with its report.
#[pyclass(frozen, module = "downwash._downwash")]
pub struct Diagnosis {
    finding: Finding,
}

#[pymethods]
impl Diagnosis {
    fn to_json(&self, py: Python<'_>) -> PyResult<String> {
        self.finding.to_json().map_err(|error| exception(py, &error))
    }

    fn to_html(&self) -> String {
        self.finding.to_html()
    }

    fn to_text(&self) -> String {
        self.finding.to_text()
    }

    /// The text of an effects file with the law that was found and the other effects.
    fn law(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.finding.law().map_err(|error| exception(py, &error))
    }

    /// The text of the vehicle file with the effects found.
    fn improved(&self, py: Python<'_>, name: PathBuf) -> PyResult<String> {
        self.finding.improved(Path::new(&name)).map_err(|error| exception(py, &error))
    }
}

/// Diagnoses logs against the vehicle file at `vehicle`.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "one for each argument of the Python function")]
pub fn diagnose(
    py: Python<'_>,
    vehicle: PathBuf,
    logs: Vec<PathBuf>,
    holdout: Vec<PathBuf>,
    new: Vec<PathBuf>,
    mapping: Option<PathBuf>,
    twins: Option<u32>,
    seed: u64,
    without: Vec<String>,
    discover: bool,
    next_flight: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Diagnosis> {
    let without = without.iter().map(|id| EffectId::from_str(id));
    let without = without.collect::<Result<Vec<_>, _>>().map_err(|e| wrong(e.to_string()))?;
    let mut args = DiagnoseArgs::new(logs, vehicle);
    args.twins = twins.unwrap_or(args.twins);
    let args = DiagnoseArgs { holdout, new, mapping, seed, without, discover, next_flight, ..args };
    let finding = watched(py, None, progress.as_ref(), move |watch| {
        find(&args, watch.stop(), &|stage| watch.report(stage, 0, 0))
    })?;
    Ok(Diagnosis { finding })
}
