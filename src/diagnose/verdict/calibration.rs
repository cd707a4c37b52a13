//! What is calibrated of the decision: the numbers that turn evidence into probabilities.
//!
//! `downwash exam --decide DIR --calibrate FILE` makes `calibration.toml`, which is compiled in and
//! says from which exams it is, and how it fares on families of cases that it is not made on.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

/// Signs that the cause is not in the catalogue: 1, and what an explanation leaves of the gap.
pub const SIGNS: usize = 2;

/// Numbers of the decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Calibration {
    /// Version of the file.
    pub version: u32,
    /// No law of the catalogue is right to more than about this share of its evidence: the standard
    /// deviation of what each explanation's evidence is off by; and a number is off by this share of
    /// its distance from the vehicle file's, beside its fit's scatter.
    pub law: f64,
    /// Log odds that the cause is not in the catalogue, by its [signs](SIGNS).
    pub discrepancy: [f64; SIGNS],
}

static SHIPPED: LazyLock<Calibration> = LazyLock::new(|| {
    // Compiled in, and read by a test.
    toml::from_str(include_str!("calibration.toml")).expect("the calibration is a table of numbers")
});

impl Calibration {
    /// The calibration that is compiled in.
    pub fn shipped() -> &'static Self {
        &SHIPPED
    }

    /// Probability that the cause is not in the catalogue.
    pub fn discrepancy(&self, signs: &[f64; SIGNS]) -> f64 {
        let log_odds: f64 = self.discrepancy.iter().zip(signs).map(|(w, x)| w * x).sum();
        1.0 / (1.0 + (-log_odds).exp())
    }

    /// Standard deviation of a number, by that of its fit and how far it is from the file's.
    pub fn deviation(&self, fitted: f64, off: f64) -> f64 {
        fitted.hypot(self.law * off)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_is_read() {
        assert!(Calibration::shipped().law > 0.0);
    }

    #[test]
    fn signs_add_up_to_log_odds() {
        let calibration =
            Calibration { discrepancy: [-1.0, 2.0], ..Calibration::shipped().clone() };
        assert!((calibration.discrepancy(&[1.0, 0.5]) - 0.5).abs() < 1e-12);
        assert!(calibration.discrepancy(&[1.0, 1.0]) > 0.6);
    }

    #[test]
    fn a_number_is_off_by_its_fit_and_by_its_law() {
        let calibration = Calibration { law: 0.1, ..Calibration::shipped().clone() };
        assert!((calibration.deviation(3.0, 40.0) - 5.0).abs() < 1e-12);
    }
}
