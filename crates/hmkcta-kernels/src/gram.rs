//! Inner products of dictionaries in float64.

use crate::machine::dispatch;
use crate::pairs::{PARALLEL_PAIRS, Pairs, read};
use crate::threads::for_each;
use pulp::{Simd, WithSimd};

/// `H_n[c,c'] = unf_n(Z_c) (kron_{m != n} M_m(c,c')) unf_n(Z_c')^T` for all pairs: `[PC R_n, PC R_n]`, symmetric.
///
/// Rows share a dictionary whatever their own memberships, so mode `n` itself puts no condition on a pair.
pub fn dictionary_gram(pairs: &Pairs, cores: &[f32], n: usize) -> Vec<f64> {
    let (cells, size) = (pairs.cells, pairs.core_size());
    let side = cells * pairs.ranks[n];
    let mut cores_last = vec![0.0; size * cells];
    cores.iter().enumerate().for_each(|(at, &z)| cores_last[at % size * cells + at / size] = f64::from(z));
    let mut h = vec![0.0; side * side];
    let tasks = h.chunks_mut(pairs.ranks[n] * side).enumerate().collect();
    for_each(cells * cells >= PARALLEL_PAIRS, tasks, |(cell, rows)| {
        dispatch(Row { pairs, core: &cores[cell * size..][..size], cores_last: &cores_last, n, cell, rows });
    });
    mirror(&mut h, side);
    h
}

/// Inner products of one cell's dictionary with those from it on, into rows `[R_n, PC, R_n]` of the result.
struct Row<'a> {
    pairs: &'a Pairs<'a>,
    /// Z_c
    core: &'a [f32],
    /// `[R_1, .., R_N, PC]`
    cores_last: &'a [f64],
    n: usize,
    cell: usize,
    rows: &'a mut [f64],
}

impl WithSimd for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let Row { pairs, core, n, cell, .. } = self;
        let (mut x, mut y) = (vec![simd.splat_f64s(0.0); core.len()], vec![simd.splat_f64s(0.0); core.len()]);
        for other in (cell..pairs.cells).step_by(S::F64_LANES) {
            x.iter_mut().zip(core).for_each(|(x, &z)| *x = simd.splat_f64s(f64::from(z)));
            for m in pairs.decomposed().filter(|&m| m != n) {
                pairs.mode_product(simd, &x, m, pairs.matrices(simd, m, (cell, other)), &mut y);
                std::mem::swap(&mut x, &mut y);
            }
            self.contract(simd, &x, other);
        }
    }
}

impl Row<'_> {
    /// `unf_n(x) unf_n(Z_c')^T` for the cells c' from `other` on into the rows.
    #[inline(always)]
    fn contract<S: Simd>(&mut self, simd: S, x: &[S::f64s], other: usize) {
        let rank = self.pairs.ranks[self.n];
        match rank {
            1 => self.contract_tile::<S, 1>(simd, x, other, (0, 0)),
            2 => self.contract_tile::<S, 2>(simd, x, other, (0, 0)),
            3 => self.contract_tile::<S, 3>(simd, x, other, (0, 0)),
            4 => self.contract_tile::<S, 4>(simd, x, other, (0, 0)),
            _ => (0..rank * rank).for_each(|at| self.contract_tile::<S, 1>(simd, x, other, (at / rank, at % rank))),
        }
    }

    /// The columns from r on of the one by those from q on of the other, TILE of each: their sums stay in registers.
    #[inline(always)]
    fn contract_tile<S: Simd, const TILE: usize>(
        &mut self,
        simd: S,
        x: &[S::f64s],
        other: usize,
        (r, q): (usize, usize),
    ) {
        let (cells, rank) = (self.pairs.cells, self.pairs.ranks[self.n]);
        let after: usize = self.pairs.ranks[self.n + 1..].iter().product();
        let lanes = S::F64_LANES.min(cells - other);
        let mut sums = [[simd.splat_f64s(0.0); TILE]; TILE];
        for before in (0..x.len()).step_by(rank * after) {
            for a in before..before + after {
                let mut z = [simd.splat_f64s(0.0); TILE];
                for (j, z) in z.iter_mut().enumerate() {
                    *z = read(simd, &self.cores_last[(a + (q + j) * after) * cells + other..][..lanes]);
                }
                for (i, sums) in sums.iter_mut().enumerate() {
                    let x = x[a + (r + i) * after];
                    sums.iter_mut().zip(z).for_each(|(sum, z)| *sum = simd.mul_add_e_f64s(x, z, *sum));
                }
            }
        }
        for (at, sum) in sums.as_flattened().iter().enumerate() {
            let (i, j) = (at / TILE, at % TILE);
            let sum: &[f64] = pulp::bytemuck::cast_slice(std::slice::from_ref(sum));
            let to = self.rows[((r + i) * cells + other) * rank + q + j..].iter_mut().step_by(rank);
            to.zip(&sum[..lanes]).for_each(|(to, &sum)| *to = sum);
        }
    }
}

/// Copy the upper triangle to the lower one, tile by tile.
fn mirror(h: &mut [f64], side: usize) {
    const TILE: usize = 32;
    for top in (0..side).step_by(TILE) {
        for left in (0..=top).step_by(TILE) {
            for i in top..side.min(top + TILE) {
                for j in left..i.min(left + TILE) {
                    h[i * side + j] = h[j * side + i];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::{CELLS, OverlappingCells, RANKS, numbers};

    #[test]
    fn agrees_with_explicit_dictionaries() {
        on_all_machines(compare_with_explicit_dictionaries);
    }

    fn compare_with_explicit_dictionaries() {
        let cells = OverlappingCells::new();
        let cores = numbers(CELLS * 12, 9);
        let products = cells.products();
        let products: Vec<&[f64]> = products.iter().map(Vec::as_slice).collect();
        let h = dictionary_gram(&Pairs { cells: CELLS, ranks: &RANKS, products: &products }, &cores, 0);
        // Column (c, r): sum_s z_c[r, s, t] U_{2,c}[j, s] at every (j, t).
        let column = |at: usize, j: usize, t: usize| -> f64 {
            let (c, r) = (at / 2, at % 2);
            (0..3).map(|s| f64::from(cores[c * 12 + (r * 3 + s) * 2 + t]) * cells.basis(1, c, j, s)).sum()
        };
        for (at, &value) in h.iter().enumerate() {
            let (i, j) = (at / (2 * CELLS), at % (2 * CELLS));
            let expected: f64 = (0..8).map(|at| column(i, at / 2, at % 2) * column(j, at / 2, at % 2)).sum();
            assert!((value - expected).abs() < 1e-12, "{i} {j}: {value} instead of {expected}");
        }
    }
}
