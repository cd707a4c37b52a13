//! Prediction errors relative to those of holding the state.

use std::ops::Range;

use super::evaluation::{FlightWindows, MultiStep, Predictor, StateError, multi_step};
use super::prediction::Baseline;

/// Sum of the errors at the middle horizons, relative to those of holding the state; lower is
/// better.
pub(super) fn score(windows: &[FlightWindows<'_>], predictor: &Predictor<'_>) -> f64 {
    let hold = multi_step(windows, &Predictor::Baseline(Baseline::Hold));
    match (multi_step(windows, predictor), hold) {
        (Some(errors), Some(hold)) => relative(&errors.all(), &hold.all()),
        _ => f64::INFINITY,
    }
}

/// Sum of the error ratios at the middle horizons; infinite if an error at any horizon is not
/// finite.
pub(super) fn relative(errors: &MultiStep, hold: &MultiStep) -> f64 {
    let sum: f64 = ratios(errors, hold).sum();
    if sum.is_finite() && errors.iter().all(StateError::is_finite) { sum } else { f64::INFINITY }
}

/// Indices of the middle horizons.
const MIDDLE: Range<usize> = 1..3;
/// Number of errors at one horizon.
const ERRORS: usize = 4;
/// Sum of the [`ratios`] of a prediction as good as holding the state.
pub(super) const AS_HOLDING: f64 = ((MIDDLE.end - MIDDLE.start) * ERRORS) as f64;

/// Each error at the middle horizons, relative to that of `hold`.
pub(super) fn ratios<'a>(
    errors: &'a MultiStep,
    hold: &'a MultiStep,
) -> impl Iterator<Item = f64> + 'a {
    errors[MIDDLE].iter().zip(&hold[MIDDLE]).flat_map(|(a, b)| -> [f64; ERRORS] {
        [
            a.position_m / b.position_m.max(1e-9),
            a.velocity_m_s / b.velocity_m_s.max(1e-9),
            a.attitude_rad / b.attitude_rad.max(1e-9),
            a.rate_rad_s / b.rate_rad_s.max(1e-9),
        ]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prediction_that_diverges_only_later_has_no_ratio() {
        let good =
            StateError { position_m: 0.1, velocity_m_s: 0.1, attitude_rad: 0.1, rate_rad_s: 0.1 };
        let mut late = [good; 4];
        assert!((relative(&late, &[good; 4]) - AS_HOLDING).abs() < 1e-12);
        late[3].rate_rad_s = f64::NAN;
        assert_eq!(relative(&late, &[good; 4]), f64::INFINITY);
    }
}
