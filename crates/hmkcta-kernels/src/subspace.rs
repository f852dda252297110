//! Orthonormal bases and leading subspaces. Bases are transposed: a basis is `rank` rows of `length` numbers.

use crate::chain::transpose;
use crate::dots::dots;
use crate::gemm::{Matrix, multiply};
use crate::machine::dispatch;
use crate::threads::room;
use pulp::{Simd, WithSimd};

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
}

impl Buffers {
    /// Inner products of all rows, `[rank, rank]`, in float64; the upper triangle is left zero.
    fn gram(&mut self, v: &[f32], rank: usize) {
        let length = v.len() / rank;
        let (gram, wide) = (&mut self.gram, &mut self.wide);
        gram.clear();
        gram.resize(rank * rank, 0.0);
        wide.resize(rank * PIECE, 0.0);
        for from in (0..length).step_by(PIECE) {
            let piece = PIECE.min(length - from);
            // Whole vectors, of which the last one is filled up with zeros.
            let padded = piece.next_multiple_of(LANES);
            for (row, wide) in v.chunks_exact(length).zip(wide.chunks_exact_mut(PIECE)) {
                wide.iter_mut().zip(&row[from..from + piece]).for_each(|(to, &value)| *to = f64::from(value));
                wide[piece..padded].fill(0.0);
            }
            dispatch(GramPiece { wide, length: padded, rank, gram });
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
    pub fn orthonormalise(&mut self, v: &mut [f32], rank: usize) {
        let n = v.len() / rank;
        // Float32 leaves an ill-conditioned basis skew; a second time settles that.
        for _ in 0..2 {
            self.gram(v, rank);
            self.orthonormalising_factor(rank);
            let product = room(&mut self.product, v.len());
            multiply(Matrix::new(&self.factor, rank, rank), Matrix::new(v, rank, n), false, product);
            v.copy_from_slice(product);
        }
    }

    /// Whether the rows of `v` are orthonormal or zero.
    pub fn is_orthonormal(&mut self, v: &[f32], rank: usize) -> bool {
        self.gram(v, rank);
        self.gram.iter().enumerate().all(|(at, g)| {
            let skew = if at / rank == at % rank { (g - 1.0).abs().min(g.abs()) } else { g.abs() };
            skew < ORTHONORMAL
        })
    }

    /// Move `u` `[rank, rows]` towards the leading left subspace of `e` `[rows, columns]`: U <- orth(E orth(E^T U)).
    ///
    /// The energy of `e` within the subspace never falls.
    pub fn iterate(&mut self, e: &[f32], u: &mut [f32], rank: usize, iterations: usize) {
        let rows = u.len() / rank;
        let columns = e.len() / rows;
        if columns <= rank && iterations > 0 {
            return self.span(e, u, rank);
        }
        let mut coefficients = std::mem::take(&mut self.coefficients);
        let v = room(&mut coefficients, rank * columns);
        for _ in 0..iterations {
            multiply(Matrix::new(u, rank, rows), Matrix::new(e, rows, columns), false, v);
            // Done here too, small singular values need not survive being squared.
            self.orthonormalise(v, rank);
            dots(v, e, columns, u, false);
            self.orthonormalise(u, rank);
        }
        self.coefficients = coefficients;
    }

    /// Let `u` `[rank, rows]` span all columns of `e`, no more than `rank`: nothing is left to iterate for.
    fn span(&mut self, e: &[f32], u: &mut [f32], rank: usize) {
        let rows = u.len() / rank;
        let columns = e.len() / rows;
        transpose(e, columns, &mut u[..rows * columns]);
        u[rows * columns..].fill(0.0);
        self.orthonormalise(u, rank);
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
    use crate::testing::{close, numbers};

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
            Buffers::default().orthonormalise(&mut v, 3);
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
        Buffers::default().orthonormalise(&mut v, 4);
        assert!(v[10..30].iter().all(|&x| x == 0.0));
        close(inner(&v, 10, 3, 3) as f32, 1.0);
        close(inner(&v, 10, 0, 3) as f32, 0.0);
    }

    #[test]
    fn nearly_parallel_rows_are_told_apart() {
        let x = numbers(50, 6);
        let mut v = x.clone();
        v.extend(x.iter().zip(numbers(50, 7)).map(|(x, y)| x + 1e-3 * y));
        Buffers::default().orthonormalise(&mut v, 2);
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
        Buffers::default().iterate(&e, &mut u, 2, 3);
        let mut expected = left.clone();
        Buffers::default().orthonormalise(&mut expected, 2);
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
}
