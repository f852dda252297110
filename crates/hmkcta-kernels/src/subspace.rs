//! Orthonormal bases and leading subspaces. Bases are transposed: a basis is `rank` rows of `length` numbers.

use crate::chain::transpose;
use crate::dots::{dots, dots_on};
use crate::gemm::{Matrix, multiply_on};
use crate::machine::dispatch;
use crate::threads::{PARALLEL, PIECES, PRODUCTS, for_each_with, room};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// What is left of a vector once its parts along the ones before are taken out counts as rounding noise below this
/// share of its length: float32's 1e-7 with two digits to spare.
const DEPENDENT: f64 = 1e-5;
/// Shorter vectors are zero: their inverse length would leave float32.
const TINY: f64 = 1e-30;
/// Bases whose Gram matrix is this close to the identity are taken as they are.
const ORTHONORMAL: f64 = 1e-5;
/// Numbers of a row converted to float64 at a time.
const PIECE: usize = 256;
/// A multiple of the lanes of every vector of float64.
const LANES: usize = 16;

/// Buffers of this module.
#[derive(Default)]
pub struct Buffers {
    coefficients: Vec<f32>,
    product: Vec<f32>,
    factor: Vec<f32>,
    gram: Vec<f64>,
    inverse: Vec<f64>,
    wide: Vec<f64>,
    partial: Vec<f64>,
}

impl Buffers {
    /// Inner products of all rows, `[rank, rank]`, in float64; the upper triangle is left zero.
    fn gram(&mut self, v: &[f32], rank: usize, parallel: bool) {
        let (length, size) = (v.len() / rank, rank * rank);
        let gram = &mut self.gram;
        gram.clear();
        gram.resize(size, 0.0);
        if v.len() < PARALLEL {
            return add_gram(v, rank, 0..length, &mut self.wide, gram);
        }
        // Pieces that take longer than what they are added up from.
        let piece = length.div_ceil(PIECES).max(rank).next_multiple_of(PIECE);
        let partial = room(&mut self.partial, length.div_ceil(piece) * size);
        partial.fill(0.0);
        let parallel = parallel && size / 2 * length >= PRODUCTS;
        let tasks = (0..length).step_by(piece).zip(partial.chunks_exact_mut(size)).collect();
        for_each_with(parallel, tasks, |(from, partial): (usize, &mut [f64]), wide| {
            add_gram(v, rank, from..length.min(from + piece), wide, partial);
        });
        for partial in partial.chunks_exact(size) {
            gram.iter_mut().zip(partial).for_each(|(to, sum)| *to += sum);
        }
    }

    /// The factor `[rank, rank]` by which rows with the present Gram matrix become orthonormal in the order they stand
    /// in, rows that depend on earlier ones becoming zero: the inverse Cholesky factor, as Gram and Schmidt would have it.
    fn orthonormalising_factor(&mut self, rank: usize) {
        let (gram, inverse) = (&mut self.gram, &mut self.inverse);
        self.factor.clear();
        self.factor.resize(rank * rank, 0.0);
        inverse.clear();
        inverse.resize(rank * rank, 0.0);
        for r in 0..rank {
            let length = gram[r * rank + r];
            // Row r of L, in place of the Gram matrix; rows found dependent have no column in L.
            for q in 0..r {
                let known: f64 = (0..q).map(|s| gram[r * rank + s] * gram[q * rank + s]).sum();
                let pivot = gram[q * rank + q];
                gram[r * rank + q] = if pivot > 0.0 { (gram[r * rank + q] - known) / pivot } else { 0.0 };
            }
            let rest = length - gram[r * rank..r * rank + r].iter().map(|l| l * l).sum::<f64>();
            let independent = rest > DEPENDENT * DEPENDENT * length && rest > TINY * TINY;
            gram[r * rank + r] = if independent { rest.sqrt() } else { 0.0 };
            if !independent {
                continue;
            }
            let pivot = gram[r * rank + r];
            for q in 0..r {
                let sum: f64 = (q..r).map(|s| gram[r * rank + s] * inverse[s * rank + q]).sum();
                inverse[r * rank + q] = -sum / pivot;
            }
            inverse[r * rank + r] = 1.0 / pivot;
            self.factor[r * rank..=r * rank + r]
                .iter_mut()
                .zip(&inverse[r * rank..])
                .for_each(|(to, &value)| *to = value as f32);
        }
    }

    /// Orthonormalise the rows of `v`; rows that depend on earlier ones become zero, and stay so.
    ///
    /// Here and below, `parallel` says whether several threads may share what is worth it.
    pub fn orthonormalise(&mut self, v: &mut [f32], rank: usize, parallel: bool) {
        let mut product = std::mem::take(&mut self.product);
        let once = room(&mut product, v.len());
        self.orthonormalise_once(v, once, rank, parallel);
        // Float32 leaves an ill-conditioned basis skew; a second time settles that.
        self.orthonormalise_once(once, v, rank, parallel);
        self.product = product;
    }

    fn orthonormalise_once(&mut self, v: &[f32], out: &mut [f32], rank: usize, parallel: bool) {
        self.gram(v, rank, parallel);
        self.orthonormalising_factor(rank);
        let factor = Matrix::new(&self.factor, rank, rank);
        multiply_on(parallel, factor, Matrix::new(v, rank, v.len() / rank), false, out);
    }

    /// Whether the rows of `v` are orthonormal or zero.
    pub fn is_orthonormal(&mut self, v: &[f32], rank: usize, parallel: bool) -> bool {
        self.gram(v, rank, parallel);
        self.gram.iter().enumerate().all(|(at, g)| {
            let skew = if at / rank == at % rank { (g - 1.0).abs().min(g.abs()) } else { g.abs() };
            skew < ORTHONORMAL
        })
    }

    /// Move `u` `[rank, rows]` towards the leading left subspace of `e` `[rows, columns]`: U <- orth(E orth(E^T U)).
    ///
    /// The energy of `e` within the subspace never falls.
    pub fn iterate(&mut self, e: &[f32], u: &mut [f32], rank: usize, iterations: usize, parallel: bool) {
        let rows = u.len() / rank;
        let columns = e.len() / rows;
        if columns <= rank && iterations > 0 {
            return self.span(e, u, rank, parallel);
        }
        let mut coefficients = std::mem::take(&mut self.coefficients);
        let v = room(&mut coefficients, rank * columns);
        for _ in 0..iterations {
            multiply_on(parallel, Matrix::new(u, rank, rows), Matrix::new(e, rows, columns), false, v);
            // Done here too, small singular values need not survive being squared.
            self.orthonormalise(v, rank, parallel);
            self.project(v, e, u, columns, parallel);
            self.orthonormalise(u, rank, parallel);
        }
        self.coefficients = coefficients;
    }

    /// `U = V E^T`
    fn project(&mut self, v: &[f32], e: &[f32], u: &mut [f32], columns: usize, parallel: bool) {
        if !parallel || u.len() * columns < PRODUCTS {
            return dots(v, e, columns, u, false);
        }
        // Rows of E are more for threads to share than those of V, but let the transpose come out.
        let turned = room(&mut self.product, u.len());
        dots_on(parallel, e, v, columns, false, turned);
        transpose(turned, v.len() / columns, u);
    }

    /// Let `u` `[rank, rows]` span all columns of `e`, no more than `rank`: nothing is left to iterate for.
    fn span(&mut self, e: &[f32], u: &mut [f32], rank: usize, parallel: bool) {
        let rows = u.len() / rank;
        let columns = e.len() / rows;
        transpose(e, columns, &mut u[..rows * columns]);
        u[rows * columns..].fill(0.0);
        self.orthonormalise(u, rank, parallel);
    }
}

/// Add the inner products of some columns of the rows of `v`, lower triangle.
fn add_gram(v: &[f32], rank: usize, columns: Range<usize>, wide: &mut Vec<f64>, gram: &mut [f64]) {
    let length = v.len() / rank;
    let wide = room(wide, rank * PIECE);
    for from in columns.clone().step_by(PIECE) {
        let piece = PIECE.min(columns.end - from);
        // Whole vectors, of which the last one is filled up with zeros.
        let padded = piece.next_multiple_of(LANES);
        for (row, wide) in v.chunks_exact(length).zip(wide.chunks_exact_mut(PIECE)) {
            wide.iter_mut().zip(&row[from..from + piece]).for_each(|(to, &value)| *to = f64::from(value));
            wide[piece..padded].fill(0.0);
        }
        dispatch(GramPiece { wide, length: padded, rank, gram });
    }
}

/// Add the inner products of the first `length` of each row of `PIECE` numbers, lower triangle.
struct GramPiece<'a> {
    wide: &'a [f64],
    length: usize,
    rank: usize,
    gram: &'a mut [f64],
}

impl WithSimd for GramPiece<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let GramPiece { wide, length, rank, gram } = self;
        let row = |r: usize| S::as_simd_f64s(&wide[r * PIECE..r * PIECE + length]).0;
        for r in 0..rank {
            let own = row(r);
            let gram = &mut gram[r * rank..=r * rank + r];
            let whole = gram.len() - gram.len() % 4;
            for q in (0..whole).step_by(4) {
                let sums = dots_with(simd, [row(q), row(q + 1), row(q + 2), row(q + 3)], own);
                gram[q..q + 4].iter_mut().zip(sums).for_each(|(to, sum)| *to += simd.reduce_sum_f64s(sum));
            }
            for (q, to) in gram.iter_mut().enumerate().skip(whole) {
                *to += simd.reduce_sum_f64s(dots_with(simd, [row(q)], own)[0]);
            }
        }
    }
}

#[inline(always)]
fn dots_with<S: Simd, const N: usize>(simd: S, rows: [&[S::f64s]; N], own: &[S::f64s]) -> [S::f64s; N] {
    let mut sums = [simd.splat_f64s(0.0); N];
    for (at, &value) in own.iter().enumerate() {
        for (sum, row) in sums.iter_mut().zip(rows) {
            *sum = simd.mul_add_e_f64s(row[at], value, *sum);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::{close, numbers, on_any_threads, same_bits};

    fn inner(v: &[f32], length: usize, r: usize, q: usize) -> f64 {
        let (a, b) = (&v[r * length..][..length], &v[q * length..][..length]);
        a.iter().zip(b).map(|(&x, &y)| f64::from(x) * f64::from(y)).sum()
    }

    #[test]
    fn rows_become_orthonormal_at_any_scale() {
        on_all_machines(orthonormalise_at_all_scales);
    }

    fn orthonormalise_at_all_scales() {
        for scale in [1e-25f32, 1.0, 1e15] {
            let mut v: Vec<f32> = numbers(3 * 700, 1).iter().map(|x| x * scale).collect();
            Buffers::default().orthonormalise(&mut v, 3, false);
            for at in 0..9 {
                close(inner(&v, 700, at / 3, at % 3) as f32, if at / 3 == at % 3 { 1.0 } else { 0.0 });
            }
        }
    }

    #[test]
    fn dependent_rows_become_zero() {
        on_all_machines(orthonormalise_dependent_rows);
    }

    fn orthonormalise_dependent_rows() {
        let mut v = numbers(10, 4);
        v.extend(v.clone().iter().map(|x| 3.0 * x));
        v.extend([0.0; 10]);
        v.extend(numbers(10, 5));
        Buffers::default().orthonormalise(&mut v, 4, false);
        assert!(v[10..30].iter().all(|&x| x == 0.0));
        close(inner(&v, 10, 3, 3) as f32, 1.0);
        close(inner(&v, 10, 0, 3) as f32, 0.0);
    }

    #[test]
    fn nearly_parallel_rows_are_told_apart() {
        let x = numbers(50, 6);
        let mut v = x.clone();
        v.extend(x.iter().zip(numbers(50, 7)).map(|(x, y)| x + 1e-3 * y));
        Buffers::default().orthonormalise(&mut v, 2, false);
        close(inner(&v, 50, 0, 1) as f32, 0.0);
        close(inner(&v, 50, 1, 1) as f32, 1.0);
    }

    #[test]
    fn a_steep_spectrum_keeps_its_small_directions() {
        on_all_machines(iterate_on_a_steep_spectrum);
    }

    fn iterate_on_a_steep_spectrum() {
        // Rank 2 with singular values 1 and 1e-3, whose squares lie beyond what float32 keeps apart.
        let (left, right) = (numbers(2 * 30, 8), numbers(2 * 40, 9));
        let e: Vec<f32> = (0..30 * 40)
            .map(|at| left[at / 40] * right[at % 40] + 1e-3 * left[30 + at / 40] * right[40 + at % 40])
            .collect();
        let mut u = numbers(2 * 30, 10);
        Buffers::default().iterate(&e, &mut u, 2, 3, false);
        let mut expected = left.clone();
        Buffers::default().orthonormalise(&mut expected, 2, false);
        let overlap: f64 = (0..4).map(|at| inner_between(&u, &expected, 30, at / 2, at % 2).powi(2)).sum();
        assert!((overlap - 2.0).abs() < 1e-3, "{overlap}");
    }

    fn inner_between(v: &[f32], w: &[f32], length: usize, r: usize, q: usize) -> f64 {
        v[r * length..][..length]
            .iter()
            .zip(&w[q * length..][..length])
            .map(|(&x, &y)| f64::from(x) * f64::from(y))
            .sum()
    }

    #[test]
    fn threads_change_nothing() {
        // Long rows of U and of V, and a matrix of fewer columns than the rank.
        for (rows, columns, rank) in [(70_000, 9, 4), (9, 70_000, 4), (40_000, 5, 6)] {
            let e = numbers(rows * columns, 1);
            let iterated = |parallel| {
                let mut u = numbers(rank * rows, 2);
                Buffers::default().iterate(&e, &mut u, rank, 1, parallel);
                u
            };
            assert!(rank * rows.max(columns) >= PARALLEL);
            assert!(same_bits(&on_any_threads(|| iterated(true)), &iterated(false)));
        }
    }
}
