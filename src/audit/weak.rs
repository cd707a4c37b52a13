//! Kinematics in weak form: compares a stream's derivative without differentiating it.
//!
//! For a bump phi that vanishes with its slope at both ends, `int phi dx/dt = -int phi' x`. The
//! left side is a weighted mean of the derivative, which another sensor measures. The right side
//! needs only the stream itself. Shifting the bump of one side in time tries a delay.

use std::ops::{Range, RangeInclusive};

use nalgebra::{DMatrix, DVector, SMatrix, SVector, SymmetricEigen};

use crate::log::import::Stream;

/// A bump `phi(t) = (1 - s^2)^3` with `s = (t - centre) / half`, 0 outside `|s| < 1`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bump {
    /// Time of its middle, s.
    pub centre: f64,
    /// Half width, s.
    pub half: f64,
    /// Index of its half width.
    pub group: usize,
}

impl Bump {
    fn value(self, time: f64) -> f64 {
        let s = (time - self.centre) / self.half;
        (1.0 - s * s).max(0.0).powi(3)
    }

    fn slope(self, time: f64) -> f64 {
        let s = (time - self.centre) / self.half;
        -6.0 * s * (1.0 - s * s).max(0.0).powi(2) / self.half
    }

    /// The bump, `by` seconds later.
    pub fn shifted(self, by: f64) -> Self {
        Self { centre: self.centre + by, ..self }
    }

    /// The integral of the bump over time, s.
    pub fn area(self) -> f64 {
        self.half * 32.0 / 35.0
    }
}

/// Integrals over time of a signal x, weighted by a bump phi and by its slope.
#[derive(Clone, Copy, Debug)]
pub(super) struct BumpIntegrals<const N: usize> {
    /// `int phi x`.
    pub value: SVector<f64, N>,
    /// `int phi' x`.
    pub slope: SVector<f64, N>,
}

/// Longest gap within a bump, relative to its half width: beyond, interpolation is a guess.
const GAP_MAX: f64 = 0.5;

/// Integrates a signal of the stream's samples, linear between them, under a bump. `signal` takes the
/// time (s) and the value of a sample. `None` if the samples do not cover the bump, if there is a gap
/// in it, or if a sample has no signal.
pub(super) fn integrate<V, const N: usize>(
    stream: &Stream<V>,
    bump: Bump,
    mut signal: impl FnMut(f64, &V) -> Option<SVector<f64, N>>,
) -> Option<BumpIntegrals<N>> {
    let (from, to) = (bump.centre - bump.half, bump.centre + bump.half);
    let mut at = stream.index_at(from)?;
    let times = stream.times();
    let mut integrals = BumpIntegrals { value: SVector::zeros(), slope: SVector::zeros() };
    let mut left = signal(times[at], &stream.values()[at])?;
    while times[at] < to {
        let (a, b) = (times[at], *times.get(at + 1)?);
        if b - a > GAP_MAX * bump.half {
            return None;
        }
        let right = signal(b, &stream.values()[at + 1])?;
        // Simpson's rule on the linear piece, within the bump: weights of both of its ends.
        let (start, end) = (a.max(from), b.min(to));
        let middle = 0.5 * (start + end);
        let (mut value, mut slope) = ([0.0; 2], [0.0; 2]);
        for (time, weight) in [(start, 1.0), (middle, 4.0), (end, 1.0)] {
            let share = weight * (end - start) / 6.0;
            let along = (time - a) / (b - a);
            for (end, part) in [1.0 - along, along].into_iter().enumerate() {
                value[end] += part * share * bump.value(time);
                slope[end] += part * share * bump.slope(time);
            }
        }
        integrals.value += left * value[0] + right * value[1];
        integrals.slope += left * slope[0] + right * slope[1];
        left = right;
        at += 1;
    }
    Some(integrals)
}

/// Bumps of each half width over the samples, in the order of their centres. Bumps of a width
/// overlap by half, and there are none in pauses without a sample.
pub(super) fn bumps(times: &[f64], halves: &[f64]) -> Vec<Bump> {
    let Some(start) = times.first() else { return Vec::new() };
    let mut bumps = Vec::new();
    for (group, half) in halves.iter().copied().enumerate() {
        let mut last = 0.0;
        for time in times {
            let number = ((time - start) / half).floor();
            if number > last {
                bumps.push(Bump { centre: start + number * half, half, group });
                last = number;
            }
        }
    }
    bumps.sort_by(|a, b| a.centre.total_cmp(&b.centre));
    bumps
}

/// The misfit under one bump, and its derivatives by the unknowns.
pub(super) struct Row<const P: usize> {
    /// Time of the bump's middle, s.
    pub time: f64,
    /// Index of the bump's half width.
    pub group: usize,
    /// The stream's derivative.
    pub measured: SVector<f64, 3>,
    /// The stream's derivative minus the expected one.
    pub misfit: SVector<f64, 3>,
    /// Derivatives of the expected value by the unknowns.
    pub slopes: SMatrix<f64, 3, P>,
}

/// Estimated unknowns with their covariance.
#[derive(Clone, Debug)]
pub(super) struct Fit<const P: usize> {
    /// The unknowns; where the rows do not show one, the value nearest to the start.
    pub value: [f64; P],
    /// Covariance in half widths of the interval: see [`interval`].
    pub covariance: SMatrix<f64, P, P>,
    /// Projection onto the directions that the rows do not show.
    pub unidentifiable: SMatrix<f64, P, P>,
    /// Explained share of the stream's motion.
    pub explained: f64,
    /// Weight of each row.
    pub weights: Vec<f64>,
}

impl<const P: usize> Fit<P> {
    /// Half width of an unknown's interval; `None` where the rows do not show it.
    pub fn half_width(&self, of: usize) -> Option<f64> {
        half_width(&self.covariance, &self.unidentifiable, of)
    }
}

/// Half width of the unknown with index `of`; `None` where it is unidentifiable.
pub(super) fn half_width<const P: usize>(
    covariance: &SMatrix<f64, P, P>,
    unidentifiable: &SMatrix<f64, P, P>,
    of: usize,
) -> Option<f64> {
    (unidentifiable[(of, of)] < UNIDENTIFIABLE_MAX).then(|| covariance[(of, of)].max(0.0).sqrt())
}

/// Range of the number of blocks of time that are left out in turn. Few blocks are long, so that
/// the misfits of one hardly correlate with the next.
pub(super) const BLOCKS: RangeInclusive<usize> = 4..=12;
/// Least length of a block, s: shorter ones correlate through the width of the bumps.
const BLOCK_S: f64 = 1.5;
/// Fewest rows of a fit.
const ROWS_MIN: usize = 24;
/// Multiple of the typical misfit beyond which misfits count linearly.
const HUBER: f64 = 2.5;
/// Iterations of Gauss-Newton.
const ITERATIONS: usize = 12;
/// A direction of the unknowns is unidentifiable if a significant step along it changes the
/// expected value by less than this share of the motion.
const IDENTIFIABLE_MIN: f64 = 1e-3;
/// An unknown is unidentifiable if more than this share of it is along unidentifiable directions.
const UNIDENTIFIABLE_MAX: f64 = 1e-3;
/// Most sweeps of a decomposition; ten are usual.
const SWEEPS: usize = 200;
/// Added to the Gram matrix without a block, against rounding.
const GRAM_RIDGE: f64 = 1e-9;
/// Number of half widths of bumps.
const GROUPS: usize = 2;

/// Half width of an interval in standard deviations over this many blocks: the interval contains the
/// value in at least 95 of 100 cases, and one three times as wide in 9998 of 10 000, by Student's t.
pub(super) fn interval(blocks: usize) -> f64 {
    /// For 4 blocks and more.
    const DEVIATIONS: [f64; 9] = [7.40, 4.34, 3.23, 2.67, 2.36, 2.31, 2.26, 2.23, 2.20];
    DEVIATIONS.get(blocks.saturating_sub(4)).copied().unwrap_or(2.20)
}

/// Time from the first to the last of ascending times, s.
pub(super) fn span_s(times: &[f64]) -> f64 {
    times.first().zip(times.last()).map_or(0.0, |(first, last)| last - first)
}

/// Blocks of `count` moments over `span` seconds, as ranges of their indices.
pub(super) fn blocks(span: f64, count: usize) -> Vec<Range<usize>> {
    let blocks = ((span / BLOCK_S) as usize).clamp(*BLOCKS.start(), *BLOCKS.end());
    let within = |part: usize| part * count / blocks;
    (0..blocks).map(|block| within(block)..within(block + 1)).collect()
}

/// Finds the unknowns by Gauss-Newton from `start`, along the directions that the rows show.
/// `sizes` are significant steps of the unknowns; 0 fixes one at its start. Outliers are weighted
/// down, and bumps of each half width are weighted by their typical misfit. The covariance comes
/// from the jackknife over blocks of time.
pub(super) fn fit<const P: usize>(
    start: [f64; P],
    sizes: [f64; P],
    rows: impl Fn(&[f64; P]) -> Vec<Row<P>>,
) -> Option<Fit<P>> {
    let mut value = start;
    let mut step_before = f64::INFINITY;
    for _ in 0..ITERATIONS {
        let normal = NormalEquations::of(&rows(&value))?;
        let step = normal.identifiable(&sizes)?.step(&normal);
        for (value, step) in value.iter_mut().zip(&step) {
            *value += step;
        }
        let size = step.norm();
        if !size.is_finite() {
            return None;
        }
        if size < 1e-9 || size >= step_before && size < 1e-6 {
            break;
        }
        step_before = size;
    }
    let rows = rows(&value);
    let normal = NormalEquations::of(&rows)?;
    let identifiable = normal.identifiable(&sizes)?;
    let covariance = identifiable.jackknife(&rows, &normal);
    let weights = normal.weights;
    let sum = |of: &dyn Fn(&Row<P>) -> f64| -> f64 {
        rows.iter().zip(&weights).map(|(row, w)| w * of(row)).sum()
    };
    let mean = rows.iter().zip(&weights).map(|(row, w)| row.measured * *w).sum::<SVector<f64, 3>>()
        / weights.iter().sum::<f64>();
    let total = sum(&|row| (row.measured - mean).norm_squared());
    let left = sum(&|row| row.misfit.norm_squared());
    Some(Fit {
        value,
        covariance,
        unidentifiable: identifiable.unidentifiable,
        explained: if total > 0.0 { 1.0 - left / total } else { 0.0 },
        weights,
    })
}

/// The normal equations `gram step = gradient` of rows with slopes J, misfit m and weight w, and the
/// weight of each row.
struct NormalEquations<const P: usize> {
    /// `sum w J^T J`.
    gram: SMatrix<f64, P, P>,
    /// `sum w J^T m`.
    gradient: SVector<f64, P>,
    /// Weighted power of the stream's derivative, `sum w |y|^2`.
    power: f64,
    weights: Vec<f64>,
}

impl<const P: usize> NormalEquations<P> {
    /// `None` if there are too few rows.
    fn of(rows: &[Row<P>]) -> Option<Self> {
        if rows.len() < ROWS_MIN {
            return None;
        }
        let typical: [f64; GROUPS] = std::array::from_fn(|group| {
            median(rows.iter().filter(|r| r.group == group).map(|r| r.misfit.norm()).collect())
        });
        let least =
            typical.iter().copied().filter(|size| *size > 0.0).fold(f64::INFINITY, f64::min);
        let weight = |row: &Row<P>| {
            let (size, typical) = (row.misfit.norm(), typical[row.group]);
            let own = if typical > 0.0 { (least / typical).powi(2) } else { 1.0 };
            if size > HUBER * typical { own * HUBER * typical / size } else { own }
        };
        let weights: Vec<f64> = rows.iter().map(weight).collect();
        let (mut gram, mut gradient, mut power) = (SMatrix::zeros(), SVector::zeros(), 0.0);
        for (row, weight) in rows.iter().zip(&weights) {
            gram += row.slopes.transpose() * row.slopes * *weight;
            gradient += row.slopes.transpose() * row.misfit * *weight;
            power += row.measured.norm_squared() * *weight;
        }
        Some(Self { gram, gradient, power, weights })
    }

    /// The directions that significant steps of these `sizes` show; `None` if nothing moves, or the
    /// numbers are not finite.
    fn identifiable(&self, sizes: &[f64; P]) -> Option<IdentifiableDirections<P>> {
        let sensitivity =
            DMatrix::from_fn(P, P, |i, j| self.gram[(i, j)] * sizes[i] * sizes[j] / self.power);
        if !sensitivity.iter().all(|value| value.is_finite()) {
            return None;
        }
        let SymmetricEigen { eigenvalues, eigenvectors } =
            SymmetricEigen::try_new(sensitivity, f64::EPSILON, SWEEPS)?;
        let (mut steps, mut unidentifiable) = (Vec::new(), SMatrix::zeros());
        for (value, vector) in eigenvalues.iter().zip(eigenvectors.column_iter()) {
            let direction = SVector::<f64, P>::from_fn(|i, _| vector[i]);
            if *value < IDENTIFIABLE_MIN * IDENTIFIABLE_MIN {
                unidentifiable += direction * direction.transpose();
            } else {
                let step = SVector::<f64, P>::from_fn(|i, _| direction[i] * sizes[i]);
                steps.push(step / (*value * self.power).sqrt());
            }
        }
        Some(IdentifiableDirections { steps, unidentifiable })
    }
}

/// The directions of the unknowns that the rows show, as steps in which the Gram matrix is the
/// identity, and the projection onto the rest.
struct IdentifiableDirections<const P: usize> {
    steps: Vec<SVector<f64, P>>,
    unidentifiable: SMatrix<f64, P, P>,
}

impl<const P: usize> IdentifiableDirections<P> {
    /// The least-squares step.
    fn step(&self, normal: &NormalEquations<P>) -> SVector<f64, P> {
        self.steps.iter().map(|step| step * step.dot(&normal.gradient)).sum()
    }

    /// Covariance in half widths of the interval, from the changes of the unknowns as each block of
    /// rows is left out.
    fn jackknife(&self, rows: &[Row<P>], normal: &NormalEquations<P>) -> SMatrix<f64, P, P> {
        let size = self.steps.len();
        let span = rows.first().zip(rows.last()).map_or(0.0, |(a, b)| b.time - a.time);
        let blocks = blocks(span, rows.len());
        let mut covariance = SMatrix::zeros();
        for range in &blocks {
            let mut gram = DMatrix::<f64>::identity(size, size);
            let mut score = DVector::<f64>::zeros(size);
            for (row, weight) in rows[range.clone()].iter().zip(&normal.weights[range.clone()]) {
                let slopes: Vec<SVector<f64, 3>> =
                    self.steps.iter().map(|step| row.slopes * step).collect();
                for (i, a) in slopes.iter().enumerate() {
                    score[i] += a.dot(&row.misfit) * weight;
                    for (j, b) in slopes.iter().enumerate() {
                        gram[(i, j)] -= a.dot(b) * weight;
                    }
                }
            }
            // Directions that only this block shows become singular without it, and their change is
            // unbounded.
            for i in 0..size {
                gram[(i, i)] += GRAM_RIDGE;
            }
            let Some(left) = gram.cholesky() else { return SMatrix::repeat(f64::INFINITY) };
            let change = left.solve(&score);
            let change: SVector<f64, P> =
                self.steps.iter().zip(change.iter()).map(|(step, change)| step * *change).sum();
            covariance += change * change.transpose();
        }
        let count = blocks.len();
        covariance * (interval(count).powi(2) * (count - 1) as f64 / count as f64)
    }
}

/// The median, or the upper of the middle two; 0 without a value.
pub fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(f: impl Fn(f64) -> f64) -> Stream<f64> {
        let mut stream = Stream::default();
        for k in 0..2000 {
            // Uneven, like the stamps of real loggers.
            let t = 0.01 * f64::from(k) + 0.003 * (f64::from(k) * 1.7).sin();
            stream.push(t, f(t));
        }
        stream
    }

    #[test]
    fn bump_function_gives_the_derivative_without_differentiation() {
        let (x, v) = (sampled(|t| (3.0 * t).sin()), sampled(|t| 3.0 * (3.0 * t).cos()));
        let of = |_, value: &f64| Some(SVector::<f64, 1>::new(*value));
        for bump in &bumps(x.times(), &[0.25])[1..70] {
            let measured = -integrate(&x, *bump, of).expect("samples").slope[0];
            let expected = integrate(&v, *bump, of).expect("samples").value[0];
            assert!((measured - expected).abs() < 1e-3, "{measured} {expected}");
        }
        let one = integrate(&sampled(|_| 1.0), Bump { centre: 5.0, half: 0.3, group: 0 }, of)
            .expect("samples");
        let area = Bump { centre: 0.0, half: 0.3, group: 0 }.area();
        assert!((one.value[0] - area).abs() < 1e-4 && one.slope[0].abs() < 1e-3);
    }

    #[test]
    fn long_pause_has_no_bump_functions() {
        let times = [0.0, 0.1, 0.2, 0.3, 1e12, 1e12 + 0.1, 1e12 + 0.4];
        assert!(bumps(&times, &[0.1]).len() < times.len());
    }

    #[test]
    fn bump_functions_do_not_span_gaps_or_ends() {
        let x = sampled(|t| t).filter_map(|t| (!(5.0..5.3).contains(t)).then_some(*t));
        let of = |_, value: &f64| Some(SVector::<f64, 1>::new(*value));
        assert!(integrate(&x, Bump { centre: 5.0, half: 0.25, group: 0 }, of).is_none());
        assert!(integrate(&x, Bump { centre: 0.1, half: 0.25, group: 0 }, of).is_none());
        assert!(integrate(&x, Bump { centre: 19.9, half: 0.25, group: 0 }, of).is_none());
        assert!(integrate(&x, Bump { centre: 8.0, half: 0.25, group: 0 }, of).is_some());
    }
}
