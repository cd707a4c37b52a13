//! A flexible learner: what the shipped simulator leaves of the accelerations, as a function of the
//! state and the outputs, whatever the cause. How far it closes the gap is what an explanation by
//! state and outputs can be measured against.
//!
//! The project's own two networks, on rows of a tenth of a second: the means of the residual
//! increments of velocity and body rate, which nothing differentiates twice.

use rayon::prelude::*;
use sitl::frame::{Attitude, Frd, Ned};
use sitl::rotor::Allocation;

use super::candidate::Candidate;
use super::observed::Observed;
use super::preparation::{Block, PreparedFlight};
use super::residuals::{Evaluator, Groups, RATE, VELOCITY};
use super::spectrum::CELL_S;
use crate::learn::dataset::Row;
use crate::learn::networks::train_both;
use crate::model::learned::{Features, Head, NetworkModel};
use crate::model::{ACCELERATIONS, Model, Point};

/// Cells that a row is the mean over, and from one row to the next.
const ROW_CELLS: usize = 10;
const STRIDE_CELLS: usize = 5;
/// One block of so many is for validation.
const VALIDATION_EVERY: usize = 4;
/// Weights of the squared weights that are tried.
const REGULARIZATION: [f64; 3] = [1e-4, 1e-3, 1e-2];
/// Fewer rows teach nothing.
const ROWS_MIN: usize = 100;

/// Accelerations that a simulator lacks, learned.
#[derive(Clone, Debug)]
pub struct Learner {
    networks: NetworkModel,
    allocation: Allocation,
}

impl Learner {
    /// Learns what `candidate` leaves of the flights of the fit. `None` where they are too few or
    /// do not report velocity, attitude and body rate.
    pub fn of(
        observed: &Observed<'_>,
        evaluator: &Evaluator,
        candidate: &Candidate,
        allocation: &Allocation,
    ) -> Option<Self> {
        let tasks: Vec<_> = observed
            .flights
            .iter()
            .zip(&observed.layouts)
            .filter(|(flight, layout)| {
                layout.has(VELOCITY) && layout.has(RATE) && flight.channels.attitude
            })
            .flat_map(|(flight, layout)| flight.blocks.iter().map(move |b| (flight, layout, b)))
            .collect();
        let groups = Groups { dynamics: true, kinematics: false, command: false };
        let rows: Vec<Vec<Row>> = tasks
            .par_iter()
            .map(|(flight, layout, block)| {
                let series = evaluator.series(flight, layout, block, candidate, groups);
                let mean = |channel: usize, first: usize| {
                    series[channel][first..first + ROW_CELLS].iter().sum::<f64>() / ROW_CELLS as f64
                };
                let firsts = (0..=block.cells - ROW_CELLS).step_by(STRIDE_CELLS);
                let row = |first: usize| Row {
                    time: block.edge(first) + 0.5 * ROW_CELLS as f64 * CELL_S,
                    point: point(flight, block, first, allocation),
                    label: std::array::from_fn(|i| match i {
                        0..3 => mean(VELOCITY + i, first),
                        _ => mean(RATE + i - 3, first),
                    }),
                    truth: None,
                };
                firsts.map(row).collect()
            })
            .collect();
        let part = |validates: bool| -> Vec<&Row> {
            let kept = rows.iter().enumerate();
            kept.filter(|(i, _)| (i % VALIDATION_EVERY == VALIDATION_EVERY - 1) == validates)
                .flat_map(|(_, rows)| rows)
                .collect()
        };
        let (training, validation) = (part(false), part(true));
        if training.len() < ROWS_MIN || validation.len() < ROWS_MIN {
            return None;
        }
        let parts = [training.as_slice(), validation.as_slice()];
        // A force may be tied to the body, or to the world.
        [Features::Heading, Features::World]
            .into_iter()
            .filter_map(|features| {
                let networks =
                    train_both(features, parts, &REGULARIZATION, &|row| row.label).ok()?;
                let shares = Head::BOTH.map(|head| share(&networks, head, &validation));
                let networks = networks.scaled(shares);
                let left: f64 =
                    Head::BOTH.iter().map(|head| left(&networks, *head, &validation)).sum();
                Some((left, Self { networks, allocation: *allocation }))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, learner)| learner)
    }

    /// Acceleration and angular acceleration to add to the simulator's.
    pub fn accelerations(
        &self,
        velocity: Ned,
        attitude: Attitude,
        body_rate: Frd,
        outputs: [f64; 4],
    ) -> (Ned, Frd) {
        let input = self.allocation.wrench(outputs);
        let at = Point { velocity, body_rate, attitude: attitude.euler(), input };
        let [n, e, d, p, q, r] = self.networks.accelerations(&at);
        (Ned::new(n, e, d), Frd::new(p, q, r))
    }
}

/// Where the vehicle is in the middle of a row, with the mean of the outputs.
fn point(flight: &PreparedFlight, block: &Block, first: usize, allocation: &Allocation) -> Point {
    let middle = block.edge(first) + 0.5 * ROW_CELLS as f64 * CELL_S;
    let [w, x, y, z] = flight.attitude.at(middle);
    let mut outputs = [0.0; 4];
    for cell in first..first + ROW_CELLS {
        for (sum, output) in outputs.iter_mut().zip(flight.outputs.at(block.middle(cell))) {
            *sum += output / ROW_CELLS as f64;
        }
    }
    Point {
        velocity: flight.velocity.at(middle).into(),
        body_rate: flight.body_rate.at(middle).into(),
        attitude: Attitude { w, x, y, z }.normalized().euler(),
        input: allocation.wrench(outputs),
    }
}

/// Share of the rows' mean square that a network leaves.
fn left(networks: &NetworkModel, head: Head, rows: &[&Row]) -> f64 {
    let (mut after, mut before) = (0.0, 0.0);
    for row in rows {
        let said: [f64; ACCELERATIONS] = networks.accelerations(&row.point);
        for i in head.rows() {
            after += (row.label[i] - said[i]).powi(2);
            before += row.label[i].powi(2);
        }
    }
    if before > 0.0 { after / before } else { 0.0 }
}

/// The share of what a network says that serves rows which it was not trained on best, 0..1.
fn share(networks: &NetworkModel, head: Head, rows: &[&Row]) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for row in rows {
        let said: [f64; ACCELERATIONS] = networks.accelerations(&row.point);
        for i in head.rows() {
            product += said[i] * row.label[i];
            square += said[i] * said[i];
        }
    }
    if square > 0.0 { (product / square).clamp(0.0, 1.0) } else { 0.0 }
}
