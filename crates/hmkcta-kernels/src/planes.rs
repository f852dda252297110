//! Reconstruction of overlapping cells plane by plane: the last two modes make up a plane, of lines along the last one.
//!
//! For fixed leading indices the cores of the cells that meet there are contracted to `[R_a, R_b]` each. Lines that share
//! their cluster subsets are products of matrices then: coefficients by the bases of the last mode, cluster by cluster of
//! its subsets, whose columns are put back in their places as the line is added to the tensor.

use crate::cells::Node;
use crate::machine::dispatch;
use crate::places::Places;
use crate::plane::{Choice, Plane};
use crate::threads::{PARALLEL, for_each};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// More numbers than any vector has; what vectors run along is padded to whole ones.
pub const PAD: usize = 16;
/// Lines worked on at a time.
pub const LINES: usize = 8;
/// Pieces the planes are shared out in.
const PIECES: usize = 64;

/// Whether this way is open: two or more modes, of which the last two have bases, and planes enough for threads to share.
pub fn applies(node: &Node) -> bool {
    let order = node.order();
    if order < 2 || node.undecomposed[order - 1] || node.undecomposed[order - 2] {
        return false;
    }
    let planes: usize = node.sizes[..order - 2].iter().product();
    planes >= PIECES / 8 || node.sizes.iter().product::<usize>() < PARALLEL
}

/// `tensor += weight * model`
pub fn accumulate(node: &Node, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    let planes = Planes::new(node, bases);
    let all = planes.cores(cores, weight);
    let plane = planes.rows * planes.columns;
    let count = tensor.len() / plane;
    let piece = count.div_ceil(PIECES);
    let parallel = tensor.len() >= PARALLEL;
    for_each(parallel, tensor.chunks_mut(piece * plane).enumerate().collect(), |(number, tensor)| {
        let mut levels = vec![Partial::default(); planes.depth];
        let from = number * piece;
        planes.descend(0, from..from + tensor.len() / plane, &all, &mut levels, &mut Buffers::default(), tensor);
    });
}

/// A node prepared for it. Modes a and b are the last two; lanes are the clusters of mode b and its ranks, `C_b R_b`, padded.
pub struct Planes<'a> {
    pub node: &'a Node<'a>,
    /// N - 2, the number of leading modes, which is mode a.
    pub depth: usize,
    pub rows: usize,
    pub columns: usize,
    pub lanes: usize,
    /// For each leading mode `[I_n, K_n, cells of the modes before, of those after but b, R_n, lanes]`.
    expanded: Vec<Vec<f32>>,
    /// Rows of mode a with the same subsets, some at a time.
    pub groups: Vec<Group>,
    /// Where the columns of each cluster of mode b start in a line of all their members, and where the last ones end.
    pub starts: Vec<usize>,
    /// For each cell of the modes but b, and each cluster of b, `[R_b, members]`.
    pub panels: Vec<f32>,
    /// Where each column of the plane is in a line.
    pub places: Places,
}

/// Combinations of subsets that meet at the present rows of the modes before n, and their cores contracted with these
/// rows: `[combinations, cells from mode n on but b, R_n, .., R_a, lanes]`.
#[derive(Clone, Default)]
pub struct Partial {
    pub cells: Vec<usize>,
    pub cores: Vec<f32>,
}

/// Buffers of one task.
#[derive(Default)]
pub struct Buffers {
    /// The cells that lines of a group belong to.
    pub choices: Vec<Choice>,
    /// Of the lines of a group, `[combinations, K_a, C_b, R_b, LINES]`.
    pub coefficients: Vec<f32>,
    /// Of these rows, lines of all clusters' members.
    pub lines: Vec<f32>,
}

impl<'a> Planes<'a> {
    fn new(node: &'a Node<'a>, bases: &[&[f32]]) -> Self {
        let depth = node.order() - 2;
        let (a, b) = (depth, depth + 1);
        let members: Vec<&[u32]> = (0..node.clusters[b]).map(|c| node.rows(b, c)).collect();
        let mut starts = vec![0];
        for members in &members {
            starts.push(starts[starts.len() - 1] + members.len().next_multiple_of(PAD));
        }
        let mut planes = Planes {
            rows: node.sizes[a],
            columns: node.sizes[b],
            node,
            depth,
            lanes: (node.clusters[b] * node.ranks[b]).next_multiple_of(PAD),
            expanded: vec![],
            groups: groups(node, a, bases[a]),
            places: Places::new(&members, &starts, node.sizes[b]),
            starts,
            panels: vec![],
        };
        planes.expanded = (0..a).map(|n| planes.expand(bases[n], node.ranks[n])).collect();
        planes.load_panels(bases[b]);
        planes
    }

    /// Numbers `[.., C_b, rank]` as `[.., rank, lanes]`.
    fn expand(&self, numbers: &[f32], rank: usize) -> Vec<f32> {
        let b = self.depth + 1;
        let (clusters, repeats) = (self.node.clusters[b], self.node.ranks[b]);
        let mut all = vec![0.0; numbers.len() / clusters * self.lanes];
        for (from, to) in numbers.chunks_exact(clusters * rank).zip(all.chunks_exact_mut(rank * self.lanes)) {
            for (at, &u) in from.iter().enumerate() {
                to[at % rank * self.lanes + at / rank * repeats..][..repeats].fill(u);
            }
        }
        all
    }

    /// All cores `[cells, R_1, .., R_N]` times the weight, as `[cells but b, R_1, .., R_a, lanes]`.
    fn cores(&self, cores: &[f32], weight: f32) -> Partial {
        let b = self.depth + 1;
        let (clusters, rank) = (self.node.clusters[b], self.node.ranks[b]);
        let others: usize = self.node.ranks[..b].iter().product();
        let mut all = vec![0.0; cores.len() / (clusters * rank) * self.lanes];
        for (from, to) in cores.chunks_exact(clusters * others * rank).zip(all.chunks_exact_mut(others * self.lanes)) {
            for (at, line) in from.chunks_exact(rank).enumerate() {
                let to = &mut to[at % others * self.lanes + at / others * rank..][..rank];
                to.iter_mut().zip(line).for_each(|(to, z)| *to = weight * z);
            }
        }
        Partial { cells: vec![0], cores: all }
    }

    /// Basis numbers of mode b, which are stored as `[I_b, K_b, cells but b, R_b]`.
    fn load_panels(&mut self, basis: &[f32]) {
        let b = self.depth + 1;
        let (rank, clusters, panel) = (self.node.ranks[b], self.node.clusters[b], self.panel());
        let cells = self.node.cells() / clusters;
        self.panels = vec![0.0; cells * panel];
        let mut filled = self.starts.clone();
        for (&c, numbers) in self.node.members(b).iter().zip(basis.chunks_exact(cells * rank)) {
            let c = usize::from(c);
            let (start, width) = (self.starts[c], self.starts[c + 1] - self.starts[c]);
            let at = start * rank + filled[c] - start;
            filled[c] += 1;
            for (&u, number) in numbers.iter().zip(0..) {
                let (cell, r): (usize, usize) = (number / rank, number % rank);
                self.panels[cell * panel + at + r * width] = u;
            }
        }
    }

    /// Numbers of all clusters of mode b for one cell of the others.
    pub fn panel(&self) -> usize {
        self.node.ranks[self.depth + 1] * self.line()
    }

    /// Numbers of a line of all clusters' members.
    pub fn line(&self) -> usize {
        self.starts[self.node.clusters[self.depth + 1]]
    }

    /// Add the model to `x`, the planes `range` of those below the present leading indices.
    fn descend(
        &self,
        level: usize,
        range: Range<usize>,
        present: &Partial,
        levels: &mut [Partial],
        buffers: &mut Buffers,
        x: &mut [f32],
    ) {
        let Some((next, levels)) = levels.split_first_mut() else {
            return dispatch(Plane { planes: self, present, buffers, x });
        };
        let span: usize = self.node.sizes[level + 1..self.depth].iter().product();
        let plane = self.rows * self.columns;
        for i in range.start / span..range.end.div_ceil(span) {
            let below = range.start.max(i * span)..range.end.min((i + 1) * span);
            let part = &mut x[(below.start - range.start) * plane..(below.end - range.start) * plane];
            dispatch(Choose { planes: self, level, i, present, next });
            self.descend(level + 1, below.start - i * span..below.end - i * span, next, levels, buffers, part);
        }
    }
}

/// Up to `LINES` rows of mode a that share their subsets.
pub struct Group {
    pub subsets: Vec<u16>,
    pub rows: Vec<u32>,
    /// Their basis numbers `[K_a, cells of the other modes, R_a, LINES]`.
    pub basis: Vec<f32>,
}

/// All rows of mode a, whose basis is stored as `[I_a, K_a, cells of the other modes, R_a]`.
fn groups(node: &Node, a: usize, basis: &[f32]) -> Vec<Group> {
    let mixture = node.mixture[a];
    let pattern = |row: u32| &node.members(a)[row as usize * mixture..][..mixture];
    let length = basis.len() / node.sizes[a];
    let mut rows: Vec<u32> = (0..node.sizes[a] as u32).collect();
    rows.sort_by_key(|&row| pattern(row));
    let mut groups = vec![];
    for rows in rows.chunk_by(|&a, &b| pattern(a) == pattern(b)) {
        for rows in rows.chunks(rows.len().div_ceil(rows.len().div_ceil(LINES))) {
            let mut numbers = vec![0.0; length * LINES];
            for (line, &row) in rows.iter().enumerate() {
                let from = &basis[row as usize * length..][..length];
                numbers[line..].iter_mut().step_by(LINES).zip(from).for_each(|(to, &u)| *to = u);
            }
            groups.push(Group { subsets: pattern(rows[0]).to_vec(), rows: rows.to_vec(), basis: numbers });
        }
    }
    groups
}

/// Keep the combinations that have row `i` of a leading mode, contracted with it.
struct Choose<'c> {
    planes: &'c Planes<'c>,
    level: usize,
    i: usize,
    present: &'c Partial,
    next: &'c mut Partial,
}

impl WithSimd for Choose<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Choose { planes, level: n, i, present, next } = self;
        let (node, lanes) = (planes.node, planes.lanes);
        let (clusters, mixture, rank) = (node.clusters[n], node.mixture[n], node.ranks[n]);
        let subsets = &node.members(n)[i * mixture..][..mixture];
        let cells =
            present.cells.iter().flat_map(|cell| subsets.iter().map(move |&c| cell * clusters + usize::from(c)));
        next.cells.clear();
        next.cells.extend(cells);
        next.cores.resize(present.cores.len() / clusters / rank * mixture, 0.0);
        // Cells of the modes after this one, and numbers of one for each number of the row.
        let after: usize = node.clusters[n + 1..=planes.depth].iter().product();
        let numbers = node.ranks[n + 1..=planes.depth].iter().product::<usize>() * lanes;
        let leading: usize = node.clusters[..n].iter().product();
        let mut outs = next.cores.chunks_exact_mut(numbers);
        for (cores, cell) in present.cores.chunks_exact(clusters * after * rank * numbers).zip(&present.cells) {
            for (k, &c) in subsets.iter().enumerate() {
                let cores = &cores[usize::from(c) * after * rank * numbers..][..after * rank * numbers];
                let first = ((i * mixture + k) * leading + cell) * after;
                for (number, (core, out)) in cores.chunks_exact(rank * numbers).zip(&mut outs).enumerate() {
                    if node.undecomposed[n] {
                        out.copy_from_slice(&core[i * numbers..][..numbers]);
                        continue;
                    }
                    let row = &planes.expanded[n][(first + number) * rank * lanes..][..rank * lanes];
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
    let rank = if R > 0 { R } else { core.len() / out.len() };
    let vectors = row.len() / rank;
    for lane in 0..vectors {
        for at in (lane..out.len()).step_by(vectors) {
            let mut sum = simd.mul_f32s(core[at], row[lane]);
            for r in 1..rank {
                sum = simd.mul_add_e_f32s(core[r * out.len() + at], row[r * vectors + lane], sum);
            }
            out[at] = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::reconstruct::by_cells;
    use crate::testing::{close, numbers};

    #[test]
    fn agrees_with_reconstruction_cell_by_cell() {
        on_all_machines(compare_with_cells);
    }

    fn compare_with_cells() {
        for (undecomposed, rows, columns) in [(false, 21, 37), (true, 21, 37), (false, 4, 180), (false, 40, 1)] {
            let (sizes, mixture) = (vec![3, rows, columns], vec![if undecomposed { 1 } else { 2 }, 2, 3]);
            let clusters = vec![if undecomposed { 1 } else { 2 }, 3, 5];
            let ranks = vec![if undecomposed { 3 } else { 2 }, 3, 2];
            let members: Vec<Vec<u16>> = (0..3)
                .map(|n| (0..sizes[n]).flat_map(|i| (0..mixture[n]).map(move |k| (i + k) as u16)).collect::<Vec<u16>>())
                .zip(&clusters)
                .map(|(members, &c)| members.iter().map(|k| k % c as u16).collect())
                .collect();
            let shape = (sizes.clone(), clusters, mixture, ranks, vec![undecomposed, false, false]);
            let node = Node::new(shape, members.iter().map(|m| m.as_slice()).collect()).unwrap();
            assert!(applies(&node));
            let bases: Vec<Vec<f32>> = (0..3).map(|n| numbers(node.basis_size(n), n as u64)).collect();
            let bases: Vec<&[f32]> = bases.iter().map(|b| b.as_slice()).collect();
            let cores = numbers(node.cells() * node.core_size(), 7);
            let mut found = numbers(sizes.iter().product(), 8);
            let mut expected = found.clone();
            accumulate(&node, &mut found, &bases, &cores, -0.5);
            by_cells(&node, &mut expected, &bases, &cores, -0.5);
            found.iter().zip(&expected).for_each(|(&x, &y)| close(x, f64::from(y)));
        }
    }
}
