//! The evidence of each cause of change in a window of cells, for each possible onset.
//!
//! With e the whitened residual of every equation and P its whitened slopes, a change of size d in
//! directions D from cell k on gives e = P b + 1(cell >= k) P D d + noise. The parameters b are the
//! vehicle's before the change: all of them are free within their [sizes](super::columns::Sizes),
//! so a constant property that shows only now, because the vehicle moves, is no change. With normal
//! priors on b and d, this is a marginal likelihood in closed form. The noise's scale is known only
//! from the cause's past statistic, so Student's t replaces the normal density.

use std::collections::VecDeque;

use nalgebra::{Cholesky, DMatrix, DVector, SMatrix, SVector};

use super::cells::Cell;
use super::columns::*;
use super::noise::{Noise, ORDER};

/// Residuals of the earlier parameters beyond this many standard deviations get less weight: they
/// are jumps of the estimate. A change is not this large in one cell, or is detected anyway.
const HUBER: f64 = 6.0;
/// Relative accuracy of an estimated change: no law is exact.
const LAW: f64 = 0.03;
/// Beyond these numbers of cells after an onset, only every second place is evaluated, then every
/// fourth.
const COARSE: [usize; 2] = [60, 120];
/// Time unit of a drift, s.
const DRIFT_S: f64 = 10.0;

type Matrix = SMatrix<f64, COLUMNS, COLUMNS>;
type Vector = SVector<f64, COLUMNS>;

/// Contribution of a whitened cell to the normal equations.
#[derive(Clone, Debug)]
pub struct Terms {
    gram: Box<Matrix>,
    moment: Vector,
}

/// The cells of a window as normal equations.
#[derive(Clone, Debug, Default)]
pub struct Window {
    terms: VecDeque<Terms>,
    /// Time at which drifts are zero, s.
    zero_s: f64,
}

/// The onsets at which the evidence is evaluated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grid {
    /// Every cell.
    Full,
    /// Fewer cells, the farther back they are.
    Thinned,
}

/// A cause's evidence as a function of its onset.
#[derive(Clone, Debug)]
pub struct Profile {
    /// The cause.
    pub cause: Cause,
    /// Candidate onsets, by cells from the window's start.
    pub places: Vec<Place>,
}

/// A cause with its onset at a cell.
#[derive(Clone, Debug)]
pub struct Place {
    /// Number of cells before it in the window.
    pub cell: usize,
    /// Log Bayes factor of the change against none, nats.
    pub evidence: f64,
    /// The same for a known noise scale: it compares onsets with each other.
    pub sharp: f64,
    /// s' V^-1 s over the number of directions: 1 on average without a change, if the noise is
    /// white and the model correct.
    pub statistic: f64,
}

/// A change along one direction, in its unit.
#[derive(Clone, Copy, Debug)]
pub struct DirectionChange {
    /// The direction, as an index into [`DIRECTIONS`].
    pub direction: usize,
    /// Value before, with its standard deviation; likewise `after` and `change`.
    pub before: [f64; 2],
    /// Value after.
    pub after: [f64; 2],
    /// After minus before.
    pub change: [f64; 2],
}

/// Excess of each cause's past statistic over its expectation, and the number of looks behind it.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    /// Factor on the noise's variance, at least 1.
    pub variance: f64,
    /// Number of looks, as degrees of freedom.
    pub looks: f64,
}

impl Window {
    /// Whitens the cells with `noise`; the first [`ORDER`] of them only serve as history. `parameters`
    /// are the vehicle's earlier ones.
    pub fn of(cells: &VecDeque<Cell>, noise: &Noise, parameters: &[f64; COLUMNS]) -> Self {
        let zero_s = cells.front().map_or(0.0, |cell| cell.time);
        let mut window = Self { terms: VecDeque::with_capacity(cells.len() + 1), zero_s };
        for index in ORDER..cells.len() {
            window.push(cells, index, noise, parameters);
        }
        window
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.terms.len()
    }

    /// Whether there are no cells.
    pub fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// Drops the first cell.
    pub fn forget(&mut self) {
        self.terms.pop_front();
    }

    /// Adds cell `index`, whitened with those before it.
    pub fn push(
        &mut self,
        cells: &VecDeque<Cell>,
        index: usize,
        noise: &Noise,
        parameters: &[f64; COLUMNS],
    ) {
        let mut gram = Box::new(Matrix::zeros());
        let mut moment = Vector::zeros();
        for (equation, filter) in noise.filters.iter().enumerate() {
            let Some(filter) = filter else { continue };
            let now = &cells[index].rows[equation];
            let (mut residual, mut model) = (now.residual, now.model);
            let mut slopes = now.slopes;
            let late = (cells[index].time - self.zero_s) / DRIFT_S;
            for (j, coefficient) in filter.coefficients.iter().enumerate() {
                let before = &cells[index - 1 - j].rows[equation];
                residual -= coefficient * before.residual;
                model -= coefficient * before.model;
                for (slope, before) in slopes[..DRIFT].iter_mut().zip(&before.slopes) {
                    *slope -= coefficient * before;
                }
            }
            if !residual.is_finite() {
                continue;
            }
            // A drift hardly changes over the filter's history.
            for (place, of) in DRIFTING.into_iter().enumerate() {
                let slope = if place == 0 { slopes[..CENTRE].iter().sum() } else { slopes[of] };
                slopes[DRIFT + place] = 0.1 * late * slope;
            }
            let variance = filter.variance + noise.law[equation] * model * model;
            let known = slopes[..DRIFT].iter().zip(parameters).map(|(slope, value)| slope * value);
            let far = (residual - known.sum::<f64>()).abs() / variance.sqrt();
            let weight = if far > HUBER { HUBER / far } else { 1.0 } / variance;
            let used: Vec<usize> = (0..COLUMNS).filter(|c| slopes[*c] != 0.0).collect();
            for &a in &used {
                let weighted = weight * slopes[a];
                moment[a] += weighted * residual;
                for &b in used.iter().take_while(|b| **b <= a) {
                    gram[(a, b)] += weighted * slopes[b];
                }
            }
        }
        gram.fill_upper_triangle_with_lower_triangle();
        self.terms.push_back(Terms { gram, moment });
    }

    /// Each cause's evidence as a function of its onset, from `after[0]` to `after[1]` cells before
    /// the end.
    pub fn profiles(
        &self,
        after: [usize; 2],
        scales: &[Scale; Cause::ALL.len()],
        grid: Grid,
    ) -> Vec<Profile> {
        let mut profiles: Vec<Profile> =
            Cause::ALL.into_iter().map(|cause| Profile { cause, places: Vec::new() }).collect();
        let Some(fit) = self.fit() else { return profiles };
        let (mut gram, mut moment) = (Matrix::zeros(), Vector::zeros());
        for (count, terms) in self.terms.iter().rev().enumerate().map(|(n, t)| (n + 1, t)) {
            if count > after[1] {
                break;
            }
            gram += terms.gram.as_ref();
            moment += terms.moment;
            let far = COARSE.iter().filter(|coarse| count > **coarse).count();
            let is_evaluated = grid == Grid::Full || count % (1 << far) == 0;
            if count < after[0] || !is_evaluated {
                continue;
            }
            let tail = Tail::of(&gram, &moment, &fit);
            let cell = self.terms.len() - count;
            for (profile, scale) in profiles.iter_mut().zip(scales) {
                profile.places.extend(tail.place(profile.cause, *scale, cell));
            }
        }
        profiles
    }

    /// A cause's change with its onset at `cell`, along each of its directions; `scale` widens the
    /// standard deviations.
    pub fn changes(&self, cause: Cause, cell: usize, scale: Scale) -> Option<Vec<DirectionChange>> {
        let fit = self.fit()?;
        let (mut gram, mut moment) = (Matrix::zeros(), Vector::zeros());
        for terms in self.terms.iter().skip(cell) {
            gram += terms.gram.as_ref();
            moment += terms.moment;
        }
        let tail = Tail::of(&gram, &moment, &fit);
        let directions = cause.directions();
        let inner =
            tail.information(directions) + DMatrix::identity(directions.len(), directions.len());
        let covariance = Cholesky::new(inner)?.inverse();
        let change = &covariance * tail.score(directions);
        let spread = scale.variance;
        let mut before = fit.mean;
        for (place, direction) in directions.iter().enumerate() {
            before -= tail.solved[*direction] * change[place];
        }
        let changes = directions.iter().enumerate().map(|(place, &direction)| {
            let axis = axis(direction);
            let value = axis.dot(&before);
            // Covariance of the parameters before: (A^-1) + (A^-1 U) C (A^-1 U)'; with the change:
            // -(A^-1 U) C.
            let onto = DVector::from_iterator(
                directions.len(),
                directions.iter().map(|other| axis.dot(&tail.solved[*other])),
            );
            let own = (axis.transpose() * fit.covariance * axis)[0];
            let own = own + (onto.transpose() * &covariance * &onto)[0];
            let law = (LAW * change[place]).powi(2) / spread;
            let change_variance = covariance[(place, place)] + law;
            let both = -(covariance.row(place) * &onto)[0];
            let deviation = |variance: f64| (spread * variance.max(0.0)).sqrt();
            DirectionChange {
                direction,
                before: [value, deviation(own)],
                after: [value + change[place], deviation(own + change_variance + 2.0 * both)],
                change: [change[place], deviation(change_variance)],
            }
        });
        Some(changes.collect())
    }

    /// The present parameters if nothing changed in the window, in their sizes.
    pub fn parameters(&self) -> Option<[f64; COLUMNS]> {
        Some(self.fit()?.mean.into())
    }

    /// The same along each direction, with its standard deviation.
    pub fn along_directions(&self) -> Option<[[f64; 2]; DIRECTIONS.len()]> {
        let Fit { mean, covariance } = self.fit()?;
        Some(std::array::from_fn(|direction| {
            let axis = axis(direction);
            [axis.dot(&mean), (axis.transpose() * covariance * axis)[0].max(0.0).sqrt()]
        }))
    }

    /// The parameters without a change.
    fn fit(&self) -> Option<Fit> {
        let mut gram = Matrix::identity();
        for terms in &self.terms {
            gram += terms.gram.as_ref();
        }
        let covariance = Cholesky::new(gram)?.inverse();
        let moment: Vector = self.terms.iter().map(|terms| terms.moment).sum();
        Some(Fit { mean: covariance * moment, covariance })
    }
}

/// Sum of the columns along a direction.
pub(super) fn along(columns: &[f64; COLUMNS], direction: usize) -> f64 {
    match DIRECTIONS[direction] {
        Direction::Thrust => columns[ROTOR..CENTRE].iter().sum(),
        Direction::Column(column) => columns[column],
    }
}

/// The vector that extracts a direction's value from the columns: the thrust's is the mean of the
/// rotors.
fn axis(direction: usize) -> Vector {
    let mut axis = Vector::zeros();
    match DIRECTIONS[direction] {
        Direction::Thrust => axis.rows_mut(ROTOR, 4).fill(0.25),
        Direction::Column(column) => axis[column] = 1.0,
    }
    axis
}

/// Posterior mean and covariance of the parameters.
struct Fit {
    mean: Vector,
    /// A^-1.
    covariance: Matrix,
}

/// The cells from one on, projected on each direction.
struct Tail {
    /// d' G d of every pair.
    own: SMatrix<f64, { DIRECTIONS.len() }, { DIRECTIONS.len() }>,
    /// d' b - (G d)' A^-1 B.
    score: [f64; DIRECTIONS.len()],
    /// G d.
    seen: [Vector; DIRECTIONS.len()],
    /// A^-1 G d.
    solved: [Vector; DIRECTIONS.len()],
}

impl Tail {
    fn of(gram: &Matrix, moment: &Vector, fit: &Fit) -> Self {
        let along = |vector: &Vector, direction: usize| along(&vector.data.0[0], direction);
        let seen: [Vector; DIRECTIONS.len()] =
            std::array::from_fn(|direction| match DIRECTIONS[direction] {
                Direction::Thrust => (ROTOR..CENTRE).map(|c| gram.column(c).into_owned()).sum(),
                Direction::Column(column) => gram.column(column).into(),
            });
        let solved = seen.map(|seen| fit.covariance * seen);
        let score = std::array::from_fn(|direction| {
            along(moment, direction) - seen[direction].dot(&fit.mean)
        });
        let own = SMatrix::from_fn(|a, b| along(&seen[a], b));
        Self { own, score, seen, solved }
    }

    fn information(&self, directions: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(directions.len(), directions.len(), |i, j| {
            let (a, b) = (directions[i], directions[j]);
            self.own[(a, b)] - self.seen[a].dot(&self.solved[b])
        })
    }

    fn score(&self, directions: &[usize]) -> DVector<f64> {
        DVector::from_iterator(directions.len(), directions.iter().map(|d| self.score[*d]))
    }

    /// The evidence for a change of normal size, with information V over the noise's scale k: ln
    /// det(1 + V) / -2, plus Student's logarithm in place of s' (1 + V)^-1 s / 2.
    fn place(&self, cause: Cause, scale: Scale, cell: usize) -> Option<Place> {
        let directions = cause.directions();
        let count = directions.len() as f64;
        let (score, information) = (self.score(directions), self.information(directions));
        let jitter = DMatrix::identity(directions.len(), directions.len());
        let sharp = Cholesky::new(&information + &jitter * 1e-9)?;
        let statistic = score.dot(&sharp.solve(&score)) / count;
        let (score, information) = (score / scale.variance, information / scale.variance);
        let inner = Cholesky::new(information + jitter)?;
        let gained = score.dot(&inner.solve(&score));
        let log_det: f64 = inner.l_dirty().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
        let freedom = scale.looks;
        let sharp = 0.5 * gained - 0.5 * log_det;
        let gained = 0.5 * (freedom + count) * (gained / freedom).ln_1p();
        Some(Place { cell, evidence: gained - 0.5 * log_det, sharp, statistic })
    }
}
