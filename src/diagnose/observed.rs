//! Flights as what is looked at in them: coefficients by place, their products and derivatives.

use rayon::prelude::*;
use sitl::vehicle::{ROTORS, VehicleParams};

use super::hypothesis::Catalogue;
use super::layout::{AT_REST, Layout, Place};
use super::preparation::{Block, PreparedFlight};
use super::residuals::{CHANNELS, COMMAND, Evaluator, Groups, RATE, VELOCITY};

/// Flights with what is looked at in them.
#[derive(Debug)]
pub struct Observed<'a> {
    /// The flights.
    pub flights: &'a [PreparedFlight],
    /// What is looked at, for each.
    pub layouts: Vec<Layout>,
    pub(super) evaluator: &'a Evaluator,
    pub(super) catalogue: &'a Catalogue,
    /// Runs of coefficients of one place: flight, place, start, end.
    runs: Vec<Run>,
    pub(super) counts: Vec<f64>,
    /// Sum of squares at each place that is left at least.
    least: Vec<f64>,
}

/// No equation holds to better than this share of what the rotors can do. Over a short flight a
/// place has few coefficients, which some numbers may explain to the last digit: without this the
/// likelihood has no bound there.
const EXACT: f64 = 1e-5;
/// What a turn of the attitude is compared with, rad/s.
const TURN: f64 = 1.0;

/// The least that is left at each channel: its deviation.
fn least_left(vehicle: &VehicleParams) -> [f64; CHANNELS] {
    let mut most = [TURN; CHANNELS];
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
    most.map(|most| EXACT * most)
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
        let mut deviation = least_left(&catalogue.vehicle);
        // How near a mean is to rest does not bound it: numbers that bring it there to the last
        // digit explain nothing that was read, and their fit is to fail.
        if layouts.iter().any(|layout| layout.is_at_rest) {
            AT_REST.iter().for_each(|channel| deviation[*channel] = 0.0);
        }
        let least = (0..Place::COUNT)
            .map(|place| counts[place] * deviation[Place::channel_of(place)].powi(2))
            .collect();
        Self { flights, layouts, evaluator, catalogue, runs, counts, least }
    }

    /// The same look at other flights.
    pub fn like<'b>(&self, flights: &'b [PreparedFlight]) -> Observed<'b>
    where
        'a: 'b,
    {
        Observed::new(flights, self.evaluator, self.catalogue)
    }

    /// The blocks of the flights that have what is asked for, in order.
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

    /// Sum of squares at each place, with the least that is left.
    pub fn power(&self, residuals: &Residuals) -> Vec<f64> {
        self.least.iter().zip(self.power_of(residuals)).map(|(least, q)| least + q).collect()
    }

    /// Sum of squares at each place.
    pub(super) fn power_of(&self, values: &Residuals) -> Vec<f64> {
        self.dot(values, values)
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
            let [count, square] = &mut sums[Place::channel_of(run.place)];
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

    /// Derivatives of the residuals with respect to changes of one number, each in proportion to
    /// one of several weights of flight and time.
    pub fn columns_by_weight(
        &self,
        values: &[f64],
        number: usize,
        weights: impl Fn(&PreparedFlight, f64) -> Vec<f64> + Sync,
    ) -> Option<Vec<Residuals>> {
        let described = &self.catalogue.numbers[number];
        let step = described.step(values[number]);
        let up = values[number] + step <= described.bounds[1];
        let step = if up { step } else { -step };
        let mut moved = values.to_vec();
        moved[number] += step;
        let [here, there] = [values, &moved].map(|values| self.catalogue.candidate(values).ok());
        let (here, there) = here.zip(there)?;
        let groups = Groups::of(described.target);
        let of_flights: Vec<Vec<Vec<f64>>> = self
            .flights
            .par_iter()
            .zip(&self.layouts)
            .map(|(flight, layout)| {
                let per_step = |time: f64| -> Vec<f64> {
                    weights(flight, time).into_iter().map(|weight| weight / step).collect()
                };
                let candidates = [&here, &there];
                self.evaluator.weighted_change(flight, layout, candidates, groups, per_step)
            })
            .collect();
        let count = of_flights.first()?.len();
        let mut columns = vec![Residuals::new(); count];
        for of_flight in of_flights {
            columns.iter_mut().zip(of_flight).for_each(|(column, part)| column.push(part));
        }
        Some(columns)
    }

    pub(super) fn dot(&self, a: &Residuals, b: &Residuals) -> Vec<f64> {
        let mut sums = vec![0.0; Place::COUNT];
        for run in &self.runs {
            let (a, b) = (&a[run.flight][run.start..run.end], &b[run.flight][run.start..run.end]);
            sums[run.place] += product(a, b);
        }
        sums
    }
}

/// The sum of products, in four sums side by side: one alone waits for itself at every number.
fn product(a: &[f64], b: &[f64]) -> f64 {
    let (fours, others) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest = fours.remainder().iter().zip(others.remainder());
    let mut sums = [0.0; 4];
    for (a, b) in fours.zip(others) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    sums.iter().sum::<f64>() + rest.map(|(a, b)| a * b).sum::<f64>()
}

/// Cost of sums of squares, in nats.
pub(super) fn noise_cost(power: &[f64], counts: &[f64]) -> f64 {
    power
        .iter()
        .zip(counts)
        .filter(|(_, n)| **n > 0.0)
        // What is not a number is no fit at all.
        .map(|(q, n)| match q.is_nan() {
            true => f64::INFINITY,
            false => 0.5 * n * (q.max(f64::MIN_POSITIVE) / n).ln(),
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::residuals::ATTITUDE;

    #[test]
    fn what_is_left_at_least_is_something_and_far_below_any_sensor() {
        for text in [
            include_str!("../../config/vehicles/crazyflie.toml"),
            include_str!("../../config/vehicles/quad1200.toml"),
        ] {
            let least = least_left(&VehicleParams::from_toml_str(text).unwrap());
            assert!(least.iter().all(|deviation| *deviation > 0.0), "{least:?}");
            // m/s^2, rad/s^2, rad/s.
            assert!(least[VELOCITY] < 1e-3 && least[RATE] < 2e-2 && least[ATTITUDE] < 1e-4);
        }
    }
}
