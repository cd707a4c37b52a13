//! The shape of a tube: the standard deviation of the position error along a plan.
//!
//! Along each axis, the closed loop from the model's error to the position error is
//!
//! ```text
//! dp/dt = v,   dv/dt = -stiffness p - damping v + sigma(t) z - r
//! dr/dt = (sigma(t) z - r) / rejection      (r = 0 without a disturbance observer)
//! dz/dt = -z / correlation + noise          (variance 1)
//! ```
//!
//! This is the slow part of the loop, with the attitude settled
//! ([`Lqr::translational`](crate::control::Lqr::translational)). Conformal calibration multiplies
//! the scale by one number, so an error in its size costs no coverage, and an error in its shape
//! only makes the tube wider.

use nalgebra::Matrix4;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::error::{AxisError, ModelError};

/// Least standard deviation, m: no position estimate is more accurate.
const SCALE_MIN_M: f64 = 1e-3;
/// Number of times that the time is doubled until the covariance is stationary: 2^24 steps.
const DOUBLINGS: usize = 24;

/// Feedback on the position: horizontal and vertical gains.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackingLoop {
    /// Gain from position error to opposing acceleration, 1/s^2.
    pub stiffness_s2: [f64; 2],
    /// Gain from velocity error to opposing acceleration, 1/s.
    pub damping_s: [f64; 2],
    /// Time constant of the disturbance observer, s; null without one.
    pub rejection_s: Option<f64>,
}

/// One axis over a step: `x+ = (still + sigma driven) x + noise`, x = (p, v, z, r).
struct AxisStep<'a> {
    still: Matrix4<f64>,
    driven: Matrix4<f64>,
    noise: Matrix4<f64>,
    error: &'a AxisError,
}

impl<'a> AxisStep<'a> {
    fn new(stiffness: f64, damping: f64, rejection_s: Option<f64>, error: &'a AxisError) -> Self {
        let reject = rejection_s.map_or(0.0, |time| 1.0 / time);
        let decay = 1.0 / error.correlation_s;
        let slope = |sigma: f64| {
            Matrix4::new(
                0.0,
                1.0,
                0.0,
                0.0, //
                -stiffness,
                -damping,
                sigma,
                -1.0, //
                0.0,
                0.0,
                -decay,
                0.0, //
                0.0,
                0.0,
                sigma * reject,
                -reject,
            )
        };
        let step = |sigma: f64| (slope(sigma) * PERIOD_S).exp();
        let still = step(0.0);
        let mut noise = Matrix4::zeros();
        noise[(2, 2)] = 1.0 - (-2.0 * decay * PERIOD_S).exp();
        // z acts on the others alone, so the step is linear in sigma.
        Self { still, driven: step(1.0) - still, noise, error }
    }

    fn at(&self, speed_m_s: f64) -> Matrix4<f64> {
        self.still + self.driven * self.error.deviation(speed_m_s)
    }

    /// The stationary covariance at a constant speed.
    fn stationary(&self, speed_m_s: f64) -> Matrix4<f64> {
        let (mut step, mut covariance) = (self.at(speed_m_s), self.noise);
        for _ in 0..DOUBLINGS {
            covariance += step * covariance * step.transpose();
            step *= step;
        }
        covariance
    }

    /// The variance of the position at each speed, m^2.
    fn variances(&self, speeds_m_s: &[f64]) -> Vec<f64> {
        let first = speeds_m_s.first().copied().unwrap_or_default();
        let mut covariance = self.stationary(first);
        speeds_m_s
            .iter()
            .map(|speed| {
                let here = covariance[(0, 0)];
                let step = self.at(*speed);
                covariance = step * covariance * step.transpose() + self.noise;
                here
            })
            .collect()
    }
}

/// Period of the speeds given to [`TrackingLoop::scale`], s.
pub const PERIOD_S: f64 = 0.01;

impl TrackingLoop {
    /// Standard deviation of the distance from the plan (root of the trace of the position's
    /// covariance), m, at each of the plan's speeds (m/s), [`PERIOD_S`] apart. It starts from the
    /// stationary covariance at the first speed.
    pub fn scale(&self, error: &ModelError, speeds_m_s: &[f64]) -> Vec<f64> {
        let [horizontal, vertical] = [&error.horizontal, &error.vertical];
        let axis = |i: usize, error| {
            let step =
                AxisStep::new(self.stiffness_s2[i], self.damping_s[i], self.rejection_s, error);
            step.variances(speeds_m_s)
        };
        let both = axis(0, horizontal).into_iter().zip(axis(1, vertical));
        both.map(|(across, down)| (2.0 * across + down).sqrt().max(SCALE_MIN_M)).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

    use super::*;

    fn loops(rejection_s: Option<f64>) -> TrackingLoop {
        TrackingLoop { stiffness_s2: [8.0, 14.0], damping_s: [4.0, 6.0], rejection_s }
    }

    fn error() -> ModelError {
        ModelError {
            horizontal: AxisError { at_rest_m_s2: 0.2, per_speed_s: 0.5, correlation_s: 0.7 },
            vertical: AxisError { at_rest_m_s2: 0.4, per_speed_s: 0.1, correlation_s: 5.0 },
        }
    }

    #[test]
    fn steady_push_scale_is_push_over_stiffness() {
        let mut error = error();
        for axis in [&mut error.horizontal, &mut error.vertical] {
            *axis = AxisError { at_rest_m_s2: 0.4, per_speed_s: 0.0, correlation_s: 60.0 };
        }
        let scale = loops(None).scale(&error, &[0.0; 3]);
        let expected = (2.0 * (0.4_f64 / 8.0).powi(2) + (0.4_f64 / 14.0).powi(2)).sqrt();
        assert!(scale.iter().all(|s| (s / expected - 1.0).abs() < 0.02), "{scale:?} {expected}");
        // An observer rejects most of it.
        assert!(loops(Some(0.5)).scale(&error, &[0.0])[0] < 0.2 * expected);
        let none = AxisError { at_rest_m_s2: 0.0, per_speed_s: 0.0, correlation_s: 1.0 };
        let none = ModelError { horizontal: none, vertical: none };
        assert_eq!(loops(None).scale(&none, &[0.0, 5.0]), [SCALE_MIN_M; 2]);
        assert!(loops(None).scale(&none, &[]).is_empty());
    }

    /// Many runs of the linear loop, each step integrated in ten finer ones with noise.
    #[test]
    fn scale_matches_the_deviation_of_simulated_runs() {
        let speeds: Vec<f64> = (0..400).map(|k| (2.0 - 0.01 * f64::from(k)).max(0.0)).collect();
        let error = error();
        for rejection_s in [None, Some(0.5)] {
            let loops = loops(rejection_s);
            let scale = loops.scale(&error, &speeds);
            let mut random = Pcg64Mcg::seed_from_u64(11);
            let mut normal = || random.sample::<f64, _>(StandardNormal);
            let runs = 2000;
            let mut squares = vec![0.0; speeds.len()];
            let fine = 10;
            let h = PERIOD_S / f64::from(fine);
            for _ in 0..runs {
                for (axis, error) in
                    [(0, &error.horizontal), (0, &error.horizontal), (1, &error.vertical)]
                {
                    let keep = (-h / error.correlation_s).exp();
                    let (mut p, mut v, mut z, mut r) = (0.0, 0.0, normal(), 0.0);
                    let mut step = |speed: f64| {
                        for _ in 0..fine {
                            let push = error.deviation(speed) * z;
                            let pull = loops.stiffness_s2[axis] * p + loops.damping_s[axis] * v;
                            v += h * (push - r - pull);
                            p += h * v;
                            r += rejection_s.map_or(0.0, |time| h * (push - r) / time);
                            z = keep * z + (1.0 - keep * keep).sqrt() * normal();
                        }
                        p
                    };
                    // The scale starts from the stationary state at the first speed.
                    (0..500).for_each(|_| {
                        step(speeds[0]);
                    });
                    let mut p = step(speeds[0]);
                    for (square, speed) in squares.iter_mut().zip(&speeds) {
                        *square += p * p / f64::from(runs);
                        p = step(*speed);
                    }
                }
            }
            for (n, (scale, square)) in scale.iter().zip(squares).enumerate() {
                let ratio = scale / f64::sqrt(square);
                assert!((ratio - 1.0).abs() < 0.08, "{n}: {ratio}");
            }
            // Slower at the end, and so closer to the plan.
            assert!(scale[399] < 0.6 * scale[0]);
        }
    }
}
