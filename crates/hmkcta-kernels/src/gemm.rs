//! Matrix products `C (+)= A B` in which A may be strided and the rows of B and C are contiguous: the lanes run along
//! the columns. Tiles of the result stay in registers. The instruction set is chosen at run time by `pulp`.

use crate::machine::{dispatch, prefetch_from};
use crate::masked::{load, store};
use crate::shared::Shared;
use crate::threads::{PIECES, PRODUCTS, for_each};
use pulp::{MemMask, Simd, WithSimd};
use std::ops::Range;

/// Rows of B worked off before the next columns: 256 rows of a tile's columns fit the level 1 or 2 cache.
const DEPTH: usize = 256;
/// Numbers of a panel of B that stay in the level 1 cache.
const CACHED: usize = 4096;
/// A result of fewer numbers is in the cache, or soon will be.
const NEAR: usize = 1 << 14;
/// Rows of a tile and vectors of each, where there are 32 registers, and where there are 16.
const WIDE: (usize, usize) = (4, 4);
const NARROW: (usize, usize) = (6, 2);
/// Columns of which several make up the part of a thread: whole tiles and cache lines.
const COLUMNS: usize = 64;

/// A matrix within a slice.
#[derive(Clone, Copy)]
pub struct Matrix<'a> {
    data: &'a [f32],
    rows: usize,
    columns: usize,
    row_step: usize,
    column_step: usize,
}

impl<'a> Matrix<'a> {
    /// A matrix whose rows lie one behind the other.
    pub fn new(data: &'a [f32], rows: usize, columns: usize) -> Self {
        Matrix { data, rows, columns, row_step: columns, column_step: 1 }
    }

    /// The same with rows that start `step` numbers apart.
    pub fn with_row_step(self, step: usize) -> Self {
        Matrix { row_step: step, ..self }
    }

    /// The transpose.
    pub fn transposed(self) -> Self {
        let Matrix { data, rows, columns, row_step, column_step } = self;
        Matrix { data, rows: columns, columns: rows, row_step: column_step, column_step: row_step }
    }

    /// `count` columns from `first` on.
    pub fn columns(self, first: usize, count: usize) -> Self {
        Matrix { data: &self.data[first * self.column_step..], columns: count, ..self }
    }

    /// The place of the last number.
    fn last(&self) -> usize {
        (self.rows - 1) * self.row_step + (self.columns - 1) * self.column_step
    }
}

/// `C = A B` or `C += A B`; B has contiguous rows.
///
/// Where `out` has room for several C, there are as many B one behind the other, and each is multiplied.
pub fn multiply(a: Matrix, b: Matrix, add: bool, out: &mut [f32]) {
    multiply_on(false, a, b, add, out);
}

/// The same, by several threads if `parallel` and if it is worth it.
pub fn multiply_on(parallel: bool, a: Matrix, b: Matrix, add: bool, out: &mut [f32]) {
    let size = a.rows * b.columns;
    assert!(a.columns == b.rows && b.column_step == 1 && out.len().is_multiple_of(size.max(1)));
    if out.is_empty() {
        return;
    }
    if a.columns == 0 {
        out.fill(if add { return } else { 0.0 });
        return;
    }
    let times = out.len() / size;
    let last = (times - 1) * b.rows * b.row_step + b.last();
    assert!(a.last() < a.data.len() && last < b.data.len());
    let out_row = b.columns;
    if parallel && out.len() * a.columns >= PRODUCTS {
        let shared = Shared::new(out);
        Run { a, b, add, times, out: shared.place(0), out_row }.in_pieces(shared);
    } else {
        dispatch(Run { a, b, add, times, out: out.as_mut_ptr(), out_row });
    }
}

/// Several products, `times` of them.
#[derive(Clone, Copy)]
struct Run<'a> {
    a: Matrix<'a>,
    b: Matrix<'a>,
    add: bool,
    times: usize,
    /// Where C starts, and numbers from one of its rows to the next.
    out: *mut f32,
    out_row: usize,
}

impl Run<'_> {
    /// Threads share the products or, where these are few, columns of each. That changes nothing in any sum.
    fn in_pieces(self, out: Shared) {
        let Run { a, b, add, times, out_row, .. } = self;
        let some = times.div_ceil(PIECES);
        let width = b.columns.div_ceil(PIECES.div_ceil(times)).next_multiple_of(COLUMNS);
        let columns = || (0..b.columns).step_by(width);
        let tasks = (0..times).step_by(some).flat_map(|first| columns().map(move |from| (first, from))).collect();
        for_each(true, tasks, |(first, from): (usize, usize)| {
            let part = b.columns(from, width.min(b.columns - from));
            let b = Matrix { data: &part.data[first * b.rows * b.row_step..], ..part };
            let out = out.place(first * a.rows * out_row + from);
            dispatch(Run { a, b, add, times: some.min(times - first), out, out_row });
        });
    }
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Run { a, b, add, times, out, out_row } = self;
        for number in 0..times {
            for k in (0..a.columns).step_by(DEPTH) {
                let depth = DEPTH.min(a.columns - k);
                let panel = Panel {
                    a: a.data[k * a.column_step..].as_ptr(),
                    a_steps: (a.row_step, a.column_step),
                    b: b.data[(number * b.rows + k) * b.row_step..].as_ptr(),
                    b_row: b.row_step,
                    out: out.wrapping_add(number * a.rows * out_row),
                    out_row,
                    m: a.rows,
                    n: b.columns,
                    depth,
                    add: add || k > 0,
                    ahead: ahead(a.rows, b.columns, depth),
                };
                // SAFETY: all rows and columns lie within the slices, as has been checked, and no other thread has these.
                unsafe {
                    match S::REGISTER_COUNT {
                        32.. => panel.run::<S, { WIDE.0 }, { WIDE.1 }>(simd),
                        _ => panel.run::<S, { NARROW.0 }, { NARROW.1 }>(simd),
                    }
                }
            }
        }
    }
}

/// One product over at most `DEPTH` rows of B.
#[derive(Clone, Copy)]
struct Panel {
    a: *const f32,
    a_steps: (usize, usize),
    b: *const f32,
    b_row: usize,
    out: *mut f32,
    out_row: usize,
    m: usize,
    n: usize,
    depth: usize,
    add: bool,
    /// How far beyond a tile of C that which comes much later begins; 0: all of C is near.
    ahead: usize,
}

/// Where to fetch C from memory in time: in the panel after this one or, of short rows, in those after the next.
fn ahead(rows: usize, columns: usize, depth: usize) -> usize {
    match CACHED / depth {
        _ if rows * columns < NEAR => 0,
        panel if panel < columns => panel,
        _ => 2 * WIDE.0 * columns,
    }
}

impl Panel {
    /// All columns, `MAX` vectors at a time, then what is left.
    ///
    /// # Safety
    /// A, B and C have these rows and columns, and nobody else has those of C.
    #[inline(always)]
    unsafe fn run<S: Simd, const M: usize, const MAX: usize>(self, simd: S) {
        let wide = MAX * S::F32_LANES;
        let whole = self.n - self.n % wide;
        let full = MemMask::new(simd.mask_between_m32s(0, S::F32_LANES as u32).mask());
        let panel = (CACHED / self.depth).next_multiple_of(wide);
        for first in (0..whole).step_by(panel) {
            // SAFETY: as the caller promises, of some columns.
            unsafe { self.rows::<S, M, MAX>(simd, first..whole.min(first + panel), full) };
        }
        let rest = self.n - whole;
        if rest > 0 {
            let vectors = rest.div_ceil(S::F32_LANES);
            let last = simd.mask_between_m32s(0, (rest - (vectors - 1) * S::F32_LANES) as u32);
            // A plain mask: pulp's own carries jump addresses that cost more than they save here.
            let last = MemMask::new(last.mask());
            // SAFETY: as above, of the columns that are left, which the mask enables.
            unsafe {
                match vectors {
                    1 => self.columns::<S, M, 1, true>(simd, whole, last),
                    2 => self.columns::<S, M, 2, true>(simd, whole, last),
                    3 => self.columns::<S, M, 3, true>(simd, whole, last),
                    _ => self.columns::<S, M, 4, true>(simd, whole, last),
                }
            }
        }
    }

    /// Whole vectors of columns, `MAX` at a time, of all rows of C, `M` at a time.
    ///
    /// # Safety
    /// A, B and C have these rows and columns, and nobody else has those of C.
    #[inline(always)]
    unsafe fn rows<S: Simd, const M: usize, const MAX: usize>(
        self,
        simd: S,
        columns: Range<usize>,
        full: MemMask<S::m32s>,
    ) {
        let step = MAX * S::F32_LANES;
        let mut row = 0;
        while row + M <= self.m {
            for column in columns.clone().step_by(step) {
                // SAFETY: as the caller promises: these rows and columns are there.
                unsafe { self.tile::<S, M, MAX, false>(simd, row, column, full) };
            }
            row += M;
        }
        if row < self.m {
            let rest = Panel {
                a: self.a.wrapping_add(row * self.a_steps.0),
                out: self.out.wrapping_add(row * self.out_row),
                m: self.m - row,
                ..self
            };
            for column in columns.step_by(step) {
                // SAFETY: as above, of the rows that are left.
                unsafe { rest.columns::<S, M, MAX, false>(simd, column, full) };
            }
        }
    }

    /// `V` vectors of columns, the last one `MASKED` or whole, of all rows of C, `M` at a time.
    ///
    /// # Safety
    /// A, B and C have these rows and columns, and nobody else has those of C.
    #[inline(always)]
    unsafe fn columns<S: Simd, const M: usize, const V: usize, const MASKED: bool>(
        self,
        simd: S,
        column: usize,
        last: MemMask<S::m32s>,
    ) {
        let mut row = 0;
        // SAFETY: as the caller promises: `M` rows from this one on, or as many as are left.
        unsafe {
            while row + M <= self.m {
                self.tile::<S, M, V, MASKED>(simd, row, column, last);
                row += M;
            }
            match self.m - row {
                0 => (),
                1 => self.tile::<S, 1, V, MASKED>(simd, row, column, last),
                2 => self.tile::<S, 2, V, MASKED>(simd, row, column, last),
                3 => self.tile::<S, 3, V, MASKED>(simd, row, column, last),
                4 => self.tile::<S, 4, V, MASKED>(simd, row, column, last),
                _ => self.tile::<S, 5, V, MASKED>(simd, row, column, last),
            }
        }
    }

    /// `M` rows by `V` vectors of C, kept in registers.
    ///
    /// # Safety
    /// A, B and C have these rows and columns, and nobody else has those of C.
    #[inline(always)]
    unsafe fn tile<S: Simd, const M: usize, const V: usize, const MASKED: bool>(
        self,
        simd: S,
        row: usize,
        column: usize,
        last: MemMask<S::m32s>,
    ) {
        let mut sums = [[simd.splat_f32s(0.0); V]; M];
        // SAFETY: as the caller promises: all of A, B and C that is touched is there.
        unsafe {
            let out = self.out.add(row * self.out_row + column);
            if self.ahead > 0 {
                (0..M).for_each(|i| prefetch_from(out.wrapping_add(i * self.out_row + self.ahead), V * S::F32_LANES));
            }
            if self.add {
                for (i, line) in sums.iter_mut().enumerate() {
                    *line = load::<S, V, MASKED>(simd, out.add(i * self.out_row), last);
                }
            }
            let mut a = self.a.add(row * self.a_steps.0);
            let mut b = self.b.add(column);
            for _ in 0..self.depth {
                let values = load::<S, V, MASKED>(simd, b, last);
                for (i, line) in sums.iter_mut().enumerate() {
                    let weight = simd.splat_f32s(*a.add(i * self.a_steps.0));
                    for (sum, &value) in line.iter_mut().zip(&values) {
                        *sum = simd.mul_add_e_f32s(weight, value, *sum);
                    }
                }
                // The last step may leave the slice, which only wrapping arithmetic may.
                a = a.wrapping_add(self.a_steps.1);
                b = b.wrapping_add(self.b_row);
            }
            for (i, line) in sums.iter().enumerate() {
                store::<S, V, MASKED>(simd, out.add(i * self.out_row), line, last);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::{close, numbers, on_any_threads, same_bits};

    #[test]
    fn agrees_with_the_definition() {
        on_all_machines(compare_with_the_definition);
    }

    fn compare_with_the_definition() {
        for (seed, &(m, k, n, batch)) in [
            (1, 1, 1, 1),
            (4, 7, 64, 2),
            (5, 3, 100, 3),
            (3, 600, 17, 1),
            (9, 257, 49, 2),
            (2, 0, 5, 1),
            (7, 2, 130, 1),
        ]
        .iter()
        .enumerate()
        {
            for (turned, b_row, add) in [(false, n, false), (true, n + 3, true)] {
                let (a, b) = (numbers(m * k, seed as u64), numbers(batch * k * b_row, seed as u64 + 100));
                let before = numbers(batch * m * n, seed as u64 + 200);
                let mut out = before.clone();
                let left = if turned { Matrix::new(&a, k, m).transposed() } else { Matrix::new(&a, m, k) };
                multiply(left, Matrix::new(&b, k, n).with_row_step(b_row), add, &mut out);
                for (at, &value) in out.iter().enumerate() {
                    let (t, i, j) = (at / (m * n), at / n % m, at % n);
                    let sum: f64 = (0..k)
                        .map(|q| {
                            f64::from(if turned { a[q * m + i] } else { a[i * k + q] })
                                * f64::from(b[(t * k + q) * b_row + j])
                        })
                        .sum();
                    close(value, if add { sum + f64::from(before[at]) } else { sum });
                }
            }
        }
    }

    #[test]
    fn threads_change_nothing() {
        // One wide product, a few, and many small ones.
        for (m, k, n, times) in [(5, 300, 1500, 1), (3, 100, 2000, 4), (4, 50, 60, 200)] {
            let (a, b) = (numbers(m * k, 1), numbers(times * k * n, 2));
            let product = |parallel| {
                let mut out = numbers(times * m * n, 3);
                multiply_on(parallel, Matrix::new(&a, m, k), Matrix::new(&b, k, n), true, &mut out);
                out
            };
            assert!(m * k * n * times >= PRODUCTS);
            assert!(same_bits(&on_any_threads(|| product(true)), &product(false)));
        }
    }
}
