//! Two streams that tell the same motion: by how much one is late, turned and out of scale against
//! the other, axis by axis, how surely, and what the motion does not show.
//!
//! Under each bump the stream's derivative is seen as
//!
//! `y(t) = exp(w) R diag(s) (x(t - d - r (t - t0)) - b)`
//!
//! with the other sensor's x, a rotation R that is about right, and the unknowns delay d (s), drift
//! r, small rotation w (rad), scales s and bias b. They are found by least squares, which takes x
//! for exact. It is not: a slope is then too small by the share of noise in x, and that of x on y
//! too small by the share of noise in y. The true one lies between (Frisch 1934), and the interval
//! of a scale holds both. Intervals are of the jackknife over blocks of time (Kunsch 1989), so
//! that misfits may hang together over any time shorter than a block, as those of estimators do,
//! and what only one moment of the flight shows is not sure.

use nalgebra::{Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::Serialize;

use super::pair::{Correction, Pair};
use super::trial::Trial;
use super::weak::{Bump, Fit, Row, fit, half_width};

/// Least share that must be explained for anything to be concluded.
const EXPLAINED_MIN: f64 = 0.5;
/// Times an interval by which a value must lie beyond a limit to do so for sure.
const SURE: f64 = 3.0;
/// Least half width of a delay's interval, s: stamps and sampling are not better known.
const DELAY_FLOOR: f64 = 2e-4;
/// What noise is answered to by the vehicle's own loop looks like a delay: by up to the loop's own
/// time, s, if nothing else moved.
const LOOP_S: f64 = 0.05;
/// What is less sure is not shown: a delay, s; a drift; a rotation, rad; a scale.
const DELAY_UNSURE: f64 = 0.2;
const DRIFT_UNSURE: f64 = 0.01;
const ROTATION_UNSURE: f64 = 1.0;
const SCALE_UNSURE: f64 = 0.5;
/// Steps of delay (s), drift, rotation (rad), bias (rad/s, m/s or m/s^2) and scale that matter.
const DELAY_SIZE: f64 = 0.1;
const DRIFT_SIZE: f64 = 0.01;
const ROTATION_SIZE: f64 = 1.0;
const BIAS_SIZE: f64 = 1.0;
const SCALE_SIZE: f64 = 1.0;

/// Places of the unknowns.
const DELAY: usize = 0;
const DRIFT: usize = 1;
const ROTATION: usize = 2;
const BIAS: usize = 5;
const SCALE: usize = 8;
/// One scale of all axes, where they have none of their own.
const COMMON: usize = 11;
const UNKNOWNS: usize = 12;

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// Half width of the interval.
    pub half_width: f64,
}

impl Estimate {
    pub(super) fn new(value: f64, half_width: f64) -> Self {
        Self { value, half_width }
    }

    fn times(self, factor: f64) -> Self {
        Self { value: factor * self.value, half_width: factor * self.half_width }
    }

    /// Whether zero is outside of `times` the interval.
    pub fn differs_from_zero(&self, times: f64) -> bool {
        self.value.abs() > times * self.half_width
    }

    /// Whether the value lies beyond `limit`, on either side of `from`, for sure.
    pub fn is_beyond(&self, limit: f64, from: f64) -> bool {
        (self.value - from).abs() - SURE * self.half_width > limit
    }
}

/// How one stream fits the derivative that another sensor measures.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Agreement {
    /// By how much the stream shows the motion later than the other sensor, s, in the middle of
    /// the log.
    pub delay_s: Estimate,
    /// By how much of itself the stream's clock runs slower than the other sensor's.
    pub drift: Option<Estimate>,
    /// How the stream's axes are turned in the other sensor's, as a rotation vector in rad: of an
    /// attitude that is the true one times a trim, the trim; of the velocity, by how much the
    /// attitude's heading is too large. `None` about an axis that the motion does not show, as
    /// the only one that it is about.
    pub rotation_rad: [Option<Estimate>; 3],
    /// The same with one scale of all axes, which shows more: for rotations that are no trim.
    #[serde(skip)]
    pub(super) coarse_rad: [Option<Estimate>; 3],
    /// What the other sensor measures too much, in its own axes and unit; `None` where the motion
    /// does not show it.
    pub bias: [Option<Estimate>; 3],
    /// The stream's derivative over what the other sensor measures along each of its axes,
    /// negative where they run contrary; `None` where the motion does not show it.
    pub scale: [Option<Estimate>; 3],
    /// The same of all axes together.
    pub common_scale: Estimate,
    /// Share of the stream's motion that this explains.
    pub explained: f64,
    /// How fast the motion along each of the sensor's axes changes: its derivative over itself,
    /// 1/s.
    pub pace: [f64; 3],
    /// Time from the first to the last moment that was compared, s.
    pub span_s: f64,
}

impl Agreement {
    /// The furthest that the stream is off in time within the log, and how surely.
    pub fn worst_delay(&self) -> Estimate {
        let Estimate { value, half_width } = self.delay_s;
        let half = 0.5 * self.span_s;
        let drift = self.drift.map_or((0.0, 0.0), |d| (half * d.value.abs(), half * d.half_width));
        Estimate { value: value.abs() + drift.0, half_width: half_width + drift.1 }
    }
}

/// How the streams agree; `None` where their motion does not show it.
pub(super) fn agreement(pair: &impl Pair) -> Option<Agreement> {
    let trial = Trial::best(pair)?;
    // In the sensor's unit, so that numbers are of a size.
    let unit = trial.unit();
    let seen: Vec<(Bump, Vector3<f64>)> =
        pair.bumps().iter().filter_map(|bump| Some((*bump, pair.seen(*bump)? / unit))).collect();
    let (first, last) = (seen.first()?.0.centre, seen.last()?.0.centre);
    let comparison = Comparison { pair, seen, middle: trial.middle, rotation: trial.rotation };
    let mut start = [0.0; UNKNOWNS];
    start[DELAY] = trial.delay;
    start[DRIFT] = trial.drift;
    start[SCALE..SCALE + 3].copy_from_slice(trial.signs.as_slice());
    start[COMMON] = 1.0;
    let common = comparison.fit(start, false)?;
    let mut start = common.fit.value;
    for scale in SCALE..SCALE + 3 {
        start[scale] *= start[COMMON];
    }
    start[COMMON] = 1.0;
    let own = comparison.fit(start, true)?;
    if own.fit.explained < EXPLAINED_MIN {
        return None;
    }
    let value = &own.fit.value;
    let noise = LOOP_S * (1.0 - own.fit.explained);
    let delay_half = own.fit.half_width(DELAY)?.max(DELAY_FLOOR) + noise;
    let delay_s = Estimate::new(value[DELAY], delay_half);
    let is_shown = delay_s.half_width < DELAY_UNSURE + noise;
    if !is_shown {
        return None;
    }
    let sure = |estimate: Estimate, limit: f64| (estimate.half_width < limit).then_some(estimate);
    let of = |at: usize| Some(Estimate::new(value[at], own.fit.half_width(at)?));
    let drift = of(DRIFT).and_then(|drift| {
        // What noise looks like a delay may do so at one end and not at the other.
        let noise = 2.0 * noise / (last - first).max(1.0);
        sure(Estimate { half_width: drift.half_width + noise, ..drift }, DRIFT_UNSURE)
    });
    let scale = |i: usize| {
        let least = Estimate::new(value[SCALE + i], own.fit.half_width(SCALE + i)?);
        Some(sure(between(least, own.followed[i]), SCALE_UNSURE)?.times(unit))
    };
    let common_scale = Estimate::new(common.fit.value[COMMON], common.fit.half_width(COMMON)?);
    Some(Agreement {
        delay_s,
        drift,
        rotation_rad: own.rotation(&comparison.rotation),
        coarse_rad: common.rotation(&comparison.rotation),
        bias: std::array::from_fn(|i| of(BIAS + i)),
        scale: std::array::from_fn(scale),
        common_scale: between(common_scale, common.fit.explained).times(unit),
        explained: own.fit.explained,
        pace: own.pace,
        span_s: last - first,
    })
}

/// A slope that lies between those of either on the other; `followed` is their ratio.
fn between(least: Estimate, followed: f64) -> Estimate {
    if followed <= 0.0 {
        return Estimate { half_width: f64::INFINITY, ..least };
    }
    let most = least.value / followed;
    Estimate {
        value: 0.5 * (least.value + most),
        half_width: least.half_width / followed + 0.5 * (most - least.value).abs(),
    }
}

/// A pair with a rotation that is about right.
struct Comparison<'a, P> {
    pair: &'a P,
    seen: Vec<(Bump, Vector3<f64>)>,
    /// Time at which the delay is that of the fit, s.
    middle: f64,
    rotation: Rotation3<f64>,
}

/// Unknowns found.
struct Compared {
    fit: Fit<UNKNOWNS>,
    /// Share of what is seen along each of the sensor's axes that is explained.
    followed: [f64; 3],
    /// The motion's derivative over itself along each of the sensor's axes, 1/s.
    pace: [f64; 3],
}

impl<P: Pair> Comparison<'_, P> {
    fn fit(&self, start: [f64; UNKNOWNS], own_scales: bool) -> Option<Compared> {
        let mut sizes = [0.0; UNKNOWNS];
        sizes[DELAY] = DELAY_SIZE;
        sizes[DRIFT] = DRIFT_SIZE;
        for (i, turns) in self.pair.turns().into_iter().enumerate() {
            sizes[ROTATION + i] = if turns { ROTATION_SIZE } else { 0.0 };
        }
        sizes[BIAS..BIAS + 3].fill(BIAS_SIZE);
        if own_scales {
            sizes[SCALE..SCALE + 3].fill(SCALE_SIZE);
        } else {
            sizes[COMMON] = SCALE_SIZE;
        }
        let fit = fit(start, sizes, |value| self.rows(value))?;
        let back = self.turn(&fit.value).transpose();
        let rows = self.rows(&fit.value);
        let weighed = || rows.iter().zip(&fit.weights);
        let weight: f64 = fit.weights.iter().sum();
        let mean = |of: &dyn Fn(&Row<UNKNOWNS>) -> Vector3<f64>| {
            weighed().map(|(row, w)| back * of(row) * *w).sum::<Vector3<f64>>() / weight
        };
        let seen = mean(&|row| row.seen);
        // Powers about the mean: of what is seen, of what is left, of how what is expected changes.
        let power = |of: &dyn Fn(&Row<UNKNOWNS>) -> Vector3<f64>, about: Vector3<f64>| {
            let square = |row: &Row<UNKNOWNS>| (back * of(row) - about).map(|part| part * part);
            weighed().map(|(row, w)| square(row) * *w).sum::<Vector3<f64>>()
        };
        let whole = power(&|row| row.seen, seen);
        let left = power(&|row| row.misfit, Vector3::zeros());
        let changes = power(&|row| row.slopes.column(DELAY).into_owned(), Vector3::zeros());
        let over_whole =
            |of: f64, i: usize, none: f64| if whole[i] > 0.0 { of / whole[i] } else { none };
        let followed = std::array::from_fn(|i| 1.0 - over_whole(left[i], i, 1.0));
        let pace = std::array::from_fn(|i| over_whole(changes[i], i, 0.0).sqrt());
        Some(Compared { fit, followed, pace })
    }

    fn turn(&self, value: &[f64; UNKNOWNS]) -> Matrix3<f64> {
        let small = Vector3::from_column_slice(&value[ROTATION..ROTATION + 3]);
        (Rotation3::new(small) * self.rotation).into_inner()
    }

    fn rows(&self, value: &[f64; UNKNOWNS]) -> Vec<Row<UNKNOWNS>> {
        let turn = self.turn(value);
        let own = Vector3::from_column_slice(&value[SCALE..SCALE + 3]);
        let map = turn * Matrix3::from_diagonal(&(own * value[COMMON]));
        let bias = Vector3::from_column_slice(&value[BIAS..BIAS + 3]);
        let correction = Correction { map, bias };
        let row = |(bump, seen): &(Bump, Vector3<f64>)| {
            let since = bump.centre - self.middle;
            let delay = value[DELAY] + value[DRIFT] * since;
            let expected = self.pair.expected(bump.shifted(-delay), delay, &correction)?;
            let mut slopes = SMatrix::<f64, 3, UNKNOWNS>::zeros();
            slopes.set_column(DELAY, &expected.late);
            slopes.set_column(DRIFT, &(expected.late * since));
            slopes.fixed_columns_mut::<3>(ROTATION).copy_from(&-expected.value.cross_matrix());
            slopes.fixed_columns_mut::<3>(BIAS).copy_from(&(map * expected.bias));
            for i in 0..3 {
                let along = turn.column(i) * (expected.plain[i] * value[COMMON]);
                slopes.set_column(SCALE + i, &along);
            }
            slopes.set_column(COMMON, &(turn * own.component_mul(&expected.plain)));
            let misfit = seen - expected.value;
            Some(Row { time: bump.centre, group: bump.group, seen: *seen, misfit, slopes })
        };
        self.seen.iter().filter_map(row).collect()
    }
}

impl Compared {
    /// The rotation vector from the sensor's axes to the stream's, in the sensor's.
    fn rotation(&self, about: &Rotation3<f64>) -> [Option<Estimate>; 3] {
        let small = Vector3::from_column_slice(&self.fit.value[ROTATION..ROTATION + 3]);
        let turned = Rotation3::new(small) * about;
        // By way of the quaternion: a matrix's own axis is lost at half a turn.
        let vector = UnitQuaternion::from_rotation_matrix(&turned).inverse().scaled_axis();
        // The fit turns the stream's axes; the answer is in the other sensor's axes.
        let there = |of: &SMatrix<f64, UNKNOWNS, UNKNOWNS>| {
            about.transpose() * of.fixed_view::<3, 3>(ROTATION, ROTATION) * about
        };
        let (covariance, hidden) = (there(&self.fit.covariance), there(&self.fit.hidden));
        std::array::from_fn(|axis| {
            let half_width = half_width(&covariance, &hidden, axis)?;
            let estimate = Estimate::new(vector[axis], half_width);
            (estimate.half_width < ROTATION_UNSURE).then_some(estimate)
        })
    }
}
