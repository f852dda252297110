//! Cores contracted with rows of the leading modes, one mode after the other.

use crate::cells::Node;
use crate::lines::Lines;
use pulp::{Simd, WithSimd};

/// Combinations of subsets that meet at the present rows of the modes before n, and their cores contracted with these
/// rows: `[combinations, cells from mode n on but b, R_n, .., R_a, lanes]`, for each row of a bundle.
#[derive(Clone, Default)]
pub struct Partial {
    pub cells: Vec<usize>,
    pub cores: Vec<f32>,
}

/// Of one row of a mode.
pub fn subsets<'a>(node: &Node<'a>, n: usize, row: u32) -> &'a [u16] {
    &node.members(n)[row as usize * node.mixture[n]..][..node.mixture[n]]
}

/// Keep the combinations that have some rows of a leading mode, which share their subsets, contracted with each.
pub struct Choose<'c> {
    pub lines: &'c Lines<'c>,
    pub level: usize,
    pub rows: &'c [u32],
    pub present: &'c Partial,
    pub next: &'c mut Partial,
}

impl WithSimd for Choose<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Choose { lines, level: n, rows, present, next } = self;
        let (node, lanes) = (lines.node, lines.lanes);
        let (clusters, mixture, rank) = (node.clusters[n], node.mixture[n], node.ranks[n]);
        let subsets = subsets(node, n, rows[0]);
        let cells =
            present.cells.iter().flat_map(|cell| subsets.iter().map(move |&c| cell * clusters + usize::from(c)));
        next.cells.clear();
        next.cells.extend(cells);
        next.cores.resize(present.cores.len() / clusters / rank * mixture * rows.len(), 0.0);
        // Cells of the modes after this one, and numbers of one for each number of the row.
        let after: usize = node.clusters[n + 1..=lines.depth].iter().product();
        let numbers = node.ranks[n + 1..=lines.depth].iter().product::<usize>() * lanes;
        let leading: usize = node.clusters[..n].iter().product();
        let each = || present.cores.chunks_exact(clusters * after * rank * numbers).zip(&present.cells);
        let mut outs = next.cores.chunks_exact_mut(numbers);
        for (i, (cores, cell)) in rows.iter().flat_map(|&i| each().map(move |part| (i as usize, part))) {
            for (k, &c) in subsets.iter().enumerate() {
                let cores = &cores[usize::from(c) * after * rank * numbers..][..after * rank * numbers];
                let first = ((i * mixture + k) * leading + cell) * after;
                for (number, (core, out)) in cores.chunks_exact(rank * numbers).zip(&mut outs).enumerate() {
                    if node.undecomposed[n] {
                        out.copy_from_slice(&core[i * numbers..][..numbers]);
                        continue;
                    }
                    let row = &lines.expanded[n][(first + number) * rank * lanes..][..rank * lanes];
                    match rank {
                        1 => weigh::<S, 1>(simd, core, row, out),
                        2 => weigh::<S, 2>(simd, core, row, out),
                        3 => weigh::<S, 3>(simd, core, row, out),
                        4 => weigh::<S, 4>(simd, core, row, out),
                        _ => weigh::<S, 0>(simd, core, row, out),
                    }
                }
            }
        }
    }
}

/// `out[j] = sum_r core[r, j] row[r]`, the row having weights for each lane; `R`: its rank if it is known, else 0.
#[inline(always)]
fn weigh<S: Simd, const R: usize>(simd: S, core: &[f32], row: &[f32], out: &mut [f32]) {
    let (core, row, out) = (S::as_simd_f32s(core).0, S::as_simd_f32s(row).0, S::as_mut_simd_f32s(out).0);
    let length = out.len();
    if R == 0 {
        let vectors = row.len() * length / core.len();
        for (at, out) in out.iter_mut().enumerate() {
            let weights = row.iter().skip(at % vectors).step_by(vectors);
            let sum = core.iter().skip(at).step_by(length).zip(weights);
            *out = sum.fold(simd.splat_f32s(0.0), |sum, (&z, &u)| simd.mul_add_e_f32s(z, u, sum));
        }
        return;
    }
    let vectors = row.len() / R;
    let core: [&[S::f32s]; R] = std::array::from_fn(|r| &core[r * length..][..length]);
    for lane in 0..vectors {
        let weights: [S::f32s; R] = std::array::from_fn(|r| row[r * vectors + lane]);
        for at in (lane..length).step_by(vectors) {
            let mut sum = simd.mul_f32s(core[0][at], weights[0]);
            for r in 1..R {
                sum = simd.mul_add_e_f32s(core[r][at], weights[r], sum);
            }
            out[at] = sum;
        }
    }
}
