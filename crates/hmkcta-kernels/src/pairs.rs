//! Pairs of cells by the inner products of their bases. The lanes of a vector are cells.

use pulp::Simd;

/// Pairs of cells from which on several threads pay.
pub const PARALLEL_PAIRS: usize = 4096;

/// All pairs of PC cells of ranks R.
pub struct Pairs<'a> {
    pub cells: usize,
    pub ranks: &'a [usize],
    /// `M_m(c, c') = U_{m,c}^T U_{m,c'}` of each mode, `[R_m, PC, R_m, PC]`; nothing for undecomposed modes.
    pub products: &'a [&'a [f64]],
}

/// A matrix `M_m(c, c')` for each of as many cells c' as there are lanes, fewer at the end.
#[derive(Clone, Copy)]
pub struct Matrices<'a> {
    numbers: &'a [f64],
    lanes: usize,
    row: usize,
    column: usize,
}

impl<'a> Pairs<'a> {
    pub fn core_size(&self) -> usize {
        self.ranks.iter().product()
    }

    /// The modes that have bases.
    pub fn decomposed(&self) -> impl Iterator<Item = usize> {
        (0..self.ranks.len()).filter(|&m| !self.products[m].is_empty())
    }

    /// Of mode m, for cell c and the cells c' from `other` on.
    #[inline(always)]
    pub fn matrices<S: Simd>(&self, _: S, m: usize, (cell, other): (usize, usize)) -> Matrices<'a> {
        let (cells, rank) = (self.cells, self.ranks[m]);
        let numbers = &self.products[m][cell * rank * cells + other..];
        Matrices { numbers, lanes: S::F64_LANES.min(cells - other), row: cells * rank * cells, column: cells }
    }

    /// `x x_m M` for `x` `[R_1, .., R_N]`.
    #[inline(always)]
    pub fn mode_product<S: Simd>(&self, simd: S, x: &[S::f64s], m: usize, matrices: Matrices, y: &mut [S::f64s]) {
        let after = self.ranks[m + 1..].iter().product();
        // Sums of small ranks stay in registers.
        match self.ranks[m] {
            1 => small_product::<S, 1>(simd, x, after, matrices, y),
            2 => small_product::<S, 2>(simd, x, after, matrices, y),
            3 => small_product::<S, 3>(simd, x, after, matrices, y),
            4 => small_product::<S, 4>(simd, x, after, matrices, y),
            rank => product(simd, x, (rank, after), matrices, y),
        }
    }
}

impl Matrices<'_> {
    #[inline(always)]
    pub fn transposed(self) -> Self {
        Matrices { row: self.column, column: self.row, ..self }
    }

    #[inline(always)]
    fn at<S: Simd>(&self, simd: S, r: usize, q: usize) -> S::f64s {
        read(simd, &self.numbers[r * self.row + q * self.column..][..self.lanes])
    }
}

#[inline(always)]
fn small_product<S: Simd, const R: usize>(simd: S, x: &[S::f64s], after: usize, matrices: Matrices, y: &mut [S::f64s]) {
    let mut matrix = [[simd.splat_f64s(0.0); R]; R];
    for (r, row) in matrix.iter_mut().enumerate() {
        for (q, m) in row.iter_mut().enumerate() {
            *m = matrices.at(simd, r, q);
        }
    }
    for (x, y) in x.chunks_exact(R * after).zip(y.chunks_exact_mut(R * after)) {
        for a in 0..after {
            let mut sums = [simd.splat_f64s(0.0); R];
            for (r, row) in matrix.iter().enumerate() {
                let value = x[r * after + a];
                sums.iter_mut().zip(row).for_each(|(sum, &m)| *sum = simd.mul_add_e_f64s(value, m, *sum));
            }
            sums.into_iter().enumerate().for_each(|(q, sum)| y[q * after + a] = sum);
        }
    }
}

#[inline(always)]
fn product<S: Simd>(simd: S, x: &[S::f64s], (rank, after): (usize, usize), matrices: Matrices, y: &mut [S::f64s]) {
    for (x, y) in x.chunks_exact(rank * after).zip(y.chunks_exact_mut(rank * after)) {
        y.fill(simd.splat_f64s(0.0));
        for (r, x) in x.chunks_exact(after).enumerate() {
            for (q, y) in y.chunks_exact_mut(after).enumerate() {
                let m = matrices.at(simd, r, q);
                y.iter_mut().zip(x).for_each(|(y, &x)| *y = simd.mul_add_e_f64s(x, m, *y));
            }
        }
    }
}

/// A vector of these numbers, zero in lanes beyond them.
#[inline(always)]
pub fn read<S: Simd>(simd: S, x: &[f64]) -> S::f64s {
    match S::as_simd_f64s(x) {
        ([whole, ..], _) => *whole,
        (_, part) => simd.partial_load_f64s(part),
    }
}
