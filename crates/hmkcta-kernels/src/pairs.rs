//! Bases of all cells side by side, so that the lanes of a vector are cells: their inner products, cell by cell.

use crate::cells::Node;
use pulp::Simd;

/// Pairs of cells from which on several threads pay.
pub const PARALLEL_PAIRS: usize = 4096;
/// More numbers than any vector has.
pub const SLACK: usize = 16;

/// `U_{m,c}` of all cells c, for the modes m asked for: `[I_m, R_m, PC]` each, zero where a row is not the cell's.
pub struct SideBySide<'a> {
    pub node: &'a Node<'a>,
    pub modes: Vec<usize>,
    bases: Vec<Vec<f64>>,
}

impl<'a> SideBySide<'a> {
    pub fn new(node: &'a Node, stored: &[&[f32]], modes: Vec<usize>) -> Self {
        let cells = node.cells();
        let room = |m: usize| vec![0.0; node.sizes[m] * node.ranks[m] * cells + SLACK];
        let mut bases: Vec<Vec<f64>> = modes.iter().map(|&m| room(m)).collect();
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
        }
        SideBySide { node, modes, bases }
    }

    /// Each mode with `M_m(c, c') = U_{m,c}^T U_{m,c'}`, `[R_m, R_m]`, for as many cells c' as there are lanes, from
    /// `other` on: over the rows that both share.
    #[inline(always)]
    pub fn grams<S: Simd>(
        &self,
        simd: S,
        (cell, other): (usize, usize),
        gram: &mut [S::f64s],
        mut use_of: impl FnMut(usize, &[S::f64s]),
    ) {
        let subset = self.node.cell(cell).subset;
        for (&m, basis) in self.modes.iter().zip(&self.bases) {
            let (rank, rows) = (self.node.ranks[m], self.node.rows(m, subset[m]));
            basis_gram(simd, basis, rows, (rank, self.node.cells()), (cell, other), gram);
            use_of(m, &gram[..rank * rank]);
        }
    }

    /// Numbers of the `M_m` of two cells, all modes together; one where there is no such mode.
    pub fn numbers(&self) -> usize {
        self.modes.iter().map(|&m| self.node.ranks[m].pow(2)).sum::<usize>().max(1)
    }

    /// Most numbers of an `M_m`.
    pub fn largest(&self) -> usize {
        self.modes.iter().map(|&m| self.node.ranks[m].pow(2)).max().unwrap_or(0)
    }
}

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
pub fn mode_product<S: Simd>(simd: S, x: &[S::f64s], rank: usize, after: usize, gram: &[S::f64s], y: &mut [S::f64s]) {
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

/// The vector that starts at `at`.
#[inline(always)]
pub fn read<S: Simd>(_: S, x: &[f64], at: usize) -> S::f64s {
    S::as_simd_f64s(&x[at..at + S::F64_LANES]).0[0]
}
