//! A network with one hidden ReLU layer, and its normalisation.

use serde::{Deserialize, Serialize};

/// `y = V max(W x + b, 0) + c`, in normalised units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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

impl Normalization {
    /// The normalised values, written to the front of `out`.
    pub fn apply<'a, const N: usize>(&self, values: &[f64], out: &'a mut [f64; N]) -> &'a [f64] {
        for (((out, value), mean), deviation) in
            out.iter_mut().zip(values).zip(&self.mean).zip(&self.deviation)
        {
            *out = (value - mean) / deviation;
        }
        &out[..values.len()]
    }
}

impl Mlp {
    /// y for x.
    pub fn evaluate(&self, x: &[f64], y: &mut [f64]) {
        y.iter_mut().zip(&self.output_biases).for_each(|(y, c)| *y = f64::from(*c));
        for j in 0..self.hidden {
            let row = &self.hidden_weights[j * self.inputs..][..self.inputs];
            let z = f64::from(self.hidden_biases[j])
                + row.iter().zip(x).map(|(w, x)| f64::from(*w) * x).sum::<f64>();
            if z > 0.0 {
                for (k, y) in y.iter_mut().enumerate() {
                    *y += f64::from(self.output_weights[k * self.hidden + j]) * z;
                }
            }
        }
    }

    /// y for x and dy/dx, `outputs` rows of `inputs`.
    pub fn linearize(&self, x: &[f64], y: &mut [f64], jacobian: &mut [f64]) {
        y.iter_mut().zip(&self.output_biases).for_each(|(y, c)| *y = f64::from(*c));
        jacobian.fill(0.0);
        for j in 0..self.hidden {
            let row = &self.hidden_weights[j * self.inputs..][..self.inputs];
            let z = f64::from(self.hidden_biases[j])
                + row.iter().zip(x).map(|(w, x)| f64::from(*w) * x).sum::<f64>();
            if z > 0.0 {
                for (k, y) in y.iter_mut().enumerate() {
                    let v = f64::from(self.output_weights[k * self.hidden + j]);
                    *y += v * z;
                    for (slope, w) in jacobian[k * self.inputs..].iter_mut().zip(row) {
                        *slope += v * f64::from(*w);
                    }
                }
            }
        }
    }
}
