//! Cholesky factors and systems of equations in float64, for many columns at once; rows and columns come in blocks of eight.

use crate::machine::dispatch;
use pulp::{Simd, WithSimd};

/// Rows and columns are multiples of this: a vector of eight float64 is the longest.
pub const BLOCK: usize = 8;
/// Of a column of length one, what is left by those before is rounding noise below this share.
const DEPENDENT: f64 = 1e-14;

/// Rows of numbers that start `step` apart.
#[derive(Clone, Copy)]
pub struct Rows<'a> {
    pub numbers: &'a [f64],
    pub step: usize,
}

/// Turn `[square | beside]`, rows of `width` numbers, into `[U | U^-T beside]` with `U^T U` the square.
pub fn eliminate(panel: &mut [f64], width: usize) {
    for top in (0..panel.len() / width).step_by(BLOCK) {
        let (above, rest) = panel.split_at_mut(top * width);
        let above = Rows { numbers: above.get(top..).unwrap_or_default(), step: width };
        let block = &mut rest[top..BLOCK * width];
        let columns = width - top;
        subtract(Product {
            a: above.numbers,
            a_steps: (width, 1),
            b: above,
            depth: top,
            out: block,
            step: width,
            columns,
            upper: false,
        });
        let factor = Factor::of(block, width);
        dispatch(Apply { factor, out: block, step: width, columns, upward: false });
    }
}

/// `y = U^-T y`; y has rows of `columns` numbers.
pub fn forward(u: Rows, y: &mut [f64], columns: usize) {
    for top in (0..y.len() / columns).step_by(BLOCK) {
        let (above, block) = y.split_at_mut(top * columns);
        let block = &mut block[..BLOCK * columns];
        subtract_transposed(
            Rows { numbers: &u.numbers[top..], ..u },
            Rows { numbers: above, step: columns },
            top,
            block,
            columns,
        );
        let factor = Factor::known(&u.numbers[top * u.step + top..], u.step);
        dispatch(Apply { factor, out: block, step: columns, columns, upward: false });
    }
}

/// `x = U^-1 x`; x has rows of `columns` numbers.
pub fn backward(u: Rows, x: &mut [f64], columns: usize) {
    let rows = x.len() / columns;
    for top in (0..rows).step_by(BLOCK).rev() {
        let (block, below) = x[top * columns..].split_at_mut(BLOCK * columns);
        let line = &u.numbers[top * u.step + top..];
        let later = Rows { numbers: line.get(BLOCK..).unwrap_or_default(), ..u };
        subtract_product(later, Rows { numbers: below, step: columns }, rows - top - BLOCK, block);
        dispatch(Apply { factor: Factor::known(line, u.step), out: block, step: columns, columns, upward: true });
    }
}

/// `out -= A^T B`, for `depth` rows of both; rows of `out` are of `columns` numbers, which B's may exceed.
pub fn subtract_transposed(a: Rows, b: Rows, depth: usize, out: &mut [f64], columns: usize) {
    subtract(Product { a: a.numbers, a_steps: (a.step, 1), b, depth, out, step: columns, columns, upper: false });
}

/// `out -= A^T A` from the diagonal on; rows of `out` are of `columns` numbers, which A's may exceed.
pub fn subtract_gram(a: Rows, depth: usize, out: &mut [f64], columns: usize) {
    subtract(Product { a: a.numbers, a_steps: (a.step, 1), b: a, depth, out, step: columns, columns, upper: true });
}

/// `out -= A B`, for `depth` numbers of A's rows; rows of `out` are as long as B's.
pub fn subtract_product(a: Rows, b: Rows, depth: usize, out: &mut [f64]) {
    subtract(Product {
        a: a.numbers,
        a_steps: (1, a.step),
        b,
        depth,
        out,
        step: b.step,
        columns: b.step,
        upper: false,
    });
}

/// `out[i, c] -= sum_j a[j, i] b[j, c]`
struct Product<'a> {
    a: &'a [f64],
    /// From one j to the next, from one i to the next.
    a_steps: (usize, usize),
    b: Rows<'a>,
    depth: usize,
    out: &'a mut [f64],
    step: usize,
    columns: usize,
    /// Whether columns before the block of the diagonal are left as they are.
    upper: bool,
}

fn subtract(product: Product) {
    let Product { a, a_steps, b, depth, ref out, step, columns, .. } = product;
    let rows = out.len().div_ceil(step.max(1));
    assert!(rows.is_multiple_of(BLOCK) && columns.is_multiple_of(BLOCK));
    if depth * rows * columns == 0 {
        return;
    }
    assert!((depth - 1) * a_steps.0 + (rows - 1) * a_steps.1 < a.len());
    assert!((depth - 1) * b.step + columns <= b.numbers.len() && (rows - 1) * step + columns <= out.len());
    dispatch(product);
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        // SAFETY: `subtract` has checked that all rows and columns lie within the slices.
        unsafe { if S::REGISTER_COUNT >= 32 { self.blocks::<S, 8>(simd) } else { self.blocks::<S, 4>(simd) } }
    }
}

impl Product<'_> {
    /// # Safety
    /// Slices hold all rows and columns, both whole blocks.
    #[inline(always)]
    unsafe fn blocks<S: Simd, const M: usize>(&mut self, simd: S) {
        let pair = 2 * S::F64_LANES;
        for row in (0..self.out.len().div_ceil(self.step)).step_by(M) {
            let first = if self.upper { row - row % BLOCK } else { 0 };
            let whole = self.columns - (self.columns - first) % pair;
            // SAFETY: as the caller promises; whole blocks of rows and columns are there.
            unsafe {
                for column in (first..whole).step_by(pair) {
                    self.tile::<S, M, 2>(simd, row, column);
                }
                for column in (whole..self.columns).step_by(S::F64_LANES) {
                    self.tile::<S, M, 1>(simd, row, column);
                }
            }
        }
    }

    /// `M` rows of `V` vectors of columns, which stay in registers.
    ///
    /// # Safety
    /// Slices hold these rows and columns.
    #[inline(always)]
    unsafe fn tile<S: Simd, const M: usize, const V: usize>(&mut self, simd: S, row: usize, column: usize) {
        // SAFETY: places of whole vectors of columns, which the caller promises.
        let at = |from: *const f64, v: usize| unsafe { from.add(v * S::F64_LANES).cast::<S::f64s>() };
        let mut sums = [[simd.splat_f64s(0.0); V]; M];
        // SAFETY: as the caller promises: `M` rows and `V` vectors of columns from here on are within the slices.
        unsafe {
            let mut a = self.a.as_ptr().add(row * self.a_steps.1);
            let mut b = self.b.numbers.as_ptr().add(column);
            for _ in 0..self.depth {
                let values: [S::f64s; V] = std::array::from_fn(|v| at(b, v).read_unaligned());
                for (m, sums) in sums.iter_mut().enumerate() {
                    let weight = simd.splat_f64s(*a.add(m * self.a_steps.1));
                    for (sum, value) in sums.iter_mut().zip(values) {
                        *sum = simd.mul_add_e_f64s(weight, value, *sum);
                    }
                }
                a = a.wrapping_add(self.a_steps.0);
                b = b.wrapping_add(self.b.step);
            }
            for (m, sums) in sums.into_iter().enumerate() {
                let out = self.out.as_mut_ptr().add((row + m) * self.step + column);
                for (v, sum) in sums.into_iter().enumerate() {
                    let to = out.add(v * S::F64_LANES).cast::<S::f64s>();
                    to.write_unaligned(simd.sub_f64s(to.read_unaligned(), sum));
                }
            }
        }
    }
}

/// U of one block, and the inverses of its diagonal, zero where a column depends on those before.
struct Factor {
    upper: [[f64; BLOCK]; BLOCK],
    inverse: [f64; BLOCK],
}

impl Factor {
    /// Of the symmetric block that `rows` start with.
    fn of(rows: &[f64], step: usize) -> Factor {
        let mut upper: [[f64; BLOCK]; BLOCK] = std::array::from_fn(|i| std::array::from_fn(|j| rows[i * step + j]));
        let mut inverse = [0.0; BLOCK];
        for i in 0..BLOCK {
            for j in 0..i {
                let (above, row) = upper.split_at_mut(i);
                let weight = above[j][i];
                row[0][i..].iter_mut().zip(&above[j][i..]).for_each(|(to, &u)| *to -= weight * u);
            }
            inverse[i] = if upper[i][i] > DEPENDENT { upper[i][i].sqrt().recip() } else { 0.0 };
            upper[i][i..].iter_mut().for_each(|u| *u *= inverse[i]);
        }
        Factor { upper, inverse }
    }

    /// The block of U that `rows` start with.
    fn known(rows: &[f64], step: usize) -> Factor {
        let upper: [[f64; BLOCK]; BLOCK] = std::array::from_fn(|i| std::array::from_fn(|j| rows[i * step + j]));
        let inverse = std::array::from_fn(|i| if upper[i][i] > 0.0 { upper[i][i].recip() } else { 0.0 });
        Factor { upper, inverse }
    }
}

/// `out = U^-T out`, or, upward, `U^-1 out`, for the rows of one block.
struct Apply<'a> {
    factor: Factor,
    out: &'a mut [f64],
    step: usize,
    columns: usize,
    upward: bool,
}

impl WithSimd for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Apply { factor: Factor { upper, inverse }, out, step, columns, upward } = self;
        assert!(columns.is_multiple_of(BLOCK) && (BLOCK - 1) * step + columns <= out.len());
        for column in (0..columns).step_by(S::F64_LANES) {
            // SAFETY: all eight rows have these columns.
            let at = |i: usize| unsafe { out.as_ptr().add(i * step + column).cast_mut().cast::<S::f64s>() };
            // SAFETY: a vector of columns is there, as `columns` are whole blocks.
            let mut rows: [S::f64s; BLOCK] = std::array::from_fn(|i| unsafe { at(i).read_unaligned() });
            for turn in 0..BLOCK {
                let i = if upward { BLOCK - 1 - turn } else { turn };
                let mut sum = rows[i];
                for other in 0..turn {
                    let j = if upward { BLOCK - 1 - other } else { other };
                    let weight = if upward { upper[i][j] } else { upper[j][i] };
                    sum = simd.mul_add_e_f64s(simd.splat_f64s(-weight), rows[j], sum);
                }
                rows[i] = simd.mul_f64s(sum, simd.splat_f64s(inverse[i]));
            }
            // SAFETY: as above.
            rows.into_iter().enumerate().for_each(|(i, row)| unsafe { at(i).write_unaligned(row) });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::numbers;

    #[test]
    fn panels_are_eliminated_and_solved() {
        on_all_machines(solve_a_system);
    }

    fn solve_a_system() {
        let (rows, beside) = (24, 16);
        let d: Vec<f64> = numbers(rows * 40, 3).into_iter().map(f64::from).collect();
        let width = rows + beside;
        let h = |i: usize, j: usize| (0..40).map(|t| d[i * 40 + t] * d[j * 40 + t]).sum::<f64>();
        let x = |i: usize, c: usize| (i * 7 % 11) as f64 - c as f64;
        let right = |i: usize, c: usize| (0..rows).map(|j| h(i, j) * x(j, c)).sum::<f64>();
        let line = |i: usize| (0..width).map(move |c| if c < rows { h(i, c) } else { right(i, c - rows) });
        let mut panel: Vec<f64> = (0..rows).flat_map(line).collect();
        eliminate(&mut panel, width);
        let u = Rows { numbers: &panel, step: width };
        let mut found: Vec<f64> = (0..rows * beside).map(|at| right(at / beside, at % beside)).collect();
        forward(u, &mut found, beside);
        for (y, line) in found.chunks_exact(beside).zip(panel.chunks_exact(width)) {
            y.iter().zip(&line[rows..]).for_each(|(y, known)| assert!((y - known).abs() < 1e-9));
        }
        backward(u, &mut found, beside);
        for (at, value) in found.iter().enumerate() {
            let expected = x(at / beside, at % beside);
            assert!((value - expected).abs() < 1e-6, "{value} instead of {expected}");
        }
    }

    #[test]
    fn dependent_columns_are_left_out() {
        // The first two columns are the same: the second gets nothing.
        let mut square: Vec<f64> = (0..64).map(|at| if at % 9 == 0 { 1.0 } else { 0.0 }).collect();
        (square[1], square[8]) = (1.0, 1.0);
        let mut x = vec![0.0; 64];
        (x[0], x[8]) = (3.0, 3.0);
        eliminate(&mut square, 8);
        let u = Rows { numbers: &square, step: 8 };
        forward(u, &mut x, 8);
        backward(u, &mut x, 8);
        assert_eq!((x[0], x[8]), (3.0, 0.0));
    }
}
