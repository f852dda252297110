//! Cores contracted with rows of the leading modes, one mode after the other.

use crate::cells::Node;
use crate::machine::dispatch;
use pulp::{Simd, WithSimd};
use std::ops::{Deref, DerefMut, Range};

/// More numbers than any vector has; what vectors run along is padded to whole ones.
pub const PAD: usize = 16;

/// Combinations of subsets that meet at the present rows of the modes before n, and their cores contracted with these
/// rows: `[combinations, cells from mode n on but b, R_n, .., R_a, lanes]`, for each row of a bundle.
#[derive(Clone, Default)]
pub struct Partial {
    pub cells: Vec<usize>,
    pub cores: Aligned,
}

/// Numbers of a vector, in one cache line: vectors that lie across two take longer to read, and much longer just after they
/// were written.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
pub struct Padded(pub [f32; PAD]);

/// Numbers of whole vectors, each in a cache line.
#[derive(Clone, Default)]
pub struct Aligned(pub Vec<Padded>);

impl Aligned {
    fn zeros(count: usize) -> Self {
        Aligned(vec![Padded::default(); count / PAD])
    }
}

impl Deref for Aligned {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        // SAFETY: as many numbers lie in the vectors, one behind the other.
        unsafe { std::slice::from_raw_parts(self.0.as_ptr().cast(), self.0.len() * PAD) }
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f32] {
        // SAFETY: as many numbers lie in the vectors, one behind the other, and are borrowed as they are.
        unsafe { std::slice::from_raw_parts_mut(self.0.as_mut_ptr().cast(), self.0.len() * PAD) }
    }
}

/// The leading modes of a node, b being the last mode and a the one before. Lanes are the clusters of mode b and its
/// ranks, `C_b R_b`, padded.
pub struct Leading<'a> {
    pub node: &'a Node<'a>,
    /// How many modes lead: all but a and b.
    pub depth: usize,
    pub lanes: usize,
    /// For each leading mode `[I_n, K_n, cells of the modes before, of those after but b, R_n, lanes]`.
    expanded: Vec<Aligned>,
    /// Rows of the last leading mode with the same subsets, some at a time; one row 0 where there is no such mode.
    pub bundles: Vec<Vec<u32>>,
}

impl<'a> Leading<'a> {
    /// With at most so many rows in a bundle.
    pub fn new<B: AsRef<[f32]>>(node: &'a Node<'a>, bases: &[B], most: usize) -> Self {
        let (depth, b) = (node.order() - 2, node.order() - 1);
        let lanes = (node.clusters[b] * node.ranks[b]).next_multiple_of(PAD);
        let bundles = match depth {
            0 => vec![vec![0]],
            _ if most == 1 => (0..node.sizes[depth - 1] as u32).map(|row| vec![row]).collect(),
            _ => alike(node, depth - 1, most),
        };
        let mut leading = Leading { node, depth, lanes, expanded: vec![], bundles };
        leading.expanded = (0..depth).map(|n| leading.expand(bases[n].as_ref(), node.ranks[n])).collect();
        leading
    }

    /// Numbers `[.., C_b, rank]` as `[.., rank, lanes]`.
    pub fn expand(&self, numbers: &[f32], rank: usize) -> Aligned {
        let b = self.node.order() - 1;
        let (clusters, repeats) = (self.node.clusters[b], self.node.ranks[b]);
        let mut all = Aligned::zeros(numbers.len() / clusters * self.lanes);
        for (from, to) in numbers.chunks_exact(clusters * rank).zip(all.chunks_exact_mut(rank * self.lanes)) {
            for (c, from) in from.chunks_exact(rank).enumerate() {
                let to = to.chunks_exact_mut(self.lanes).zip(from);
                to.for_each(|(to, &u)| to[c * repeats..][..repeats].fill(u));
            }
        }
        all
    }

    /// All cores `[cells, R_1, .., R_N]` times the weight, as `[cells but b, R_1, .., R_a, lanes]`.
    pub fn cores(&self, cores: &[f32], weight: f32) -> Partial {
        let b = self.node.order() - 1;
        let (clusters, rank) = (self.node.clusters[b], self.node.ranks[b]);
        let others: usize = self.node.ranks[..b].iter().product();
        let mut all = Aligned::zeros(cores.len() / (clusters * rank) * self.lanes);
        for (from, to) in cores.chunks_exact(clusters * others * rank).zip(all.chunks_exact_mut(others * self.lanes)) {
            for (c, from) in from.chunks_exact(others * rank).enumerate() {
                for (from, to) in from.chunks_exact(rank).zip(to.chunks_exact_mut(self.lanes)) {
                    to[c * rank..].iter_mut().zip(from).for_each(|(to, z)| *to = weight * z);
                }
            }
        }
        Partial { cells: vec![0], cores: all }
    }

    /// How many bundles there are, for all tuples of the leading modes but the last.
    pub fn count(&self) -> usize {
        self.bundles.len() * self.node.sizes[..self.depth.saturating_sub(1)].iter().product::<usize>()
    }

    /// Bundle `number` of all: its rows of the last leading mode, and the first tuple that they could be of.
    pub fn bundle(&self, number: usize) -> (&[u32], usize) {
        let rows = if self.depth > 0 { self.node.sizes[self.depth - 1] } else { 1 };
        (&self.bundles[number % self.bundles.len()], number / self.bundles.len() * rows)
    }

    /// Do the work on the bundles `range`, with the cores contracted for each.
    pub fn each(&self, range: Range<usize>, all: &Partial, mut work: impl FnMut(usize, &Partial)) {
        self.descend((0, 0), range, all, &mut vec![Partial::default(); self.depth], &mut work);
    }

    /// Of those below the present leading rows, which come after `before` others.
    fn descend(
        &self,
        (level, before): (usize, usize),
        range: Range<usize>,
        present: &Partial,
        levels: &mut [Partial],
        work: &mut impl FnMut(usize, &Partial),
    ) {
        let Some((next, levels)) = levels.split_first_mut() else { return work(before, present) };
        if levels.is_empty() {
            for bundle in range {
                dispatch(Choose { leading: self, level, rows: &self.bundles[bundle], present, next });
                work(before + bundle, next);
            }
            return;
        }
        let span = self.node.sizes[level + 1..self.depth - 1].iter().product::<usize>() * self.bundles.len();
        for i in range.start / span..range.end.div_ceil(span) {
            let start = i * span;
            let below = range.start.max(start) - start..range.end.min(start + span) - start;
            dispatch(Choose { leading: self, level, rows: &[i as u32], present, next });
            self.descend((level + 1, before + start), below, next, levels, work);
        }
    }
}

/// Of one row of a mode.
pub fn subsets<'a>(node: &Node<'a>, n: usize, row: u32) -> &'a [u16] {
    &node.members(n)[row as usize * node.mixture[n]..][..node.mixture[n]]
}

/// The rows of a mode with the same subsets, at most so many at a time.
pub fn alike(node: &Node, n: usize, most: usize) -> Vec<Vec<u32>> {
    let mut rows: Vec<u32> = (0..node.sizes[n] as u32).collect();
    rows.sort_by_key(|&row| subsets(node, n, row));
    let same = rows.chunk_by(|&i, &j| subsets(node, n, i) == subsets(node, n, j));
    same.flat_map(|rows| rows.chunks(rows.len().div_ceil(rows.len().div_ceil(most)))).map(<[u32]>::to_vec).collect()
}

/// Keep the combinations that have some rows of a leading mode, which share their subsets, contracted with each.
struct Choose<'c> {
    leading: &'c Leading<'c>,
    level: usize,
    rows: &'c [u32],
    present: &'c Partial,
    next: &'c mut Partial,
}

impl WithSimd for Choose<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Choose { leading, level: n, rows, present, next } = self;
        let (node, lanes, b) = (leading.node, leading.lanes, leading.node.order() - 1);
        let (clusters, mixture, rank) = (node.clusters[n], node.mixture[n], node.ranks[n]);
        let subsets = subsets(node, n, rows[0]);
        let cells =
            present.cells.iter().flat_map(|cell| subsets.iter().map(move |&c| cell * clusters + usize::from(c)));
        next.cells.clear();
        next.cells.extend(cells);
        let vectors = present.cores.0.len() / clusters / rank * mixture * rows.len();
        next.cores.0.resize(vectors, Padded::default());
        // Cells of the modes after this one, and numbers of one for each number of the row.
        let after: usize = node.clusters[n + 1..b].iter().product();
        let numbers = node.ranks[n + 1..b].iter().product::<usize>() * lanes;
        let before: usize = node.clusters[..n].iter().product();
        let each = || present.cores.chunks_exact(clusters * after * rank * numbers).zip(&present.cells);
        let mut outs = next.cores.chunks_exact_mut(numbers);
        for (i, (cores, cell)) in rows.iter().flat_map(|&i| each().map(move |part| (i as usize, part))) {
            for (k, &c) in subsets.iter().enumerate() {
                let cores = &cores[usize::from(c) * after * rank * numbers..][..after * rank * numbers];
                let first = ((i * mixture + k) * before + cell) * after;
                for (number, (core, out)) in cores.chunks_exact(rank * numbers).zip(&mut outs).enumerate() {
                    if node.undecomposed[n] {
                        out.copy_from_slice(&core[i * numbers..][..numbers]);
                        continue;
                    }
                    let row = &leading.expanded[n][(first + number) * rank * lanes..][..rank * lanes];
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
