//! The cost of hypotheses about a point, from products of derivatives at each place.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::diagnose::catalogue::hypothesis::{Catalogue, Values};
use crate::diagnose::likelihood::layout::Place;
use crate::diagnose::likelihood::observed::{Observed, Residuals, level, noise_cost, pools};

/// Most reweighting rounds in a solve.
const WEIGHT_ROUNDS: usize = 40;
/// Rounds end when one lowers the cost by less than this, nats.
const COST_STEP_MIN: f64 = 2e-5;

/// Residuals linearised in some numbers about a point, as products at each place.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Values of all numbers at the point.
    pub values: Values,
    /// Indices of the numbers that it is linear in.
    pub numbers: Vec<usize>,
    /// Derivative of the residuals by each of those numbers.
    pub columns: Vec<Residuals>,
    /// Products of the columns at each place: the upper triangle, row by row.
    gram: Vec<Vec<f64>>,
    /// Products of the columns with the residuals, at each place.
    cross: Vec<Vec<f64>>,
    /// Squares of the residuals at each place, of each by itself: [pools](pools) come after.
    square: Vec<f64>,
}

fn triangle(i: usize, j: usize, n: usize) -> usize {
    let (i, j) = if i <= j { (i, j) } else { (j, i) };
    i * n - i * (i + 1) / 2 + j
}

/// Products of columns with residuals at each place.
fn crosses<C>(observed: &Observed<'_>, columns: &[C], base: &Residuals) -> Vec<Vec<f64>>
where
    C: std::borrow::Borrow<Residuals> + Sync,
{
    let crosses: Vec<Vec<f64>> =
        columns.par_iter().map(|column| observed.dot(column.borrow(), base)).collect();
    (0..Place::COUNT).map(|place| crosses.iter().map(|cross| cross[place]).collect()).collect()
}

impl Linearised {
    /// Linearises in `numbers` about `values`; numbers without a derivative are left out.
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
        Self {
            values: values.to_vec(),
            cross: crosses(observed, &columns, base),
            square: observed.squares(base),
            numbers,
            columns,
            gram,
        }
    }

    /// The same derivatives and residuals, moved to other values.
    pub fn resting_at(&self, values: Values) -> Self {
        Self { values, ..self.clone() }
    }

    /// The same derivatives about other residuals. The result has no columns: it can only be
    /// solved.
    pub fn about(&self, observed: &Observed<'_>, base: &Residuals) -> Self {
        Self {
            values: self.values.clone(),
            numbers: self.numbers.clone(),
            columns: Vec::new(),
            gram: self.gram.clone(),
            cross: crosses(observed, &self.columns, base),
            square: observed.squares(base),
        }
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
            .levelled(self.square.clone())
            .iter()
            .zip(&one.counts)
            .map(|(q, n)| n / q.max(f64::MIN_POSITIVE))
            .collect();
        let weighted = |column: &Residuals| -> f64 {
            one.power_of(column).iter().zip(&weights).map(|(q, weight)| q * weight).sum()
        };
        let share = |number: &usize| {
            let column = one.column(&self.values, &of_one, *number)?;
            let again = other.column(&self.values, &of_other, *number)?;
            let difference: Residuals = column
                .iter()
                .zip(&again)
                .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a - b).collect())
                .collect();
            // The difference contains the noise of both.
            let share = 0.5 * weighted(&difference) / weighted(&column);
            share.is_finite().then_some((*number, share))
        };
        self.numbers.par_iter().filter_map(share).collect()
    }

    /// The derivatives by `numbers` on other flights, whose residuals are `base`.
    pub fn columns_of(
        &self,
        others: &Observed<'_>,
        base: &Residuals,
        numbers: &[usize],
    ) -> Vec<(usize, Residuals)> {
        let of_one = |n: &usize| Some((*n, others.column(&self.values, base, *n)?));
        numbers.iter().filter_map(of_one).collect()
    }

    /// As [`about`](Self::about), with the given derivatives `own` for some numbers.
    pub fn about_with(
        &self,
        observed: &Observed<'_>,
        base: &Residuals,
        own: &[(usize, Residuals)],
    ) -> Self {
        if own.is_empty() {
            return self.about(observed, base);
        }
        self.with(observed, &self.values, base, &self.numbers, own)
    }

    /// A copy restricted to the numbers in `keep`, with the columns `fresh` added.
    pub(in crate::diagnose) fn with(
        &self,
        observed: &Observed<'_>,
        values: &[f64],
        base: &Residuals,
        keep: &[usize],
        fresh: &[(usize, Residuals)],
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
        let cross = crosses(observed, &columns, base);
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
        let cost_of = |power: &[f64], delta: &DVector<f64>| {
            let pulled: f64 = (0..n).map(|i| prior[i] * (off[i] + delta[i]).powi(2)).sum();
            noise_cost(power, counts) + 0.5 * pulled
        };
        let mut delta = DVector::from_fn(n, |i, _| {
            let number = self.numbers[used[i]];
            (start[number] - self.values[number]).clamp(limits[i][0], limits[i][1])
        });
        let mut current = quadratic.power(&delta);
        let mut cost = cost_of(&current, &delta);
        let mut normal = DMatrix::zeros(n, n);
        for _ in 0..WEIGHT_ROUNDS {
            let gradient;
            (normal, gradient) = quadratic.normal_equations(&prior, &off, counts, &current);
            let target = bounded_minimum(&normal, &gradient, &limits, &delta)?;
            // Halves the step until the cost falls: far from the fixed point the weights may
            // overshoot.
            let mut share = 1.0;
            let mut moved = false;
            while share > 1e-3 {
                let trial = &delta + (&target - &delta) * share;
                let there = quadratic.power(&trial);
                let new = cost_of(&there, &trial);
                if new < cost {
                    moved = cost - new > COST_STEP_MIN;
                    (delta, current, cost) = (trial, there, new);
                    break;
                }
                share *= 0.5;
            }
            if !moved {
                break;
            }
        }
        let factor = scaled_cholesky(&normal)?;
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
        let row = |number: &usize| used.iter().position(|i| self.numbers[*i] == *number);
        let rows: Option<Vec<usize>> = active.iter().map(row).collect();
        let joint = rows.map_or_else(DMatrix::default, |rows| {
            DMatrix::from_fn(rows.len(), rows.len(), |a, b| covariance[(rows[a], rows[b])])
        });
        Some(Solution { values, deviation, joint, cost, evidence, power: current })
    }

    /// The products of the numbers `used`, at places with coefficients.
    fn restricted(&self, used: &[usize], counts: &[f64]) -> Quadratic {
        let total = self.numbers.len();
        let pairs: Vec<usize> = (0..used.len())
            .flat_map(|a| (a..used.len()).map(move |b| (a, b)))
            .map(|(a, b)| triangle(used[a], used[b], total))
            .collect();
        let places: Vec<usize> = (0..Place::COUNT).filter(|place| counts[*place] > 0.0).collect();
        let of_places = |of: &[Vec<f64>], which: &[usize]| -> Vec<f64> {
            places.iter().flat_map(|place| which.iter().map(|i| of[*place][*i])).collect()
        };
        Quadratic {
            numbers: used.len(),
            gram: of_places(&self.gram, &pairs),
            cross: of_places(&self.cross, used),
            square: places.iter().map(|place| self.square[*place]).collect(),
            pools: pools(counts),
            counts: counts.to_vec(),
            places,
        }
    }
}

/// The sum of squares at each place as a quadratic in a few numbers, packed for speed: a diagnosis
/// solves a thousand of these.
struct Quadratic {
    numbers: usize,
    places: Vec<usize>,
    /// Upper triangles, row by row, one place after another.
    gram: Vec<f64>,
    /// Products with the residuals, one place after another.
    cross: Vec<f64>,
    square: Vec<f64>,
    counts: Vec<f64>,
    /// Places that share one variance.
    pools: Vec<Vec<usize>>,
}

impl Quadratic {
    /// Index, triangle and products of each place.
    fn parts(&self) -> impl Iterator<Item = (usize, &[f64], &[f64])> {
        let (n, size) = (self.numbers, self.numbers * (self.numbers + 1) / 2);
        let of_place = move |(k, place): (usize, &usize)| {
            (*place, &self.gram[k * size..(k + 1) * size], &self.cross[k * n..(k + 1) * n])
        };
        self.places.iter().enumerate().map(of_place)
    }

    /// The sum of squares at each place, `delta` away from the point.
    fn power(&self, delta: &DVector<f64>) -> Vec<f64> {
        let mut power = vec![0.0; Place::COUNT];
        for ((place, gram, cross), square) in self.parts().zip(&self.square) {
            let mut q = *square;
            let mut rest = gram;
            for (a, (d, cross)) in delta.iter().zip(cross).enumerate() {
                let (row, below) = rest.split_at(self.numbers - a);
                rest = below;
                let products = row.iter().zip(delta.as_slice()[a..].iter());
                let sum: f64 = products.map(|(g, d)| g * d).sum();
                q += d * (2.0 * (cross + sum) - row[0] * d);
            }
            power[place] = q.max(1e-9 * square).max(f64::MIN_POSITIVE);
        }
        self.pools.iter().for_each(|pool| level(&mut power, &self.counts, pool));
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
        for (place, gram, cross) in self.parts() {
            let weight = counts[place] / power[place];
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

/// A quadratic's descent within limits ends where one more step would lower it by less, nats.
const DESCENT_MIN: f64 = 1e-9;

/// The minimum within limits of x' N x / 2 + g' x, `normal` being N and `gradient` g.
///
/// An active-set method: from the feasible point `start` it goes to the minimum over the numbers that
/// no limit holds, up to the first limit on the way, and then lets go the number that its limit holds
/// back most. So no step raises the cost, which the reweighting above relies on.
fn bounded_minimum(
    normal: &DMatrix<f64>,
    gradient: &DVector<f64>,
    limits: &[[f64; 2]],
    start: &DVector<f64>,
) -> Option<DVector<f64>> {
    let n = gradient.len();
    let mut at = start.clone();
    let mut held: Vec<bool> =
        (0..n).map(|i| at[i] <= limits[i][0] || at[i] >= limits[i][1]).collect();
    // Each number is held or let go a few times at most.
    for _ in 0..8 * n + 8 {
        let slope = gradient + normal * &at;
        let free: Vec<usize> = (0..n).filter(|i| !held[*i]).collect();
        if !free.is_empty() {
            let matrix =
                DMatrix::from_fn(free.len(), free.len(), |a, b| normal[(free[a], free[b])]);
            let right = DVector::from_fn(free.len(), |a, _| -slope[free[a]]);
            let step = scaled_cholesky(&matrix)?.solve(&right);
            let reach = |(a, i): (usize, &usize)| {
                let limit = limits[*i][usize::from(step[a] > 0.0)];
                let share = (limit - at[*i]) / step[a];
                (share < 1.0).then_some((share.max(0.0), *i, limit))
            };
            let blocked = free.iter().enumerate().filter_map(reach);
            let first = blocked.min_by(|a, b| a.0.total_cmp(&b.0));
            let share = first.map_or(1.0, |(share, ..)| share);
            free.iter().enumerate().for_each(|(a, i)| at[*i] += share * step[a]);
            if let Some((_, i, limit)) = first {
                (at[i], held[i]) = (limit, true);
                continue;
            }
        }
        let slope = gradient + normal * &at;
        let descent = |i: usize| {
            let [low, high] = limits[i];
            let inwards = (slope[i] < 0.0 && at[i] < high) || (slope[i] > 0.0 && at[i] > low);
            if inwards { slope[i].powi(2) / normal[(i, i)] } else { 0.0 }
        };
        let held_back = (0..n).filter(|i| held[*i]).map(|i| (i, descent(i)));
        match held_back.max_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((i, gain)) if gain > DESCENT_MIN => held[i] = false,
            _ => return Some(at),
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
    /// Residual sum of squares at each place.
    pub power: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn cost(normal: &DMatrix<f64>, gradient: &DVector<f64>, at: &DVector<f64>) -> f64 {
        0.5 * at.dot(&(normal * at)) + gradient.dot(at)
    }

    proptest! {
        #[test]
        fn no_single_number_improves_the_bounded_minimum(
            entries in prop::collection::vec(-1.0_f64..1.0, 36),
            slopes in prop::collection::vec(-5.0_f64..5.0, 6),
            lows in prop::collection::vec(-1.0_f64..0.0, 6),
            highs in prop::collection::vec(0.0_f64..1.0, 6),
            share in prop::collection::vec(0.0_f64..1.0, 6),
        ) {
            let root = DMatrix::from_vec(6, 6, entries);
            let normal = root.transpose() * &root + DMatrix::identity(6, 6) * 1e-3;
            let gradient = DVector::from_vec(slopes);
            let limits: Vec<[f64; 2]> = lows.into_iter().zip(highs).map(|(a, b)| [a, b]).collect();
            let start = DVector::from_fn(6, |i, _| {
                limits[i][0] + share[i] * (limits[i][1] - limits[i][0])
            });
            let least = bounded_minimum(&normal, &gradient, &limits, &start).expect("a minimum");
            let at_least = cost(&normal, &gradient, &least);
            prop_assert!(at_least <= cost(&normal, &gradient, &start) + 1e-9);
            // The cost is convex: where no single number leads down, nothing does.
            for i in 0..6 {
                for to in limits[i] {
                    for share in [1e-3, 0.1, 1.0] {
                        let mut moved = least.clone();
                        moved[i] += share * (to - least[i]);
                        prop_assert!(cost(&normal, &gradient, &moved) >= at_least - 1e-7);
                    }
                }
            }
        }
    }
}
