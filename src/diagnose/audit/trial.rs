//! A first guess of how two streams fit: the delay, rotation and scale that explain most.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};

use super::weak::Bump;

/// Delays that are tried, s.
const DELAYS: std::ops::Range<f64> = -0.1..0.3;
/// Step of the trial, s.
pub(super) const DELAY_STEP: f64 = 0.01;
/// Bumps of the trial at most.
const TRIAL_BUMPS: usize = 400;
/// Least share that axes of another handedness must explain to be believed.
const MIRRORED_MIN: f64 = 0.7;
/// Axes whose singular value is below this share of the first one's do not move.
const MOVES_MIN: f64 = 1e-6;
/// Sweeps of a decomposition at most; ten are usual.
const SWEEPS: usize = 200;

/// The first guess: the delay at which a rotation and a scale explain most.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial {
    pub delay: f64,
    /// From the axes of what is expected to those of what is seen.
    pub rotation: Rotation3<f64>,
    pub scale: f64,
    pub explained: f64,
    pub is_mirrored: bool,
    /// Axes that move.
    pub moving: usize,
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
        // Damaged numbers may be of any size.
        let powers_are_finite =
            cross.norm().is_finite() && x_power.is_finite() && y_power.is_finite();
        let svd = powers_are_finite
            .then(|| cross.try_svd(true, true, f64::EPSILON, SWEEPS))
            .flatten()
            .and_then(|svd| Some((svd.u?, svd.v_t?, svd.singular_values)));
        let Some((u, v, s)) = svd else {
            let rotation = Rotation3::identity();
            return Self {
                delay,
                rotation,
                scale: 1.0,
                explained: 0.0,
                is_mirrored: false,
                moving: 0,
            };
        };
        let sign = (u * v).determinant().signum();
        let share = |power: f64| match x_power * y_power {
            0.0 => 0.0,
            powers => power * power / powers,
        };
        // Axes that hardly move leave the handedness open.
        let mirrored = share(s.sum());
        if sign < 0.0 && s[2] > 0.1 * s[0] && mirrored > MIRRORED_MIN {
            let rotation = Rotation3::identity();
            return Self {
                delay,
                rotation,
                scale: 1.0,
                explained: mirrored,
                is_mirrored: true,
                moving: 3,
            };
        }
        let power = s[0] + s[1] + sign * s[2];
        let scale = if x_power > 0.0 { power / x_power } else { 0.0 };
        let from = [v.row(0).transpose(), v.row(1).transpose()];
        let to = [u.column(0).into_owned(), u.column(1).into_owned()];
        let moving = s.iter().filter(|value| **value > MOVES_MIN * s[0]).count();
        let rotation = rotation_of(from, to, moving);
        Self { delay, rotation, scale, explained: share(power), is_mirrored: false, moving }
    }

    /// Angle of the rotation, rad.
    pub fn angle(&self) -> f64 {
        self.rotation.angle()
    }

    /// The scale, where it is no accuracy but a unit.
    pub fn unit(&self) -> f64 {
        if (0.7..1.4).contains(&self.scale) { 1.0 } else { self.scale }
    }
}

/// The rotation that takes `from` to `to`, unit vectors of which the first `moving` count. One
/// leaves the turn about itself open: then it is the shortest rotation.
fn rotation_of(from: [Vector3<f64>; 2], to: [Vector3<f64>; 2], moving: usize) -> Rotation3<f64> {
    match moving {
        0 => Rotation3::identity(),
        1 => Rotation3::rotation_between(&from[0], &to[0]).unwrap_or_else(|| {
            // Opposite ones: by half a turn about an axis across.
            let across = from[0].cross(&Vector3::ith(from[0].iamin(), 1.0));
            Rotation3::from_axis_angle(&Unit::new_normalize(across), std::f64::consts::PI)
        }),
        _ => {
            let right_handed =
                |[a, b]: [Vector3<f64>; 2]| Matrix3::from_columns(&[a, b, a.cross(&b)]);
            Rotation3::from_matrix_unchecked(right_handed(to) * right_handed(from).transpose())
        }
    }
}
