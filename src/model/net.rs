//! A network with one hidden ReLU layer, and its normalisation.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `y = V max(W x + b, 0) + c`, in normalised units.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
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

impl Normalization {
    /// The normalised values.
    ///
    /// # Panics
    /// If `N` is not the number of columns.
    pub fn apply<const N: usize>(&self, values: &[f64; N]) -> [f64; N] {
        std::array::from_fn(|i| (values[i] - self.mean[i]) / self.deviation[i])
    }
}

impl Mlp {
    /// Whether the network has this size, and its weights and biases have the lengths that follow.
    pub fn has_size(&self, inputs: usize, hidden: usize, outputs: usize) -> bool {
        let lengths = [
            self.hidden_weights.len(),
            self.hidden_biases.len(),
            self.output_weights.len(),
            self.output_biases.len(),
        ];
        [self.inputs, self.hidden, self.outputs] == [inputs, hidden, outputs]
            && lengths == [hidden * inputs, hidden, outputs * hidden, outputs]
    }

    /// y(x), computed in f64.
    ///
    /// # Panics
    /// If `I` and `O` are not the numbers of the network's inputs and outputs.
    pub fn evaluate<const I: usize, const O: usize>(&self, x: &[f64; I]) -> [f64; O] {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the check above found both instruction sets.
            return unsafe { evaluate_avx2(self, x) };
        }
        evaluate::<false, I, O>(self, x)
    }

    /// y(x) and its derivatives dy/dx, one row per output, computed in f64. At a kink, where a
    /// unit's pre-activation is 0, the unit counts as inactive.
    ///
    /// # Panics
    /// If `I` and `O` are not the numbers of the network's inputs and outputs.
    pub fn linearize<const I: usize, const O: usize>(
        &self,
        x: &[f64; I],
    ) -> ([f64; O], [[f64; I]; O]) {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            // SAFETY: the check above found both instruction sets.
            return unsafe { linearize_avx2(self, x) };
        }
        linearize::<false, I, O>(self, x)
    }
}

/// [`evaluate`] for machines with AVX2 and FMA, which the package's build does not assume: the
/// planner linearises at several hundred points, thousands of times.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn evaluate_avx2<const I: usize, const O: usize>(net: &Mlp, x: &[f64; I]) -> [f64; O] {
    evaluate::<true, I, O>(net, x)
}

/// [`linearize`] for machines with AVX2 and FMA.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn linearize_avx2<const I: usize, const O: usize>(
    net: &Mlp,
    x: &[f64; I],
) -> ([f64; O], [[f64; I]; O]) {
    linearize::<true, I, O>(net, x)
}

#[inline(always)]
fn evaluate<const FUSED: bool, const I: usize, const O: usize>(
    net: &Mlp,
    x: &[f64; I],
) -> [f64; O] {
    let mut y = output_biases(net);
    for_each_unit::<FUSED, I, O>(net, x, |_, v, pre_activation| {
        let h = pre_activation.max(0.0);
        for (y, v) in y.iter_mut().zip(v) {
            *y = product_sum::<FUSED>(*v, h, *y);
        }
    });
    y
}

#[inline(always)]
fn linearize<const FUSED: bool, const I: usize, const O: usize>(
    net: &Mlp,
    x: &[f64; I],
) -> ([f64; O], [[f64; I]; O]) {
    let mut y = output_biases(net);
    let mut jacobian = [[0.0; I]; O];
    // Whether a unit is active is almost random, and a mispredicted branch costs more than a unit's
    // pre-activation: collect the active units without a branch, then visit them.
    let mut active = [(0_usize, [0.0; O]); BATCH];
    let mut count = 0;
    let rows = net.hidden_weights.as_chunks::<I>().0;
    for_each_unit::<FUSED, I, O>(net, x, |unit, v, pre_activation| {
        let h = pre_activation.max(0.0);
        for (y, v) in y.iter_mut().zip(v) {
            *y = product_sum::<FUSED>(*v, h, *y);
        }
        active[count] = (unit, *v);
        count += usize::from(pre_activation > 0.0);
        if count == BATCH {
            add_slopes::<FUSED, I, O>(rows, &active, &mut jacobian);
            count = 0;
        }
    });
    add_slopes::<FUSED, I, O>(rows, &active[..count], &mut jacobian);
    (y, jacobian)
}

/// Number of units that are collected before they are visited.
const BATCH: usize = 64;
/// Columns of the Jacobian that stay in registers while the units are visited.
const COLUMNS: usize = 8;

/// Adds the slopes of active units, each given as a row of W and its output weights.
#[inline(always)]
fn add_slopes<const FUSED: bool, const I: usize, const O: usize>(
    rows: &[[f32; I]],
    active: &[(usize, [f64; O])],
    jacobian: &mut [[f64; I]; O],
) {
    let mut done = 0;
    while done < I {
        // The last block overlaps with finished columns, so that it has eight.
        let first = done.min(I.saturating_sub(COLUMNS));
        let mut sums = [[0.0; COLUMNS]; O];
        for (unit, v) in active {
            let row = &rows[*unit][first..];
            let mut short = [0.0; COLUMNS];
            let w = row.first_chunk::<COLUMNS>().unwrap_or_else(|| {
                short[..row.len()].copy_from_slice(row);
                &short
            });
            for (sums, v) in sums.iter_mut().zip(v) {
                for (sum, w) in sums.iter_mut().zip(w) {
                    *sum = product_sum::<FUSED>(*v, f64::from(*w), *sum);
                }
            }
        }
        let new = done - first;
        for (row, sums) in jacobian.iter_mut().zip(sums) {
            for (derivative, sum) in row[done..].iter_mut().zip(&sums[new..]) {
                *derivative += sum;
            }
        }
        done = first + COLUMNS;
    }
}

fn output_biases<const O: usize>(net: &Mlp) -> [f64; O] {
    assert_eq!(net.outputs, O, "the network's outputs");
    std::array::from_fn(|output| f64::from(net.output_biases[output]))
}

/// Calls `visit` with each hidden unit's index, its output weights, and its pre-activation at `x`.
#[inline(always)]
fn for_each_unit<const FUSED: bool, const I: usize, const O: usize>(
    net: &Mlp,
    x: &[f64; I],
    mut visit: impl FnMut(usize, &[f64; O], f64),
) {
    assert_eq!(net.inputs, I, "the network's inputs");
    let mut columns: [&[f32]; O] = [&[]; O];
    for (column, weights) in columns.iter_mut().zip(net.output_weights.chunks(net.hidden)) {
        *column = weights;
    }
    let rows = net.hidden_weights.as_chunks::<I>().0;
    for (unit, (row, bias)) in rows.iter().zip(&net.hidden_biases).enumerate() {
        // Four partial sums share a register.
        let mut sums = [f64::from(*bias), 0.0, 0.0, 0.0];
        for (w, x) in row.chunks(4).zip(x.chunks(4)) {
            for ((sum, w), x) in sums.iter_mut().zip(w).zip(x) {
                *sum = product_sum::<FUSED>(f64::from(*w), *x, *sum);
            }
        }
        let mut v = [0.0; O];
        for (v, column) in v.iter_mut().zip(columns) {
            *v = f64::from(column[unit]);
        }
        visit(unit, &v, (sums[0] + sums[2]) + (sums[1] + sums[3]));
    }
}

/// `a b + sum`.
#[inline(always)]
fn product_sum<const FUSED: bool>(a: f64, b: f64, sum: f64) -> f64 {
    if FUSED { a.mul_add(b, sum) } else { a * b + sum }
}

/// `normalised = (value - mean) / deviation`, column by column.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize, Deserialize)]
pub struct Normalization {
    /// Mean of each column.
    pub mean: Vec<f64>,
    /// Standard deviation of each column, above 0.
    pub deviation: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn network(values: &[f32], hidden: usize) -> Mlp {
        let mut values = values.iter().copied().cycle();
        let mut take = |count| values.by_ref().take(count).collect::<Vec<_>>();
        Mlp {
            inputs: 13,
            hidden,
            outputs: 3,
            hidden_weights: take(13 * hidden),
            hidden_biases: take(hidden),
            output_weights: take(3 * hidden),
            output_biases: take(3),
        }
    }

    #[test]
    fn network_matches_a_hand_calculation() {
        let net = Mlp {
            inputs: 2,
            hidden: 2,
            outputs: 1,
            hidden_weights: vec![1.0, 2.0, -3.0, 1.0],
            hidden_biases: vec![0.5, 1.0],
            output_weights: vec![2.0, 4.0],
            output_biases: vec![-1.0],
        };
        // Pre-activations 5.5 and 0: the second unit is at its kink.
        assert_eq!(net.evaluate(&[1.0, 2.0]), [10.0]);
        assert_eq!(net.linearize(&[1.0, 2.0]), ([10.0], [[2.0, 4.0]]));
    }

    proptest! {
        #[test]
        fn network_jacobian_matches_finite_differences(
            values in prop::collection::vec(-1.0_f32..1.0, 211),
            at in prop::array::uniform13(-2.0_f64..2.0),
            hidden in 1_usize..40,
        ) {
            let net = network(&values, hidden);
            let (y, jacobian): ([f64; 3], _) = net.linearize(&at);
            let direct: [f64; 3] = net.evaluate(&at);
            for (y, direct) in y.iter().zip(direct) {
                prop_assert!((y - direct).abs() < 1e-12);
            }
            let step = 1e-6;
            let mut away = true;
            for_each_unit::<false, 13, 3>(&net, &at, |_, _, pre_activation| {
                away &= pre_activation.abs() > 2.0 * step; // no weight is above 1
            });
            prop_assume!(away);
            for input in 0..13 {
                let [mut above, mut below] = [at; 2];
                above[input] += step;
                below[input] -= step;
                let [above, below]: [[f64; 3]; 2] = [net.evaluate(&above), net.evaluate(&below)];
                for output in 0..3 {
                    let slope = (above[output] - below[output]) / (2.0 * step);
                    prop_assert!((slope - jacobian[output][input]).abs() < 1e-7);
                }
            }
        }
    }
}
