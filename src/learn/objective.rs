//! Mean squared error of a network over a set of samples, and its gradient, on all threads.

use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use super::kernel::{self, BLOCK, CHUNK, Scratch};
use super::lanes::WIDTH;
use super::packed::{Instructions, Packed, Shape};
use super::samples::Samples;

/// The mean of the squared errors over rows and outputs, as a function of the parameters.
///
/// Rows are divided into chunks of a fixed size. Whichever threads compute the chunks, their sums
/// are added in the order of the rows, in f64: the result does not depend on the number of threads.
pub(super) struct Objective<'a> {
    samples: Cow<'a, Samples>,
    shape: Shape,
    instructions: Instructions,
    scratches: Mutex<Vec<Scratch>>,
    /// The gradients of the chunks, one after the other.
    partial: Vec<f64>,
}

impl<'a> Objective<'a> {
    pub fn new(samples: Cow<'a, Samples>, shape: Shape) -> Self {
        Self::with_instructions(samples, shape, Instructions::detect())
    }

    fn with_instructions(
        samples: Cow<'a, Samples>,
        shape: Shape,
        instructions: Instructions,
    ) -> Self {
        let scratches = Mutex::new(Vec::new());
        Self { samples, shape, instructions, scratches, partial: Vec::new() }
    }

    /// The loss over all samples.
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

    /// Computes the loss, and writes its gradient to `gradient`.
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

    /// The loss of one batch of rows and its gradient, computed on the calling thread.
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

    /// Number of packets in a chunk.
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    fn random_problem(shape: Shape, rows: usize, seed: u64) -> (Samples, Vec<f32>) {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut values = |count: usize| -> Vec<f32> {
            (0..count).map(|_| random.random_range(-1.0..1.0)).collect()
        };
        let mut samples = Samples::with_capacity(shape.inputs, shape.outputs, rows);
        for _ in 0..rows {
            let (inputs, targets) = (values(shape.inputs), values(shape.outputs));
            samples.push(&inputs, &targets).expect("finite values");
        }
        (samples, values(shape.parameters()))
    }

    /// The loss and its gradient, row by row in f64, and the least distance of a hidden unit from
    /// its kink.
    fn naive(samples: &Samples, shape: Shape, parameters: &[f64]) -> (f64, Vec<f64>, f64) {
        let Shape { inputs, hidden, outputs } = shape;
        let bias = hidden * inputs;
        let weight = bias + hidden;
        let mut gradient = vec![0.0; parameters.len()];
        let (mut loss, mut margin) = (0.0, f64::INFINITY);
        for row in 0..samples.len() {
            let row: Vec<f64> = samples.row(row).map(f64::from).collect();
            let (x, targets) = row.split_at(inputs);
            let pre_activation = |unit: usize| -> f64 {
                let weights = &parameters[unit * inputs..(unit + 1) * inputs];
                let sum: f64 = weights.iter().zip(x).map(|(w, x)| w * x).sum();
                sum + parameters[bias + unit]
            };
            let units: Vec<f64> = (0..hidden).map(pre_activation).collect();
            for (output, target) in targets.iter().enumerate() {
                let weights = &parameters[weight + output * hidden..][..hidden];
                let sum: f64 = weights.iter().zip(&units).map(|(v, z)| v * z.max(0.0)).sum();
                let error = sum + parameters[weight + outputs * hidden + output] - target;
                let slope = 2.0 * error;
                loss += error * error;
                gradient[weight + outputs * hidden + output] += slope;
                for (unit, z) in units.iter().enumerate() {
                    margin = margin.min(z.abs());
                    if *z > 0.0 {
                        gradient[weight + output * hidden + unit] += slope * z;
                        gradient[bias + unit] += slope * weights[unit];
                        for (input, x) in x.iter().enumerate() {
                            gradient[unit * inputs + input] += slope * weights[unit] * x;
                        }
                    }
                }
            }
        }
        let scale = 1.0 / (samples.len() * outputs) as f64;
        gradient.iter_mut().for_each(|derivative| *derivative *= scale);
        (loss * scale, gradient, margin)
    }

    fn shapes() -> impl Strategy<Value = Shape> {
        (1..=16_usize, prop::sample::select(vec![1_usize, 2, 7, 10, 33, 100]), 1..=8_usize)
            .prop_map(|(inputs, hidden, outputs)| Shape { inputs, hidden, outputs })
    }

    /// Every instruction set of this machine.
    fn instructions() -> Vec<Instructions> {
        let mut all = vec![Instructions::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                all.push(Instructions::Avx2);
            }
            if is_x86_feature_detected!("avx512f") {
                all.push(Instructions::Avx512);
            }
        }
        all
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn every_instruction_set_agrees_with_plain_sums(
            shape in shapes(),
            rows in prop::sample::select(vec![1_usize, 15, 16, 17, 100, BLOCK + 5, CHUNK + 31]),
            seed in any::<u64>(),
        ) {
            let (samples, parameters) = random_problem(shape, rows, seed);
            let wide: Vec<f64> = parameters.iter().copied().map(f64::from).collect();
            let (loss, gradient, margin) = naive(&samples, shape, &wide);
            prop_assume!(margin > 1e-6); // else rounding decides whether a unit is active
            prop_assume!(loss > 0.02); // else rounding is most of an error that all but cancels
            for instructions in instructions() {
                let samples = Cow::Borrowed(&samples);
                let mut objective = Objective::with_instructions(samples, shape, instructions);
                let mut found = vec![f64::NAN; shape.parameters()];
                let found_loss = objective.gradient(&parameters, &mut found);
                prop_assert!((found_loss / loss - 1.0).abs() < 1e-5);
                prop_assert_eq!(objective.loss(&parameters).to_bits(), found_loss.to_bits());
                let size = gradient.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
                for (found, expected) in found.iter().zip(&gradient) {
                    prop_assert!((found - expected).abs() < 1e-5 * size, "{instructions:?}");
                }
            }
        }

        #[test]
        fn gradient_matches_finite_differences(shape in shapes(), seed in any::<u64>()) {
            let (samples, parameters) = random_problem(shape, 20, seed);
            let wide: Vec<f64> = parameters.iter().copied().map(f64::from).collect();
            let step = 1e-5;
            let (_, _, margin) = naive(&samples, shape, &wide);
            prop_assume!(margin > 1.1 * step);
            let mut gradient = vec![0.0; wide.len()];
            Objective::new(Cow::Borrowed(&samples), shape).gradient(&parameters, &mut gradient);
            let size = gradient.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            for index in (0..wide.len()).step_by(1 + wide.len() / 20) {
                let loss = |offset| {
                    let mut moved = wide.clone();
                    moved[index] += offset;
                    naive(&samples, shape, &moved).0
                };
                let slope = (loss(step) - loss(-step)) / (2.0 * step);
                prop_assert!((gradient[index] - slope).abs() < 1e-4 * size);
            }
        }
    }

    #[test]
    fn batches_add_up_to_the_whole() {
        let shape = Shape { inputs: 3, hidden: 5, outputs: 2 };
        let (samples, parameters) = random_problem(shape, 2 * BLOCK + 7, 1);
        let mut objective = Objective::new(Cow::Borrowed(&samples), shape);
        let mut gradient = vec![0.0; shape.parameters()];
        let loss = objective.gradient(&parameters, &mut gradient);
        let (mut part, mut sum, mut losses) = (gradient.clone(), vec![0.0; gradient.len()], 0.0);
        assert_eq!(objective.batches(), 3);
        for (batch, rows) in [BLOCK, BLOCK, 7].into_iter().enumerate() {
            let share = rows as f64 / samples.len() as f64;
            losses += share * objective.batch_gradient(batch, &parameters, &mut part);
            for (sum, part) in sum.iter_mut().zip(&part) {
                *sum += share * part;
            }
        }
        assert!((losses - loss).abs() < 1e-6 * loss);
        for (sum, whole) in sum.iter().zip(&gradient) {
            assert!((sum - whole).abs() < 1e-6);
        }
    }
}
