//! Loss and gradient of a network with one hidden ReLU layer over many rows, fused: the hidden
//! layer of a block of rows never leaves the cache.
//!
//! Sixteen rows occupy the lanes side by side, so no sum crosses lanes until a chunk of rows is
//! done. The forward pass keeps a tile of hidden units in registers while it runs over the inputs;
//! the backward pass keeps a tile of the hidden weights' gradient in registers while it runs over
//! the rows of the block. A lane adds at most [`CHUNK`]` / 16` products in f32; all further sums
//! are f64 and run in the order of the rows, whichever thread computed the parts.

#![allow(
    clippy::needless_range_loop,
    reason = "indices below constants unroll, and say which registers are meant"
)]

#[cfg(target_arch = "x86_64")]
use super::lanes::{Avx2, Avx512};
use super::lanes::{Lanes, Packet, Portable, WIDTH};
use super::packed::{Instructions, MOST_OUTPUTS, Packed, Shape};

/// Rows of a block: its hidden layer (256 KiB at 100 units) fits the second-level cache.
pub(super) const BLOCK: usize = BLOCK_GROUPS * WIDTH;
const BLOCK_GROUPS: usize = 40;

/// Rows whose sums one thread computes: about a hundredth of ten milliseconds' work.
pub(super) const CHUNK: usize = 4 * BLOCK;

/// A thread's workspace, allocated once.
pub(super) struct Scratch {
    /// The hidden layer of a block, tile after tile, with the groups of sixteen rows in order
    /// within a tile; the backward pass overwrites it with the derivative of the loss.
    hidden: Vec<Packet>,
    /// The errors of a block.
    errors: Vec<Packet>,
    /// Sums over rows, in the layout of [`Packed::tiles`].
    sums: Vec<Packet>,
    /// Sums of the errors.
    error_sums: [Packet; MOST_OUTPUTS],
    /// Sum of the squared errors.
    squares: Packet,
}

impl Scratch {
    pub fn new(shape: Shape, instructions: Instructions) -> Self {
        let tile = instructions.tile();
        let padded = shape.hidden.div_ceil(tile) * tile;
        Self {
            hidden: vec![Packet::ZERO; padded * BLOCK_GROUPS],
            errors: vec![Packet::ZERO; MOST_OUTPUTS * BLOCK_GROUPS],
            sums: vec![Packet::ZERO; padded * shape.stride()],
            error_sums: [Packet::ZERO; MOST_OUTPUTS],
            squares: Packet::ZERO,
        }
    }
}

/// Writes the sum over the rows of half the squared errors' derivative with respect to each
/// parameter to `gradient`; returns the sum of the squared errors. `packets` holds at most
/// [`CHUNK`] rows of a set.
pub(super) fn gradient(
    net: &Packed,
    packets: &[Packet],
    scratch: &mut Scratch,
    gradient: &mut [f64],
) -> f64 {
    scratch.sums.fill(Packet::ZERO);
    scratch.error_sums = [Packet::ZERO; MOST_OUTPUTS];
    scratch.squares = Packet::ZERO;
    run::<true>(net, packets, scratch);

    let Shape { inputs, hidden, outputs } = net.shape;
    let tile = net.instructions.tile();
    let (weights, rest) = gradient.split_at_mut(hidden * inputs);
    let (hidden_biases, rest) = rest.split_at_mut(hidden);
    let (output_weights, output_biases) = rest.split_at_mut(outputs * hidden);
    for unit in 0..hidden {
        let first = unit / tile * tile * net.shape.stride() + unit % tile;
        let sum = |row: usize| scratch.sums[first + row * tile].sum();
        for input in 0..inputs {
            weights[unit * inputs + input] = sum(input);
        }
        hidden_biases[unit] = sum(inputs);
        for output in 0..outputs {
            output_weights[output * hidden + unit] = sum(inputs + 1 + output);
        }
    }
    for (bias, sum) in output_biases.iter_mut().zip(&scratch.error_sums) {
        *bias = sum.sum();
    }
    scratch.squares.sum()
}

/// Sum of the squared errors over at most [`CHUNK`] rows of a set.
pub(super) fn squared_errors(net: &Packed, packets: &[Packet], scratch: &mut Scratch) -> f64 {
    scratch.squares = Packet::ZERO;
    run::<false>(net, packets, scratch);
    scratch.squares.sum()
}

fn run<const BACKWARD: bool>(net: &Packed, packets: &[Packet], scratch: &mut Scratch) {
    match (net.instructions, net.shape.outputs) {
        // SAFETY: `Instructions::detect` found these instructions on this machine.
        #[cfg(target_arch = "x86_64")]
        (Instructions::Avx512, ..=3) => unsafe { avx512::<BACKWARD, 3>(net, packets, scratch) },
        #[cfg(target_arch = "x86_64")]
        (Instructions::Avx512, _) => unsafe { avx512::<BACKWARD, 8>(net, packets, scratch) },
        #[cfg(target_arch = "x86_64")]
        (Instructions::Avx2, ..=3) => unsafe { avx2::<BACKWARD, 3>(net, packets, scratch) },
        #[cfg(target_arch = "x86_64")]
        (Instructions::Avx2, _) => unsafe { avx2::<BACKWARD, 8>(net, packets, scratch) },
        // SAFETY: needs no special instructions.
        (Instructions::Portable, _) => unsafe {
            blocks::<Portable, BACKWARD, 4, 1, 2, 2, 8>(net, packets, scratch)
        },
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f")]
unsafe fn avx512<const BACKWARD: bool, const O: usize>(
    net: &Packed,
    packets: &[Packet],
    scratch: &mut Scratch,
) {
    // 20 of 32 registers hold sums, forward and backward.
    unsafe { blocks::<Avx512, BACKWARD, 10, 2, 10, 2, O>(net, packets, scratch) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
unsafe fn avx2<const BACKWARD: bool, const O: usize>(
    net: &Packed,
    packets: &[Packet],
    scratch: &mut Scratch,
) {
    // 12 of 16 registers hold sums, forward and backward.
    unsafe { blocks::<Avx2, BACKWARD, 6, 1, 3, 2, O>(net, packets, scratch) }
}

/// Forward over tiles of `J` units by `G` groups of sixteen rows, backward over tiles of `JB` units
/// by `KB` inputs; the outputs are padded to `O`.
///
/// # Safety
/// The machine must have the instructions of `V`.
#[inline(always)]
unsafe fn blocks<
    V: Lanes,
    const BACKWARD: bool,
    const J: usize,
    const G: usize,
    const JB: usize,
    const KB: usize,
    const O: usize,
>(
    net: &Packed,
    packets: &[Packet],
    scratch: &mut Scratch,
) {
    let stride = net.shape.stride();
    let tile_rows = net.tiles.as_chunks::<J>().0;
    for block in packets.chunks(BLOCK_GROUPS * stride) {
        let groups = block.len() / stride;
        let hidden = scratch.hidden.as_chunks_mut::<J>().0;
        let errors = scratch.errors.as_chunks_mut::<O>().0;
        let mut group = 0;
        while group + G <= groups {
            let rows = &block[group * stride..(group + G) * stride];
            unsafe {
                forward::<V, BACKWARD, J, G, O>(
                    net,
                    tile_rows,
                    rows,
                    group,
                    groups,
                    hidden,
                    errors,
                    &mut scratch.squares,
                );
            }
            group += G;
        }
        while group < groups {
            let rows = &block[group * stride..(group + 1) * stride];
            unsafe {
                forward::<V, BACKWARD, J, 1, O>(
                    net,
                    tile_rows,
                    rows,
                    group,
                    groups,
                    hidden,
                    errors,
                    &mut scratch.squares,
                );
            }
            group += 1;
        }
        if !BACKWARD {
            continue;
        }
        let errors = &errors[..groups];
        for (tile, sums) in scratch.sums.as_chunks_mut::<J>().0.chunks_mut(stride).enumerate() {
            let hidden = &mut hidden[tile * groups..(tile + 1) * groups];
            let weights = &tile_rows[tile * stride..(tile + 1) * stride];
            unsafe {
                backward_output::<V, J, O>(net, weights, errors, hidden, sums);
                backward_hidden::<V, J, JB, KB>(net, block, hidden, sums);
            }
        }
        for errors in errors {
            for (sum, error) in scratch.error_sums.iter_mut().zip(errors) {
                unsafe { V::load(sum).plus(V::load(error)).store(sum) };
            }
        }
    }
}

/// The hidden layer and the errors of `G` groups of sixteen rows.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
unsafe fn forward<V: Lanes, const STORE: bool, const J: usize, const G: usize, const O: usize>(
    net: &Packed,
    tile_rows: &[[f32; J]],
    rows: &[Packet],
    group: usize,
    groups: usize,
    hidden: &mut [[Packet; J]],
    errors: &mut [[Packet; O]],
    squares: &mut Packet,
) {
    let Shape { inputs, outputs, .. } = net.shape;
    let stride = net.shape.stride();
    unsafe {
        let mut y = [[V::splat(0.0); G]; O];
        for (y, bias) in y.iter_mut().zip(&net.biases) {
            *y = [V::splat(*bias); G];
        }
        for (tile, weights) in tile_rows.chunks_exact(stride).enumerate() {
            let (input_weights, rest) = weights.split_at(inputs);
            let mut h = [[V::splat(0.0); G]; J];
            for j in 0..J {
                h[j] = [V::splat(rest[0][j]); G];
            }
            for (k, weights) in input_weights.iter().enumerate() {
                let mut x = [V::splat(0.0); G];
                for g in 0..G {
                    x[g] = V::load(&rows[g * stride + k]);
                }
                for j in 0..J {
                    let w = V::splat(weights[j]);
                    for g in 0..G {
                        h[j][g] = h[j][g].plus_product(w, x[g]);
                    }
                }
            }
            for j in 0..J {
                for g in 0..G {
                    h[j][g] = h[j][g].rectified();
                }
            }
            if STORE {
                for g in 0..G {
                    let stored = &mut hidden[tile * groups + group + g];
                    for j in 0..J {
                        h[j][g].store(&mut stored[j]);
                    }
                }
            }
            for (y, weights) in y.iter_mut().zip(&rest[1..]) {
                for j in 0..J {
                    let w = V::splat(weights[j]);
                    for g in 0..G {
                        y[g] = y[g].plus_product(w, h[j][g]);
                    }
                }
            }
        }
        let mut sum = V::load(squares);
        for g in 0..G {
            let rows = &rows[g * stride..(g + 1) * stride];
            let errors = &mut errors[group + g];
            let weight = V::load(&rows[inputs]);
            for o in 0..O {
                // Outputs beyond the network's are 0 and have no target.
                let mut error = y[o][g];
                if o < outputs {
                    error = error.minus(V::load(&rows[inputs + 1 + o])).times(weight);
                }
                sum = sum.plus_product(error, error);
                error.store(&mut errors[o]);
            }
        }
        sum.store(squares);
    }
}

/// The derivatives with respect to the output weights of a tile, and to its hidden units, which
/// they overwrite.
#[inline(always)]
unsafe fn backward_output<V: Lanes, const J: usize, const O: usize>(
    net: &Packed,
    weights: &[[f32; J]],
    errors: &[[Packet; O]],
    hidden: &mut [[Packet; J]],
    sums: &mut [[Packet; J]],
) {
    let Shape { inputs, outputs, .. } = net.shape;
    unsafe {
        for j in 0..J {
            let mut v = [V::splat(0.0); O];
            for (v, weights) in v.iter_mut().zip(&weights[inputs + 1..]) {
                *v = V::splat(weights[j]);
            }
            let mut products = [V::splat(0.0); O];
            for (hidden, errors) in hidden.iter_mut().zip(errors) {
                let h = V::load(&hidden[j]);
                let e = V::load(&errors[0]);
                products[0] = products[0].plus_product(e, h);
                let mut d = v[0].times(e);
                for o in 1..O {
                    let e = V::load(&errors[o]);
                    products[o] = products[o].plus_product(e, h);
                    d = d.plus_product(v[o], e);
                }
                d.where_active(h).store(&mut hidden[j]);
            }
            for (sum, product) in sums[inputs + 1..inputs + 1 + outputs].iter_mut().zip(products) {
                V::load(&sum[j]).plus(product).store(&mut sum[j]);
            }
        }
    }
}

/// The derivatives with respect to the hidden weights and biases of a tile.
#[inline(always)]
unsafe fn backward_hidden<V: Lanes, const J: usize, const JB: usize, const KB: usize>(
    net: &Packed,
    block: &[Packet],
    derivatives: &[[Packet; J]],
    sums: &mut [[Packet; J]],
) {
    let columns = net.shape.inputs + 1;
    let mut k = 0;
    // The columns change last: they come from the second-level cache, the units from the first.
    while k + KB <= columns {
        for first in (0..J).step_by(JB) {
            unsafe { products::<V, J, JB, KB>(net, block, derivatives, sums, first, k) };
        }
        k += KB;
    }
    while k < columns {
        for first in (0..J).step_by(JB) {
            unsafe { products::<V, J, JB, 1>(net, block, derivatives, sums, first, k) };
        }
        k += 1;
    }
}

/// Adds to `sums` the products of `KB` columns from `k` on with `JB` units from `first` on.
#[inline(always)]
unsafe fn products<V: Lanes, const J: usize, const JB: usize, const KB: usize>(
    net: &Packed,
    block: &[Packet],
    derivatives: &[[Packet; J]],
    sums: &mut [[Packet; J]],
    first: usize,
    k: usize,
) {
    let stride = net.shape.stride();
    unsafe {
        let mut products = [[V::splat(0.0); JB]; KB];
        for (rows, derivatives) in block.chunks_exact(stride).zip(derivatives) {
            let columns = &rows[k..k + KB];
            let mut d = [V::splat(0.0); JB];
            for j in 0..JB {
                d[j] = V::load(&derivatives[first + j]);
            }
            for i in 0..KB {
                let x = V::load(&columns[i]);
                for j in 0..JB {
                    products[i][j] = products[i][j].plus_product(x, d[j]);
                }
            }
        }
        for (sums, products) in sums[k..k + KB].iter_mut().zip(products) {
            for j in 0..JB {
                let sum = &mut sums[first + j];
                V::load(sum).plus(products[j]).store(sum);
            }
        }
    }
}
