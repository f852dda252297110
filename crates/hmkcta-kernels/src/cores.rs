//! Cores of all cells together, the bases given: least squares by conjugate gradients.

use crate::cell_pairs::{Laid, Pairs};
use crate::machine::dispatch;
use crate::sizes::zeros;
use pulp::{Simd, WithSimd};

/// Where what is left of the right sides, squared, is a smaller share of them, the cores are exact.
const EXACT: f64 = 1e-14;

/// Change the cores `[PC, R_1, .., R_N]` to leave less of the tensor, of which `b` are the projections on all bases.
///
/// They solve `G Z = b` where `(G Z)_c = sum_c' Z_c' x_m M_m(c, c')` over all decomposed modes m.
pub fn solve_cores(pairs: &Pairs, cores: &mut [f32], b: &[f64], steps: usize) {
    let (cells, size) = (pairs.cells, pairs.core_size());
    let mut z = Laid::new(cells, size, cores.iter().map(|&z| f64::from(z)));
    let b = Laid::new(cells, size, b.iter().copied());
    let mut r = b.clone();
    r.add(-1.0, &normal(pairs, &z));
    let (mut p, mut left) = (r.clone(), r.dot(&r));
    for _ in 0..steps {
        let q = normal(pairs, &p);
        let curvature = p.dot(&q);
        if left <= EXACT * b.dot(&b) || curvature <= 0.0 {
            break;
        }
        let step = left / curvature;
        z.add(step, &p);
        r.add(-step, &q);
        let before = std::mem::replace(&mut left, r.dot(&r));
        let mut next = r.clone();
        next.add(left / before, &p);
        p = next;
    }
    cores.iter_mut().zip(z.numbers(cells)).for_each(|(core, z)| *core = z as f32);
}

/// `G Z`
fn normal(pairs: &Pairs, z: &Laid) -> Laid {
    let (cells, size) = (pairs.cells, pairs.core_size());
    let mut g = zeros(cells * size);
    pairs.share_cells(&mut g, |from, g| dispatch(Rows { pairs, from, z, g }));
    Laid::new(cells, size, g.into_iter())
}

/// `(G Z)_c` of some cells, `[cells, R_1, .., R_N]`.
struct Rows<'a> {
    pairs: &'a Pairs<'a>,
    from: usize,
    z: &'a Laid,
    g: &'a mut [f64],
}

impl WithSimd for Rows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Rows { pairs, from, z, g } = self;
        let size = pairs.core_size();
        let zeros = vec![simd.splat_f64s(0.0); size];
        let (mut x, mut y, mut sum) = (zeros.clone(), zeros.clone(), zeros);
        for (cell, g) in (from..).zip(g.chunks_exact_mut(size)) {
            sum.fill(simd.splat_f64s(0.0));
            for group in pairs.groups(simd, 0) {
                let numbers = pairs.numbers(simd, cell, group, None);
                for (x, z) in x.iter_mut().zip(z.vectors(simd, group)) {
                    *x = simd.mul_f64s(z, numbers);
                }
                pairs.multiply(simd, &mut x, &mut y, None, |m| pairs.matrices(m, cell, group).transposed());
                sum.iter_mut().zip(&x).for_each(|(sum, &x)| *sum = simd.add_f64s(*sum, x));
            }
            g.iter_mut().zip(&sum).for_each(|(g, &sum)| *g = simd.reduce_sum_f64s(sum));
        }
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
