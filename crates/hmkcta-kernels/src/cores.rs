//! Cores of all cells together, the bases given: least squares by conjugate gradients.

use crate::machine::dispatch;
use crate::pairs::{PARALLEL_PAIRS, Pairs, read};
use crate::threads::for_each;
use pulp::{Simd, WithSimd};

/// Where what is left of the right sides, squared, is a smaller share of them, the cores are exact.
const EXACT: f64 = 1e-14;

/// Change the cores `[PC, R_1, .., R_N]` to leave less of the tensor, of which `b` are the projections on all bases.
///
/// They solve `G Z = b` where `(G Z)_c = sum_c' Z_c' x_m M_m(c, c')` over all decomposed modes m.
pub fn solve_cores(pairs: &Pairs, cores: &mut [f32], b: &[f64], steps: usize) {
    let (cells, size) = (pairs.cells, pairs.core_size());
    let mut z = cells_last(cores.iter().map(|&z| f64::from(z)), cells, size);
    let b = cells_last(b.iter().copied(), cells, size);
    let mut r: Vec<f64> = b.iter().zip(normal(pairs, &z)).map(|(b, g)| b - g).collect();
    let (mut p, mut left) = (r.clone(), dot(&r, &r));
    for _ in 0..steps {
        let q = normal(pairs, &p);
        let curvature = dot(&p, &q);
        if left <= EXACT * dot(&b, &b) || curvature <= 0.0 {
            break;
        }
        let step = left / curvature;
        z.iter_mut().zip(&p).for_each(|(z, p)| *z += step * p);
        r.iter_mut().zip(&q).for_each(|(r, q)| *r -= step * q);
        let before = std::mem::replace(&mut left, dot(&r, &r));
        p.iter_mut().zip(&r).for_each(|(p, r)| *p = r + left / before * *p);
    }
    cores.iter_mut().enumerate().for_each(|(at, core)| *core = z[at % size * cells + at / size] as f32);
}

fn dot(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

/// Numbers `[PC, R_1, .., R_N]` as `[R_1, .., R_N, PC]`.
fn cells_last(numbers: impl Iterator<Item = f64>, cells: usize, size: usize) -> Vec<f64> {
    let mut last = vec![0.0; size * cells];
    numbers.enumerate().for_each(|(at, value)| last[at % size * cells + at / size] = value);
    last
}

/// `G Z` for `z` `[R_1, .., R_N, PC]`, likewise.
fn normal(pairs: &Pairs, z: &[f64]) -> Vec<f64> {
    let (cells, size) = (pairs.cells, pairs.core_size());
    let mut g = vec![0.0; cells * size];
    let tasks = g.chunks_mut(size).enumerate().collect();
    for_each(cells * cells >= PARALLEL_PAIRS, tasks, |(cell, g)| dispatch(Row { pairs, cell, z, g }));
    cells_last(g.into_iter(), cells, size)
}

/// `(G Z)_c` of one cell c, `[R_1, .., R_N]`.
struct Row<'a> {
    pairs: &'a Pairs<'a>,
    cell: usize,
    z: &'a [f64],
    g: &'a mut [f64],
}

impl WithSimd for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Row { pairs, cell, z, g } = self;
        let (cells, zero) = (pairs.cells, simd.splat_f64s(0.0));
        let (mut x, mut y, mut sum) = (vec![zero; g.len()], vec![zero; g.len()], vec![zero; g.len()]);
        for other in (0..cells).step_by(S::F64_LANES) {
            let end = cells.min(other + S::F64_LANES);
            x.iter_mut().enumerate().for_each(|(at, x)| *x = read(simd, &z[at * cells + other..at * cells + end]));
            for m in pairs.decomposed() {
                let back = pairs.matrices(simd, m, (cell, other)).transposed();
                pairs.mode_product(simd, &x, m, back, &mut y);
                std::mem::swap(&mut x, &mut y);
            }
            sum.iter_mut().zip(&x).for_each(|(sum, &x)| *sum = simd.add_f64s(*sum, x));
        }
        g.iter_mut().zip(&sum).for_each(|(g, &sum)| *g = simd.reduce_sum_f64s(sum));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::{CELLS, OverlappingCells, RANKS, numbers};

    #[test]
    fn leaves_nothing_that_cores_could_take() {
        on_all_machines(compare_with_explicit_columns);
    }

    /// b of a tensor that the bases can express: its cores leave nothing.
    fn compare_with_explicit_columns() {
        let cells = OverlappingCells::new();
        // Column (c, r, s, t): U_{1,c}[i, r] U_{2,c}[j, s] where k = t.
        let column = |at: usize, i: usize, j: usize, k: usize| -> f64 {
            let (c, r, s, t) = (at / 12, at / 6 % 2, at / 2 % 3, at % 2);
            if k == t { cells.basis(0, c, i, r) * cells.basis(1, c, j, s) } else { 0.0 }
        };
        let places = || (0..24).map(|at| (at / 8, at / 2 % 4, at % 2));
        let model = |z: &[f32]| -> Vec<f64> {
            let value = |(i, j, k)| z.iter().enumerate().map(|(at, &z)| f64::from(z) * column(at, i, j, k)).sum();
            places().map(value).collect()
        };
        let tensor = model(&numbers(CELLS * 12, 7));
        let b: Vec<f64> = (0..CELLS * 12)
            .map(|at| places().zip(&tensor).map(|((i, j, k), t)| t * column(at, i, j, k)).sum())
            .collect();
        let mut cores = numbers(CELLS * 12, 9);
        let products = cells.products();
        let products: Vec<&[f64]> = products.iter().map(Vec::as_slice).collect();
        let pairs = Pairs { cells: CELLS, ranks: &RANKS, products: &products };
        let left = |cores: &[f32]| tensor.iter().zip(model(cores)).map(|(t, m)| (t - m).powi(2)).sum::<f64>();
        let mut before = left(&cores);
        for _ in 0..4 {
            solve_cores(&pairs, &mut cores, &b, 4);
            let after = left(&cores);
            assert!(after < before, "{after} after {before}");
            before = after;
        }
        solve_cores(&pairs, &mut cores, &b, 200);
        let whole: f64 = tensor.iter().map(|t| t * t).sum();
        assert!(left(&cores) < 1e-10 * whole, "{} of {whole}", left(&cores));
    }
}
