//! Fits hypotheses to flights: maximum a posteriori with an unknown noise spectrum.
//!
//! The coefficients of a channel within a band are Gaussian with an unknown common variance, which
//! is profiled out. The cost is `sum n/2 ln(Q/n)` over channels and bands plus the priors, where Q
//! is the residual sum of squares. Gauss-Newton steps minimise it, with weights n/Q iterated to a
//! fixed point. The evidence is Laplace's approximation: a number costs the ratio of its prior's
//! width to its posterior's.

use nalgebra::DMatrix;

use crate::diagnose::catalogue::hypothesis::{Catalogue, Values};
use crate::diagnose::likelihood::column::Residuals;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::observed::{Observed, noise_cost};

/// Normal quantile for 90 % intervals.
pub(in crate::diagnose) const Z90: f64 = 1.645;
/// A fit ends when a step lowers the cost by less than this, nats.
const COST_STEP_MIN: f64 = 0.02;
/// Most steps of a descent.
const STEPS_MAX: usize = 12;
/// Starts that are followed to a minimum, those with the lowest cost first.
const STARTS_MAX: usize = 2;
/// Starts are equal if their active numbers are within this share of their magnitudes.
const SAME_START_SHARE: f64 = 0.02;

/// 90 % interval of a normal number.
pub fn interval(value: f64, deviation: f64) -> [f64; 2] {
    [value - Z90 * deviation, value + Z90 * deviation]
}

/// A hypothesis, or several, fitted to the flights without linearisation.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Indices of the fitted hypotheses in the catalogue; empty for the file alone.
    pub hypotheses: Vec<usize>,
    /// Values of all numbers, nuisances included.
    pub values: Values,
    /// Standard deviations of the free numbers.
    pub deviation: Vec<f64>,
    /// Covariance of the numbers of its hypotheses; empty if one of them has no derivative.
    pub joint: DMatrix<f64>,
    /// Log evidence, nats.
    pub evidence: f64,
    /// Cost at the minimum, nats.
    pub cost: f64,
    /// Residual sum of squares in each bin.
    pub power: Vec<f64>,
}

impl Fit {
    /// Indices of the numbers of its hypotheses.
    pub fn active(&self, catalogue: &Catalogue) -> Vec<usize> {
        let hypotheses = self.hypotheses.iter();
        hypotheses.flat_map(|h| catalogue.hypotheses[*h].numbers.iter().copied()).collect()
    }

    /// Variance of the noise in each bin; 0 without coefficients.
    pub fn noise(&self, counts: &[f64]) -> Vec<f64> {
        self.power.iter().zip(counts).map(|(q, n)| if *n > 0.0 { q / n } else { 0.0 }).collect()
    }
}

/// The cost at the given numbers, nats, and the residuals. `active` numbers have their wide priors.
fn cost_at(observed: &Observed<'_>, values: &[f64], active: &[usize]) -> Option<(f64, Residuals)> {
    let residuals = observed.residuals(values)?;
    let noise = noise_cost(&observed.power(&residuals), &observed.counts);
    let catalogue = observed.catalogue;
    let pulled: f64 = catalogue
        .numbers
        .iter()
        .enumerate()
        .map(|(i, number)| {
            let [middle, width] = number.prior(active.contains(&i));
            let off = values[i] - middle;
            if off == 0.0 { 0.0 } else { (off / width).powi(2) }
        })
        .sum();
    Some((noise + 0.5 * pulled, residuals))
}

/// Fits the given hypotheses together. `about` holds the nuisances' derivatives and the start
/// values; each of `starts` replaces some of them. Without a start, the fit starts there.
pub fn fit(
    observed: &Observed<'_>,
    about: &Linearised,
    hypotheses: &[usize],
    starts: &[Vec<(usize, f64)>],
) -> Option<Fit> {
    let numbers = hypotheses.iter().map(|h| &observed.catalogue.hypotheses[*h].numbers);
    let active: Vec<usize> = numbers.flatten().copied().collect();
    fit_numbers(observed, about, hypotheses, &active, starts)
}

/// As [`fit`], with `active` numbers beyond those of the hypotheses, such as a law's.
pub(in crate::diagnose) fn fit_numbers(
    observed: &Observed<'_>,
    about: &Linearised,
    hypotheses: &[usize],
    active: &[usize],
    starts: &[Vec<(usize, f64)>],
) -> Option<Fit> {
    let catalogue = observed.catalogue;
    let nuisances: Vec<usize> =
        catalogue.nuisances().filter(|number| !active.contains(number)).collect();
    let none: Vec<(usize, f64)> = Vec::new();
    let unchanged = starts.is_empty().then_some(&none);
    let mut possible: Vec<DescentStart> = unchanged
        .into_iter()
        .chain(starts)
        .filter_map(|start| {
            let mut values = about.values.clone();
            for (number, value) in start {
                values[*number] = *value;
            }
            let (cost, residuals) = cost_at(observed, &values, active)?;
            Some(DescentStart { cost, values, residuals })
        })
        .collect();
    // Two starts that lead to the same minimum would displace a third that does not.
    let is_near = |a: &DescentStart, b: &DescentStart| {
        let mut numbers = 0..catalogue.numbers.len();
        numbers.all(|n| {
            let apart = (a.values[n] - b.values[n]).abs();
            apart
                <= if active.contains(&n) {
                    SAME_START_SHARE * catalogue.numbers[n].magnitude
                } else {
                    0.0
                }
        })
    };
    possible.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let mut apart: Vec<DescentStart> = Vec::with_capacity(STARTS_MAX);
    for start in possible {
        if apart.len() < STARTS_MAX && !apart.iter().any(|other| is_near(&start, other)) {
            apart.push(start);
        }
    }
    apart
        .into_iter()
        .filter_map(|start| descend(observed, about, hypotheses, active, &nuisances, start))
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
}

/// The start of a descent.
struct DescentStart {
    cost: f64,
    values: Values,
    residuals: Residuals,
}

/// Steps from a start to the nearest minimum over the active numbers and the nuisances.
fn descend(
    observed: &Observed<'_>,
    about: &Linearised,
    hypotheses: &[usize],
    active: &[usize],
    nuisances: &[usize],
    start: DescentStart,
) -> Option<Fit> {
    let catalogue = observed.catalogue;
    let DescentStart { mut cost, mut values, mut residuals } = start;
    let mut last = None;
    for _ in 0..STEPS_MAX {
        let fresh = observed.columns(&values, &residuals, active);
        let local = about.with(observed, &values, &residuals, nuisances, &fresh);
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
        // The curvature of the last solution, at the cost reached.
        evidence: solution.evidence + solution.cost - cost,
        deviation: solution.deviation,
        joint: solution.joint,
        values,
        cost,
    })
}
