//! Inner products of dictionaries in float64.

use crate::cells::Node;
use crate::machine::dispatch;
use crate::pairs::{PARALLEL_PAIRS, SLACK, SideBySide, mode_product, read};
use crate::threads::for_each;
use pulp::{Simd, WithSimd};

/// `H_n[c,c'] = unf_n(Z_c) (kron_{m != n} M_m(c,c')) unf_n(Z_c')^T` for all pairs: `[PC R_n, PC R_n]`, symmetric.
///
/// Rows share a dictionary whatever their own memberships, so mode `n` itself puts no condition on a pair.
/// `M_m(c, c') = U_{m,c}^T U_{m,c'}`, over the rows both cells share.
pub fn dictionary_gram(node: &Node, bases: &[&[f32]], cores: &[f32], n: usize) -> Vec<f64> {
    let (cells, rank) = (node.cells(), node.ranks[n]);
    let side = cells * rank;
    let dictionaries = Dictionaries::new(node, bases, cores, n);
    let mut h = vec![0.0f64; side * side];
    let tasks = h.chunks_mut(rank * side).enumerate().collect();
    for_each(cells * cells >= PARALLEL_PAIRS, tasks, |(cell, rows)| {
        dispatch(Row { dictionaries: &dictionaries, cell, rows });
    });
    mirror(&mut h, side);
    h
}

/// The dictionaries of mode n, all cells side by side.
struct Dictionaries<'a> {
    bases: SideBySide<'a>,
    n: usize,
    cells: usize,
    /// `[PC, R_1, .., R_N]`
    cores: Vec<f64>,
    /// `[R_1, .., R_N, PC]`
    cores_last: Vec<f64>,
}

impl<'a> Dictionaries<'a> {
    fn new(node: &'a Node, stored: &[&[f32]], cores: &[f32], n: usize) -> Self {
        let (cells, size) = (node.cells(), node.core_size());
        let modes = (0..node.order()).filter(|&m| m != n && !node.undecomposed[m]).collect();
        let mut cores_last = vec![0.0; size * cells + SLACK];
        for (at, &value) in cores.iter().enumerate() {
            cores_last[at % size * cells + at / size] = f64::from(value);
        }
        let cores = cores.iter().map(|&z| f64::from(z)).collect();
        Dictionaries { bases: SideBySide::new(node, stored, modes), n, cells, cores, cores_last }
    }
}

/// Inner products of one cell with those from it on, into rows `[R_n, PC, R_n]` of the result.
struct Row<'a> {
    dictionaries: &'a Dictionaries<'a>,
    cell: usize,
    rows: &'a mut [f64],
}

impl WithSimd for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Row { dictionaries: d, cell, rows } = self;
        let ranks = &d.bases.node.ranks;
        let size = d.bases.node.core_size();
        let (mut x, mut y) = (vec![simd.splat_f64s(0.0); size], vec![simd.splat_f64s(0.0); size]);
        let mut gram = vec![simd.splat_f64s(0.0); d.bases.largest()];
        for other in (cell..d.cells).step_by(S::F64_LANES) {
            x.iter_mut().zip(&d.cores[cell * size..]).for_each(|(x, &z)| *x = simd.splat_f64s(z));
            d.bases.grams(simd, (cell, other), &mut gram, |m, gram| {
                mode_product(simd, &x, ranks[m], ranks[m + 1..].iter().product(), gram, &mut y);
                std::mem::swap(&mut x, &mut y);
            });
            contract(simd, &x, d, other, rows);
        }
    }
}

/// `unf_n(x) unf_n(Z_c')^T` for the cells c' from `other` on into rows `[R_n, PC, R_n]`.
#[inline(always)]
fn contract<S: Simd>(simd: S, x: &[S::f64s], d: &Dictionaries, other: usize, rows: &mut [f64]) {
    let rank = d.bases.node.ranks[d.n];
    let after: usize = d.bases.node.ranks[d.n + 1..].iter().product();
    let lanes = S::F64_LANES.min(d.cells - other);
    for r in 0..rank {
        for q in 0..rank {
            let mut sum = simd.splat_f64s(0.0);
            for before in 0..x.len() / (rank * after) {
                for a in 0..after {
                    let at = |s: usize| (before * rank + s) * after + a;
                    sum = simd.mul_add_e_f64s(x[at(r)], read(simd, &d.cores_last, at(q) * d.cells + other), sum);
                }
            }
            let sums = [sum];
            let sums: &[f64] = pulp::bytemuck::cast_slice(&sums);
            for (lane, &sum) in sums.iter().enumerate().take(lanes) {
                rows[(r * d.cells + other + lane) * rank + q] = sum;
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
    use crate::testing::{numbers, overlapping_cells};

    #[test]
    fn agrees_with_explicit_dictionaries() {
        on_all_machines(compare_with_explicit_dictionaries);
    }

    fn compare_with_explicit_dictionaries() {
        let (node, stored) = overlapping_cells();
        let stored: Vec<&[f32]> = stored.iter().map(|b| b.as_slice()).collect();
        let cores = numbers(node.cells() * node.core_size(), 9);
        let h = dictionary_gram(&node, &stored, &cores, 0);
        // Column (c, r): sum_s z_c[r, s, t] U_{2,c}[j, s] at every (j, t).
        let column = |c: usize, r: usize, j: usize, t: usize| -> f64 {
            let cell = node.cell(c);
            let Some(at) = node.place(&cell, 1, j) else { return 0.0 };
            (0..3).map(|s| f64::from(cores[c * 12 + (r * 3 + s) * 2 + t]) * f64::from(stored[1][at + s])).sum()
        };
        for (at, &value) in h.iter().enumerate() {
            let (i, j) = (at / 8, at % 8);
            let expected: f64 =
                (0..8).map(|at| column(i / 2, i % 2, at / 2, at % 2) * column(j / 2, j % 2, at / 2, at % 2)).sum();
            assert!((value - expected).abs() < 1e-12, "{i} {j}: {value} instead of {expected}");
        }
    }
}
