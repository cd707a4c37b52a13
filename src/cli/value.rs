//! Values of flags: each function parses one and refuses what has no meaning.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};

use crate::control::{LAWS, Law};

/// Longest time that a flag takes, s.
const SECONDS_MAX: f64 = 1e6;

/// Longest time between false alarms that a flag takes, h: a century.
const HOURS_MAX: f64 = 876_600.0;

/// Takes a number.
fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| format!("expected a number, found {text:?}"))
}

/// Takes a number above 0 and at most `most`, in `unit`.
fn above_zero(text: &str, most: f64, unit: &str) -> Result<f64, String> {
    let value = number(text)?;
    let is_sensible = value > 0.0 && value <= most;
    let refusal = || format!("expected above 0 and at most {most} {unit}, found {value}");
    is_sensible.then_some(value).ok_or_else(refusal)
}

/// Takes a time above 0 s.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    above_zero(text, SECONDS_MAX, "s")
}

/// Takes a time above 0 h.
pub(super) fn hours(text: &str) -> Result<f64, String> {
    above_zero(text, HOURS_MAX, "h")
}

/// Takes a share from 0 to 1.
pub(super) fn share(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    let refusal = || format!("expected a share from 0 to 1, found {value}");
    (0.0..=1.0).contains(&value).then_some(value).ok_or_else(refusal)
}

/// Takes a number of at least 1.
pub(super) fn count(text: &str) -> Result<usize, String> {
    let value: usize =
        text.parse().map_err(|_| format!("expected a whole number, found {text:?}"))?;
    (value > 0).then_some(value).ok_or_else(|| "expected at least 1, found 0".to_owned())
}

/// Takes the id of a control law; its help is the table of laws.
pub(super) fn law() -> impl TypedValueParser<Value = Law> {
    let values = LAWS.map(|spec| PossibleValue::new(spec.id).help(spec.summary));
    PossibleValuesParser::new(values).map(|id| Law::named(&id).unwrap_or_default())
}
