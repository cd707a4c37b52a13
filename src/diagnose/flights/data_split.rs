//! Splits the data into flights for fitting, for choosing among explanations, and held out.

use crate::diagnose::flights::input::DiagnosisInput;
use crate::diagnose::flights::preparation::PreparedFlight;

/// Least time for fitting, s: with less, all flights are for fitting and for choosing.
const FITTED_MIN_S: f64 = 20.0;
/// Gap between parts of one flight, s.
const GUARD_S: f64 = 1.0;

/// The flights that explanations come from. Held-out flights are not among them.
#[derive(Debug)]
pub struct DataSplit {
    /// For fitting.
    pub fitted: Vec<PreparedFlight>,
    /// For choosing; the flights for fitting where there are too few for both.
    pub choosing: Vec<PreparedFlight>,
}

impl DataSplit {
    /// The last of several flights is for choosing; of a single one, its second half. Where that
    /// leaves too little for fitting, all flights do both.
    pub fn of(input: &DiagnosisInput<'_>) -> Self {
        let parted = match input.fitted {
            [fitted @ .., last] if !fitted.is_empty() => {
                Some(Self { fitted: fitted.to_vec(), choosing: vec![last.clone()] })
            }
            [only] => only
                .split(GUARD_S)
                .map(|(first, second)| Self { fitted: vec![first], choosing: vec![second] }),
            _ => None,
        };
        let seconds = |flights: &[PreparedFlight]| -> f64 {
            flights.iter().map(PreparedFlight::seconds).sum()
        };
        parted.filter(|parts| seconds(&parts.fitted) >= FITTED_MIN_S).unwrap_or_else(|| Self {
            fitted: input.fitted.to_vec(),
            choosing: input.fitted.to_vec(),
        })
    }
}
