//! Flights as coefficients by bin, with their products and derivatives.

use rayon::prelude::*;
use vehicle::{ROTORS, VehicleParams};

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::spectrum::BANDS;
use crate::diagnose::likelihood::channels::{CHANNELS, COMMAND, RATE, VELOCITY};
use crate::diagnose::likelihood::layout::{AT_REST, Bin, Layout};
use crate::diagnose::likelihood::residuals::{Evaluator, Groups};

/// Flights with the coefficients in use.
#[derive(Debug)]
pub struct Observed<'a> {
    /// The prepared flights.
    pub flights: &'a [PreparedFlight],
    /// The coefficients in use of each flight.
    pub layouts: Vec<Layout>,
    pub(in crate::diagnose) evaluator: &'a Evaluator,
    pub(in crate::diagnose) catalogue: &'a Catalogue,
    /// Channels that are left out.
    unused: Vec<usize>,
    /// Runs of coefficients in one bin.
    runs: Vec<Run>,
    pub(in crate::diagnose) counts: Vec<f64>,
    /// Bins that share one variance.
    pools: Vec<Vec<usize>>,
    /// Lower limit of the sum of squares in each bin.
    least: Vec<f64>,
}

/// No equation is exact to better than this share of the rotors' full output. In a short flight a
/// bin has few coefficients, which a few numbers may fit exactly; without this limit the
/// likelihood is unbounded there.
const EXACTNESS: f64 = 1e-5;
/// Body rate that the attitude's exactness refers to, rad/s.
const EXACTNESS_RATE: f64 = 1.0;

/// Smallest standard deviation of the residual in each channel.
fn residual_floor(vehicle: &VehicleParams) -> [f64; CHANNELS] {
    let mut most = [EXACTNESS_RATE; CHANNELS];
    if let Ok(allocation) = vehicle.allocation() {
        most[COMMAND..].fill(0.0);
        for rotor in 0..ROTORS {
            let alone = std::array::from_fn(|i| if i == rotor { 1.0 } else { 0.0 });
            let wrench = allocation.wrench(alone);
            most[COMMAND..].iter_mut().zip(wrench).for_each(|(sum, part)| *sum += part.abs());
        }
        let force = most[COMMAND];
        most[VELOCITY..RATE].fill(force / vehicle.mass);
        for (axis, inertia) in vehicle.inertia.iter().enumerate() {
            most[RATE + axis] = most[COMMAND + 1 + axis] / inertia;
        }
    }
    most.map(|most| EXACTNESS * most)
}

/// Coefficients `start..end` of a block of a flight, all in one bin. All are indices.
#[derive(Clone, Copy, Debug)]
struct Run {
    flight: usize,
    block: usize,
    bin: usize,
    start: usize,
    end: usize,
}

/// Residual coefficients of each flight, in the order of its layout.
pub type Residuals = Vec<Vec<f64>>;

impl<'a> Observed<'a> {
    /// Uses every channel that the logs hold.
    pub fn new(
        flights: &'a [PreparedFlight],
        evaluator: &'a Evaluator,
        catalogue: &'a Catalogue,
    ) -> Self {
        Self::without(flights, evaluator, catalogue, &[])
    }

    /// As [`new`](Self::new), without the channels `unused`.
    pub fn without(
        flights: &'a [PreparedFlight],
        evaluator: &'a Evaluator,
        catalogue: &'a Catalogue,
        unused: &[usize],
    ) -> Self {
        let layouts: Vec<Layout> =
            flights.iter().map(|flight| Layout::without(flight, unused)).collect();
        let mut runs: Vec<Run> = Vec::new();
        let mut counts = vec![0.0; Bin::COUNT];
        for (flight, layout) in layouts.iter().enumerate() {
            for (block, ends) in layout.blocks.windows(2).enumerate() {
                let mut start = ends[0];
                while start < ends[1] {
                    let bin = layout.bins[start].index();
                    let mut end = start + 1;
                    while end < ends[1] && layout.bins[end].index() == bin {
                        end += 1;
                    }
                    counts[bin] += (end - start) as f64;
                    runs.push(Run { flight, block, bin, start, end });
                    start = end;
                }
            }
        }
        let mut deviation = residual_floor(&catalogue.vehicle);
        // Distance from assumed rest has no lower limit: numbers that reach rest exactly explain no
        // reading, and their fit should fail.
        if layouts.iter().any(|layout| layout.is_at_rest) {
            AT_REST.iter().for_each(|channel| deviation[*channel] = 0.0);
        }
        let least = (0..Bin::COUNT)
            .map(|bin| counts[bin] * deviation[Bin::channel_of(bin)].powi(2))
            .collect();
        let unused = unused.to_vec();
        Self {
            flights,
            layouts,
            evaluator,
            catalogue,
            unused,
            runs,
            pools: pools(&counts),
            counts,
            least,
        }
    }

    /// The same flights and channels with another catalogue.
    pub(in crate::diagnose) fn with_catalogue<'b>(&self, catalogue: &'b Catalogue) -> Observed<'b>
    where
        'a: 'b,
    {
        Observed::without(self.flights, self.evaluator, catalogue, &self.unused)
    }

    /// Other flights with the same catalogue and channels.
    pub fn with_flights<'b>(&self, flights: &'b [PreparedFlight]) -> Observed<'b>
    where
        'a: 'b,
    {
        Observed::without(flights, self.evaluator, self.catalogue, &self.unused)
    }

    /// The blocks of the flights that satisfy `has`, in order.
    pub fn blocks(
        &self,
        has: impl Fn(&PreparedFlight, &Layout) -> bool,
    ) -> Vec<(&'a PreparedFlight, &Layout, &'a Block)> {
        let flights = self.flights.iter().zip(&self.layouts);
        flights
            .filter(|(flight, layout)| has(flight, layout))
            .flat_map(|(flight, layout)| flight.blocks.iter().map(move |b| (flight, layout, b)))
            .collect()
    }

    /// Number of coefficients in each bin.
    pub fn counts(&self) -> &[f64] {
        &self.counts
    }

    /// Whether the caller has stopped the diagnosis; nothing is evaluated from then on.
    pub(in crate::diagnose) fn is_stopped(&self) -> bool {
        self.evaluator.is_stopped()
    }

    /// Residuals at `values`. `None` for a vehicle that the physics rejects, and after the caller
    /// has stopped the diagnosis.
    pub fn residuals(&self, values: &[f64]) -> Option<Residuals> {
        self.residuals_in(values, Groups::ALL)
    }

    fn residuals_in(&self, values: &[f64], groups: Groups) -> Option<Residuals> {
        if self.is_stopped() {
            return None;
        }
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

    /// Sum of squares in each bin, with its lower limit added; the bins of a pool share theirs.
    pub fn power(&self, residuals: &Residuals) -> Vec<f64> {
        self.pooled(self.squares(residuals))
    }

    /// Sum of squares in each bin by itself, with its lower limit added.
    pub(in crate::diagnose) fn squares(&self, residuals: &Residuals) -> Vec<f64> {
        let least = self.least.iter().zip(self.power_of(residuals));
        least.map(|(least, q)| least + q).collect()
    }

    /// The same with one variance for the bins of each pool.
    pub(in crate::diagnose) fn pooled(&self, mut squares: Vec<f64>) -> Vec<f64> {
        self.pools.iter().for_each(|pool| pool_power(&mut squares, &self.counts, pool));
        squares
    }

    /// Sum of squares in each bin, without the lower limit.
    pub(in crate::diagnose) fn power_of(&self, values: &Residuals) -> Vec<f64> {
        self.dot(values, values)
    }

    /// Log density of each block in nats, without constants. The noise in each bin is that of all
    /// blocks together, since other flights may be rougher than the fitted ones.
    pub fn log_density(&self, residuals: &Residuals) -> Vec<f64> {
        let power = self.power(residuals);
        let mut density: Vec<f64> = Vec::new();
        let mut last = None;
        for run in &self.runs {
            if last != Some((run.flight, run.block)) {
                density.push(0.0);
                last = Some((run.flight, run.block));
            }
            let variance = (power[run.bin] / self.counts[run.bin]).max(f64::MIN_POSITIVE);
            let part = &residuals[run.flight][run.start..run.end];
            let n = (run.end - run.start) as f64;
            let square = product(part, part);
            if let Some(density) = density.last_mut() {
                *density -= 0.5 * (n * variance.ln() + square / variance);
            }
        }
        density
    }

    /// Derivative of the residuals with respect to one number at `values`, where the residuals are
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
        // Switching an effect on may replace another one; both points have it on.
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
                let difference = a.iter().zip(b).zip(&layout.bins);
                difference
                    .map(
                        |((a, b), bin)| {
                            if groups.has(bin.channel()) { (b - a) * scale } else { 0.0 }
                        },
                    )
                    .collect()
            })
            .collect();
        Some(column)
    }

    /// Sum of products in each bin.
    pub(in crate::diagnose) fn dot(&self, a: &Residuals, b: &Residuals) -> Vec<f64> {
        let mut sums = vec![0.0; Bin::COUNT];
        for run in &self.runs {
            let (a, b) = (&a[run.flight][run.start..run.end], &b[run.flight][run.start..run.end]);
            sums[run.bin] += product(a, b);
        }
        sums
    }
}

/// The sum of products, in four independent sums: a single one would stall on each addition.
fn product(a: &[f64], b: &[f64]) -> f64 {
    let (fours, others) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest = fours.remainder().iter().zip(others.remainder());
    let mut sums = [0.0; 4];
    for (a, b) in fours.zip(others) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    sums.iter().sum::<f64>() + rest.map(|(a, b)| a * b).sum::<f64>()
}

/// Least coefficients for a variance; neighbouring bands of a channel with fewer share one.
const POOLED_MIN: f64 = 8.0;

/// Bins that share one variance, where a single bin has too few coefficients to estimate it.
/// There, an exact fit by a few numbers is no evidence.
pub(in crate::diagnose) fn pools(counts: &[f64]) -> Vec<Vec<usize>> {
    let mut pools: Vec<Vec<usize>> = Vec::new();
    for channel in 0..CHANNELS {
        let mut open: Vec<usize> = Vec::new();
        let first = pools.len();
        for band in 0..BANDS.len() {
            let bin = Bin::index_of(channel, band);
            if counts[bin] > 0.0 {
                open.push(bin);
            }
            if open.iter().map(|bin| counts[*bin]).sum::<f64>() >= POOLED_MIN {
                pools.push(std::mem::take(&mut open));
            }
        }
        match pools.get_mut(first..).and_then(<[_]>::last_mut) {
            Some(last) => last.append(&mut open),
            None => pools.push(open),
        }
    }
    pools.retain(|pool| pool.len() > 1);
    pools
}

/// Gives the bins of a pool one variance.
pub(in crate::diagnose) fn pool_power(power: &mut [f64], counts: &[f64], pool: &[usize]) {
    let sum: f64 = pool.iter().map(|bin| power[*bin]).sum();
    let count: f64 = pool.iter().map(|bin| counts[*bin]).sum();
    pool.iter().for_each(|bin| power[*bin] = counts[*bin] * sum / count);
}

/// Cost of the sums of squares, in nats.
pub(in crate::diagnose) fn noise_cost(power: &[f64], counts: &[f64]) -> f64 {
    power
        .iter()
        .zip(counts)
        .filter(|(_, n)| **n > 0.0)
        // NaN means that there is no fit.
        .map(|(q, n)| match q.is_nan() {
            true => f64::INFINITY,
            false => 0.5 * n * (q.max(f64::MIN_POSITIVE) / n).ln(),
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::likelihood::channels::ATTITUDE;

    #[test]
    fn residual_floor_is_positive_and_far_below_sensor_noise() {
        for text in [
            include_str!("../../../config/vehicles/crazyflie.toml"),
            include_str!("../../../config/vehicles/quad1200.toml"),
        ] {
            let least = residual_floor(&VehicleParams::from_toml_str(text).unwrap());
            assert!(least.iter().all(|deviation| *deviation > 0.0), "{least:?}");
            // m/s^2, rad/s^2, rad/s.
            assert!(least[VELOCITY] < 1e-3 && least[RATE] < 2e-2 && least[ATTITUDE] < 1e-4);
        }
    }
}
