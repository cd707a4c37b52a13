//! A network with one hidden ReLU layer, and its normalisation.

use serde::{Deserialize, Serialize};

/// `y = V max(W x + b, 0) + c`, in normalised units.
#[derive(Clone, Debug, PartialEq)]
pub struct Mlp {
    /// Number of inputs.
    pub inputs: usize,
    /// Number of hidden units.
    pub hidden: usize,
    /// Number of outputs.
    pub outputs: usize,
    /// W, `hidden` rows of `inputs`.
    pub hidden_weights: Vec<f32>,
    /// b, of length `hidden`.
    pub hidden_biases: Vec<f32>,
    /// V, `outputs` rows of `hidden`.
    pub output_weights: Vec<f32>,
    /// c, of length `outputs`.
    pub output_biases: Vec<f32>,
}

/// `normalised = (value - mean) / deviation`, column by column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Normalization {
    /// Means.
    pub mean: Vec<f64>,
    /// Deviations, above 0.
    pub deviation: Vec<f64>,
}
