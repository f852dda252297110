//! Inner products of dictionaries in float64.

use crate::cell_pairs::{Group, Laid, Pairs};
use crate::machine::dispatch;
use crate::sizes::zeros;
use pulp::{Simd, WithSimd};

/// `H_n[c,c'] = unf_n(Z_c) (kron_{m != n} M_m(c,c')) unf_n(Z_c')^T` for all pairs: `[PC R_n, PC R_n]`, symmetric.
///
/// Rows share a dictionary whatever their own memberships, so mode `n` itself puts no condition on a pair.
pub fn dictionary_gram(pairs: &Pairs, cores: &[f32], n: usize) -> Vec<f64> {
    let (cells, size) = (pairs.cells, pairs.core_size());
    let side = cells * pairs.ranks[n];
    let laid = Laid::new(cells, size, cores.iter().map(|&z| f64::from(z)));
    let mut h = zeros(side * side);
    pairs.share_cells(&mut h, |from, rows| dispatch(Rows { pairs, cores, laid: &laid, n, from, rows }));
    mirror(&mut h, side);
    h
}

/// Inner products of the dictionaries of some cells with those from each on, into rows `[cells, R_n, PC, R_n]`.
struct Rows<'a> {
    pairs: &'a Pairs<'a>,
    cores: &'a [f32],
    laid: &'a Laid,
    n: usize,
    from: usize,
    rows: &'a mut [f64],
}

impl WithSimd for Rows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Rows { pairs, cores, laid, n, from, rows } = self;
        let size = pairs.core_size();
        let zeros = vec![simd.splat_f64s(0.0); size];
        let (mut x, mut y, mut z) = (zeros.clone(), zeros.clone(), zeros);
        let of_cells = cores.chunks_exact(size).enumerate().skip(from);
        for ((cell, core), rows) in of_cells.zip(rows.chunks_exact_mut(pairs.ranks[n].pow(2) * pairs.cells)) {
            let mut row = Row { pairs, n, rows };
            for group in pairs.groups(simd, cell) {
                let numbers = pairs.numbers(simd, cell, group, Some(n));
                for (x, &z) in x.iter_mut().zip(core) {
                    *x = simd.mul_f64s(simd.splat_f64s(f64::from(z)), numbers);
                }
                pairs.multiply(simd, &mut x, &mut y, Some(n), |m| pairs.matrices(m, cell, group));
                z.iter_mut().zip(laid.vectors(simd, group)).for_each(|(to, z)| *to = z);
                row.contract(simd, &x, &z, group);
            }
        }
    }
}

/// The rows of one cell, `[R_n, PC, R_n]`.
struct Row<'a> {
    pairs: &'a Pairs<'a>,
    n: usize,
    rows: &'a mut [f64],
}

impl Row<'_> {
    /// `unf_n(x) unf_n(z)^T` for the cells c' into the rows.
    #[inline(always)]
    fn contract<S: Simd>(&mut self, simd: S, x: &[S::f64s], z: &[S::f64s], group: Group) {
        let rank = self.pairs.ranks[self.n];
        match rank {
            1 => self.contract_tile::<S, 1>(simd, x, z, group, (0, 0)),
            2 => self.contract_tile::<S, 2>(simd, x, z, group, (0, 0)),
            3 => self.contract_tile::<S, 3>(simd, x, z, group, (0, 0)),
            4 => self.contract_tile::<S, 4>(simd, x, z, group, (0, 0)),
            _ => (0..rank * rank).for_each(|at| self.contract_tile::<S, 1>(simd, x, z, group, (at / rank, at % rank))),
        }
    }

    /// The columns from r on of the one by those from q on of the other, TILE of each: their sums stay in registers.
    #[inline(always)]
    fn contract_tile<S: Simd, const TILE: usize>(
        &mut self,
        simd: S,
        x: &[S::f64s],
        z: &[S::f64s],
        group: Group,
        (r, q): (usize, usize),
    ) {
        let (cells, rank) = (self.pairs.cells, self.pairs.ranks[self.n]);
        let after: usize = self.pairs.ranks[self.n + 1..].iter().product();
        let mut sums = [[simd.splat_f64s(0.0); TILE]; TILE];
        for before in (0..x.len()).step_by(rank * after) {
            for a in before..before + after {
                for (i, sums) in sums.iter_mut().enumerate() {
                    for (j, sum) in sums.iter_mut().enumerate() {
                        *sum = simd.mul_add_e_f64s(x[a + (r + i) * after], z[a + (q + j) * after], *sum);
                    }
                }
            }
        }
        for (i, sums) in sums.iter().enumerate() {
            for (j, &sum) in sums.iter().enumerate() {
                let to = self.rows[((r + i) * cells + group.from) * rank + q + j..].iter_mut().step_by(rank);
                // A copy: what is pointed to would not stay in a register.
                let sum = [sum];
                let sum: &[f64] = pulp::bytemuck::cast_slice(&sum);
                to.zip(&sum[..group.lanes]).for_each(|(to, &sum)| *to = sum);
            }
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
