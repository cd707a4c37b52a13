//! Comparisons of flights.

use std::path::PathBuf;

use clap::ValueEnum;
use downwash::cli::CompareArgs;
use downwash::command::compared;
use pyo3::prelude::*;

use crate::errors::wrong;
use crate::watch::watched;

fn choice<T: ValueEnum>(argument: &str, word: &str) -> PyResult<T> {
    T::from_str(word, false).map_err(|_| {
        let words = T::value_variants().iter().filter_map(T::to_possible_value);
        let words: Vec<String> = words.map(|value| format!("'{}'", value.get_name())).collect();
        wrong(format!("{argument}: expected {}, found {word:?}", words.join(", ")))
    })
}

/// Compares the logs `a` with the logs `b`. Returns the comparison as JSON and as an HTML page.
#[pyfunction]
pub fn compare(
    py: Python<'_>,
    a: Vec<PathBuf>,
    b: Vec<PathBuf>,
    align: &str,
    pair: &str,
    mapping: Option<PathBuf>,
) -> PyResult<(String, String)> {
    let (align, pair) = (choice("align", align)?, choice("pair", pair)?);
    let args = CompareArgs { align, pair, mapping, ..CompareArgs::new(a, b) };
    watched(py, None, None, move |_| {
        let compared = compared(&args)?;
        Ok((serde_json::to_string(&compared.comparison)?, compared.html))
    })
}
