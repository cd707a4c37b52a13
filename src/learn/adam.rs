//! Adam (Kingma and Ba 2015) on batches; its step size falls to zero along a half cosine.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Decay of the mean gradient.
const MEAN_DECAY: f32 = 0.9;
/// Decay of the mean squared gradient.
const SQUARE_DECAY: f32 = 0.999;
/// Added to the root of the mean square.
const EPSILON: f32 = 1e-8;

/// The optimiser's state.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub(super) struct Adam {
    means: Vec<f32>,
    squares: Vec<f32>,
    /// Steps taken.
    steps: u64,
}

impl Adam {
    pub fn new(parameters: usize) -> Self {
        Self { means: vec![0.0; parameters], squares: vec![0.0; parameters], steps: 0 }
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.means.len().min(self.squares.len())
    }

    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f64], rate: f64) {
        self.steps += 1;
        let steps = self.steps as f64;
        let mean_bias = 1.0 - f64::from(MEAN_DECAY).powf(steps);
        let square_bias = 1.0 - f64::from(SQUARE_DECAY).powf(steps);
        let rate = (rate / mean_bias) as f32;
        let scale = (1.0 / square_bias.sqrt()) as f32;
        let memory = self.means.iter_mut().zip(&mut self.squares);
        for ((parameter, &derivative), (mean, square)) in
            parameters.iter_mut().zip(gradient).zip(memory)
        {
            let derivative = derivative as f32;
            *mean += (1.0 - MEAN_DECAY) * (derivative - *mean);
            *square += (1.0 - SQUARE_DECAY) * (derivative * derivative - *square);
            *parameter -= rate * *mean / (square.sqrt() * scale + EPSILON);
        }
    }
}

/// The step size after a fraction `progress` (0 to 1) of the training.
pub(super) fn rate(first: f64, progress: f64) -> f64 {
    0.5 * first * (1.0 + (std::f64::consts::PI * progress).cos())
}
