//! Matrix products `C = A B^T`: inner products of contiguous rows, the lanes run along the rows.

use crate::machine::dispatch;
use crate::threads::{PIECES, PRODUCTS, for_each};
use pulp::{MemMask, Simd, WithSimd};

/// Numbers of a row worked off before the next rows: eight such pieces fit the level 1 or 2 cache.
const DEPTH: usize = 2048;
const ROWS: usize = 4;

/// `out[i, j] = sum_k a[i, k] b[j, k]` with contiguous rows of `k` numbers, or that added to `out`.
pub fn dots(a: &[f32], b: &[f32], k: usize, out: &mut [f32], add: bool) {
    if k == 0 {
        out.fill(if add { return } else { 0.0 });
        return;
    }
    let (m, n) = (a.len() / k, b.len() / k);
    assert!(a.len() == m * k && b.len() == n * k && out.len() == m * n);
    dispatch(Run { a, b, k, out, add });
}

/// The same, by several threads if `parallel` and if it is worth it: each has some rows of A.
pub fn dots_on(parallel: bool, a: &[f32], b: &[f32], k: usize, add: bool, out: &mut [f32]) {
    if !parallel || out.len() * k < PRODUCTS {
        return dots(a, b, k, out, add);
    }
    let (m, n) = (a.len() / k, b.len() / k);
    assert!(a.len() == m * k && out.len() == m * n);
    let rows = m.div_ceil(PIECES).next_multiple_of(ROWS);
    let tasks = a.chunks(rows * k).zip(out.chunks_mut(rows * n)).collect();
    for_each(true, tasks, |(a, out)| dots(a, b, k, out, add));
}

struct Run<'a> {
    a: &'a [f32],
    b: &'a [f32],
    k: usize,
    out: &'a mut [f32],
    add: bool,
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for from in (0..self.k).step_by(DEPTH) {
            if S::REGISTER_COUNT >= 32 { self.piece::<S, 4>(simd, from) } else { self.piece::<S, 2>(simd, from) }
        }
    }
}

impl Run<'_> {
    /// All pairs over at most `DEPTH` numbers from `from` on, `N` rows of B at a time.
    #[inline(always)]
    fn piece<S: Simd, const N: usize>(&mut self, simd: S, from: usize) {
        let m = self.a.len() / self.k;
        let whole = m - m % ROWS;
        for row in (0..whole).step_by(ROWS) {
            self.rows::<S, ROWS, N>(simd, row, from);
        }
        for row in whole..m {
            self.rows::<S, 1, N>(simd, row, from);
        }
    }

    #[inline(always)]
    fn rows<S: Simd, const M: usize, const N: usize>(&mut self, simd: S, row: usize, from: usize) {
        let n = self.b.len() / self.k;
        let whole = n - n % N;
        for column in (0..whole).step_by(N) {
            self.tile::<S, M, N>(simd, row, column, from);
        }
        match n - whole {
            0 => (),
            1 => self.tile::<S, M, 1>(simd, row, whole, from),
            2 => self.tile::<S, M, 2>(simd, row, whole, from),
            _ => self.tile::<S, M, 3>(simd, row, whole, from),
        }
    }

    /// `M` by `N` inner products over one piece, added to what earlier pieces gave.
    #[inline(always)]
    fn tile<S: Simd, const M: usize, const N: usize>(&mut self, simd: S, row: usize, column: usize, from: usize) {
        let length = DEPTH.min(self.k - from);
        let a: [&[f32]; M] = std::array::from_fn(|i| &self.a[(row + i) * self.k + from..][..length]);
        let b: [&[f32]; N] = std::array::from_fn(|j| &self.b[(column + j) * self.k + from..][..length]);
        let sums = inner_products::<S, M, N>(simd, a, b, length);
        let n = self.b.len() / self.k;
        let keep = from > 0 || self.add;
        for (line, out) in sums.iter().zip(self.out[row * n..].chunks_mut(n)) {
            for (sum, out) in line.iter().zip(&mut out[column..column + N]) {
                *out = if keep { *out } else { 0.0 } + simd.reduce_sum_f32s(*sum);
            }
        }
    }
}

#[inline(always)]
fn inner_products<S: Simd, const M: usize, const N: usize>(
    simd: S,
    a: [&[f32]; M],
    b: [&[f32]; N],
    length: usize,
) -> [[S::f32s; N]; M] {
    let mut sums = [[simd.splat_f32s(0.0); N]; M];
    let whole = length - length % S::F32_LANES;
    let mask = MemMask::new(simd.mask_between_m32s(0, (length - whole) as u32).mask());
    // SAFETY: every slice has `length` numbers, `at + F32_LANES <= length`, and the mask enables what is left.
    unsafe {
        for at in (0..whole).step_by(S::F32_LANES) {
            add_products::<S, M, N, false>(simd, &mut sums, &a, &b, at, mask);
        }
        if whole < length {
            add_products::<S, M, N, true>(simd, &mut sums, &a, &b, whole, mask);
        }
    }
    sums
}

/// `sums[i][j] += a[i] * b[j]` for the vectors at `at`.
///
/// # Safety
/// All rows have a vector of numbers from there on, or what the mask enables.
#[inline(always)]
unsafe fn add_products<S: Simd, const M: usize, const N: usize, const MASKED: bool>(
    simd: S,
    sums: &mut [[S::f32s; N]; M],
    a: &[&[f32]; M],
    b: &[&[f32]; N],
    at: usize,
    mask: MemMask<S::m32s>,
) {
    // SAFETY: as the caller promises.
    unsafe {
        let mut right = [simd.splat_f32s(0.0); N];
        for (value, row) in right.iter_mut().zip(b) {
            *value = read::<S, MASKED>(simd, row.as_ptr().add(at), mask);
        }
        for (line, row) in sums.iter_mut().zip(a) {
            let left = read::<S, MASKED>(simd, row.as_ptr().add(at), mask);
            for (sum, &value) in line.iter_mut().zip(&right) {
                *sum = simd.mul_add_e_f32s(left, value, *sum);
            }
        }
    }
}

/// # Safety
/// `from` points to a vector of numbers, or to what the mask enables.
#[inline(always)]
unsafe fn read<S: Simd, const MASKED: bool>(simd: S, from: *const f32, mask: MemMask<S::m32s>) -> S::f32s {
    // SAFETY: as the caller promises: a vector of numbers is there, or what the mask enables.
    unsafe { if MASKED { simd.mask_load_ptr_f32s(mask, from) } else { from.cast::<S::f32s>().read_unaligned() } }
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
        for (seed, &(m, n, k)) in
            [(1, 1, 1), (4, 4, 64), (5, 6, 33), (3, 7, 5000), (9, 2, 15), (2, 2, 0)].iter().enumerate()
        {
            let (a, b) = (numbers(m * k, seed as u64), numbers(n * k, seed as u64 + 50));
            for add in [false, true] {
                let mut out = vec![7.0; m * n];
                dots(&a, &b, k, &mut out, add);
                for (at, &value) in out.iter().enumerate() {
                    let (i, j) = (at / n, at % n);
                    let sum: f64 = (0..k).map(|q| f64::from(a[i * k + q]) * f64::from(b[j * k + q])).sum();
                    close(value, if add { sum + 7.0 } else { sum });
                }
            }
        }
    }

    #[test]
    fn threads_change_nothing() {
        let (m, n, k) = (333, 3, 2100);
        let (a, b) = (numbers(m * k, 1), numbers(n * k, 2));
        let product = |parallel| {
            let mut out = numbers(m * n, 3);
            dots_on(parallel, &a, &b, k, true, &mut out);
            out
        };
        assert!(m * n * k >= PRODUCTS);
        assert!(same_bits(&on_any_threads(|| product(true)), &product(false)));
    }
}
