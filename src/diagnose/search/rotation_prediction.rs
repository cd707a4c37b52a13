//! Checks whether motor outputs predict the body's rotation.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::diagnose::likelihood::channels::RATE;
use crate::diagnose::likelihood::equation_residual::{gyro_noise, measured_rotation, rotation};
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::noise::report_noise;
use crate::diagnose::search::Search;
use crate::diagnose::search::explanation::Explanation;

/// Upper limit of the unexplained share; at it, nothing is known of an axis.
const UNEXPLAINED_MAX: f64 = 0.95;

/// How well moments from the motor outputs predict the angular acceleration about one axis, as mean
/// squares in rad^2/s^4.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct RotationPrediction {
    /// Measured by the gyro.
    pub measured: f64,
    /// Left by the effect that explains most of it.
    pub left: f64,
    /// Caused by the gyro's noise.
    pub noise: f64,
    /// Whether moments about the axis are used.
    pub is_usable: bool,
}

impl RotationPrediction {
    /// Least share of the angular acceleration that a single effect leaves, beyond the gyro's noise.
    pub fn unexplained(&self) -> f64 {
        let beyond = |power: f64| (power - self.noise).max(0.0);
        let measured = beyond(self.measured).max(f64::MIN_POSITIVE);
        (beyond(self.left) / measured).min(UNEXPLAINED_MAX)
    }

    /// Possible overestimate of the moment of inertia about the axis, as a share. Where a share s
    /// of a regressor's power is error, least squares shrink its coefficient by 1 - s.
    pub fn inflation(&self) -> f64 {
        let share = self.unexplained();
        share / (1.0 - share)
    }
}

/// How well moments predict the angular acceleration about each axis, and the channels of the axes
/// that are not usable. `file` and `about` are the fit of the vehicle file's numbers to the flights
/// of `search`, and the derivatives there. Every axis is usable where `is_loop_known`: the setpoints
/// then drive the predictions.
///
/// Moments are computed from motor outputs. Outputs that are logged more slowly than the loop runs
/// alias. Others have wrong units, or contain torques that are not modelled and the feedback's
/// response to them. A fit then looks like an inertia or a torque constant that is far off, because
/// least squares shrink a regressor that is mostly error. An axis is not usable if every
/// single effect leaves more of its angular acceleration than it explains, beyond the gyro's noise.
pub fn rotation_predictions(
    search: &Search<'_>,
    file: &Explanation,
    about: &Linearised,
    is_loop_known: bool,
) -> ([RotationPrediction; 3], Vec<usize>) {
    let observed = search.fitted;
    let usable = RotationPrediction { is_usable: true, ..RotationPrediction::default() };
    let powers = search.powers(about).chain(std::iter::once(file.fit.power.clone()));
    let least = |least: [f64; 3], power: Vec<f64>| {
        let left = rotation(observed, &power);
        std::array::from_fn(|axis| least[axis].min(left[axis]))
    };
    let left = powers.fold([f64::INFINITY; 3], least);
    let measured = measured_rotation(observed);
    let noise = report_noise(observed.flights, &file.fit.power, observed.counts());
    let of_axis = |axis: usize| {
        let mut found = RotationPrediction {
            measured: measured[axis],
            left: left[axis],
            noise: gyro_noise(observed, noise.body_rate, axis),
            ..usable
        };
        let left = (found.left - found.noise).max(0.0);
        found.is_usable = is_loop_known
            || left <= 0.5 * (found.measured - found.noise).max(0.0)
            || left < found.noise;
        found
    };
    let turning = [0, 1, 2].map(of_axis);
    let unused = (0..3).filter(|axis| !turning[*axis].is_usable).map(|axis| RATE + axis);
    (turning, unused.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regressor_with_half_error_doubles_the_inertia() {
        let half = RotationPrediction { measured: 1.1, left: 0.6, noise: 0.1, is_usable: true };
        assert!((half.unexplained() - 0.5).abs() < 1e-12 && (half.inflation() - 1.0).abs() < 1e-12);
        let exact = RotationPrediction { left: 0.1, ..half };
        assert_eq!((exact.unexplained(), exact.inflation()), (0.0, 0.0));
        // Without rotation nothing is known.
        let still = RotationPrediction { measured: 0.1, ..half };
        assert_eq!(still.unexplained(), UNEXPLAINED_MAX);
    }
}
