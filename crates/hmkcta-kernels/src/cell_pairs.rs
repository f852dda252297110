//! Pairs of cells by the inner products of their bases. The lanes of a vector are cells.

use crate::sizes::zeros;
use crate::threads::{count, for_each};
use pulp::Simd;

/// Pairs of cells from which on several threads pay, and the pieces they share.
const PARALLEL_PAIRS: usize = 4096;
const PIECES: usize = 32;

/// All pairs of PC cells of ranks R.
pub struct Pairs<'a> {
    pub cells: usize,
    pub ranks: &'a [usize],
    /// `M_m(c, c') = U_{m,c}^T U_{m,c'}` of each mode, `[R_m, PC, R_m, PC]`; nothing for undecomposed modes.
    pub products: &'a [&'a [f64]],
}

/// Cells c', as many as there are lanes, fewer at the end.
#[derive(Clone, Copy)]
pub struct Group {
    pub from: usize,
    pub lanes: usize,
}

/// Numbers of all cells, `[PC, R_1, .., R_N]`: those of WIDE cells side by side, zero where there is no cell.
#[derive(Clone)]
pub struct Laid {
    size: usize,
    /// `[groups of WIDE cells, R_1, .., R_N, WIDE]`
    numbers: Vec<f64>,
}

/// The lanes of the widest vector.
const WIDE: usize = 8;

impl Laid {
    pub fn new(cells: usize, size: usize, mut numbers: impl Iterator<Item = f64>) -> Self {
        let mut laid = Laid { size, numbers: zeros(cells.next_multiple_of(WIDE) * size) };
        for cell in 0..cells {
            let places = laid.place(cell)..;
            laid.numbers[places].iter_mut().step_by(WIDE).zip(numbers.by_ref().take(size)).for_each(|(to, z)| *to = z);
        }
        laid
    }

    /// Add as much of the others.
    pub fn add(&mut self, factor: f64, others: &Laid) {
        self.numbers.iter_mut().zip(&others.numbers).for_each(|(to, z)| *to += factor * z);
    }

    /// The inner product.
    pub fn dot(&self, others: &Laid) -> f64 {
        self.numbers.iter().zip(&others.numbers).map(|(x, y)| x * y).sum()
    }

    /// Cell after cell.
    pub fn numbers(&self, cells: usize) -> impl Iterator<Item = f64> {
        (0..cells).flat_map(|cell| self.numbers[self.place(cell)..].iter().step_by(WIDE).take(self.size).copied())
    }

    /// A vector for each number of a core.
    #[inline(always)]
    pub fn vectors<S: Simd>(&self, _: S, group: Group) -> impl Iterator<Item = S::f64s> {
        let wide = self.numbers[group.from / WIDE * WIDE * self.size..].chunks_exact(WIDE);
        let lanes = group.from % WIDE..;
        wide.take(self.size).map(move |wide| S::as_simd_f64s(&wide[lanes.clone()]).0[0])
    }

    /// The first number of a cell.
    fn place(&self, cell: usize) -> usize {
        cell / WIDE * WIDE * self.size + cell % WIDE
    }
}

/// A matrix `M_m(c, c')` for each cell c' of a group.
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

    /// Work on numbers of all cells: the first of some cells, and theirs. All are one task for one thread, as buffers are
    /// made for each.
    pub fn share_cells(&self, numbers: &mut [f64], work: impl Fn(usize, &mut [f64]) + Sync + Send) {
        let parallel = self.cells * self.cells >= PARALLEL_PAIRS;
        let piece = if parallel && count() > 1 { self.cells.div_ceil(PIECES) } else { self.cells.max(1) };
        let size = numbers.len() / self.cells.max(1) * piece;
        let tasks = numbers.chunks_mut(size.max(1)).enumerate().collect();
        for_each(parallel, tasks, |(number, numbers)| work(number * piece, numbers));
    }

    /// All cells, from the group of `first` on.
    #[inline(always)]
    pub fn groups<S: Simd>(&self, _: S, first: usize) -> impl Iterator<Item = Group> + use<S> {
        let cells = self.cells;
        let first = first - first % S::F64_LANES;
        (first..cells).step_by(S::F64_LANES).map(move |from| Group { from, lanes: S::F64_LANES.min(cells - from) })
    }

    /// Of mode m, for cell c and the cells c'.
    #[inline(always)]
    pub fn matrices(&self, m: usize, cell: usize, group: Group) -> Matrices<'a> {
        let (cells, rank) = (self.cells, self.ranks[m]);
        let numbers = &self.products[m][cell * rank * cells + group.from..];
        Matrices { numbers, lanes: group.lanes, row: cells * rank * cells, column: cells }
    }

    /// The product of `M_m(c, c')` over modes of rank one, where they are numbers.
    #[inline(always)]
    pub fn numbers<S: Simd>(&self, simd: S, cell: usize, group: Group, but: Option<usize>) -> S::f64s {
        let mut numbers = simd.splat_f64s(1.0);
        for m in self.modes(but).filter(|&m| self.ranks[m] == 1) {
            numbers = simd.mul_f64s(numbers, self.matrices(m, cell, group).at(simd, 0, 0));
        }
        numbers
    }

    /// `x x_m M` over all modes that have bases of more than one column; `y` is of the same size as `x`.
    #[inline(always)]
    pub fn multiply<S: Simd>(
        &self,
        simd: S,
        x: &mut Vec<S::f64s>,
        y: &mut Vec<S::f64s>,
        but: Option<usize>,
        matrices: impl Fn(usize) -> Matrices<'a>,
    ) {
        for m in self.modes(but) {
            let after = self.ranks[m + 1..].iter().product();
            // Sums of small ranks stay in registers.
            match self.ranks[m] {
                1 => continue,
                2 => small_product::<S, 2>(simd, x, after, matrices(m), y),
                3 => small_product::<S, 3>(simd, x, after, matrices(m), y),
                4 => small_product::<S, 4>(simd, x, after, matrices(m), y),
                rank => product(simd, x, (rank, after), matrices(m), y),
            }
            std::mem::swap(x, y);
        }
    }

    /// The modes that have bases.
    #[inline(always)]
    pub fn modes(&self, but: Option<usize>) -> impl Iterator<Item = usize> {
        (0..self.ranks.len()).filter(move |&m| Some(m) != but && !self.products[m].is_empty())
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
                for (sum, &m) in sums.iter_mut().zip(row) {
                    *sum = simd.mul_add_e_f64s(x[r * after + a], m, *sum);
                }
            }
            for (q, &sum) in sums.iter().enumerate() {
                y[q * after + a] = sum;
            }
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
fn read<S: Simd>(simd: S, x: &[f64]) -> S::f64s {
    match S::as_simd_f64s(x) {
        ([whole, ..], _) => *whole,
        (_, part) => simd.partial_load_f64s(part),
    }
}
