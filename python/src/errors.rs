//! Errors as exceptions, with the command line's messages.

use downwash::command::{Exit, error_text, exit_of};
use pyo3::exceptions::{PyException, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    downwash,
    DownwashError,
    PyException,
    "An error of downwash; `exit_code` is the command line's exit code."
);

pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let class = module.py().get_type::<DownwashError>();
    class.setattr("exit_code", 1)?;
    module.add("DownwashError", class)
}

/// The exception for an error, with the command line's exit code.
pub fn exception(py: Python<'_>, error: &anyhow::Error) -> PyErr {
    raised(py, error_text(error), exit_of(error))
}

fn raised(py: Python<'_>, text: String, exit: Exit) -> PyErr {
    let exception = DownwashError::new_err(text);
    match exception.value(py).setattr("exit_code", exit.code()) {
        Ok(()) => exception,
        Err(failed) => failed,
    }
}

/// The result of reading a file, or the exception for a refused one.
pub fn read<T, E: Into<anyhow::Error>>(py: Python<'_>, result: Result<T, E>) -> PyResult<T> {
    result.map_err(|error| raised(py, error_text(&error.into()), Exit::Usage))
}

/// Makes the ValueError for an argument that is invalid whatever the others are.
pub fn wrong(what: impl Into<String>) -> PyErr {
    PyValueError::new_err(what.into())
}

/// The exception for invalid JSON, without the position, since the user did not write the JSON.
pub fn unread(what: &str, error: &serde_json::Error) -> PyErr {
    let text = error.to_string();
    let message = text.rsplit_once(" at line ").map_or(text.as_str(), |(message, _)| message);
    wrong(format!("{what}: {message}"))
}

/// The exception for a panic, which is a bug in this program.
pub fn fault(panic: &(dyn std::any::Any + Send)) -> PyErr {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
    DownwashError::new_err(format!("internal error, please report it: {text}"))
}
