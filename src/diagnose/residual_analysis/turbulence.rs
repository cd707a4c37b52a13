//! Decides whether an unexplained force is turbulence.
//!
//! Gusts act through the drag. Their force is mainly horizontal, equally strong along north and
//! east, falls with frequency without a line, and is independent of the vehicle's own motion. The
//! strength of the gusts follows from that force and the vehicle's drag.

use nalgebra::{DMatrix, DVector};
use vehicle::VehicleParams;
use vehicle::effects::{EffectId, EffectSet, Slots};

use crate::diagnose::residual_analysis::map::Sample;
use crate::diagnose::residual_analysis::unmodelled_force::UnmodelledForce;

/// Largest ratio of power between north and east for turbulence: few gusts pass in a flight.
const ISOTROPY_MAX: f64 = 4.0;
/// Least ratio of a line's density to that of both neighbouring bands.
const LINE_RATIO_MIN: f64 = 2.5;
/// Strongest gusts that such a vehicle flies in, m/s.
const STORM_M_S: f64 = 20.0;
/// Largest share of the force that the vehicle's own motion may explain.
const EXPLAINED_MAX: f64 = 0.35;

/// The gusts that explain `force` through the drag of `effects` and the file; `None` if it is not
/// turbulence. `samples` are the residuals of the best explanation.
pub fn gusts(
    vehicle: &VehicleParams,
    effects: &EffectSet,
    force: &UnmodelledForce,
    samples: &[Sample],
) -> Option<Slots> {
    let all = vehicle.modelled_effects.overlay(effects);
    let linear = vehicle.linear_drag_n_per_m_s.filter(|_| !effects.contains(EffectId::RotorDrag));
    let drag = Drag {
        linear: linear.or(all.value(EffectId::RotorDrag, "d_xy", 0)).unwrap_or(0.0),
        quadratic: 0.5
            * vehicle.air_density
            * all.value(EffectId::ParasiticDrag, "cda_m2", 0).unwrap_or(0.0),
    };
    let [north, east, down] = force.mean_square.map(|power| power.max(0.0));
    let (most, least) = (north.max(east), north.min(east));
    let is_level = most < ISOTROPY_MAX * least && down < most;
    if !is_level || has_line(&force.bands) || explained_by_motion(samples)? > EXPLAINED_MAX {
        return None;
    }
    let mass = all.value(EffectId::Mass, "mass_kg", 0).unwrap_or(vehicle.mass);
    let mut slots = Slots::default();
    for slot in EffectId::Gusts.spec().slots() {
        slots[slot.index] = slot.parameter.default.unwrap_or(0.0);
    }
    slots[0] = drag.gusts((0.5 * (north + east)).sqrt() * mass)?;
    Some(slots)
}

/// A vehicle's drag along the wind: `linear` [kg/s] and `quadratic` [kg/m].
#[derive(Clone, Copy, Debug)]
struct Drag {
    linear: f64,
    quadratic: f64,
}

impl Drag {
    /// Standard deviation of the gusts, m/s, that cause a force with standard deviation `force`
    /// along one axis, N, on a vehicle that is slow relative to them; `None` above the strongest
    /// gusts.
    fn gusts(self, force: f64) -> Option<f64> {
        // For normal gusts of deviations 1, 1 and 0.6: mean square of |g| g_x, and its mean product
        // with g_x.
        const SQUARE: f64 = 4.36;
        const PRODUCT: f64 = 2.0;
        let Self { linear, quadratic } = self;
        let pushed = |sigma: f64| {
            let (a, b) = (linear * sigma, quadratic * sigma * sigma);
            (a * a + 2.0 * PRODUCT * a * b + SQUARE * b * b).sqrt()
        };
        let (mut low, mut high) = (0.0, STORM_M_S);
        if pushed(high) < force {
            return None;
        }
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if pushed(middle) < force { low = middle } else { high = middle }
        }
        Some(high)
    }
}

/// Whether one band stands out from its neighbours.
fn has_line(bands: &[[f64; 3]]) -> bool {
    let density: Vec<f64> =
        bands.iter().map(|[from, to, power]| power.max(0.0) / (to - from)).collect();
    let total: f64 = bands.iter().map(|[.., power]| power.max(0.0)).sum();
    density.windows(3).zip(&bands[1..]).any(|(d, [.., power])| {
        d[1] > LINE_RATIO_MIN * d[0] && d[1] > LINE_RATIO_MIN * d[2] && *power > 0.2 * total
    })
}

/// Share of the force in body axes that a regression on velocity, body rate and throttle explains,
/// less the share that as many unrelated regressors would explain.
fn explained_by_motion(samples: &[Sample]) -> Option<f64> {
    let n = samples.len();
    let rows: Vec<[f64; REGRESSORS]> = samples.iter().map(regressors).collect();
    if n < 4 * REGRESSORS {
        return None;
    }
    let x = DMatrix::from_fn(n, REGRESSORS, |i, j| rows[i][j]);
    let gram = x.transpose() * &x + DMatrix::identity(REGRESSORS, REGRESSORS) * 1e-9;
    let factor = gram.cholesky()?;
    let (mut unexplained, mut total) = (0.0, 0.0);
    for axis in 0..3 {
        let y = DVector::from_fn(n, |i, _| samples[i].body[axis]);
        let left = &y - &x * factor.solve(&(x.transpose() * &y));
        let mean = y.mean();
        total += y.iter().map(|y| (y - mean).powi(2)).sum::<f64>();
        let penalty = n as f64 / (n - REGRESSORS) as f64;
        unexplained += left.norm_squared() * penalty;
    }
    (total > 0.0).then(|| (total - unexplained) / total)
}

/// Number of [`regressors`].
const REGRESSORS: usize = 11;

/// 1, velocity, body rate, velocity times speed, and throttle of a sample.
fn regressors(sample: &Sample) -> [f64; REGRESSORS] {
    let [vx, vy, vz] = sample.body_velocity;
    let [p, q, r] = sample.body_rate;
    let speed = (vx * vx + vy * vy + vz * vz).sqrt();
    [1.0, vx, vy, vz, p, q, r, speed * vx, speed * vy, speed * vz, sample.throttle()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gust_speed_follows_from_either_drag() {
        let linear = Drag { linear: 0.2, quadratic: 0.0 };
        assert!((linear.gusts(0.3).unwrap() - 1.5).abs() < 1e-9);
        let quadratic = Drag { linear: 0.0, quadratic: 0.05 };
        let force = 0.05 * 4.36_f64.sqrt() * 2.0 * 2.0;
        assert!((quadratic.gusts(force).unwrap() - 2.0).abs() < 1e-9);
        let both = Drag { linear: 0.2, quadratic: 0.05 };
        assert!(both.gusts(0.3).unwrap() < 1.5);
        assert_eq!(Drag { linear: 0.0, quadratic: 0.0 }.gusts(0.3), None);
    }

    #[test]
    fn spectral_line_is_distinguished_from_a_slope() {
        let slope = [[0.1, 0.2, 0.05], [0.2, 0.35, 0.06], [0.35, 0.6, 0.05], [0.6, 1.0, 0.03]];
        assert!(!has_line(&slope));
        let line = [[0.1, 0.2, 0.01], [0.2, 0.35, 0.01], [0.35, 0.6, 0.4], [0.6, 1.0, 0.03]];
        assert!(has_line(&line));
    }
}
