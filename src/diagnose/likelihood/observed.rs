//! Flights as coefficients by bin, with their products and derivatives.

use rayon::prelude::*;
use vehicle::{ROTORS, VehicleParams};

use crate::diagnose::catalogue::candidate::Candidate;
use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::spectrum::BANDS;
use crate::diagnose::likelihood::channels::{CHANNELS, COMMAND, RATE, VELOCITY};
use crate::diagnose::likelihood::column::{Column, Residuals};
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

/// A step of a number, for the derivative by it.
struct Step {
    number: usize,
    /// The groups that the number affects.
    groups: Groups,
    /// Signed inverse of the step's size.
    scale: f64,
    /// Whether the derivative is taken between one and two steps from the point.
    is_beyond: bool,
}

impl Run {
    /// The coefficients of this run.
    fn of<'a>(&self, all: &'a Residuals) -> &'a [f64] {
        &all[self.flight][self.start..self.end]
    }
}

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
        let candidate = self.catalogue.candidate(values).ok()?;
        self.residuals_under(&[(candidate, Groups::ALL)])?.pop()
    }

    /// Residuals under each candidate in its groups, 0 in others. `None` after the caller has stopped
    /// the diagnosis.
    fn residuals_under(&self, candidates: &[(Candidate, Groups)]) -> Option<Vec<Residuals>> {
        let blocks = self.blocks(|_, _| true);
        let of_blocks: Vec<Vec<Vec<f64>>> = blocks
            .into_par_iter()
            .filter(|_| !self.is_stopped())
            .map(|(flight, layout, block)| {
                let mut block = self.evaluator.block(flight, layout, block);
                let of_one = |(candidate, groups): &(Candidate, Groups)| {
                    block.coefficients(candidate, *groups)
                };
                candidates.iter().map(of_one).collect()
            })
            .collect();
        if self.is_stopped() {
            return None;
        }
        let mut all = vec![Residuals::new(); candidates.len()];
        let mut of_blocks = of_blocks.into_iter();
        for flight in self.flights {
            all.iter_mut().for_each(|residuals| residuals.push(Vec::new()));
            for of_block in of_blocks.by_ref().take(flight.blocks.len()) {
                for (residuals, own) in all.iter_mut().zip(of_block) {
                    residuals.last_mut()?.extend(own);
                }
            }
        }
        Some(all)
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
            let part = run.of(residuals);
            let n = (run.end - run.start) as f64;
            let square = product(part, part);
            if let Some(density) = density.last_mut() {
                *density -= 0.5 * (n * variance.ln() + square / variance);
            }
        }
        density
    }

    /// Derivatives of the residuals with respect to `numbers` at `values`, where the residuals are
    /// `base`. Numbers whose steps the physics rejects are left out.
    pub fn columns(&self, values: &[f64], base: &Residuals, numbers: &[usize]) -> Vec<Column> {
        let steps = numbers.iter().filter_map(|number| self.step(values, *number));
        let (steps, candidates): (Vec<Step>, Vec<Vec<Candidate>>) = steps.unzip();
        let with_groups = steps.iter().zip(candidates).flat_map(|(step, candidates)| {
            candidates.into_iter().map(|candidate| (candidate, step.groups))
        });
        let with_groups: Vec<(Candidate, Groups)> = with_groups.collect();
        let Some(moved) = self.residuals_under(&with_groups) else { return Vec::new() };
        let mut moved = moved.into_iter();
        let column = |step: Step| {
            let near = if step.is_beyond { moved.next()? } else { base.clone() };
            let far = moved.next()?;
            let mut column = near;
            for ((column, far), layout) in column.iter_mut().zip(&far).zip(&self.layouts) {
                for ((near, far), bin) in column.iter_mut().zip(far).zip(&layout.bins) {
                    let is_acting = step.groups.has(bin.channel());
                    *near = if is_acting { (far - *near) * step.scale } else { 0.0 };
                }
            }
            Some(Column::new(step.number, column, &self.layouts))
        };
        steps.into_iter().filter_map(column).collect()
    }

    /// The step of a number for its derivative, and the candidates there.
    fn step(&self, values: &[f64], number: usize) -> Option<(Step, Vec<Candidate>)> {
        let described = &self.catalogue.numbers[number];
        let size = described.step(values[number]);
        let up = values[number] + 2.0 * size <= described.bounds[1];
        let sign = if up { 1.0 } else { -1.0 };
        // Switching an effect on may replace another one; both points have it on.
        let is_beyond = values[number] == described.reference
            && self.catalogue.vehicle.linear_drag_n_per_m_s.is_some();
        let moved = |steps: f64| {
            let mut moved = values.to_vec();
            moved[number] += steps * sign * size;
            self.catalogue.candidate(&moved).ok()
        };
        let points: &[f64] = if is_beyond { &[1.0, 2.0] } else { &[1.0] };
        let candidates: Option<Vec<Candidate>> = points.iter().map(|steps| moved(*steps)).collect();
        let groups = Groups::of(described.target);
        Some((Step { number, groups, scale: sign / size, is_beyond }, candidates?))
    }

    /// Sum of products in each bin.
    pub(in crate::diagnose) fn dot(&self, a: &Residuals, b: &Residuals) -> Vec<f64> {
        let mut sums = vec![0.0; Bin::COUNT];
        for run in &self.runs {
            sums[run.bin] += product(run.of(a), run.of(b));
        }
        sums
    }

    /// Sums of products in each bin, row by row: of each column with itself, the later ones and
    /// `base`, without the columns before `from` as second factors.
    pub(in crate::diagnose) fn products(
        &self,
        columns: &[&Column],
        base: &Residuals,
        from: usize,
    ) -> Vec<Vec<f64>> {
        let count = columns.len() + 1;
        let mut starts = Vec::with_capacity(columns.len());
        let mut total = 0;
        for row in 0..columns.len() {
            starts.push(total);
            total += count - row.max(from);
        }
        let mut by_bin: Vec<Vec<&Run>> = vec![Vec::new(); Bin::COUNT];
        self.runs.iter().for_each(|run| by_bin[run.bin].push(run));
        let in_bin = |(bin, runs): (usize, &Vec<&Run>)| {
            let mut sums = vec![0.0; total];
            let columns = columns.iter().enumerate().filter(|(_, column)| column.acts(bin));
            let mut acting: Vec<(usize, &Residuals)> =
                columns.map(|(place, column)| (place, &column.residuals)).collect();
            acting.push((count - 1, base));
            for run in runs {
                for (k, (i, a)) in acting[..acting.len() - 1].iter().enumerate() {
                    let sums = &mut sums[starts[*i]..];
                    for (j, b) in acting[k..].iter().filter(|(j, _)| *j >= from) {
                        sums[j - from.max(*i)] += product(run.of(a), run.of(b));
                    }
                }
            }
            sums
        };
        by_bin.par_iter().enumerate().map(in_bin).collect()
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
