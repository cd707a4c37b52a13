//! Decides whether an unexplained force is turbulence.
//!
//! Gusts act through the drag. Their force is mainly horizontal, equally strong along north and
//! east, falls with frequency without a line, is never far beyond its usual size, and is independent
//! of the vehicle's own motion. The strength of the gusts follows from that force and the vehicle's
//! drag.

use nalgebra::{DMatrix, DVector};
use vehicle::VehicleParams;
use vehicle::effects::{Effect, EffectId, EffectSet, Gusts};

use crate::diagnose::residual_analysis::map::Sample;
use crate::diagnose::residual_analysis::unmodelled_force::{
    FORCE_MAX_HZ, FORCE_MIN_HZ, UnmodelledForce,
};

/// Largest ratio of power between north and east for turbulence: few gusts pass in a flight.
const ISOTROPY_MAX: f64 = 4.0;
/// Least ratio of a line's density to that of both neighbouring bands.
const LINE_RATIO_MIN: f64 = 2.5;
/// Strongest gusts that such a vehicle flies in, m/s.
const STORM_M_S: f64 = 20.0;
/// Largest kurtosis of the force along one axis: normal gusts give 3 through a linear drag, and 7.6
/// through a quadratic one. Events that are short and rare give more.
const KURTOSIS_MAX: f64 = 8.0;
/// Largest share of the force that the vehicle's own motion may explain.
pub(in crate::diagnose) const EXPLAINED_MAX: f64 = 0.35;

/// Standard deviation, m/s, of the gusts of default shape that explain `force` through the drag of
/// `effects` and the file; `None` if it is not turbulence. `samples` are the residuals of the best
/// explanation, and `slung_load` is the share of the force that a load on a line would explain.
pub fn gusts(
    vehicle: &VehicleParams,
    effects: &EffectSet,
    force: &UnmodelledForce,
    samples: &[Sample],
    slung_load: f64,
) -> Option<f64> {
    let all = vehicle.modelled_effects.overlay(effects);
    // A fit sees the velocity over the ground, not through the air: gusts lower its drag.
    let drag = |id: EffectId, name: &str| {
        let values = [effects, &vehicle.modelled_effects].map(|set| set.value(id, name, 0));
        values.into_iter().flatten().fold(0.0, f64::max)
    };
    let linear =
        drag(EffectId::RotorDrag, "d_xy").max(vehicle.linear_drag_n_per_m_s.unwrap_or(0.0));
    let quadratic = 0.5 * vehicle.air_density * drag(EffectId::ParasiticDrag, "cda_m2");
    let drag = Drag { linear, quadratic };
    let [north, east, down] = force.mean_square.map(|power| power.max(0.0));
    let (most, least) = (north.max(east), north.min(east));
    let is_level = most < ISOTROPY_MAX * least && down < most;
    let by_motion = explained_by_motion(samples)?.max(slung_load);
    let along = |axis: usize| samples.iter().map(move |sample| sample.world[axis]);
    let is_steady = 0.5 * (kurtosis(along(0)) + kurtosis(along(1))) < KURTOSIS_MAX;
    if !is_level || has_line(&force.bands) || !is_steady || by_motion > EXPLAINED_MAX {
        return None;
    }
    let mass = all.value(EffectId::Mass, "mass_kg", 0).unwrap_or(vehicle.mass);
    // Slow samples resolve fewer bands.
    let [_, upper, _] = force.bands.last()?;
    let share = Gusts::neutral().share_of_power(FORCE_MIN_HZ, upper.min(FORCE_MAX_HZ));
    drag.gusts((0.5 * (north + east) / share).sqrt() * mass)
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

/// Kurtosis of values: the fourth moment about the mean over the squared variance; not a number for
/// values without variance.
fn kurtosis(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    let moment = |power| values.clone().map(|value| (value - mean).powi(power)).sum::<f64>() / n;
    moment(4) / moment(2).powi(2)
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
    use rand::{Rng, SeedableRng};
    use rand_distr::StandardNormal;
    use rand_pcg::Pcg64Mcg;

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
    fn rare_events_have_a_larger_kurtosis_than_normal_gusts() {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        let gusts: Vec<[f64; 3]> = (0..20_000)
            .map(|_| std::array::from_fn(|_| rng.sample::<f64, _>(StandardNormal)))
            .collect();
        let linear = kurtosis(gusts.iter().map(|gust| gust[0]));
        assert!((linear - 3.0).abs() < 0.2, "{linear}");
        let speed = |[x, y, z]: &[f64; 3]| (x * x + y * y + z * z).sqrt();
        let quadratic = kurtosis(gusts.iter().map(|gust| speed(gust) * gust[0]));
        assert!((quadratic - 7.56).abs() < 1.0, "{quadratic}");
        let bump = |k: usize| if k % 50 < 3 { 1.0 } else { 0.0 };
        assert!(kurtosis((0..1000).map(bump)) > KURTOSIS_MAX);
    }

    #[test]
    fn spectral_line_is_distinguished_from_a_slope() {
        let slope = [[0.1, 0.2, 0.05], [0.2, 0.35, 0.06], [0.35, 0.6, 0.05], [0.6, 1.0, 0.03]];
        assert!(!has_line(&slope));
        let line = [[0.1, 0.2, 0.01], [0.2, 0.35, 0.01], [0.35, 0.6, 0.4], [0.6, 1.0, 0.03]];
        assert!(has_line(&line));
    }
}
