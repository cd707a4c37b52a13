//! Fits of hypotheses to flights: maximum a posteriori with the noise's spectrum unknown.
//!
//! The coefficients of a channel within a band are taken as Gaussian with a common variance that
//! is not known and profiled out, so that the cost is `sum n/2 ln(Q/n)` over channels and bands,
//! Q the sum of squares that is left, plus the priors. Its minimum is found by Gauss-Newton steps
//! whose weights n/Q are iterated to a fixed point. The evidence is Laplace's approximation: the
//! cost of a number is the ratio of its prior's width to its posterior's.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::hypothesis::{Catalogue, Values};
use super::preparation::PreparedFlight;
use super::residuals::{CHANNELS, Evaluator, Groups, Layout, Place};
use super::spectrum::BANDS;

/// Rounds of weights in a solve.
const WEIGHT_ROUNDS: usize = 40;
/// A fit ends when a step lowers the cost by less.
const COST_STEP_MIN: f64 = 0.02;
const STEPS_MAX: usize = 12;
/// Starts that are followed to their end, of those that cost least.
const STARTS_MAX: usize = 2;

/// Flights with what is looked at in them.
#[derive(Debug)]
pub struct Observed<'a> {
    /// The flights.
    pub flights: &'a [PreparedFlight],
    /// What is looked at, for each.
    pub layouts: Vec<Layout>,
    evaluator: &'a Evaluator,
    catalogue: &'a Catalogue,
    /// Runs of coefficients of one place: flight, place, start, end.
    runs: Vec<Run>,
    counts: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Run {
    flight: usize,
    block: usize,
    place: usize,
    start: usize,
    end: usize,
}

/// Residuals of every flight.
pub type Residuals = Vec<Vec<f64>>;

impl<'a> Observed<'a> {
    /// Looks at flights.
    pub fn new(
        flights: &'a [PreparedFlight],
        evaluator: &'a Evaluator,
        catalogue: &'a Catalogue,
    ) -> Self {
        let layouts: Vec<Layout> = flights.iter().map(Layout::new).collect();
        let mut runs: Vec<Run> = Vec::new();
        let mut counts = vec![0.0; Place::COUNT];
        for (flight, layout) in layouts.iter().enumerate() {
            for (block, ends) in layout.blocks.windows(2).enumerate() {
                let mut start = ends[0];
                while start < ends[1] {
                    let place = layout.places[start].index();
                    let mut end = start + 1;
                    while end < ends[1] && layout.places[end].index() == place {
                        end += 1;
                    }
                    counts[place] += (end - start) as f64;
                    runs.push(Run { flight, block, place, start, end });
                    start = end;
                }
            }
        }
        Self { flights, layouts, evaluator, catalogue, runs, counts }
    }

    /// Number of coefficients at each place.
    pub fn counts(&self) -> &[f64] {
        &self.counts
    }

    /// What `values` leave unexplained; `None` for a vehicle that the physics refuses.
    pub fn residuals(&self, values: &[f64]) -> Option<Residuals> {
        self.residuals_in(values, Groups::ALL)
    }

    fn residuals_in(&self, values: &[f64], groups: Groups) -> Option<Residuals> {
        let candidate = self.catalogue.candidate(values).ok()?;
        Some(
            self.flights
                .par_iter()
                .zip(&self.layouts)
                .map(|(flight, layout)| {
                    self.evaluator.residuals(flight, layout, &candidate, groups)
                })
                .collect(),
        )
    }

    /// Sum of squares at each place.
    pub fn power(&self, residuals: &Residuals) -> Vec<f64> {
        let mut power = vec![0.0; Place::COUNT];
        for run in &self.runs {
            let part = &residuals[run.flight][run.start..run.end];
            power[run.place] += part.iter().map(|r| r * r).sum::<f64>();
        }
        power
    }

    /// Log density of each block in nats, without constants, under noise whose spectrum has the
    /// shape of `noise` in every channel and whose strength in the block is not known: a flight
    /// held out may be rougher than the fitted ones, and a bump does not decide.
    pub fn log_density(&self, residuals: &Residuals, noise: &[f64]) -> Vec<f64> {
        let mut first = 0;
        let mut density = Vec::new();
        // Of each channel in a block: number, sum of squares in units of the noise.
        let mut sums = [[0.0; 2]; CHANNELS];
        let strength = |sums: &mut [[f64; 2]; CHANNELS]| -> f64 {
            std::mem::take(sums)
                .iter()
                .filter(|[n, _]| *n > 0.0)
                .map(|[n, q]| 0.5 * n * (q / n).max(f64::MIN_POSITIVE).ln())
                .sum()
        };
        for (index, run) in self.runs.iter().enumerate() {
            if index == 0
                || (run.flight, run.block) != (self.runs[first].flight, self.runs[first].block)
            {
                if let Some(last) = density.last_mut() {
                    *last -= strength(&mut sums);
                }
                density.push(0.0);
                first = index;
            }
            let variance = noise[run.place];
            if variance <= 0.0 {
                continue;
            }
            let part = &residuals[run.flight][run.start..run.end];
            let n = (run.end - run.start) as f64;
            let [count, square] = &mut sums[run.place / BANDS.len()];
            *count += n;
            *square += part.iter().map(|r| r * r).sum::<f64>() / variance;
            if let Some(last) = density.last_mut() {
                *last -= 0.5 * n * variance.ln();
            }
        }
        if let Some(last) = density.last_mut() {
            *last -= strength(&mut sums);
        }
        density
    }

    /// Derivatives of the residuals with respect to one number at `values`, where they are
    /// `base`.
    pub fn column(&self, values: &[f64], base: &Residuals, number: usize) -> Option<Residuals> {
        let described = &self.catalogue.numbers[number];
        let step = described.step(values[number]);
        let groups = Groups::of(described.target);
        let moved = |by: f64| {
            let mut moved = values.to_vec();
            moved[number] += by;
            self.residuals_in(&moved, groups)
        };
        let up = values[number] + 2.0 * step <= described.bounds[1];
        let sign = if up { 1.0 } else { -1.0 };
        // An effect that is on where it was off may replace another: both points have it on.
        let switches = values[number] == described.reference
            && self.catalogue.vehicle.linear_drag_n_per_m_s.is_some();
        let (near, far) = if switches {
            (moved(sign * step)?, moved(2.0 * sign * step)?)
        } else {
            (base.clone(), moved(sign * step)?)
        };
        let scale = sign / step;
        let column = near
            .iter()
            .zip(&far)
            .zip(&self.layouts)
            .map(|((a, b), layout)| {
                let difference = a.iter().zip(b).zip(&layout.places);
                difference
                    .map(
                        |((a, b), place)| {
                            if groups.has(place.channel()) { (b - a) * scale } else { 0.0 }
                        },
                    )
                    .collect()
            })
            .collect();
        Some(column)
    }

    fn dot(&self, a: &Residuals, b: &Residuals) -> Vec<f64> {
        let mut sums = vec![0.0; Place::COUNT];
        for run in &self.runs {
            let (a, b) = (&a[run.flight][run.start..run.end], &b[run.flight][run.start..run.end]);
            sums[run.place] += a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        }
        sums
    }
}

/// The residuals about a point as linear in some numbers, by their products at each place.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// The point.
    pub values: Values,
    /// The numbers.
    pub numbers: Vec<usize>,
    /// Derivatives of the residuals by each of them.
    pub columns: Vec<Residuals>,
    /// Products of the columns: upper triangle, row by row, of each place.
    gram: Vec<Vec<f64>>,
    /// Products of the columns with the residuals, at each place.
    cross: Vec<Vec<f64>>,
    /// Squares of the residuals at each place.
    square: Vec<f64>,
}

fn triangle(i: usize, j: usize, n: usize) -> usize {
    let (i, j) = if i <= j { (i, j) } else { (j, i) };
    i * n - i * (i + 1) / 2 + j
}

impl Linearised {
    /// About `values`, in `numbers`; those without a derivative are left out.
    pub fn new(observed: &Observed<'_>, values: &[f64], numbers: &[usize]) -> Option<Self> {
        let base = observed.residuals(values)?;
        let columns: Vec<(usize, Residuals)> = numbers
            .par_iter()
            .filter_map(|n| Some((*n, observed.column(values, &base, *n)?)))
            .collect();
        let (numbers, columns): (Vec<_>, Vec<_>) = columns.into_iter().unzip();
        Some(Self::from_columns(observed, values, &base, numbers, columns))
    }

    fn from_columns(
        observed: &Observed<'_>,
        values: &[f64],
        base: &Residuals,
        numbers: Vec<usize>,
        columns: Vec<Residuals>,
    ) -> Self {
        let n = numbers.len();
        let pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (i..n).map(move |j| (i, j))).collect();
        let products: Vec<Vec<f64>> =
            pairs.par_iter().map(|(i, j)| observed.dot(&columns[*i], &columns[*j])).collect();
        let gram = (0..Place::COUNT)
            .map(|place| products.iter().map(|product| product[place]).collect())
            .collect();
        let mut linearised = Self {
            values: values.to_vec(),
            numbers,
            columns,
            gram,
            cross: Vec::new(),
            square: Vec::new(),
        };
        linearised.rest_on(observed, base);
        linearised
    }

    /// The same derivatives about other residuals.
    pub fn rest_on(&mut self, observed: &Observed<'_>, base: &Residuals) {
        let crosses: Vec<Vec<f64>> =
            self.columns.par_iter().map(|column| observed.dot(column, base)).collect();
        self.cross = (0..Place::COUNT)
            .map(|place| crosses.iter().map(|cross| cross[place]).collect())
            .collect();
        self.square = observed.power(base);
    }

    /// The part with fewer numbers (those of `keep` that it has), extended by the columns of
    /// others.
    fn with(
        &self,
        observed: &Observed<'_>,
        values: &[f64],
        base: &Residuals,
        keep: &[usize],
        fresh: Vec<(usize, Residuals)>,
    ) -> Self {
        let kept: Vec<usize> = (0..self.numbers.len())
            .filter(|i| {
                keep.contains(&self.numbers[*i])
                    && fresh.iter().all(|(n, _)| *n != self.numbers[*i])
            })
            .collect();
        let mut numbers: Vec<usize> = kept.iter().map(|i| self.numbers[*i]).collect();
        let old = numbers.len();
        let mut columns: Vec<&Residuals> = kept.iter().map(|i| &self.columns[*i]).collect();
        numbers.extend(fresh.iter().map(|(n, _)| *n));
        columns.extend(fresh.iter().map(|(_, column)| column));
        let n = numbers.len();
        let pairs: Vec<(usize, usize)> = (0..n).flat_map(|i| (i..n).map(move |j| (i, j))).collect();
        let products: Vec<Option<Vec<f64>>> = pairs
            .par_iter()
            .map(|(i, j)| (*j >= old).then(|| observed.dot(columns[*i], columns[*j])))
            .collect();
        let gram = (0..Place::COUNT)
            .map(|place| {
                pairs
                    .iter()
                    .zip(&products)
                    .map(|((i, j), product)| match product {
                        Some(product) => product[place],
                        None => self.gram[place][triangle(kept[*i], kept[*j], self.numbers.len())],
                    })
                    .collect()
            })
            .collect();
        let crosses: Vec<Vec<f64>> =
            columns.par_iter().map(|column| observed.dot(column, base)).collect();
        let cross = (0..Place::COUNT)
            .map(|place| crosses.iter().map(|cross| cross[place]).collect())
            .collect();
        let square = observed.power(base);
        Self { values: values.to_vec(), numbers, columns: Vec::new(), gram, cross, square }
    }

    /// The least cost over `active` numbers, held by their wide priors, and all others with a
    /// tolerance.
    pub fn solve(
        &self,
        catalogue: &Catalogue,
        counts: &[f64],
        active: &[usize],
    ) -> Option<Solution> {
        let used: Vec<usize> = (0..self.numbers.len())
            .filter(|i| {
                let number = self.numbers[*i];
                active.contains(&number) || catalogue.numbers[number].tolerance > 0.0
            })
            .collect();
        let n = used.len();
        let total = self.numbers.len();
        let mut prior = DVector::zeros(n);
        let mut off = DVector::zeros(n);
        for (row, i) in used.iter().enumerate() {
            let number = &catalogue.numbers[self.numbers[*i]];
            let width = if active.contains(&self.numbers[*i]) {
                number.magnitude
            } else {
                number.tolerance
            };
            prior[row] = width.powi(-2);
            off[row] = self.values[self.numbers[*i]] - number.reference;
        }
        let places: Vec<usize> = (0..Place::COUNT).filter(|p| counts[*p] > 0.0).collect();
        let power = |delta: &DVector<f64>| -> Vec<f64> {
            let mut power = vec![0.0; Place::COUNT];
            for place in &places {
                let (gram, cross) = (&self.gram[*place], &self.cross[*place]);
                let mut q = self.square[*place];
                for (a, i) in used.iter().enumerate() {
                    let d = delta[a];
                    if d == 0.0 {
                        continue;
                    }
                    let mut row = 0.0;
                    for (b, j) in used.iter().enumerate() {
                        row += gram[triangle(*i, *j, total)] * delta[b];
                    }
                    q += d * (2.0 * cross[*i] + row);
                }
                power[*place] = q.max(1e-9 * self.square[*place]).max(f64::MIN_POSITIVE);
            }
            power
        };
        let cost_of = |power: &[f64], delta: &DVector<f64>| {
            let noise = noise_cost(power, counts);
            let pulled: f64 = (0..n).map(|i| prior[i] * (off[i] + delta[i]).powi(2)).sum();
            noise + 0.5 * pulled
        };
        let limits: Vec<[f64; 2]> = used
            .iter()
            .map(|i| {
                let number = self.numbers[*i];
                let value = self.values[number];
                catalogue.limits(number, active).map(|limit| limit - value)
            })
            .collect();
        let mut delta = DVector::from_fn(n, |i, _| 0.0_f64.clamp(limits[i][0], limits[i][1]));
        let mut current = power(&delta);
        let mut cost = cost_of(&current, &delta);
        let mut factor = None;
        let mut held = vec![false; n];
        for _ in 0..WEIGHT_ROUNDS {
            let mut normal = DMatrix::from_diagonal(&prior);
            let mut gradient = DVector::from_fn(n, |i, _| prior[i] * off[i]);
            for place in &places {
                let weight = counts[*place] / current[*place];
                let (gram, cross) = (&self.gram[*place], &self.cross[*place]);
                for (a, i) in used.iter().enumerate() {
                    gradient[a] += weight * cross[*i];
                    for (b, j) in used.iter().enumerate().skip(a) {
                        normal[(a, b)] += weight * gram[triangle(*i, *j, total)];
                    }
                }
            }
            for a in 0..n {
                for b in 0..a {
                    normal[(a, b)] = normal[(b, a)];
                }
            }
            factor = Some(scaled_cholesky(&normal)?);
            let target = bounded_minimum(&normal, &gradient, &limits, &mut held)?;
            // Halved until the cost falls: far from the fixed point the weights may overshoot.
            let mut share = 1.0;
            let mut moved = false;
            while share > 1e-3 {
                let trial = &delta + (&target - &delta) * share;
                let there = power(&trial);
                let new = cost_of(&there, &trial);
                if new < cost {
                    moved = cost - new > 1e-3 * COST_STEP_MIN;
                    (delta, current, cost) = (trial, there, new);
                    break;
                }
                share *= 0.5;
            }
            if !moved {
                break;
            }
        }
        let factor = factor?;
        let evidence = -cost + 0.5 * prior.iter().map(|p| p.ln()).sum::<f64>()
            - 0.5 * factor.log_determinant();
        let mut values = self.values.clone();
        let mut deviation = vec![0.0; catalogue.numbers.len()];
        let covariance = factor.inverse();
        for (a, i) in used.iter().enumerate() {
            let number = self.numbers[*i];
            values[number] += delta[a];
            deviation[number] = covariance[(a, a)].max(0.0).sqrt();
        }
        Some(Solution { values, deviation, cost, evidence, power: current })
    }
}

/// Cost of sums of squares, in nats.
fn noise_cost(power: &[f64], counts: &[f64]) -> f64 {
    power
        .iter()
        .zip(counts)
        .filter(|(_, n)| **n > 0.0)
        .map(|(q, n)| 0.5 * n * (q.max(f64::MIN_POSITIVE) / n).ln())
        .sum()
}

/// The minimum of a quadratic within limits: numbers that would leave theirs are held there.
/// `held` carries over which.
fn bounded_minimum(
    normal: &DMatrix<f64>,
    gradient: &DVector<f64>,
    limits: &[[f64; 2]],
    held: &mut [bool],
) -> Option<DVector<f64>> {
    let n = gradient.len();
    held.fill(false);
    let mut at = DVector::zeros(n);
    for _ in 0..n {
        let free: Vec<usize> = (0..n).filter(|i| !held[*i]).collect();
        let matrix = DMatrix::from_fn(free.len(), free.len(), |a, b| normal[(free[a], free[b])]);
        let right = DVector::from_fn(free.len(), |a, _| {
            let i = free[a];
            let fixed: f64 = (0..n).filter(|j| held[*j]).map(|j| normal[(i, j)] * at[j]).sum();
            -gradient[i] - fixed
        });
        let solution = scaled_cholesky(&matrix)?.solve(&right);
        let mut left = false;
        for (a, i) in free.iter().enumerate() {
            let [low, high] = limits[*i];
            at[*i] = solution[a].clamp(low, high);
            if solution[a] < low || solution[a] > high {
                held[*i] = true;
                left = true;
            }
        }
        if !left {
            break;
        }
    }
    Some(at)
}

/// A Cholesky factor of a matrix scaled to a unit diagonal.
struct ScaledCholesky {
    factor: nalgebra::Cholesky<f64, nalgebra::Dyn>,
    scale: DVector<f64>,
}

fn scaled_cholesky(matrix: &DMatrix<f64>) -> Option<ScaledCholesky> {
    let scale = matrix.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
    let scaled = DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] * scale[i] * scale[j] + if i == j { 1e-12 } else { 0.0 }
    });
    Some(ScaledCholesky { factor: scaled.cholesky()?, scale })
}

impl ScaledCholesky {
    fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        self.factor.solve(&right.component_mul(&self.scale)).component_mul(&self.scale)
    }

    fn inverse(&self) -> DMatrix<f64> {
        let inverse = self.factor.inverse();
        DMatrix::from_fn(inverse.nrows(), inverse.ncols(), |i, j| {
            inverse[(i, j)] * self.scale[i] * self.scale[j]
        })
    }

    fn log_determinant(&self) -> f64 {
        let l = self.factor.l_dirty();
        (0..self.scale.len()).map(|i| 2.0 * (l[(i, i)].ln() - self.scale[i].ln())).sum()
    }
}

/// The minimum of a linearised cost.
#[derive(Clone, Debug)]
pub struct Solution {
    /// All numbers there.
    pub values: Values,
    /// Standard deviations of those that were free.
    pub deviation: Vec<f64>,
    /// Cost, nats.
    pub cost: f64,
    /// Log evidence.
    pub evidence: f64,
    /// Sum of squares left at each place.
    pub power: Vec<f64>,
}

/// A hypothesis, or several, fitted without linearisation.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Indices of the catalogue's hypotheses.
    pub hypotheses: Vec<usize>,
    /// All numbers.
    pub values: Values,
    /// Standard deviations of those that were free.
    pub deviation: Vec<f64>,
    /// Log evidence.
    pub evidence: f64,
    /// Cost, nats.
    pub cost: f64,
    /// Sum of squares left at each place.
    pub power: Vec<f64>,
}

impl Fit {
    /// Variance of the noise at each place; 0 where nothing is looked at.
    pub fn noise(&self, counts: &[f64]) -> Vec<f64> {
        self.power.iter().zip(counts).map(|(q, n)| if *n > 0.0 { q / n } else { 0.0 }).collect()
    }
}

/// The cost at given numbers, and the residuals.
fn cost_at(observed: &Observed<'_>, values: &[f64], active: &[usize]) -> Option<(f64, Residuals)> {
    let residuals = observed.residuals(values)?;
    let noise = noise_cost(&observed.power(&residuals), &observed.counts);
    let catalogue = observed.catalogue;
    let pulled: f64 = catalogue
        .numbers
        .iter()
        .enumerate()
        .map(|(i, number)| {
            let width = if active.contains(&i) { number.magnitude } else { number.tolerance };
            let off = values[i] - number.reference;
            if off == 0.0 { 0.0 } else { (off / width).powi(2) }
        })
        .sum();
    Some((noise + 0.5 * pulled, residuals))
}

/// Fits the given hypotheses together. `about` has the nuisances' derivatives and the values to
/// start from; `starts` are further values of the active numbers to start from.
pub fn fit(
    observed: &Observed<'_>,
    about: &Linearised,
    hypotheses: &[usize],
    starts: &[Vec<(usize, f64)>],
) -> Option<Fit> {
    let catalogue = observed.catalogue;
    let active: Vec<usize> =
        hypotheses.iter().flat_map(|h| catalogue.hypotheses[*h].numbers.iter().copied()).collect();
    let nuisances: Vec<usize> =
        catalogue.nuisances().filter(|number| !active.contains(number)).collect();
    let own: Vec<(usize, f64)> = Vec::new();
    let at_hand = starts.is_empty().then_some(&own);
    let mut begun: Vec<Begun> = at_hand
        .into_iter()
        .chain(starts)
        .filter_map(|start| {
            let mut values = about.values.clone();
            for (number, value) in start {
                values[*number] = *value;
            }
            let (cost, residuals) = cost_at(observed, &values, &active)?;
            Some(Begun { cost, values, residuals })
        })
        .collect();
    begun.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    begun.dedup_by(|a, b| a.values == b.values);
    begun.truncate(STARTS_MAX);
    begun
        .into_iter()
        .filter_map(|begun| descend(observed, about, hypotheses, (&active, &nuisances), begun))
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// Where a fit begins.
struct Begun {
    cost: f64,
    values: Values,
    residuals: Residuals,
}

/// Steps from a start to the nearest minimum. Numbers: active and nuisances.
fn descend(
    observed: &Observed<'_>,
    about: &Linearised,
    hypotheses: &[usize],
    (active, nuisances): (&[usize], &[usize]),
    begun: Begun,
) -> Option<Fit> {
    let catalogue = observed.catalogue;
    let Begun { mut cost, mut values, mut residuals } = begun;
    let mut last = None;
    for _ in 0..STEPS_MAX {
        let fresh: Vec<(usize, Residuals)> = active
            .par_iter()
            .filter_map(|n| Some((*n, observed.column(&values, &residuals, *n)?)))
            .collect();
        let local = about.with(observed, &values, &residuals, nuisances, fresh);
        let solution = local.solve(catalogue, &observed.counts, active)?;
        let mut share = 1.0;
        let mut gained = 0.0;
        while share > 0.05 {
            let trial: Values =
                values.iter().zip(&solution.values).map(|(a, b)| a + (b - a) * share).collect();
            if let Some((new, there)) = cost_at(observed, &trial, active)
                && new < cost
            {
                gained = cost - new;
                (cost, values, residuals) = (new, trial, there);
                break;
            }
            share *= 0.4;
        }
        last = Some(solution);
        if gained < COST_STEP_MIN {
            break;
        }
    }
    let solution = last?;
    Some(Fit {
        hypotheses: hypotheses.to_vec(),
        power: observed.power(&residuals),
        // The curvature there with the cost as it is.
        evidence: solution.evidence + solution.cost - cost,
        deviation: solution.deviation,
        values,
        cost,
    })
}
