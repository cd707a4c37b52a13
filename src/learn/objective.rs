//! Mean squared error of a network over a set of samples, and its gradient, on all threads.

use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::kernel::{self, BLOCK, CHUNK, Instructions, Packed, Scratch, Shape};
use super::lanes::WIDTH;
use super::samples::Samples;

/// The mean of the squared errors over rows and outputs, as a function of the parameters.
///
/// Rows are cut into chunks of a fixed size. Whichever threads compute the chunks, their sums are
/// added in the order of the rows, in f64: the number of threads does not change a bit.
pub(super) struct Objective<'a> {
    samples: Cow<'a, Samples>,
    shape: Shape,
    instructions: Instructions,
    scratches: Mutex<Vec<Scratch>>,
    /// The gradient of each chunk, chunk after chunk.
    partial: Vec<f64>,
}

impl<'a> Objective<'a> {
    pub fn new(samples: Cow<'a, Samples>, shape: Shape) -> Self {
        Self::with_instructions(samples, shape, Instructions::detect())
    }

    pub fn with_instructions(
        samples: Cow<'a, Samples>,
        shape: Shape,
        instructions: Instructions,
    ) -> Self {
        let scratches = Mutex::new(Vec::new());
        Self { samples, shape, instructions, scratches, partial: Vec::new() }
    }

    /// The loss.
    pub fn loss(&self, parameters: &[f32]) -> f64 {
        let net = Packed::new(self.shape, self.instructions, parameters);
        let squares: Vec<f64> = self
            .samples
            .packets()
            .par_chunks(self.chunk())
            .with_max_len(1)
            .map(|rows| self.with_scratch(|scratch| kernel::squared_errors(&net, rows, scratch)))
            .collect();
        squares.iter().sum::<f64>() * self.scale()
    }

    /// The loss, and its gradient into `gradient`.
    pub fn gradient(&mut self, parameters: &[f32], gradient: &mut [f64]) -> f64 {
        let net = Packed::new(self.shape, self.instructions, parameters);
        let size = self.shape.parameters();
        let chunks = self.samples.packets().len().div_ceil(self.chunk());
        let mut partial = std::mem::take(&mut self.partial);
        partial.resize(chunks * size, 0.0);
        let squares: Vec<f64> = partial
            .par_chunks_mut(size)
            .zip(self.samples.packets().par_chunks(self.chunk()))
            .with_max_len(1)
            .map(|(gradient, rows)| {
                self.with_scratch(|scratch| kernel::gradient(&net, rows, scratch, gradient))
            })
            .collect();
        gradient.fill(0.0);
        for partial in partial.chunks(size) {
            for (sum, part) in gradient.iter_mut().zip(partial) {
                *sum += part;
            }
        }
        self.partial = partial;
        let scale = self.scale();
        for derivative in gradient.iter_mut() {
            *derivative *= 2.0 * scale;
        }
        squares.iter().sum::<f64>() * scale
    }

    /// Number of batches.
    pub fn batches(&self) -> usize {
        self.samples.len().div_ceil(BLOCK)
    }

    /// The loss of one batch of rows and its gradient, on the caller's thread.
    pub fn batch_gradient(&self, batch: usize, parameters: &[f32], gradient: &mut [f64]) -> f64 {
        let net = Packed::new(self.shape, self.instructions, parameters);
        let first = batch * BLOCK;
        let last = self.samples.len().min(first + BLOCK);
        let stride = self.samples.stride();
        let rows = first / WIDTH * stride..last.div_ceil(WIDTH) * stride;
        let rows = &self.samples.packets()[rows];
        let squares = self.with_scratch(|scratch| kernel::gradient(&net, rows, scratch, gradient));
        let scale = 1.0 / ((last - first) * self.shape.outputs) as f64;
        for derivative in gradient.iter_mut() {
            *derivative *= 2.0 * scale;
        }
        squares * scale
    }

    /// Packets of a chunk.
    fn chunk(&self) -> usize {
        CHUNK / WIDTH * self.samples.stride()
    }

    fn scale(&self) -> f64 {
        1.0 / (self.samples.len() * self.shape.outputs) as f64
    }

    fn with_scratch<T>(&self, work: impl FnOnce(&mut Scratch) -> T) -> T {
        let pool = || self.scratches.lock().unwrap_or_else(PoisonError::into_inner);
        let free = pool().pop();
        let mut scratch = free.unwrap_or_else(|| Scratch::new(self.shape, self.instructions));
        let result = work(&mut scratch);
        pool().push(scratch);
        result
    }
}
