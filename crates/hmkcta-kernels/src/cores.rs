//! Cores of all cells together, the bases given: least squares by conjugate gradients.

use crate::cells::Node;
use crate::machine::dispatch;
use crate::pairs::{PARALLEL_PAIRS, SideBySide, mode_product, read};
use crate::threads::for_each;
use pulp::{Simd, WithSimd, bytemuck};

/// As many cells as any vector has lanes, or a multiple.
const LANES: usize = 16;
/// Where what is left of the right sides, squared, is a smaller share of them, the cores are exact.
const EXACT: f64 = 1e-14;

/// Change the cores `[PC, R_1, .., R_N]` to leave less of the tensor, of which `b` are the projections on all bases.
///
/// They solve `G Z = b` where `(G Z)_c = sum_c' Z_c' x_m M_m(c, c')` over all decomposed modes m.
pub fn solve_cores(node: &Node, bases: &[&[f32]], cores: &mut [f32], b: &[f64], steps: usize) {
    let modes = (0..node.order()).filter(|&m| !node.undecomposed[m]).collect();
    let operator = Operator::new(SideBySide::new(node, bases, modes));
    let mut z = operator.side_by_side(cores.iter().map(|&z| f64::from(z)));
    let b = operator.side_by_side(b.iter().copied());
    let mut r: Vec<f64> = b.iter().zip(operator.apply(&z)).map(|(b, g)| b - g).collect();
    let (mut p, mut left) = (r.clone(), dot(&r, &r));
    for _ in 0..steps {
        let q = operator.apply(&p);
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
    let size = node.core_size();
    cores.iter_mut().enumerate().for_each(|(at, core)| *core = z[at % size * operator.width + at / size] as f32);
}

fn dot(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

/// G, by the inner products `M_m(c, c')` of the bases of all pairs of cells.
struct Operator<'a> {
    bases: SideBySide<'a>,
    /// PC in whole vectors.
    width: usize,
    /// For each cell c and vector of cells c', `[R_m, R_m]` of all modes, transposed.
    grams: Vec<f32>,
}

impl<'a> Operator<'a> {
    fn new(bases: SideBySide<'a>) -> Self {
        let cells = bases.node.cells();
        let width = cells.next_multiple_of(LANES);
        let mut grams = vec![0.0; cells * width * bases.numbers()];
        let tasks = grams.chunks_mut(width * bases.numbers()).enumerate().collect();
        for_each(cells * cells >= PARALLEL_PAIRS, tasks, |(cell, grams)| {
            dispatch(Grams { bases: &bases, cell, grams })
        });
        Operator { bases, width, grams }
    }

    /// Numbers `[PC, R_1, .., R_N]` as `[R_1, .., R_N, width]`, zero beyond the cells.
    fn side_by_side(&self, numbers: impl Iterator<Item = f64>) -> Vec<f64> {
        let size = self.bases.node.core_size();
        let mut last = vec![0.0; size * self.width];
        numbers.enumerate().for_each(|(at, value)| last[at % size * self.width + at / size] = value);
        last
    }

    fn apply(&self, z: &[f64]) -> Vec<f64> {
        let (cells, size) = (self.bases.node.cells(), self.bases.node.core_size());
        let mut g = vec![0.0; cells * size];
        let tasks = g.chunks_mut(size).enumerate().collect();
        for_each(cells * cells >= PARALLEL_PAIRS, tasks, |(cell, g)| dispatch(Row { operator: self, cell, z, g }));
        self.side_by_side(g.into_iter())
    }
}

/// The inner products of one cell's bases with those of all cells.
struct Grams<'a> {
    bases: &'a SideBySide<'a>,
    cell: usize,
    grams: &'a mut [f32],
}

impl WithSimd for Grams<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Grams { bases, cell, grams } = self;
        let mut gram = vec![simd.splat_f64s(0.0); bases.largest()];
        let ranks = &bases.node.ranks;
        let groups = (0..bases.node.cells()).step_by(S::F64_LANES);
        for (other, grams) in groups.zip(grams.chunks_exact_mut(bases.numbers() * S::F64_LANES)) {
            let mut at = 0;
            bases.grams(simd, (cell, other), &mut gram, |m, gram| {
                for (own, sums) in gram.iter().enumerate() {
                    let place = at + own % ranks[m] * ranks[m] + own / ranks[m];
                    let sums: &[f64] = bytemuck::cast_slice(std::slice::from_ref(sums));
                    let to = &mut grams[place * S::F64_LANES..][..S::F64_LANES];
                    to.iter_mut().zip(sums).for_each(|(to, &sum)| *to = sum as f32);
                }
                at += gram.len();
            });
        }
    }
}

/// `(G Z)_c` of one cell c, `[R_1, .., R_N]`.
struct Row<'a> {
    operator: &'a Operator<'a>,
    cell: usize,
    z: &'a [f64],
    g: &'a mut [f64],
}

impl WithSimd for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Row { operator, cell, z, g } = self;
        let Operator { bases, width, grams } = operator;
        let (ranks, size) = (&bases.node.ranks, bases.node.core_size());
        let zero = simd.splat_f64s(0.0);
        let (mut x, mut y, mut sum) = (vec![zero; size], vec![zero; size], vec![zero; size]);
        let mut gram = vec![zero; bases.largest()];
        let grams = grams[cell * width * bases.numbers()..].chunks_exact(bases.numbers() * S::F64_LANES);
        for (other, mut grams) in (0..bases.node.cells()).step_by(S::F64_LANES).zip(grams) {
            x.iter_mut().enumerate().for_each(|(at, x)| *x = read(simd, z, at * width + other));
            for &m in &bases.modes {
                let (own, rest) = grams.split_at(ranks[m] * ranks[m] * S::F64_LANES);
                let wide: &mut [f64] = bytemuck::cast_slice_mut(&mut gram);
                wide.iter_mut().zip(own).for_each(|(to, &value)| *to = f64::from(value));
                mode_product(simd, &x, ranks[m], ranks[m + 1..].iter().product(), &gram, &mut y);
                std::mem::swap(&mut x, &mut y);
                grams = rest;
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
    use crate::testing::{numbers, overlapping_cells};

    #[test]
    fn leaves_nothing_that_cores_could_take() {
        on_all_machines(compare_with_explicit_columns);
    }

    /// b of a tensor that the bases can express: its cores leave nothing.
    fn compare_with_explicit_columns() {
        let (node, stored) = overlapping_cells();
        let stored: Vec<&[f32]> = stored.iter().map(|b| b.as_slice()).collect();
        // Column (c, r, s, t): U_{1,c}[i, r] U_{2,c}[j, s] where k = t.
        let column = |at: usize, i: usize, j: usize, k: usize| -> f64 {
            let (c, r, s, t) = (at / 12, at / 6 % 2, at / 2 % 3, at % 2);
            let cell = node.cell(c);
            match (node.place(&cell, 0, i), node.place(&cell, 1, j)) {
                (Some(u), Some(v)) if k == t => f64::from(stored[0][u + r]) * f64::from(stored[1][v + s]),
                _ => 0.0,
            }
        };
        let places = || (0..24).map(|at| (at / 8, at / 2 % 4, at % 2));
        let model = |z: &[f32]| -> Vec<f64> {
            let value = |(i, j, k)| z.iter().enumerate().map(|(at, &z)| f64::from(z) * column(at, i, j, k)).sum();
            places().map(value).collect()
        };
        let tensor = model(&numbers(48, 7));
        let b: Vec<f64> =
            (0..48).map(|at| places().zip(&tensor).map(|((i, j, k), t)| t * column(at, i, j, k)).sum()).collect();
        let mut cores = numbers(48, 9);
        let left = |cores: &[f32]| tensor.iter().zip(model(cores)).map(|(t, m)| (t - m).powi(2)).sum::<f64>();
        let mut before = left(&cores);
        for _ in 0..4 {
            solve_cores(&node, &stored, &mut cores, &b, 4);
            let after = left(&cores);
            assert!(after < before, "{after} after {before}");
            before = after;
        }
        solve_cores(&node, &stored, &mut cores, &b, 200);
        let whole: f64 = tensor.iter().map(|t| t * t).sum();
        assert!(left(&cores) < 1e-10 * whole, "{} of {whole}", left(&cores));
    }
}
