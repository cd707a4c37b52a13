//! The derivative of a flight's residuals by one number.

use crate::diagnose::likelihood::layout::{Bin, Layout};

/// Residual coefficients of each flight, in the order of its layout.
pub type Residuals = Vec<Vec<f64>>;

/// The derivative of the residuals by one number.
#[derive(Clone, Debug)]
pub struct Column {
    /// Index of the number in the catalogue.
    pub number: usize,
    /// The derivative by it.
    pub residuals: Residuals,
    /// Whether it differs from 0 in each bin: few numbers act on any one channel.
    acts: Vec<bool>,
}

impl Column {
    /// The derivative by `number` on flights with these layouts.
    pub fn new(number: usize, residuals: Residuals, layouts: &[Layout]) -> Self {
        let mut acts = vec![false; Bin::COUNT];
        for (residuals, layout) in residuals.iter().zip(layouts) {
            for (value, bin) in residuals.iter().zip(&layout.bins) {
                acts[bin.index()] |= *value != 0.0;
            }
        }
        Self { number, residuals, acts }
    }

    /// Whether it differs from 0 in the bin of this index.
    pub fn acts(&self, bin: usize) -> bool {
        self.acts[bin]
    }
}
