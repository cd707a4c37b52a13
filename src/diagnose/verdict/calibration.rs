//! The calibrated numbers that turn evidence into probabilities.
//!
//! `downwash exam --decide DIR --calibrate FILE` writes `calibration.toml`, which is compiled in.
//! It records the exams that it was fitted on, and its scores on families of cases that it was not
//! fitted on.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

/// Number of signs that the cause is outside the catalogue: the constant 1, and the share of the
/// closable gap that an explanation leaves open.
pub const SIGNS: usize = 2;

/// The calibrated numbers of the decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Version of the file.
    pub version: u32,
    /// Inexactness of the catalogue's laws, as a share. It is the standard deviation of each
    /// explanation's evidence relative to its size. A number also errs by this share of its
    /// distance from the vehicle file's value, beside its fit's scatter.
    pub law: f64,
    /// Log odds that the cause is outside the catalogue: the weights of its [signs](SIGNS).
    pub discrepancy: [f64; SIGNS],
}

static SHIPPED: LazyLock<Calibration> = LazyLock::new(|| {
    // Compiled in, and parsed by a test.
    toml::from_str(include_str!("calibration.toml")).expect("the calibration is a table of numbers")
});

impl Calibration {
    /// The calibration that is compiled in.
    pub fn shipped() -> &'static Self {
        &SHIPPED
    }

    /// Probability that the cause is outside the catalogue.
    pub fn discrepancy(&self, signs: &[f64; SIGNS]) -> f64 {
        let log_odds: f64 = self.discrepancy.iter().zip(signs).map(|(w, x)| w * x).sum();
        1.0 / (1.0 + (-log_odds).exp())
    }

    /// Standard deviation of a number, from its fit's (`fitted`) and its distance from the file's
    /// value (`off`).
    pub fn deviation(&self, fitted: f64, off: f64) -> f64 {
        fitted.hypot(self.law * off)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_calibration_loads() {
        assert!(Calibration::shipped().law > 0.0);
    }

    #[test]
    fn signs_add_up_to_the_log_odds() {
        let calibration =
            Calibration { discrepancy: [-1.0, 2.0], ..Calibration::shipped().clone() };
        assert!((calibration.discrepancy(&[1.0, 0.5]) - 0.5).abs() < 1e-12);
        assert!(calibration.discrepancy(&[1.0, 1.0]) > 0.6);
    }

    #[test]
    fn deviation_combines_fit_error_and_law_error() {
        let calibration = Calibration { law: 0.1, ..Calibration::shipped().clone() };
        assert!((calibration.deviation(3.0, 40.0) - 5.0).abs() < 1e-12);
    }
}
