//! Quality of a model: errors of its accelerations, and of its open-loop predictions.

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::rigid_body::State;

use super::dataset::Row;
use super::not_finite;
use super::prediction::{Baseline, RecordedInputs};
use crate::model::{ACCELERATIONS, Model};

/// Horizons of multi-step predictions, s.
pub const HORIZONS_S: [f64; 4] = [0.02, 0.1, 0.5, 1.0];
/// Time between the starts of windows, s.
const WINDOW_STRIDE_S: f64 = 0.25;

/// Names of the accelerations, in order.
pub const ACCELERATION_NAMES: [&str; ACCELERATIONS] =
    ["a_n", "a_e", "a_d", "alpha_x", "alpha_y", "alpha_z"];

/// Normalised mean squared errors: relative to the variance of the training rows' labels.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct OneStep {
    /// Of each acceleration.
    #[serde(deserialize_with = "not_finite::array")]
    pub each: [f64; ACCELERATIONS],
    /// Mean of the linear ones.
    #[serde(deserialize_with = "not_finite::number")]
    pub linear: f64,
    /// Mean of the angular ones.
    #[serde(deserialize_with = "not_finite::number")]
    pub angular: f64,
    /// Number of rows.
    pub rows: usize,
}

impl OneStep {
    /// The error of `model` against the value that `observed` returns for each row; `None` if it
    /// returns none.
    pub fn of(
        model: &dyn Model,
        rows: &[&Row],
        deviation: &[f64; ACCELERATIONS],
        observed: impl Fn(&Row) -> Option<[f64; ACCELERATIONS]> + Sync,
    ) -> Option<Self> {
        let pair = |row: &Row| Some((model.accelerations(&row.point), observed(row)?));
        Self::of_values(rows, deviation, pair)
    }

    /// The difference between the two values that `pair` returns for each row; `None` if it returns
    /// none.
    pub fn of_values(
        rows: &[&Row],
        deviation: &[f64; ACCELERATIONS],
        pair: impl Fn(&Row) -> Option<([f64; ACCELERATIONS], [f64; ACCELERATIONS])> + Sync,
    ) -> Option<Self> {
        // Fixed pieces, summed in order: the result does not depend on the number of threads.
        let pieces: Vec<([f64; ACCELERATIONS], usize)> = rows
            .par_chunks(4096)
            .map(|piece| {
                let (mut sum, mut count) = ([0.0; ACCELERATIONS], 0);
                for row in piece {
                    let Some((a, b)) = pair(row) else { continue };
                    for i in 0..ACCELERATIONS {
                        sum[i] += ((a[i] - b[i]) / deviation[i]).powi(2);
                    }
                    count += 1;
                }
                (sum, count)
            })
            .collect();
        let rows = pieces.iter().map(|(_, count)| count).sum();
        if rows == 0 {
            return None;
        }
        let each: [f64; ACCELERATIONS] = std::array::from_fn(|i| {
            pieces.iter().map(|(sum, _)| sum[i]).sum::<f64>() / rows as f64
        });
        let mean = |range: std::ops::Range<usize>| each[range].iter().sum::<f64>() / 3.0;
        Some(Self { each, linear: mean(0..3), angular: mean(3..6), rows })
    }
}

/// Root mean square norm of reported minus predicted state, at one horizon.
#[derive(Clone, Copy, Debug, Default, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct StateError {
    /// Of position, m.
    #[serde(deserialize_with = "not_finite::number")]
    pub position_m: f64,
    /// Of velocity, m/s.
    #[serde(deserialize_with = "not_finite::number")]
    pub velocity_m_s: f64,
    /// Of attitude: the rotation angle, rad.
    #[serde(deserialize_with = "not_finite::number")]
    pub attitude_rad: f64,
    /// Of body rate, rad/s.
    #[serde(deserialize_with = "not_finite::number")]
    pub rate_rad_s: f64,
}

impl StateError {
    /// Whether all errors are finite.
    pub fn is_finite(&self) -> bool {
        let Self { position_m, velocity_m_s, attitude_rad, rate_rad_s } = self;
        [position_m, velocity_m_s, attitude_rad, rate_rad_s].iter().all(|error| error.is_finite())
    }
}

/// Errors at each of [`HORIZONS_S`].
pub type MultiStep = [StateError; HORIZONS_S.len()];

/// A source of predictions.
pub enum Predictor<'a> {
    /// A model.
    Model(&'a dyn Model),
    /// A baseline without a model.
    Baseline(Baseline),
}

/// The windows of one flight.
pub struct FlightWindows<'a> {
    /// The flight, and the inputs that act on it.
    pub inputs: RecordedInputs<'a>,
    /// Start of each window, s.
    pub starts: Vec<f64>,
}

/// Sums of squares at each horizon, and number of windows.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    squares: [[f64; 4]; HORIZONS_S.len()],
    windows: usize,
}

/// Windows in a block: with [`WINDOW_STRIDE_S`] 4 s of flight, longer than most gusts.
const BLOCK: usize = 16;

/// Open-loop errors over the windows of some flights, by block of consecutive windows. Errors of
/// one block are alike; blocks are taken as independent.
#[derive(Clone, Debug)]
pub struct WindowErrors {
    blocks: Vec<Sums>,
}

/// Open-loop errors over windows of flights; `None` if there is no window.
pub fn multi_step(
    flights: &[FlightWindows<'_>],
    predictor: &Predictor<'_>,
) -> Option<WindowErrors> {
    let mut blocks = Vec::new();
    for FlightWindows { inputs, starts } in flights {
        blocks.par_extend(starts.par_chunks(BLOCK).map(|starts| {
            let mut sums = Sums::default();
            for start in starts {
                sums.add(inputs, *start, predictor);
            }
            sums
        }));
    }
    let errors = WindowErrors { blocks };
    (errors.windows() > 0).then_some(errors)
}

impl WindowErrors {
    /// Number of windows.
    pub fn windows(&self) -> usize {
        self.blocks.iter().map(|block| block.windows).sum()
    }

    /// Number of blocks.
    pub fn blocks(&self) -> usize {
        self.blocks.len()
    }

    /// The errors over all windows.
    pub fn all(&self) -> MultiStep {
        Sums::over(&self.blocks).errors()
    }

    /// The errors over all blocks but one.
    pub fn without(&self, left_out: usize) -> MultiStep {
        let kept = self.blocks.iter().enumerate().filter(|(block, _)| *block != left_out);
        Sums::over(kept.map(|(_, sums)| sums)).errors()
    }

    /// Blocks of one window with these errors, the same in every quantity at every horizon.
    #[cfg(test)]
    pub fn of_blocks(errors: &[f64]) -> Self {
        let block = |error: &f64| Sums { squares: [[error * error; 4]; 4], windows: 1 };
        Self { blocks: errors.iter().map(block).collect() }
    }
}

impl Sums {
    fn over<'a>(blocks: impl IntoIterator<Item = &'a Self>) -> Self {
        let mut total = Self::default();
        for block in blocks {
            for (mine, theirs) in total.squares.iter_mut().zip(&block.squares) {
                mine.iter_mut().zip(theirs).for_each(|(a, b)| *a += b);
            }
            total.windows += block.windows;
        }
        total
    }

    /// Root mean squares; not finite without a window.
    fn errors(&self) -> MultiStep {
        self.squares.map(|squares| {
            let [position_m, velocity_m_s, attitude_rad, rate_rad_s] =
                squares.map(|square| (square / self.windows as f64).sqrt());
            StateError { position_m, velocity_m_s, attitude_rad, rate_rad_s }
        })
    }

    fn add(&mut self, inputs: &RecordedInputs<'_>, start: f64, predictor: &Predictor<'_>) {
        let Some(state) = inputs.reported(start) else { return };
        let reported: Option<Vec<State>> =
            HORIZONS_S.iter().map(|h| inputs.reported(start + h)).collect();
        let predicted = match predictor {
            Predictor::Model(model) => inputs.predict(*model, start, state, &HORIZONS_S),
            Predictor::Baseline(baseline) => {
                Some(HORIZONS_S.iter().map(|h| baseline.predict(&state, *h)).collect())
            }
        };
        let (Some(reported), Some(predicted)) = (reported, predicted) else { return };
        if predicted.len() < HORIZONS_S.len() {
            return;
        }
        for ((squares, a), b) in self.squares.iter_mut().zip(&reported).zip(&predicted) {
            let errors = [
                (a.position - b.position).norm(),
                (a.velocity - b.velocity).norm(),
                a.attitude.angle_to(b.attitude),
                (a.body_rate - b.body_rate).norm(),
            ];
            squares.iter_mut().zip(errors).for_each(|(sum, e)| *sum += e * e);
        }
        self.windows += 1;
    }
}

/// Start times of windows within spans, s: every quarter of a second, as long as the longest
/// horizon fits.
pub fn window_starts(spans: &[std::ops::Range<f64>]) -> Vec<f64> {
    let longest = HORIZONS_S[HORIZONS_S.len() - 1];
    let mut starts = Vec::new();
    for span in spans {
        let mut start = (span.start * 100.0).ceil() / 100.0;
        while start + longest < span.end {
            starts.push(start);
            start += WINDOW_STRIDE_S;
        }
    }
    starts
}
