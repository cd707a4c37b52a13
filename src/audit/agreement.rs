//! Compares two streams of the same motion: the delay, rotation and scale of one against the other,
//! axis by axis, with intervals, and the parts that the motion does not show.
//!
//! Under each bump the model of the stream's derivative is
//!
//! `y(t) = exp(w) R diag(s) (x(t - d - r (t - t0)) - b)`
//!
//! x is the other sensor, R a rotation that is about right. The unknowns are the delay d (s), drift
//! r, small rotation w (rad), scales s and bias b. Least squares find them, with x taken as exact.
//! Noise in x makes a slope too small by its share, and noise in y does the same to the slope of x
//! on y. The true slope is between the two (Frisch 1934), and the interval of a scale contains
//! both. Intervals come from the jackknife over blocks of time (Kunsch 1989). Misfits may therefore
//! correlate over any time shorter than a block, as an estimator's do, and a value that a single
//! moment determines has a wide interval.

use nalgebra::{Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::Serialize;

use super::initial_fit::InitialFit;
use super::pair::{Correction, Pair};
use super::weak::{Bump, Fit, Row, fit, half_width};

/// Least explained share for a conclusion.
const EXPLAINED_MIN: f64 = 0.5;
/// Intervals by which a value must exceed a limit for certainty.
const CERTAIN_INTERVALS: f64 = 3.0;
/// Least half width of a delay's interval, s: stamps and sampling are not more accurate.
const DELAY_FLOOR: f64 = 2e-4;
/// The vehicle's loop responds to noise, which looks like a delay: by up to this time of the loop,
/// s, if nothing else moves.
const LOOP_S: f64 = 0.05;
/// Half widths above which a value counts as not shown: a delay, s; a drift; a rotation, rad; a
/// scale.
const DELAY_HALF_WIDTH_MAX: f64 = 0.2;
const DRIFT_HALF_WIDTH_MAX: f64 = 0.01;
const ROTATION_HALF_WIDTH_MAX: f64 = 1.0;
const SCALE_HALF_WIDTH_MAX: f64 = 0.5;
/// Significant steps of delay (s), drift, rotation (rad), bias (rad/s, m/s or m/s^2) and scale.
const DELAY_STEP: f64 = 0.1;
const DRIFT_STEP: f64 = 0.01;
const ROTATION_STEP: f64 = 1.0;
const BIAS_STEP: f64 = 1.0;
const SCALE_STEP: f64 = 1.0;

/// Indices of the unknowns.
const DELAY: usize = 0;
const DRIFT: usize = 1;
const ROTATION: usize = 2;
const BIAS: usize = 5;
const SCALE: usize = 8;
/// A single scale for all axes, in place of one for each.
const COMMON: usize = 11;
const UNKNOWNS: usize = 12;

/// A value with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Estimate {
    /// Best estimate.
    pub value: f64,
    /// Half width of the 95 % interval.
    pub half_width: f64,
}

impl Estimate {
    pub(super) fn new(value: f64, half_width: f64) -> Self {
        Self { value, half_width }
    }

    fn times(self, factor: f64) -> Self {
        Self { value: factor * self.value, half_width: factor.abs() * self.half_width }
    }

    /// Whether zero is further off than `times` the half width.
    pub fn differs_from_zero(&self, times: f64) -> bool {
        self.value.abs() > times * self.half_width
    }

    /// Whether the value is certainly further than `limit` from `from`, on either side.
    pub fn is_beyond(&self, limit: f64, from: f64) -> bool {
        (self.value - from).abs() - CERTAIN_INTERVALS * self.half_width > limit
    }
}

/// The fit of one stream's derivative to another sensor.
#[derive(Clone, Copy, Debug, PartialEq, JsonSchema, Serialize)]
pub struct Agreement {
    /// Delay of the stream behind the other sensor, s, in the middle of the log.
    pub delay_s: Estimate,
    /// Relative rate by which the stream's clock is slower than the other sensor's.
    pub drift: Option<Estimate>,
    /// Rotation vector of the stream's axes in the other sensor's, rad. For an attitude it is the
    /// trim, if the attitude is the true one times a trim. For a velocity it is the excess of the
    /// attitude's heading. `None` about an axis that the motion does not show, such as the only
    /// axis of a rotation.
    pub rotation_rad: [Option<Estimate>; 3],
    /// The rotation from a fit with a single scale for all axes, which shows more: for rotations
    /// too large to be trims.
    #[serde(skip)]
    pub(super) coarse_rad: [Option<Estimate>; 3],
    /// Share of the motion across each axis that this fit leaves unexplained.
    #[serde(skip)]
    pub(super) coarse_unexplained: [f64; 3],
    /// Bias of the other sensor in its own axes and unit; `None` where the motion does not show it.
    pub bias: [Option<Estimate>; 3],
    /// Ratio of the stream's derivative to the other sensor along each of its axes, negative where
    /// they are opposite; `None` where the motion does not show it.
    pub scale: [Option<Estimate>; 3],
    /// The ratio for all axes together.
    pub common_scale: Estimate,
    /// Share of the stream's motion that the fit explains.
    pub explained: f64,
    /// Rate of change of the motion along each of the sensor's axes: its derivative over itself,
    /// 1/s.
    pub pace: [f64; 3],
    /// Time from the first to the last compared moment, s.
    pub span_s: f64,
}

impl Agreement {
    /// The largest timing error of the stream within the log, with its interval.
    pub fn worst_delay(&self) -> Estimate {
        let Estimate { value, half_width } = self.delay_s;
        let half = 0.5 * self.span_s;
        let drift = self.drift.map_or((0.0, 0.0), |d| (half * d.value.abs(), half * d.half_width));
        Estimate { value: value.abs() + drift.0, half_width: half_width + drift.1 }
    }
}

/// The agreement of two streams; `None` where their motion does not show it.
pub(super) fn agreement(pair: &impl Pair) -> Option<Agreement> {
    let initial = InitialFit::best(pair)?;
    // In the sensor's unit, for numbers of order 1.
    let unit = initial.unit();
    let measured: Vec<(Bump, Vector3<f64>)> = pair
        .bumps()
        .iter()
        .filter_map(|bump| Some((*bump, pair.measured(*bump)? / unit)))
        .collect();
    let (first, last) = (measured.first()?.0.centre, measured.last()?.0.centre);
    let comparison =
        Comparison { pair, measured, middle: initial.middle, rotation: initial.rotation };
    let mut start = [0.0; UNKNOWNS];
    start[DELAY] = initial.delay;
    start[DRIFT] = initial.drift;
    start[SCALE..SCALE + 3].copy_from_slice(initial.signs.as_slice());
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
    let is_shown = delay_s.half_width < DELAY_HALF_WIDTH_MAX + noise;
    if !is_shown {
        return None;
    }
    let sure = |estimate: Estimate, limit: f64| (estimate.half_width < limit).then_some(estimate);
    let of = |at: usize| Some(Estimate::new(value[at], own.fit.half_width(at)?));
    let drift = of(DRIFT).and_then(|drift| {
        // A delay due to noise may be present at one end of the log only.
        let noise = 2.0 * noise / (last - first).max(1.0);
        sure(Estimate { half_width: drift.half_width + noise, ..drift }, DRIFT_HALF_WIDTH_MAX)
    });
    let scale = |i: usize| {
        let least = Estimate::new(value[SCALE + i], own.fit.half_width(SCALE + i)?);
        Some(sure(between(least, own.explained[i]), SCALE_HALF_WIDTH_MAX)?.times(unit))
    };
    let common_scale = Estimate::new(common.fit.value[COMMON], common.fit.half_width(COMMON)?);
    Some(Agreement {
        delay_s,
        drift,
        rotation_rad: own.rotation(&comparison.rotation),
        coarse_rad: common.rotation(&comparison.rotation),
        coarse_unexplained: common.unexplained_across(),
        bias: std::array::from_fn(|i| of(BIAS + i)),
        scale: std::array::from_fn(scale),
        common_scale: between(common_scale, common.fit.explained).times(unit),
        explained: own.fit.explained,
        pace: own.pace,
        span_s: last - first,
    })
}

/// A slope between the two regressions of either on the other, whose ratio is `explained`.
fn between(least: Estimate, explained: f64) -> Estimate {
    if explained <= 0.0 {
        return Estimate { half_width: f64::INFINITY, ..least };
    }
    let most = least.value / explained;
    Estimate {
        value: 0.5 * (least.value + most),
        half_width: least.half_width / explained + 0.5 * (most - least.value).abs(),
    }
}

/// A pair with an approximate rotation.
struct Comparison<'a, P> {
    pair: &'a P,
    measured: Vec<(Bump, Vector3<f64>)>,
    /// Time at which the fit's delay applies, s.
    middle: f64,
    rotation: Rotation3<f64>,
}

/// A fit of the unknowns with its quality.
struct ComparisonFit {
    fit: Fit<UNKNOWNS>,
    /// Explained share of the motion along each of the sensor's axes.
    explained: [f64; 3],
    /// The motion's derivative over itself along each of the sensor's axes, 1/s.
    pace: [f64; 3],
}

impl<P: Pair> Comparison<'_, P> {
    /// The fit from `start`, with a scale for each axis, or a single one.
    fn fit(&self, start: [f64; UNKNOWNS], own_scales: bool) -> Option<ComparisonFit> {
        let mut sizes = [0.0; UNKNOWNS];
        sizes[DELAY] = DELAY_STEP;
        sizes[DRIFT] = DRIFT_STEP;
        for (i, is_rotatable) in self.pair.rotatable_axes().into_iter().enumerate() {
            sizes[ROTATION + i] = if is_rotatable { ROTATION_STEP } else { 0.0 };
        }
        sizes[BIAS..BIAS + 3].fill(BIAS_STEP);
        if own_scales {
            sizes[SCALE..SCALE + 3].fill(SCALE_STEP);
        } else {
            sizes[COMMON] = SCALE_STEP;
        }
        let fit = fit(start, sizes, |value| self.rows(value))?;
        let back = self.turn(&fit.value).transpose();
        let rows = self.rows(&fit.value);
        let weighted = || rows.iter().zip(&fit.weights);
        let weight: f64 = fit.weights.iter().sum();
        let mean = |of: &dyn Fn(&Row<UNKNOWNS>) -> Vector3<f64>| {
            weighted().map(|(row, w)| back * of(row) * *w).sum::<Vector3<f64>>() / weight
        };
        let measured = mean(&|row| row.measured);
        // Powers about the mean: of the motion, of the residual, of the expected changes.
        let power = |of: &dyn Fn(&Row<UNKNOWNS>) -> Vector3<f64>, about: Vector3<f64>| {
            let square = |row: &Row<UNKNOWNS>| (back * of(row) - about).map(|part| part * part);
            weighted().map(|(row, w)| square(row) * *w).sum::<Vector3<f64>>()
        };
        let total_power = power(&|row| row.measured, measured);
        let left = power(&|row| row.misfit, Vector3::zeros());
        let changes = power(&|row| row.slopes.column(DELAY).into_owned(), Vector3::zeros());
        let share_of_total = |of: f64, i: usize, none: f64| {
            if total_power[i] > 0.0 { of / total_power[i] } else { none }
        };
        let explained = std::array::from_fn(|i| 1.0 - share_of_total(left[i], i, 1.0));
        let pace = std::array::from_fn(|i| share_of_total(changes[i], i, 0.0).sqrt());
        Some(ComparisonFit { fit, explained, pace })
    }

    /// `exp(w) R`.
    fn turn(&self, value: &[f64; UNKNOWNS]) -> Matrix3<f64> {
        let small = Vector3::from_column_slice(&value[ROTATION..ROTATION + 3]);
        (Rotation3::new(small) * self.rotation).into_inner()
    }

    /// The misfit under each bump at these unknowns, with its slopes.
    fn rows(&self, value: &[f64; UNKNOWNS]) -> Vec<Row<UNKNOWNS>> {
        let turn = self.turn(value);
        let own = Vector3::from_column_slice(&value[SCALE..SCALE + 3]);
        let map = turn * Matrix3::from_diagonal(&(own * value[COMMON]));
        let bias = Vector3::from_column_slice(&value[BIAS..BIAS + 3]);
        let correction = Correction { map, bias };
        let row = |(bump, measured): &(Bump, Vector3<f64>)| {
            let since = bump.centre - self.middle;
            let delay = value[DELAY] + value[DRIFT] * since;
            let expected = self.pair.expected(bump.shifted(-delay), delay, &correction)?;
            let mut slopes = SMatrix::<f64, 3, UNKNOWNS>::zeros();
            slopes.set_column(DELAY, &expected.by_delay);
            slopes.set_column(DRIFT, &(expected.by_delay * since));
            slopes.fixed_columns_mut::<3>(ROTATION).copy_from(&-expected.value.cross_matrix());
            slopes.fixed_columns_mut::<3>(BIAS).copy_from(&(map * expected.bias));
            for i in 0..3 {
                let along = turn.column(i) * (expected.unbiased[i] * value[COMMON]);
                slopes.set_column(SCALE + i, &along);
            }
            slopes.set_column(COMMON, &(turn * own.component_mul(&expected.unbiased)));
            let misfit = measured - expected.value;
            Some(Row { time: bump.centre, group: bump.group, measured: *measured, misfit, slopes })
        };
        self.measured.iter().filter_map(row).collect()
    }
}

impl ComparisonFit {
    /// Share of the motion that is left unexplained along the worse of the two axes that a rotation
    /// about each axis mixes.
    fn unexplained_across(&self) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let [a, b] = [(axis + 1) % 3, (axis + 2) % 3].map(|other| self.explained[other]);
            1.0 - a.min(b).clamp(0.0, 1.0)
        })
    }

    /// The rotation vector from the sensor's axes to the stream's, in the sensor's axes.
    fn rotation(&self, about: &Rotation3<f64>) -> [Option<Estimate>; 3] {
        let small = Vector3::from_column_slice(&self.fit.value[ROTATION..ROTATION + 3]);
        let turned = Rotation3::new(small) * about;
        // Through the quaternion, since a matrix loses its axis at half a turn.
        let vector = UnitQuaternion::from_rotation_matrix(&turned).inverse().scaled_axis();
        // The fit rotates the stream's axes; the answer is in the other sensor's axes.
        let there = |of: &SMatrix<f64, UNKNOWNS, UNKNOWNS>| {
            about.transpose() * of.fixed_view::<3, 3>(ROTATION, ROTATION) * about
        };
        let (covariance, unidentifiable) =
            (there(&self.fit.covariance), there(&self.fit.unidentifiable));
        std::array::from_fn(|axis| {
            let half_width = half_width(&covariance, &unidentifiable, axis)?;
            let estimate = Estimate::new(vector[axis], half_width);
            (estimate.half_width < ROTATION_HALF_WIDTH_MAX).then_some(estimate)
        })
    }
}
