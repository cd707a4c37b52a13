//! The native part of the Python package `downwash`. Each function passes its arguments to the
//! library and returns the results. The user-facing API is in `downwash/*.py`, which shapes the
//! arrays; here every array is flat and contiguous.

// PyO3's macros generate such conversions.
#![allow(clippy::useless_conversion)]

mod compare;
mod diagnosis;
mod errors;
mod fleet;
mod flight;
mod log;
mod model;
mod onset;
mod plan;
mod plant;
mod pool;
mod sweep;
mod vehicle;
mod watch;

use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::prelude::*;

/// Runs the command line and returns its exit code; `program` is the path of the program.
#[pyfunction]
fn main(py: Python<'_>, program: PathBuf, args: Vec<OsString>) -> u8 {
    py.detach(|| {
        let args = std::iter::once(program.clone().into_os_string()).chain(args);
        downwash::command::main(Some(program.clone()), args).code()
    })
}

#[pymodule]
fn _downwash(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    errors::add(module)?;
    module.add_class::<vehicle::Vehicle>()?;
    module.add_class::<plant::Plant>()?;
    module.add_class::<fleet::Fleet>()?;
    module.add_class::<log::Log>()?;
    module.add_class::<flight::Trajectory>()?;
    module.add_class::<flight::Wish>()?;
    module.add_class::<plan::Plan>()?;
    module.add_class::<onset::Changes>()?;
    module.add_class::<model::Model>()?;
    module.add_class::<diagnosis::Diagnosis>()?;
    module.add_function(wrap_pyfunction!(main, module)?)?;
    module.add_function(wrap_pyfunction!(vehicle::effects, module)?)?;
    module.add_function(wrap_pyfunction!(plant::rollouts, module)?)?;
    module.add_function(wrap_pyfunction!(log::audit, module)?)?;
    module.add_function(wrap_pyfunction!(compare::compare, module)?)?;
    module.add_function(wrap_pyfunction!(flight::fly, module)?)?;
    module.add_function(wrap_pyfunction!(sweep::sweep, module)?)?;
    module.add_function(wrap_pyfunction!(plan::plan, module)?)?;
    module.add_function(wrap_pyfunction!(model::train, module)?)?;
    module.add_function(wrap_pyfunction!(model::evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(diagnosis::diagnose, module)?)?;
    module.add_function(wrap_pyfunction!(onset::onset, module)?)?;
    Ok(())
}
