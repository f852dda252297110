//! Inner products of dictionaries in float64.

use crate::cells::Node;
use crate::machine::dispatch;
use crate::threads::for_each;
use pulp::{Simd, WithSimd};

/// Pairs of cells from which on several threads pay.
const PARALLEL_PAIRS: usize = 4096;
/// More numbers than any vector has.
const SLACK: usize = 16;

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

/// All cells side by side, so that the lanes of a vector are cells.
struct Dictionaries<'a> {
    node: &'a Node<'a>,
    n: usize,
    cells: usize,
    /// Modes whose bases count.
    modes: Vec<usize>,
    /// For each of those, `[I_m, R_m, PC]`, zero where a row is not the cell's.
    bases: Vec<Vec<f64>>,
    /// `[PC, R_1, .., R_N]`
    cores: Vec<f64>,
    /// `[R_1, .., R_N, PC]`
    cores_last: Vec<f64>,
}

impl<'a> Dictionaries<'a> {
    fn new(node: &'a Node, stored: &[&[f32]], cores: &[f32], n: usize) -> Self {
        let (cells, size) = (node.cells(), node.core_size());
        let modes: Vec<usize> = (0..node.order()).filter(|&m| m != n && !node.undecomposed[m]).collect();
        let room = |m: usize| vec![0.0; node.sizes[m] * node.ranks[m] * cells + SLACK];
        let mut bases: Vec<Vec<f64>> = modes.iter().map(|&m| room(m)).collect();
        let mut cores_last = vec![0.0; size * cells + SLACK];
        for c in 0..cells {
            let cell = node.cell(c);
            for (&m, dense) in modes.iter().zip(&mut bases) {
                let basis = node.load_basis(&cell, m, stored[m]);
                let rows = node.rows(m, cell.subset[m]);
                for (at, &value) in basis.iter().enumerate() {
                    let (r, i) = (at / rows.len(), rows[at % rows.len()] as usize);
                    dense[(i * node.ranks[m] + r) * cells + c] = f64::from(value);
                }
            }
            for (z, &value) in cores[c * size..(c + 1) * size].iter().enumerate() {
                cores_last[z * cells + c] = f64::from(value);
            }
        }
        let cores = cores.iter().map(|&z| f64::from(z)).collect();
        Dictionaries { node, n, cells, modes, bases, cores, cores_last }
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
        let ranks = &d.node.ranks;
        let size = d.node.core_size();
        let (mut x, mut y) = (vec![simd.splat_f64s(0.0); size], vec![simd.splat_f64s(0.0); size]);
        let largest = ranks.iter().max().map_or(0, |r| r * r);
        let mut gram = vec![simd.splat_f64s(0.0); largest];
        let subset = d.node.cell(cell).subset;
        for other in (cell..d.cells).step_by(S::F64_LANES) {
            x.iter_mut().zip(&d.cores[cell * size..]).for_each(|(x, &z)| *x = simd.splat_f64s(z));
            for (&m, basis) in d.modes.iter().zip(&d.bases) {
                let shared = d.node.rows(m, subset[m]);
                basis_gram(simd, basis, shared, (ranks[m], d.cells), (cell, other), &mut gram);
                mode_product(simd, &x, ranks[m], ranks[m + 1..].iter().product(), &gram, &mut y);
                std::mem::swap(&mut x, &mut y);
            }
            contract(simd, &x, d, other, rows);
        }
    }
}

/// `M_m(c, c')`, `[R_m, R_m]`, for as many cells c' as there are lanes, from `other` on.
#[inline(always)]
fn basis_gram<S: Simd>(
    simd: S,
    basis: &[f64],
    rows: &[u32],
    (rank, cells): (usize, usize),
    (cell, other): (usize, usize),
    gram: &mut [S::f64s],
) {
    // Sums of small ranks stay in registers.
    match rank {
        1 => small_gram::<S, 1>(simd, basis, rows, cells, (cell, other), gram),
        2 => small_gram::<S, 2>(simd, basis, rows, cells, (cell, other), gram),
        3 => small_gram::<S, 3>(simd, basis, rows, cells, (cell, other), gram),
        4 => small_gram::<S, 4>(simd, basis, rows, cells, (cell, other), gram),
        _ => {
            for (at, sum) in gram[..rank * rank].iter_mut().enumerate() {
                let (r, q) = (at / rank, at % rank);
                *sum = simd.splat_f64s(0.0);
                for &i in rows {
                    let row = &basis[i as usize * rank * cells..];
                    let value = simd.splat_f64s(row[r * cells + cell]);
                    *sum = simd.mul_add_e_f64s(value, read(simd, row, q * cells + other), *sum);
                }
            }
        }
    }
}

#[inline(always)]
fn small_gram<S: Simd, const R: usize>(
    simd: S,
    basis: &[f64],
    rows: &[u32],
    cells: usize,
    (cell, other): (usize, usize),
    gram: &mut [S::f64s],
) {
    let mut sums = [[simd.splat_f64s(0.0); R]; R];
    for &i in rows {
        let row = &basis[i as usize * R * cells..];
        let others: [S::f64s; R] = std::array::from_fn(|q| read(simd, row, q * cells + other));
        for (r, sums) in sums.iter_mut().enumerate() {
            let value = simd.splat_f64s(row[r * cells + cell]);
            sums.iter_mut().zip(others).for_each(|(sum, other)| *sum = simd.mul_add_e_f64s(value, other, *sum));
        }
    }
    gram.iter_mut().zip(sums.into_iter().flatten()).for_each(|(to, sum)| *to = sum);
}

/// `y = x x_m M` for `x` `[before, R_m, after]`.
#[inline(always)]
fn mode_product<S: Simd>(simd: S, x: &[S::f64s], rank: usize, after: usize, gram: &[S::f64s], y: &mut [S::f64s]) {
    match rank {
        1 => small_product::<S, 1>(simd, x, after, gram, y),
        2 => small_product::<S, 2>(simd, x, after, gram, y),
        3 => small_product::<S, 3>(simd, x, after, gram, y),
        4 => small_product::<S, 4>(simd, x, after, gram, y),
        _ => {
            for (x, y) in x.chunks_exact(rank * after).zip(y.chunks_exact_mut(rank * after)) {
                for (at, y) in y.iter_mut().enumerate() {
                    let (q, a) = (at / after, at % after);
                    let products = (0..rank).map(|r| (x[r * after + a], gram[r * rank + q]));
                    *y = products.fold(simd.splat_f64s(0.0), |sum, (x, m)| simd.mul_add_e_f64s(x, m, sum));
                }
            }
        }
    }
}

#[inline(always)]
fn small_product<S: Simd, const R: usize>(simd: S, x: &[S::f64s], after: usize, gram: &[S::f64s], y: &mut [S::f64s]) {
    let gram: [[S::f64s; R]; R] = std::array::from_fn(|r| std::array::from_fn(|q| gram[r * R + q]));
    for (x, y) in x.chunks_exact(R * after).zip(y.chunks_exact_mut(R * after)) {
        for a in 0..after {
            let mut sums = [simd.splat_f64s(0.0); R];
            for (r, gram) in gram.iter().enumerate() {
                let value = x[r * after + a];
                sums.iter_mut().zip(gram).for_each(|(sum, &m)| *sum = simd.mul_add_e_f64s(value, m, *sum));
            }
            sums.into_iter().enumerate().for_each(|(q, sum)| y[q * after + a] = sum);
        }
    }
}

/// `unf_n(x) unf_n(Z_c')^T` for the cells c' from `other` on into rows `[R_n, PC, R_n]`.
#[inline(always)]
fn contract<S: Simd>(simd: S, x: &[S::f64s], d: &Dictionaries, other: usize, rows: &mut [f64]) {
    let rank = d.node.ranks[d.n];
    let after: usize = d.node.ranks[d.n + 1..].iter().product();
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

/// The vector that starts at `at`.
#[inline(always)]
fn read<S: Simd>(_: S, x: &[f64], at: usize) -> S::f64s {
    S::as_simd_f64s(&x[at..at + S::F64_LANES]).0[0]
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
    use crate::testing::numbers;

    #[test]
    fn agrees_with_explicit_dictionaries() {
        on_all_machines(compare_with_explicit_dictionaries);
    }

    fn compare_with_explicit_dictionaries() {
        let (sizes, ranks) = (vec![3, 4, 2], vec![2, 3, 2]);
        let members: [&[u16]; 3] = [&[0, 1, 1], &[0, 1, 1, 0, 0, 1, 1, 0], &[0, 0]];
        let shape = (sizes.clone(), vec![2, 2, 1], vec![1, 2, 1], ranks.clone(), vec![false, false, true]);
        let node = Node::new(shape, members.to_vec()).unwrap();
        let stored: Vec<Vec<f32>> = (0..3).map(|n| numbers(node.basis_size(n), n as u64 + 1)).collect();
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
