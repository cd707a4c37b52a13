//! A first guess of how two streams fit: the delay, rotation and scale that explain most.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};

use super::pair::{Correction, Pair};
use super::weak::Bump;

/// Largest delay that is tried in either direction, s.
const DELAY_MAX: f64 = 0.5;
/// Step of the delays that are tried, in half widths of a bump.
const STEP: f64 = 0.1;
/// Drifts that are tried in either direction, in steps of the delay at the ends of the log.
const DRIFTS: i32 = 16;
/// Largest relative rate error between clocks: resonators without a quartz are off by half of it.
const DRIFT_MAX: f64 = 0.015;
/// Another delay, and another drift, must leave less than this share of the unexplained part.
const BETTER_DELAY: f64 = 0.95;
const BETTER_DRIFT: f64 = 0.8;
/// Axes of opposite handedness must leave less than this share.
const BETTER_MIRRORED: f64 = 0.5;
/// They must also explain this much more of the motion: less is rounding, where all is explained.
const NEGLIGIBLE: f64 = 1e-4;
/// Most and fewest bumps of an initial fit.
const BUMPS: usize = 300;
pub(super) const BUMPS_MIN: usize = 24;
/// Axes with a singular value below this share of the largest do not move.
const MOVES_MIN: f64 = 1e-6;
/// Most sweeps of a decomposition; ten are usual.
const SWEEPS: usize = 200;

/// The first guess: the delay at which a rotation and a scale explain most.
#[derive(Clone, Copy, Debug)]
pub(super) struct InitialFit {
    /// Delay at `middle`, s.
    pub delay: f64,
    /// Change of the delay over time, s/s.
    pub drift: f64,
    /// Mean time of the motion, s.
    pub middle: f64,
    /// From the axes of the expected derivative to those of the measured one.
    pub rotation: Rotation3<f64>,
    /// Sign of each axis of the expected derivative; -1 for a reversed one.
    pub signs: Vector3<f64>,
    /// Ratio of the measured derivative to the expected one.
    pub scale: f64,
    /// Share of the motion that the fit explains.
    pub explained: f64,
    /// Number of axes that move.
    pub moving: usize,
}

impl InitialFit {
    /// The best over all delays and drifts; `None` with too few bumps.
    pub fn best(pair: &impl Pair) -> Option<Self> {
        let bumps = Self::bumps(pair);
        let step = STEP * bumps.first()?.half;
        let steps = (DELAY_MAX / step).ceil() as i32;
        let moments: Vec<Moment> =
            bumps.into_iter().filter_map(|bump| Moment::of(pair, bump, step, steps)).collect();
        let (first, last) = (moments.first()?.centre, moments.last()?.centre);
        let power = |moment: &Moment| moment.measured.norm_squared();
        let total_power: f64 = moments.iter().map(power).sum();
        let middle = moments.iter().map(|m| m.centre * power(m)).sum::<f64>() / total_power;
        let half = 0.5 * (last - first);
        let rotatable = pair.rotatable_axes();
        let mut best: Option<Self> = None;
        for drift in outwards(DRIFTS).map(|end| f64::from(end) * step / half) {
            if drift.abs() > DRIFT_MAX {
                continue;
            }
            let mut steady: Option<Self> = None;
            for delay in outwards(steps).map(|delay| f64::from(delay) * step) {
                let late = |m: &Moment| ((delay + drift * (m.centre - middle)) / step).round();
                let pairs =
                    moments.iter().filter_map(|m| Some((m.measured, m.at(late(m) as i32)?)));
                let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = pairs.collect();
                if pairs.len() < BUMPS_MIN {
                    continue;
                }
                let initial = Self { delay, drift, middle, ..Self::at(&pairs, rotatable) };
                if steady.is_none_or(|best| initial.explains_more_than(&best, BETTER_DELAY)) {
                    steady = Some(initial);
                }
            }
            if let Some(steady) = steady
                && best.is_none_or(|best| steady.explains_more_than(&best, BETTER_DRIFT))
            {
                best = Some(steady);
            }
        }
        best
    }

    fn explains_more_than(&self, other: &Self, share: f64) -> bool {
        1.0 - self.explained < share * (1.0 - other.explained) - NEGLIGIBLE
    }

    /// The best rotation and scale (Kabsch, Umeyama) of pairs of a measured and an expected
    /// derivative, without their means.
    fn at(pairs: &[(Vector3<f64>, Vector3<f64>)], rotatable: [bool; 3]) -> Self {
        let (y_mean, x_mean) = means(pairs);
        let (mut cross, mut x_power, mut y_power) = (Matrix3::zeros(), 0.0, 0.0);
        for (y, x) in pairs {
            let (y, x) = (y - y_mean, x - x_mean);
            cross += y * x.transpose();
            x_power += x.norm_squared();
            y_power += y.norm_squared();
        }
        let mut initial = Self {
            delay: 0.0,
            drift: 0.0,
            middle: 0.0,
            rotation: Rotation3::identity(),
            signs: Vector3::repeat(1.0),
            scale: 1.0,
            explained: 0.0,
            moving: 0,
        };
        // Damaged numbers may be arbitrarily large.
        if !(cross.norm().is_finite() && x_power.is_finite() && y_power.is_finite()) {
            return initial;
        }
        let found = if rotatable == [true; 3] {
            RotationFit::any(&cross)
        } else {
            RotationFit::level(&cross)
        };
        let Some(RotationFit { proper, power, mirrored, mirrored_power, moving }) = found else {
            return initial;
        };
        // A rotation with negative power opposes the motion, and explains nothing.
        let share = |power: f64| match x_power * y_power {
            0.0 => 0.0,
            powers => (power.max(0.0).powi(2) / powers).min(1.0),
        };
        let (rotation, signs, power) =
            if 1.0 - share(mirrored_power) < BETTER_MIRRORED * (1.0 - share(power)) - NEGLIGIBLE {
                let (rotation, signs) = smallest_rotation(&mirrored, rotatable);
                (rotation, signs, mirrored_power)
            } else {
                (proper, Vector3::repeat(1.0), power)
            };
        initial.rotation = rotation;
        initial.signs = signs;
        initial.moving = moving;
        initial.explained = share(power);
        initial.scale = if x_power > 0.0 { power.max(0.0) / x_power } else { 0.0 };
        initial
    }

    /// The fit at one delay, and what it leaves of each bump. `None` under a bump without samples
    /// at that delay.
    pub fn with_misfits(pair: &impl Pair, bumps: &[Bump], delay: f64) -> (Self, Vec<Option<f64>>) {
        let of_bump = |bump: &Bump| {
            let expected = pair.expected(bump.shifted(-delay), delay, &Correction::NONE)?;
            Some((pair.measured(*bump)?, expected.value))
        };
        let all: Vec<Option<(Vector3<f64>, Vector3<f64>)>> = bumps.iter().map(of_bump).collect();
        let pairs: Vec<_> = all.iter().flatten().copied().collect();
        let fit = Self { delay, ..Self::at(&pairs, pair.rotatable_axes()) };
        let (y, x) = means(&pairs);
        let map = fit.rotation * Matrix3::from_diagonal(&(fit.signs * fit.scale));
        let misfit = |(measured, expected): (Vector3<f64>, Vector3<f64>)| {
            (measured - y - map * (expected - x)).norm_squared()
        };
        (fit, all.into_iter().map(|pair| pair.map(misfit)).collect())
    }

    /// The bumps that an initial fit compares.
    pub fn bumps(pair: &impl Pair) -> Vec<Bump> {
        let bumps: Vec<Bump> =
            pair.bumps().iter().copied().filter(|bump| bump.group == 0).collect();
        let stride = bumps.len().div_ceil(BUMPS).max(1);
        bumps.into_iter().step_by(stride).collect()
    }

    /// Angle of the rotation, rad.
    pub fn angle(&self) -> f64 {
        self.rotation.angle()
    }

    /// The scale, if it indicates another unit rather than a calibration error.
    pub fn unit(&self) -> f64 {
        if (0.7..1.4).contains(&self.scale) { 1.0 } else { self.scale }
    }
}

/// The means of pairs of a measured and an expected derivative.
pub(super) fn means(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> (Vector3<f64>, Vector3<f64>) {
    let count = pairs.len() as f64;
    pairs
        .iter()
        .fold((Vector3::zeros(), Vector3::zeros()), |(a, b), (y, x)| (a + y / count, b + x / count))
}

/// Integers from 0 outwards.
fn outwards(most: i32) -> impl Iterator<Item = i32> {
    std::iter::once(0).chain((1..=most).flat_map(|k| [k, -k]))
}

/// The measured derivative under a bump, and the expected one at each delay.
pub(super) struct Moment {
    /// Time of the bump's middle, s.
    pub centre: f64,
    pub measured: Vector3<f64>,
    /// From the largest delay ahead to the largest one behind, a step apart.
    expected: Vec<Option<Vector3<f64>>>,
}

impl Moment {
    /// With the delays up to `steps` times `step` (s) in either direction.
    pub fn of(pair: &impl Pair, bump: Bump, step: f64, steps: i32) -> Option<Self> {
        let measured = pair.measured(bump)?;
        let at = |k: i32| {
            let delay = f64::from(k) * step;
            Some(pair.expected(bump.shifted(-delay), delay, &Correction::NONE)?.value)
        };
        Some(Self { centre: bump.centre, measured, expected: (-steps..=steps).map(at).collect() })
    }

    /// The expected derivative at a delay of this many steps.
    pub fn at(&self, steps: i32) -> Option<Vector3<f64>> {
        let middle = self.expected.len() / 2;
        *self.expected.get(middle.checked_add_signed(steps as isize)?)?
    }
}

/// The best rotation, and the best one with opposite handedness, with the power that each explains.
struct RotationFit {
    proper: Rotation3<f64>,
    power: f64,
    mirrored: Matrix3<f64>,
    mirrored_power: f64,
    moving: usize,
}

impl RotationFit {
    /// About any axis, from `cross = sum y x^T` of the derivatives without their means.
    fn any(cross: &Matrix3<f64>) -> Option<Self> {
        let svd = cross.try_svd(true, true, f64::EPSILON, SWEEPS)?;
        let (u, v, s) = (svd.u?, svd.v_t?, svd.singular_values);
        let sign = (u * v).determinant().signum();
        let from = [v.row(0).transpose(), v.row(1).transpose()];
        let to = [u.column(0).into_owned(), u.column(1).into_owned()];
        let moving = s.iter().filter(|value| **value > MOVES_MIN * s[0]).count();
        Some(Self {
            proper: rotation_of(from, to, moving),
            power: s[0] + s[1] + sign * s[2],
            mirrored: u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -sign)) * v,
            mirrored_power: s[0] + s[1] - sign * s[2],
            moving,
        })
    }

    /// The same about down only.
    fn level(cross: &Matrix3<f64>) -> Option<Self> {
        let [along, across] = [cross[(0, 0)] + cross[(1, 1)], cross[(1, 0)] - cross[(0, 1)]];
        let [even, odd] = [cross[(0, 0)] - cross[(1, 1)], cross[(1, 0)] + cross[(0, 1)]];
        let down = cross[(2, 2)];
        let heading = |angle: f64| Rotation3::from_axis_angle(&Vector3::z_axis(), angle);
        let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
        Some(Self {
            proper: heading(across.atan2(along)),
            power: along.hypot(across) + down,
            mirrored: heading(odd.atan2(even)).into_inner() * flip,
            mirrored_power: even.hypot(odd) + down,
            moving: 3,
        })
    }
}

/// A transformation of opposite handedness as one reversed axis and the smallest rotation.
fn smallest_rotation(
    mirrored: &Matrix3<f64>,
    rotatable: [bool; 3],
) -> (Rotation3<f64>, Vector3<f64>) {
    let with = |axis: usize| {
        let mut signs = Vector3::repeat(1.0);
        signs[axis] = -1.0;
        let rotation = mirrored * Matrix3::from_diagonal(&signs);
        (Rotation3::from_matrix_unchecked(rotation), signs)
    };
    // Where only the heading may be off, down stays.
    let axes = if rotatable == [true; 3] { 0..3 } else { 0..2 };
    let mut all = axes.map(with);
    let first = all.next().unwrap_or_else(|| with(0));
    all.fold(first, |best, next| if next.0.angle() < best.0.angle() { next } else { best })
}

/// The rotation that takes the first `moving` unit vectors of `from` to those of `to`. A single one
/// leaves the rotation about itself open, and yields the shortest rotation.
fn rotation_of(from: [Vector3<f64>; 2], to: [Vector3<f64>; 2], moving: usize) -> Rotation3<f64> {
    match moving {
        0 => Rotation3::identity(),
        1 => Rotation3::rotation_between(&from[0], &to[0]).unwrap_or_else(|| {
            // For opposite vectors, half a turn about a perpendicular axis.
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
