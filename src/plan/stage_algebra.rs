//! Small dense matrices of constant size, for the stages of a horizon.
//!
//! Every function is inlined into callers compiled for the machine's vector instructions; `FUSED`
//! states that the machine has a fused multiply-add.

// Matrix algebra reads best with explicit indices.
#![allow(clippy::needless_range_loop)]

/// A matrix as an array of rows.
pub(super) type Matrix<const R: usize, const C: usize> = [[f64; C]; R];

/// A matrix is not positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NotPositive;

/// `a b + sum`.
#[inline(always)]
fn product_sum<const FUSED: bool>(a: f64, b: f64, sum: f64) -> f64 {
    if FUSED { a.mul_add(b, sum) } else { a * b + sum }
}

#[inline(always)]
pub(super) fn dot<const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[inline(always)]
pub(super) fn add_scaled<const FUSED: bool, const C: usize>(
    sums: &mut [f64; C],
    scale: f64,
    row: &[f64; C],
) {
    for (sum, entry) in sums.iter_mut().zip(row) {
        *sum = product_sum::<FUSED>(scale, *entry, *sum);
    }
}

/// Rows whose sums share registers.
const BLOCK: usize = 4;

/// `X Y`.
#[inline(always)]
pub(super) fn product<const FUSED: bool, const R: usize, const M: usize, const C: usize>(
    x: &Matrix<R, M>,
    y: &Matrix<M, C>,
) -> Matrix<R, C> {
    let mut out = [[0.0; C]; R];
    for (out, x) in out.chunks_mut(BLOCK).zip(x.chunks(BLOCK)) {
        let mut sums = [[0.0; C]; BLOCK];
        for (k, y) in y.iter().enumerate() {
            for (sums, x) in sums.iter_mut().zip(x) {
                add_scaled::<FUSED, C>(sums, x[k], y);
            }
        }
        out.copy_from_slice(&sums[..out.len()]);
    }
    out
}

/// `X' Y`.
#[inline(always)]
pub(super) fn transposed_product<
    const FUSED: bool,
    const M: usize,
    const R: usize,
    const C: usize,
>(
    x: &Matrix<M, R>,
    y: &Matrix<M, C>,
) -> Matrix<R, C> {
    let mut out = [[0.0; C]; R];
    for (block, out) in out.chunks_mut(BLOCK).enumerate() {
        let mut sums = [[0.0; C]; BLOCK];
        for (x, y) in x.iter().zip(y) {
            for (sums, x) in sums.iter_mut().zip(&x[block * BLOCK..]) {
                add_scaled::<FUSED, C>(sums, *x, y);
            }
        }
        out.copy_from_slice(&sums[..out.len()]);
    }
    out
}

/// `X v`.
#[inline(always)]
pub(super) fn times_vector<const FUSED: bool, const R: usize, const C: usize>(
    x: &Matrix<R, C>,
    v: &[f64; C],
) -> [f64; R] {
    let mut out = [0.0; R];
    for (out, row) in out.iter_mut().zip(x) {
        let mut sums = [0.0; 4];
        for (row, v) in row.chunks(4).zip(v.chunks(4)) {
            for ((sum, entry), v) in sums.iter_mut().zip(row).zip(v) {
                *sum = product_sum::<FUSED>(*entry, *v, *sum);
            }
        }
        *out = (sums[0] + sums[2]) + (sums[1] + sums[3]);
    }
    out
}

/// Adds `X' v`.
#[inline(always)]
pub(super) fn transposed_times<const FUSED: bool, const R: usize, const C: usize>(
    x: &Matrix<R, C>,
    v: &[f64; R],
    sums: &mut [f64; C],
) {
    for (row, v) in x.iter().zip(v) {
        add_scaled::<FUSED, C>(sums, *v, row);
    }
}

/// The lower Cholesky factor in place, its diagonal inverted.
#[inline(always)]
pub(super) fn cholesky<const N: usize>(matrix: &mut Matrix<N, N>) -> Result<(), NotPositive> {
    for j in 0..N {
        let mut pivot = matrix[j][j];
        for k in 0..j {
            pivot -= matrix[j][k] * matrix[j][k];
        }
        if pivot.is_nan() || pivot <= 0.0 {
            return Err(NotPositive);
        }
        let inverse = 1.0 / pivot.sqrt();
        matrix[j][j] = inverse;
        for i in j + 1..N {
            let mut entry = matrix[i][j];
            for k in 0..j {
                entry -= matrix[i][k] * matrix[j][k];
            }
            matrix[i][j] = entry * inverse;
        }
    }
    Ok(())
}

/// Solves `L L' X = Y` in place.
#[inline(always)]
pub(super) fn solve_rows<const FUSED: bool, const N: usize, const C: usize>(
    factor: &Matrix<N, N>,
    rows: &mut Matrix<N, C>,
) {
    for i in 0..N {
        let mut row = rows[i];
        for k in 0..i {
            add_scaled::<FUSED, C>(&mut row, -factor[i][k], &rows[k]);
        }
        rows[i] = row.map(|entry| entry * factor[i][i]);
    }
    for i in (0..N).rev() {
        let mut row = rows[i];
        for k in i + 1..N {
            add_scaled::<FUSED, C>(&mut row, -factor[k][i], &rows[k]);
        }
        rows[i] = row.map(|entry| entry * factor[i][i]);
    }
}

/// Solves `L L' x = y` in place.
#[inline(always)]
pub(super) fn solve_vector<const N: usize>(factor: &Matrix<N, N>, y: &mut [f64; N]) {
    for i in 0..N {
        let mut entry = y[i];
        for k in 0..i {
            entry -= factor[i][k] * y[k];
        }
        y[i] = entry * factor[i][i];
    }
    for i in (0..N).rev() {
        let mut entry = y[i];
        for k in i + 1..N {
            entry -= factor[k][i] * y[k];
        }
        y[i] = entry * factor[i][i];
    }
}
