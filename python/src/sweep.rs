//! Many simulated flights, one worker's share of them.

use std::path::PathBuf;

use downwash::cli::Shard;
use downwash::command::Sweep;
use pyo3::prelude::*;

use crate::errors::wrong;
use crate::watch::watched;

/// Flies what is missing of shard `index` of `count`: the JSON of `sweep`.
#[pyfunction]
pub fn sweep(
    py: Python<'_>,
    manifest: PathBuf,
    out: PathBuf,
    index: usize,
    count: usize,
    jobs: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    if !(1..=count).contains(&index) {
        return Err(wrong(format!(
            "shard: expected (i, n) with i from 1 to n, found {index}/{count}"
        )));
    }
    watched(py, jobs, progress.as_ref(), move |watch| {
        let shard = Shard { index, count };
        let sweep = Sweep { manifest: &manifest, out: &out, shard };
        let summary = sweep.run(watch.stop(), &|done, of| watch.tell("flights", done, of))?;
        Ok(serde_json::to_string(&summary)?)
    })
}
