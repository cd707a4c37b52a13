//! Non-finite errors in JSON, which cannot represent them: they are written as `null`, and `null`
//! is read as an infinite error.

use serde::{Deserialize, Deserializer};

/// Reads a number; `null` becomes infinity.
pub fn number<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::INFINITY))
}

/// As [`number`], for a list.
pub fn numbers<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<f64>, D::Error> {
    Ok(finite_or_infinite(Vec::deserialize(from)?))
}

/// As [`number`], for a list of lists.
pub fn lists<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Vec<f64>>, D::Error> {
    Ok(Vec::deserialize(from)?.into_iter().map(finite_or_infinite).collect())
}

/// As [`number`], for a list of fixed length.
pub fn array<'de, D: Deserializer<'de>, const N: usize>(from: D) -> Result<[f64; N], D::Error>
where
    [Option<f64>; N]: Deserialize<'de>,
{
    let read: [Option<f64>; N] = Deserialize::deserialize(from)?;
    Ok(read.map(|number| number.unwrap_or(f64::INFINITY)))
}

fn finite_or_infinite(read: Vec<Option<f64>>) -> Vec<f64> {
    read.into_iter().map(|number| number.unwrap_or(f64::INFINITY)).collect()
}
