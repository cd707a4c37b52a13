//! A first guess of how two streams fit: the delay, rotation and scale that explain most.

use nalgebra::{Matrix3, Vector3};

use super::weak::Bump;

/// Delays that are tried, s.
const DELAYS: std::ops::Range<f64> = -0.1..0.3;
/// Step of the trial, s.
pub(super) const DELAY_STEP: f64 = 0.01;
/// Bumps of the trial at most.
const TRIAL_BUMPS: usize = 400;
/// Least share that axes of another handedness must explain to be believed.
const MIRRORED_MIN: f64 = 0.7;

/// The first guess: the delay at which a rotation and a scale explain most.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial {
    pub delay: f64,
    pub rotation: Matrix3<f64>,
    pub scale: f64,
    pub explained: f64,
    pub is_mirrored: bool,
}

impl Trial {
    /// Tries all delays on what is seen and what is expected under each bump.
    pub fn best(
        bumps: &[Bump],
        seen: impl Fn(Bump) -> Option<Vector3<f64>>,
        expected: impl Fn(Bump, f64) -> Option<Vector3<f64>>,
    ) -> Option<Self> {
        let stride = (bumps.len() / TRIAL_BUMPS).max(1);
        let seen: Vec<(Bump, Vector3<f64>)> =
            bumps.iter().step_by(stride).filter_map(|bump| Some((*bump, seen(*bump)?))).collect();
        let steps = ((DELAYS.end - DELAYS.start) / DELAY_STEP).round() as usize;
        let mut best: Option<Self> = None;
        for step in 0..=steps {
            let delay = DELAYS.start + step as f64 * DELAY_STEP;
            let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = seen
                .iter()
                .filter_map(|(bump, y)| Some((*y, expected(bump.shifted(-delay), delay)?)))
                .collect();
            if pairs.len() < 24 {
                continue;
            }
            let trial = Self::at(delay, &pairs);
            if best.is_none_or(|best| trial.explained > best.explained) {
                best = Some(trial);
            }
        }
        best
    }

    /// The best rotation and scale (Kabsch, Umeyama) of pairs less their means.
    fn at(delay: f64, pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Self {
        let count = pairs.len() as f64;
        let (y_mean, x_mean) =
            pairs.iter().fold((Vector3::zeros(), Vector3::zeros()), |(a, b), (y, x)| {
                (a + y / count, b + x / count)
            });
        let (mut cross, mut x_power, mut y_power) = (Matrix3::zeros(), 0.0, 0.0);
        for (y, x) in pairs {
            let (y, x) = (y - y_mean, x - x_mean);
            cross += y * x.transpose();
            x_power += x.norm_squared();
            y_power += y.norm_squared();
        }
        // Damaged numbers may be of any size, and a decomposition of them need not end.
        if !(cross.norm().is_finite() && x_power.is_finite() && y_power.is_finite()) {
            let rotation = Matrix3::identity();
            return Self { delay, rotation, scale: 1.0, explained: 0.0, is_mirrored: false };
        }
        let svd = cross.svd(true, true);
        let (u, v) = (svd.u.unwrap_or_default(), svd.v_t.unwrap_or_default());
        let sign = (u * v).determinant().signum();
        let s = svd.singular_values;
        let share = |power: f64| match x_power * y_power {
            0.0 => 0.0,
            powers => power * power / powers,
        };
        // Axes that hardly move leave the handedness open.
        let mirrored = share(s.sum());
        if sign < 0.0 && s[2] > 0.1 * s[0] && mirrored > MIRRORED_MIN {
            let rotation = Matrix3::identity();
            return Self { delay, rotation, scale: 1.0, explained: mirrored, is_mirrored: true };
        }
        let power = s[0] + s[1] + sign * s[2];
        let turn = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign));
        let scale = if x_power > 0.0 { power / x_power } else { 0.0 };
        let rotation = u * turn * v;
        Self { delay, rotation, scale, explained: share(power), is_mirrored: false }
    }

    /// Angle of the rotation, rad.
    pub fn angle(&self) -> f64 {
        (0.5 * (self.rotation.trace() - 1.0)).clamp(-1.0, 1.0).acos()
    }

    /// The scale, where it is no accuracy but a unit.
    pub fn unit(&self) -> f64 {
        if (0.7..1.4).contains(&self.scale) { 1.0 } else { self.scale }
    }
}
