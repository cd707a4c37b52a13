//! A flexible learner: the residual accelerations of the shipped simulator as a function of the
//! state and the outputs, whatever the cause. It measures how far any explanation by state and
//! outputs could close the gap.
//!
//! It consists of the project's two networks, on rows of a tenth of a second. The labels are the
//! mean residual increments of velocity and body rate, which need no second derivative.

use rayon::prelude::*;
use vehicle::frame::{Frd, Ned};
use vehicle::rigid_body::State;
use vehicle::rotor::Allocation;

use crate::diagnose::catalogue::candidate::Candidate;
use crate::diagnose::flights::preparation::{Block, PreparedFlight};
use crate::diagnose::flights::spectrum::CELL_S;
use crate::diagnose::likelihood::channels::{CHANNELS, RATE, VELOCITY};
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::likelihood::residuals::{Evaluator, Groups};
use crate::learn::dataset::Row;
use crate::learn::networks::train_both;
use crate::learn::summary::TrainSettings;
use crate::learn::training;
use crate::model::features::{Features, Head};
use crate::model::learned::NetworkModel;
use crate::model::{ACCELERATIONS, Model, Point};

/// Cells that a row averages, and cells from one row to the next.
const ROW_CELLS: usize = 10;
const STRIDE_CELLS: usize = 5;
/// Share of each block, at its end, for validation.
const VALIDATION: f64 = 0.25;
/// Weights of the squared network weights that are tried.
const REGULARIZATION: [f64; 3] = [1e-4, 1e-3, 1e-2];
/// Fewest rows for training and for validation.
const ROWS_MIN: usize = 40;

/// Learned corrections of a simulator's accelerations.
#[derive(Clone, Debug)]
pub struct Learner {
    networks: NetworkModel,
    allocation: Allocation,
    /// The largest label of each output. Beyond the training data a network may return anything, and
    /// a prediction that follows it diverges.
    largest: [f64; ACCELERATIONS],
    /// Residual share of the mean square of force and of moment on rows outside the training set,
    /// 0..1.
    pub left: [f64; 2],
}

impl Learner {
    /// Learns the residuals of `candidate` on the fitted flights. `allocation` is the firmware's
    /// mixer. `None` if there are too few rows, or a flight without velocity, attitude and body
    /// rate.
    pub fn of(
        observed: &Observed<'_>,
        evaluator: &Evaluator,
        candidate: &Candidate,
        allocation: &Allocation,
    ) -> Option<Self> {
        let tasks = observed.blocks(|flight, layout| {
            layout.has(VELOCITY) && layout.has(RATE) && flight.channels.attitude
        });
        let groups = Groups { dynamics: true, kinematics: false, command: false };
        let rows: Vec<Vec<Row>> = tasks
            .par_iter()
            .map(|(flight, layout, block)| {
                let series =
                    evaluator.block(flight, layout, block).series(candidate, groups).residuals;
                let firsts = (0..=block.cells - ROW_CELLS).step_by(STRIDE_CELLS);
                firsts.map(|first| row(flight, block, first, &series, allocation)).collect()
            })
            .collect();
        let part = |validates: bool| -> Vec<&Row> {
            let of_block = |rows: &'_ Vec<Row>| (rows.len() as f64 * (1.0 - VALIDATION)) as usize;
            rows.iter()
                .flat_map(
                    |rows| {
                        if validates { &rows[of_block(rows)..] } else { &rows[..of_block(rows)] }
                    },
                )
                .collect()
        };
        let (training, validation) = (part(false), part(true));
        if training.len() < ROWS_MIN || validation.len() < ROWS_MIN {
            return None;
        }
        let largest = std::array::from_fn(|i| {
            training.iter().map(|row| row.label[i].abs()).fold(0.0, f64::max)
        });
        // A force may be fixed to the body or to the world.
        [Features::Body, Features::World]
            .into_iter()
            .filter_map(|features| {
                let parts = [training.as_slice(), validation.as_slice()];
                let networks = train_both(parts, &settings(features), &|row| row.label).ok()?;
                let fits = Head::BOTH.map(|head| HeadAccuracy::of(&networks, head, &validation));
                let networks = networks.scaled(fits.map(|fit| fit.share));
                let left: f64 = fits.iter().map(|fit| fit.left).sum();
                let allocation = *allocation;
                let learner =
                    Self { networks, allocation, largest, left: fits.map(|fit| fit.left) };
                Some((left, learner))
            })
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, learner)| learner)
    }

    /// Acceleration in world axes, m/s^2, and angular acceleration in body axes, rad/s^2, to add to
    /// the simulator's. `outputs` are those of the motors, 0..1.
    pub fn accelerations(&self, state: &State, outputs: [f64; 4]) -> (Ned, Frd) {
        let at = Point {
            velocity: state.velocity,
            body_rate: state.body_rate,
            attitude: state.attitude.euler(),
            input: self.allocation.wrench(outputs),
        };
        let mut corrections = self.networks.accelerations(&at);
        for (correction, largest) in corrections.iter_mut().zip(self.largest) {
            *correction = correction.clamp(-largest, largest);
        }
        let [n, e, d, p, q, r] = corrections;
        (Ned::new(n, e, d), Frd::new(p, q, r))
    }
}

fn settings(features: Features) -> TrainSettings {
    let training::Settings { hidden, passes, method, seed, .. } = training::Settings::default();
    TrainSettings {
        features,
        hidden,
        passes,
        method,
        regularization: REGULARIZATION.into(),
        seed,
        window_half_s: 0.5 * ROW_CELLS as f64 * CELL_S,
        windows_half_s: Vec::new(),
    }
}

/// The row of the cells from `first`: the state at the middle, and the means of the outputs and of
/// the residual accelerations (`series` by channel).
fn row(
    flight: &PreparedFlight,
    block: &Block,
    first: usize,
    series: &[Vec<f64>; CHANNELS],
    allocation: &Allocation,
) -> Row {
    let cells = first..first + ROW_CELLS;
    let time = block.edge(first) + 0.5 * ROW_CELLS as f64 * CELL_S;
    let mut outputs = [0.0; 4];
    for cell in cells.clone() {
        for (sum, output) in outputs.iter_mut().zip(flight.outputs.at(block.middle(cell))) {
            *sum += output / ROW_CELLS as f64;
        }
    }
    let mean =
        |channel: usize| series[channel][cells.clone()].iter().sum::<f64>() / ROW_CELLS as f64;
    Row {
        time,
        point: Point {
            velocity: flight.velocity.at(time).into(),
            body_rate: flight.body_rate.at(time).into(),
            attitude: flight.attitude.attitude_at(time).euler(),
            input: allocation.wrench(outputs),
        },
        label: std::array::from_fn(|i| mean(if i < 3 { VELOCITY + i } else { RATE + i - 3 })),
        truth: None,
    }
}

/// The accuracy of a network on rows outside its training set.
#[derive(Clone, Copy, Debug, PartialEq)]
struct HeadAccuracy {
    /// The best scale of its output, 0..1, by least squares.
    share: f64,
    /// Residual share of the labels' mean square with that scale, 0..1.
    left: f64,
}

impl HeadAccuracy {
    fn of(networks: &NetworkModel, head: Head, rows: &[&Row]) -> Self {
        Self::between(rows.iter().flat_map(|row| {
            let predicted: [f64; ACCELERATIONS] = networks.accelerations(&row.point);
            head.rows().map(move |i| (predicted[i], row.label[i]))
        }))
    }

    /// Fits pairs of an output and its label.
    fn between(pairs: impl Iterator<Item = (f64, f64)>) -> Self {
        let (mut product, mut outputs, mut labels) = (0.0, 0.0, 0.0);
        for (x, y) in pairs {
            product += x * y;
            outputs += x * x;
            labels += y * y;
        }
        let share = if outputs > 0.0 { (product / outputs).clamp(0.0, 1.0) } else { 0.0 };
        let after = labels - 2.0 * share * product + share * share * outputs;
        Self { share, left: if labels > 0.0 { after / labels } else { 0.0 } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn network_output_twice_too_large_is_halved() {
        let fit = HeadAccuracy::between([(2.0, 1.0), (-4.0, -2.0)].into_iter());
        assert_eq!(fit, HeadAccuracy { share: 0.5, left: 0.0 });
        // An output opposed to the labels is scaled to 0, and an output of 0 leaves everything.
        assert_eq!(
            HeadAccuracy::between([(1.0, -1.0)].into_iter()),
            HeadAccuracy { share: 0.0, left: 1.0 }
        );
        assert_eq!(
            HeadAccuracy::between([(0.0, 1.0)].into_iter()),
            HeadAccuracy { share: 0.0, left: 1.0 }
        );
    }
}
