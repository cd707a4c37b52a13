//! The cost of hypotheses about a point, from products of derivatives in each bin.

use nalgebra::{DMatrix, DVector};

use crate::diagnose::catalogue::hypothesis::{Catalogue, Values};
use crate::diagnose::likelihood::bounded_minimum::{bounded_minimum, scaled_cholesky};
use crate::diagnose::likelihood::column::{Column, Residuals};
use crate::diagnose::likelihood::layout::Bin;
use crate::diagnose::likelihood::observed::{Observed, noise_cost, pool_power, pools};

/// Most reweighting rounds in a solve.
const WEIGHT_ROUNDS: usize = 40;
/// Rounds end when one lowers the cost by less than this, nats.
const COST_STEP_MIN: f64 = 2e-5;

/// Numbers whose derivatives are in memory at once on flights that are compared.
const NUMBERS_AT_ONCE: usize = 8;

/// Residuals linearised in some numbers about a point, as products in each bin.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Values of all numbers at the point.
    pub values: Values,
    /// Indices of the numbers that it is linear in.
    pub numbers: Vec<usize>,
    /// Derivative of the residuals by each of those numbers.
    columns: Vec<Column>,
    /// Products of the columns in each bin: the upper triangle, row by row.
    gram: Vec<Vec<f64>>,
    /// Products of the columns with the residuals, in each bin.
    cross: Vec<Vec<f64>>,
    /// Sum of squares of the residuals in each bin, before [pools] share theirs.
    square: Vec<f64>,
}

/// Index of entry (i, j) of a symmetric matrix of `n` rows in its upper triangle, row by row.
fn triangle_index(i: usize, j: usize, n: usize) -> usize {
    let (i, j) = if i <= j { (i, j) } else { (j, i) };
    i * n - i * (i + 1) / 2 + j
}

/// Splits the products of `count` columns and the residuals, as [`Observed::products`] gives them
/// without the columns before `from`, into those of columns and those with the residuals.
fn split_base(products: &[f64], count: usize, from: usize) -> [Vec<f64>; 2] {
    let (mut gram, mut cross) = (Vec::with_capacity(products.len()), Vec::with_capacity(count));
    let mut rest = products;
    for row in 0..count {
        let (own, below) = rest.split_at(count + 1 - row.max(from));
        let (columns, base) = own.split_at(own.len() - 1);
        gram.extend_from_slice(columns);
        cross.extend_from_slice(base);
        rest = below;
    }
    [gram, cross]
}

impl Linearised {
    /// Linearises in `numbers` about `values`; numbers without a derivative are left out.
    pub fn new(observed: &Observed<'_>, values: &[f64], numbers: &[usize]) -> Option<Self> {
        let base = observed.residuals(values)?;
        let columns = observed.columns(values, &base, numbers);
        let all: Vec<&Column> = columns.iter().collect();
        let products = observed.products(&all, &base, 0);
        let split = products.iter().map(|bin| split_base(bin, columns.len(), 0).into());
        let (gram, cross) = split.unzip();
        Some(Self {
            values: values.to_vec(),
            numbers: columns.iter().map(|column| column.number).collect(),
            square: observed.squares(&base),
            columns,
            gram,
            cross,
        })
    }

    /// The same derivatives and residuals, moved to other values.
    pub fn moved_to(&self, values: Values) -> Self {
        Self { values, ..self.clone() }
    }

    /// The same derivatives about other residuals. The result has no columns: it can only be
    /// solved.
    pub fn with_residuals(&self, observed: &Observed<'_>, base: &Residuals) -> Self {
        self.with(observed, &self.values, base, &self.numbers, &[])
    }

    /// The share of noise in the square of each number's derivative, from two draws of the same
    /// flights. Numbers without a derivative are left out. A hover neither tilts nor turns, so its
    /// outputs only follow the loop's own gyro; and a derivative by a time is the slope of noisy
    /// readings. Noise of a regressor recurs in the residuals (errors in variables; Fuller 1987).
    /// Only derivatives with the noise of their own flights reproduce its effect on a fit.
    pub fn noise_shares(&self, [one, other]: [&Observed<'_>; 2]) -> Vec<(usize, f64)> {
        let residuals = [one, other].map(|observed| observed.residuals(&self.values));
        let [Some(of_one), Some(of_other)] = residuals else { return Vec::new() };
        let weights: Vec<f64> = one
            .pooled(self.square.clone())
            .iter()
            .zip(&one.counts)
            .map(|(q, n)| n / q.max(f64::MIN_POSITIVE))
            .collect();
        let weighted = |column: &Residuals| -> f64 {
            one.power_of(column).iter().zip(&weights).map(|(q, weight)| q * weight).sum()
        };
        let share = |(column, again): (&Column, &Column)| {
            let pairs = column.residuals.iter().zip(&again.residuals);
            let difference: Residuals =
                pairs.map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect()).collect();
            // The difference contains the noise of both.
            let share = 0.5 * weighted(&difference) / weighted(&column.residuals);
            share.is_finite().then_some((column.number, share))
        };
        // A few at a time, for the sake of memory. Both draws leave out the same numbers.
        let shares = self.numbers.chunks(NUMBERS_AT_ONCE).flat_map(|numbers| {
            let columns = one.columns(&self.values, &of_one, numbers);
            let again = other.columns(&self.values, &of_other, numbers);
            columns.iter().zip(&again).filter_map(share).collect::<Vec<_>>()
        });
        shares.collect()
    }

    /// As [`with_residuals`](Self::with_residuals), with the derivatives `own` for some numbers.
    pub fn with_residuals_and_columns(
        &self,
        observed: &Observed<'_>,
        base: &Residuals,
        own: &[Column],
    ) -> Self {
        self.with(observed, &self.values, base, &self.numbers, own)
    }

    /// A copy restricted to the numbers in `keep`, with the columns `fresh` added.
    pub(in crate::diagnose) fn with(
        &self,
        observed: &Observed<'_>,
        values: &[f64],
        base: &Residuals,
        keep: &[usize],
        fresh: &[Column],
    ) -> Self {
        let kept: Vec<usize> = (0..self.numbers.len())
            .filter(|i| {
                keep.contains(&self.numbers[*i])
                    && fresh.iter().all(|column| column.number != self.numbers[*i])
            })
            .collect();
        let mut numbers: Vec<usize> = kept.iter().map(|i| self.numbers[*i]).collect();
        let old = numbers.len();
        numbers.extend(fresh.iter().map(|column| column.number));
        let columns: Vec<&Column> = kept.iter().map(|i| &self.columns[*i]).chain(fresh).collect();
        let n = numbers.len();
        let products = observed.products(&columns, base, old);
        let mut cross = Vec::with_capacity(Bin::COUNT);
        let mut gram = Vec::with_capacity(Bin::COUNT);
        for (known, products) in self.gram.iter().zip(&products) {
            let [fresh, with_base] = split_base(products, n, old);
            cross.push(with_base);
            let mut fresh = fresh.into_iter();
            let mut triangle = Vec::with_capacity(n * (n + 1) / 2);
            for row in 0..n {
                let known = (row..old)
                    .map(|j| known[triangle_index(kept[row], kept[j], self.numbers.len())]);
                triangle.extend(known);
                triangle.extend(fresh.by_ref().take(n - row.max(old)));
            }
            gram.push(triangle);
        }
        let square = observed.squares(base);
        Self { values: values.to_vec(), numbers, columns: Vec::new(), gram, cross, square }
    }

    /// The least cost over the `active` numbers, under their wide priors, and all numbers with a
    /// tolerance.
    pub fn solve(
        &self,
        catalogue: &Catalogue,
        counts: &[f64],
        active: &[usize],
    ) -> Option<Solution> {
        self.solve_from(catalogue, counts, active, &self.values)
    }

    /// As [`solve`](Self::solve), from the values `start`.
    pub fn solve_from(
        &self,
        catalogue: &Catalogue,
        counts: &[f64],
        active: &[usize],
        start: &[f64],
    ) -> Option<Solution> {
        let problem = self.penalised(catalogue, counts, active);
        let start = DVector::from_fn(problem.used.len(), |i, _| {
            let number = self.numbers[problem.used[i]];
            let [low, high] = problem.limits[i];
            (start[number] - self.values[number]).clamp(low, high)
        });
        let Minimum { delta, power, cost, normal } = problem.minimum(counts, start)?;
        let factor = scaled_cholesky(&normal)?;
        let evidence = -cost + 0.5 * problem.prior.iter().map(|p| p.ln()).sum::<f64>()
            - 0.5 * factor.log_determinant();
        let used = &problem.used;
        let mut values = self.values.clone();
        let mut deviation = vec![0.0; catalogue.numbers.len()];
        let covariance = factor.inverse();
        for (a, i) in used.iter().enumerate() {
            let number = self.numbers[*i];
            values[number] += delta[a];
            deviation[number] = covariance[(a, a)].max(0.0).sqrt();
        }
        let row = |number: &usize| used.iter().position(|i| self.numbers[*i] == *number);
        let rows: Option<Vec<usize>> = active.iter().map(row).collect();
        let joint = rows.map_or_else(DMatrix::default, |rows| {
            DMatrix::from_fn(rows.len(), rows.len(), |a, b| covariance[(rows[a], rows[b])])
        });
        Some(Solution { values, deviation, joint, cost, evidence, power })
    }

    /// The cost as a function of the `active` numbers and all numbers with a tolerance.
    fn penalised(&self, catalogue: &Catalogue, counts: &[f64], active: &[usize]) -> Penalised {
        let used: Vec<usize> = (0..self.numbers.len())
            .filter(|i| {
                let number = self.numbers[*i];
                active.contains(&number) || catalogue.numbers[number].tolerance > 0.0
            })
            .collect();
        let n = used.len();
        let (mut prior, mut off) = (DVector::zeros(n), DVector::zeros(n));
        let mut limits = Vec::with_capacity(n);
        for (row, i) in used.iter().enumerate() {
            let number = self.numbers[*i];
            let value = self.values[number];
            let [middle, width] = catalogue.numbers[number].prior(active.contains(&number));
            prior[row] = width.powi(-2);
            off[row] = value - middle;
            limits.push(catalogue.limits(number, active).map(|limit| limit - value));
        }
        let quadratic = self.restricted(&used, counts);
        Penalised { used, quadratic, prior, off, limits }
    }

    /// The products of the numbers `used`, in bins with coefficients.
    fn restricted(&self, used: &[usize], counts: &[f64]) -> Quadratic {
        let total = self.numbers.len();
        let pairs: Vec<usize> = (0..used.len())
            .flat_map(|a| (a..used.len()).map(move |b| (a, b)))
            .map(|(a, b)| triangle_index(used[a], used[b], total))
            .collect();
        let bins: Vec<usize> = (0..Bin::COUNT).filter(|bin| counts[*bin] > 0.0).collect();
        let of_places = |of: &[Vec<f64>], which: &[usize]| -> Vec<f64> {
            bins.iter().flat_map(|bin| which.iter().map(|i| of[*bin][*i])).collect()
        };
        Quadratic {
            numbers: used.len(),
            gram: of_places(&self.gram, &pairs),
            cross: of_places(&self.cross, used),
            square: bins.iter().map(|bin| self.square[*bin]).collect(),
            pools: pools(counts),
            counts: counts.to_vec(),
            bins,
        }
    }
}

/// The noise's cost of a [`Quadratic`] plus the normal priors of its numbers, within limits.
struct Penalised {
    /// Indices of the numbers in [`Linearised::numbers`].
    used: Vec<usize>,
    quadratic: Quadratic,
    /// Precision of each prior.
    prior: DVector<f64>,
    /// Distance of the point from the middle of each prior.
    off: DVector<f64>,
    /// Limits of each number's distance from the point.
    limits: Vec<[f64; 2]>,
}

/// A minimum of a [`Penalised`] cost, `delta` away from the point.
struct Minimum {
    delta: DVector<f64>,
    /// Sum of squares in each bin.
    power: Vec<f64>,
    cost: f64,
    /// Matrix of the normal equations of the last step.
    normal: DMatrix<f64>,
}

impl Penalised {
    /// The cost where the sums of squares are `power`, `delta` away from the point, nats.
    fn cost(&self, power: &[f64], counts: &[f64], delta: &DVector<f64>) -> f64 {
        let squares = (0..delta.len()).map(|i| self.prior[i] * (self.off[i] + delta[i]).powi(2));
        let penalty: f64 = squares.sum();
        noise_cost(power, counts) + 0.5 * penalty
    }

    /// Reweights by the noise and solves, until the cost no longer falls.
    fn minimum(&self, counts: &[f64], start: DVector<f64>) -> Option<Minimum> {
        let mut delta = start;
        let mut power = self.quadratic.power(&delta);
        let mut cost = self.cost(&power, counts, &delta);
        let mut normal = DMatrix::zeros(delta.len(), delta.len());
        for _ in 0..WEIGHT_ROUNDS {
            let gradient;
            (normal, gradient) =
                self.quadratic.normal_equations(&self.prior, &self.off, counts, &power);
            let target = bounded_minimum(&normal, &gradient, &self.limits, &delta)?;
            // Halves the step until the cost falls: far from the fixed point the weights may
            // overshoot.
            let mut share = 1.0;
            let mut moved = false;
            while share > 1e-3 {
                let trial = &delta + (&target - &delta) * share;
                let there = self.quadratic.power(&trial);
                let new = self.cost(&there, counts, &trial);
                if new < cost {
                    moved = cost - new > COST_STEP_MIN;
                    (delta, power, cost) = (trial, there, new);
                    break;
                }
                share *= 0.5;
            }
            if !moved {
                break;
            }
        }
        Some(Minimum { delta, power, cost, normal })
    }
}

/// The sum of squares in each bin as a quadratic in a few numbers, packed for speed: a diagnosis
/// solves a thousand of these.
struct Quadratic {
    /// Count of the numbers.
    numbers: usize,
    /// Indices of the bins with coefficients.
    bins: Vec<usize>,
    /// Upper triangles, row by row, one bin after another.
    gram: Vec<f64>,
    /// Products with the residuals, one bin after another.
    cross: Vec<f64>,
    /// Sum of squares of the residuals in each of `bins`.
    square: Vec<f64>,
    /// Number of coefficients in every bin.
    counts: Vec<f64>,
    /// Bins that share one variance.
    pools: Vec<Vec<usize>>,
}

impl Quadratic {
    /// Index, triangle and products of each bin.
    fn parts(&self) -> impl Iterator<Item = (usize, &[f64], &[f64])> {
        let (n, size) = (self.numbers, self.numbers * (self.numbers + 1) / 2);
        let of_bin = move |(k, bin): (usize, &usize)| {
            (*bin, &self.gram[k * size..(k + 1) * size], &self.cross[k * n..(k + 1) * n])
        };
        self.bins.iter().enumerate().map(of_bin)
    }

    /// The sum of squares in each bin, `delta` away from the point.
    fn power(&self, delta: &DVector<f64>) -> Vec<f64> {
        let mut power = vec![0.0; Bin::COUNT];
        for ((bin, gram, cross), square) in self.parts().zip(&self.square) {
            let mut q = *square;
            let mut rest = gram;
            for (a, (d, cross)) in delta.iter().zip(cross).enumerate() {
                let (row, below) = rest.split_at(self.numbers - a);
                rest = below;
                let products = row.iter().zip(delta.as_slice()[a..].iter());
                let sum: f64 = products.map(|(g, d)| g * d).sum();
                q += d * (2.0 * (cross + sum) - row[0] * d);
            }
            power[bin] = q.max(1e-9 * square).max(f64::MIN_POSITIVE);
        }
        self.pools.iter().for_each(|pool| pool_power(&mut power, &self.counts, pool));
        power
    }

    /// Matrix and gradient at the point, with the noise variance from `power`.
    fn normal_equations(
        &self,
        prior: &DVector<f64>,
        off: &DVector<f64>,
        counts: &[f64],
        power: &[f64],
    ) -> (DMatrix<f64>, DVector<f64>) {
        let n = self.numbers;
        let mut triangle = vec![0.0; n * (n + 1) / 2];
        let mut gradient = prior.component_mul(off);
        for (bin, gram, cross) in self.parts() {
            let weight = counts[bin] / power[bin];
            triangle.iter_mut().zip(gram).for_each(|(sum, g)| *sum += weight * g);
            gradient.iter_mut().zip(cross).for_each(|(sum, c)| *sum += weight * c);
        }
        let mut normal = DMatrix::from_diagonal(prior);
        let mut entries = triangle.into_iter();
        for a in 0..n {
            for b in a..n {
                normal[(a, b)] += entries.next().unwrap_or(0.0);
                normal[(b, a)] = normal[(a, b)];
            }
        }
        (normal, gradient)
    }
}

/// The minimum of a linearised cost.
#[derive(Clone, Debug)]
pub struct Solution {
    /// All numbers at the minimum.
    pub values: Values,
    /// Standard deviations of the free numbers.
    pub deviation: Vec<f64>,
    /// Covariance of the active numbers; empty if one of them has no derivative.
    pub joint: DMatrix<f64>,
    /// Cost, nats.
    pub cost: f64,
    /// Log evidence, nats.
    pub evidence: f64,
    /// Residual sum of squares in each bin.
    pub power: Vec<f64>,
}
