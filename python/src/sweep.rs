//! Sweeps of simulated flights, diagnoses or exam cases: one worker's share.

use std::path::PathBuf;

use downwash::cli::Shard;
use downwash::command::{Sweep, set_program};
use pyo3::prelude::*;

use crate::errors::wrong;
use crate::watch::watched;

/// Computes the missing points of shard `index` of `count`. Returns the JSON of `sweep`.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "one for each argument of the Python function")]
pub fn sweep(
    py: Python<'_>,
    manifest: PathBuf,
    out: PathBuf,
    index: usize,
    count: usize,
    jobs: Option<usize>,
    program: PathBuf,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    if !(1..=count).contains(&index) {
        return Err(wrong(format!(
            "shard: expected (i, n) with i from 1 to n, found {index}/{count}"
        )));
    }
    // An exam runs its diagnoses in separate processes.
    set_program(program);
    watched(py, jobs, progress.as_ref(), move |watch| {
        let shard = Shard { index, count };
        let sweep = Sweep { manifest: &manifest, out: &out, shard };
        let summary = sweep.run(watch.stop(), &|done, of| watch.report("flights", done, of))?;
        Ok(serde_json::to_string(&summary)?)
    })
}
