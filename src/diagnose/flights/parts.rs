//! Three parts of the data: flights for fitting, for choosing among explanations, and for reporting.

use crate::diagnose::flights::case::Case;
use crate::diagnose::flights::preparation::PreparedFlight;

/// Less than so much leaves too little for fitting: flights then do both, s.
const FITTED_MIN_S: f64 = 20.0;
/// Guard between parts of one flight, s.
const GUARD_S: f64 = 1.0;

/// The flights that explanations are made from. Those reported on touch nothing.
#[derive(Debug)]
pub struct Parts {
    /// For fitting.
    pub fitted: Vec<PreparedFlight>,
    /// For choosing; none where there is too little.
    pub choosing: Vec<PreparedFlight>,
}

impl Parts {
    /// The last of several flights chooses; of one its second half. Where that leaves too little,
    /// all of them do both.
    pub fn of(case: &Case<'_>) -> Self {
        let parted = match case.fitted {
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
            fitted: case.fitted.to_vec(),
            choosing: case.fitted.to_vec(),
        })
    }
}
