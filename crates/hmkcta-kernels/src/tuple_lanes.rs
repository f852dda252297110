//! The products of `pair_projection.rs`: some tuples at a time, the lanes of vectors.

use crate::machine::dispatch;
use pulp::{Simd, WithSimd};

/// Tuples worked on at a time: the lanes of the longest vectors.
pub const TUPLES: usize = 16;
/// Most columns whose sums are in registers at a time.
const TOGETHER: usize = 6;

/// `sums[r, l, t] += sum over rows i of weights[i, r, l] sum over columns j of x[i, j, t] panel[j, l]`, l being the
/// `width` columns of some cells' bases. Where row i and column j of `x` begin is the sum of their two places.
pub struct Product<'a> {
    pub x: &'a [f32],
    pub rows: &'a [usize],
    pub columns: &'a [usize],
    pub panel: &'a [f32],
    pub weights: &'a [f32],
    pub rank: usize,
    pub width: usize,
    pub sums: &'a mut [f32],
}

impl Product<'_> {
    /// Add it up.
    pub fn add_up(self) {
        dispatch(self);
    }
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let Product { rows, columns, rank, width, .. } = self;
        let last = rows.iter().max().zip(columns.iter().max());
        assert!(last.is_none_or(|(row, column)| row + column + TUPLES <= self.x.len()));
        assert!(self.panel.len() >= columns.len() * width && self.weights.len() >= rows.len() * rank * width);
        assert!(self.sums.len() >= rank * width * TUPLES);
        let step = width.div_ceil(width.div_ceil(TOGETHER));
        for first in (0..width).step_by(step) {
            // SAFETY: all rows, columns and sums lie within the slices.
            unsafe {
                match step.min(width - first) {
                    1 => self.rows::<S, 1>(simd, first),
                    2 => self.rows::<S, 2>(simd, first),
                    3 => self.rows::<S, 3>(simd, first),
                    4 => self.rows::<S, 4>(simd, first),
                    5 => self.rows::<S, 5>(simd, first),
                    _ => self.rows::<S, 6>(simd, first),
                }
            }
        }
    }
}

impl Product<'_> {
    /// All rows of `L` columns of bases, as many at a time as registers hold sums for.
    ///
    /// # Safety
    /// `L` columns from the first on, all rows, and the sums of both lie within the slices.
    #[inline(always)]
    unsafe fn rows<S: Simd, const L: usize>(&mut self, simd: S, first: usize) {
        let most = if S::REGISTER_COUNT >= 32 { 4 } else { 2 } * if L <= 2 { 2 } else { 1 };
        for tuple in (0..TUPLES).step_by(S::F32_LANES) {
            let mut row = 0;
            while row < self.rows.len() {
                // SAFETY: as the caller promises: these rows and columns lie within the slices.
                unsafe {
                    row += match most.min(self.rows.len() - row) {
                        8.. => self.tile::<S, L, 8>(simd, (first, row, tuple)),
                        4.. => self.tile::<S, L, 4>(simd, (first, row, tuple)),
                        2.. => self.tile::<S, L, 2>(simd, (first, row, tuple)),
                        _ => self.tile::<S, L, 1>(simd, (first, row, tuple)),
                    }
                }
            }
        }
    }

    /// `M` rows, of a vector of tuples.
    ///
    /// # Safety
    /// That of `rows`, for `M` rows from this one on.
    #[inline(always)]
    unsafe fn tile<S: Simd, const L: usize, const M: usize>(
        &mut self,
        simd: S,
        (first, row, tuple): (usize, usize, usize),
    ) -> usize {
        let mut products = [[simd.splat_f32s(0.0); L]; M];
        // SAFETY: as above.
        unsafe {
            let mut x = [self.x.as_ptr().add(tuple); M];
            for (i, x) in x.iter_mut().enumerate() {
                *x = x.add(self.rows[row + i]);
            }
            for (j, &column) in self.columns.iter().enumerate() {
                let panel = self.panel.as_ptr().add(j * self.width + first);
                let values = x.map(|x| x.add(column).cast::<S::f32s>().read_unaligned());
                for l in 0..L {
                    let number = simd.splat_f32s(*panel.add(l));
                    for (products, value) in products.iter_mut().zip(values) {
                        products[l] = simd.mul_add_e_f32s(number, value, products[l]);
                    }
                }
            }
            for r in 0..self.rank {
                for l in 0..L {
                    let sum = self.sums.as_mut_ptr().add((r * self.width + first + l) * TUPLES + tuple);
                    let sum = sum.cast::<S::f32s>();
                    let mut total = sum.read_unaligned();
                    for (i, products) in products.iter().enumerate() {
                        let weight = *self.weights.as_ptr().add(((row + i) * self.rank + r) * self.width + first + l);
                        total = simd.mul_add_e_f32s(simd.splat_f32s(weight), products[l], total);
                    }
                    sum.write_unaligned(total);
                }
            }
        }
        M
    }
}
