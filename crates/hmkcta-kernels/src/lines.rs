//! Reconstruction of overlapping cells line by line: a line has all columns, the rows of the last mode b.
//!
//! For fixed rows of the leading modes the cores of the cells that meet there are contracted to `[R_a, R_b]` each, a
//! being the mode that makes the least work, and then with the bases of mode b: to panels, which each row of mode a
//! weighs. Lines are products of matrices then, cluster by cluster of mode b, whose columns are put back in their places
//! as lines are added to the tensor.

use crate::bundle::{Bundle, Choice};
use crate::cells::Node;
use crate::leading::{Choose, Partial, subsets};
use crate::machine::dispatch;
use crate::places::Places;
use crate::threads::{PARALLEL, for_each};
use crate::turned::Turned;
use std::ops::Range;

/// More numbers than any vector has; what vectors run along is padded to whole ones.
pub const PAD: usize = 16;
/// Rows of mode a worked on at a time.
pub const ROWS: usize = 8;
/// Numbers that the lines of a bundle should have for a row of mode a, all clusters' members; most rows of a bundle.
const BUNDLED: usize = 400;
const MOST_BUNDLED: usize = 8;
/// What a group of rows and a multiply-add of a panel cost beside one of a line, measured.
const GROUP: f64 = 2.0;
const PANEL: f64 = 4.0;
/// Pieces the tensor is cut into, for threads to share.
const PIECES: usize = 64;

/// The mode whose rows make the least work; None where the last mode or all others have no bases, or what is left would
/// be too few tuples of rows for threads to share.
pub fn mode_of_rows(node: &Node) -> Option<usize> {
    let (b, elements) = (node.order() - 1, node.sizes.iter().product::<usize>());
    let shared = |n: usize| elements < PARALLEL || elements / (node.sizes[n] * node.sizes[b]) >= PIECES / 8;
    let open = |&n: &usize| !node.undecomposed[n] && !node.undecomposed[b] && shared(n);
    let cost = |n: usize| {
        let groups = alike(node, n, ROWS).len() as f64;
        let panels = (node.clusters[n] * node.ranks[b]) as f64 / node.mixture[n] as f64;
        node.ranks[n] as f64 * (1.0 + (GROUP * groups + PANEL * panels) / node.sizes[n] as f64)
    };
    let costs = (0..b).rev().filter(open).map(|n| (cost(n), n));
    costs.min_by(|x, y| x.0.total_cmp(&y.0)).map(|(_, n)| n)
}

/// `tensor += weight * model`, with the rows of this mode.
pub fn accumulate(node: &Node, mode: usize, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    assert_eq!(tensor.len(), node.sizes.iter().product::<usize>());
    let turned = Turned::new(node, mode, bases, cores);
    let lines = Lines::new(&turned.node, &turned.bases);
    let all = lines.cores(&turned.cores, weight);
    let inner = node.sizes[mode + 1..node.order() - 1].iter().product();
    let target = Target { start: tensor.as_mut_ptr(), rows: node.sizes[mode], columns: lines.columns, inner };
    let count = lines.bundles.len() * turned.node.sizes[..lines.depth.saturating_sub(1)].iter().product::<usize>();
    let parallel = tensor.len() >= PARALLEL;
    let piece = if parallel { count.div_ceil(PIECES) } else { count };
    for_each(parallel, (0..count).step_by(piece).collect(), |from| {
        let mut levels = vec![Partial::default(); lines.depth];
        let range = from..count.min(from + piece);
        lines.descend((0, 0), range, &all, &mut levels, &mut Buffers::default(), &target);
    });
}

/// The tensor: a line of `columns` numbers for each row of mode a and each tuple of rows of the leading modes, of which
/// those behind mode a in the tensor have `inner` combinations.
pub struct Target {
    start: *mut f32,
    rows: usize,
    columns: usize,
    inner: usize,
}

// SAFETY: threads work on tuples of their own, whose lines share no element.
unsafe impl Sync for Target {}

impl Target {
    /// Where row 0 of a tuple is found.
    fn tuple(&self, number: usize) -> *mut f32 {
        let line = number / self.inner * self.rows * self.inner + number % self.inner;
        self.start.wrapping_add(line * self.columns)
    }

    /// From one row of mode a to the next.
    pub fn step(&self) -> usize {
        self.inner * self.columns
    }
}

/// A node prepared for it. Modes a and b are the last two; lanes are the clusters of mode b and its ranks, `C_b R_b`,
/// padded.
pub struct Lines<'a> {
    pub node: &'a Node<'a>,
    /// N - 2, the number of leading modes, which is mode a.
    pub depth: usize,
    pub columns: usize,
    pub lanes: usize,
    /// For each leading mode `[I_n, K_n, cells of the modes before, of those after but b, R_n, lanes]`.
    pub expanded: Vec<Vec<f32>>,
    /// Rows of mode a with the same subsets, some at a time.
    pub groups: Vec<Group>,
    /// Rows of the last leading mode with the same subsets, some at a time; one row 0 where there is no such mode.
    bundles: Vec<Vec<u32>>,
    /// For each cell of the modes but b, and each cluster of b, `[R_b, members]`, these padded.
    pub bases: Vec<f32>,
    /// Where each column is in a line.
    pub places: Places,
}

/// Buffers of one task.
#[derive(Default)]
pub struct Buffers {
    /// Where the tuples of a bundle and of the next one start.
    pub starts: Vec<*mut f32>,
    pub ahead: Vec<*mut f32>,
    /// The cells that lines of a group belong to.
    pub choices: Vec<Choice>,
    /// Cores contracted with the bases of mode b: lines `[combinations, C_a, R_a]`.
    pub panels: Vec<f32>,
    /// Lines of the rows of a group.
    pub lines: Vec<f32>,
}

impl<'a> Lines<'a> {
    fn new(node: &'a Node<'a>, bases: &[Vec<f32>]) -> Self {
        let depth = node.order() - 2;
        let (a, b) = (depth, depth + 1);
        let most = (BUNDLED / (node.mixture[b] * node.sizes[b])).clamp(1, MOST_BUNDLED);
        let bundles = if depth > 0 { alike(node, depth - 1, most) } else { vec![vec![0]] };
        let longest = bundles.iter().map(Vec::len).max().unwrap_or(1);
        let mut lines = Lines {
            columns: node.sizes[b],
            node,
            depth,
            lanes: (node.clusters[b] * node.ranks[b]).next_multiple_of(PAD),
            expanded: vec![],
            groups: groups(node, a, &bases[a]),
            bundles,
            places: Places::new(node, b, longest),
            bases: vec![],
        };
        lines.expanded = (0..a).map(|n| lines.expand(&bases[n], node.ranks[n])).collect();
        lines.bases = lines.sorted(&bases[b]);
        lines
    }

    /// Numbers `[.., C_b, rank]` as `[.., rank, lanes]`.
    fn expand(&self, numbers: &[f32], rank: usize) -> Vec<f32> {
        let b = self.depth + 1;
        let (clusters, repeats) = (self.node.clusters[b], self.node.ranks[b]);
        let mut all = vec![0.0; numbers.len() / clusters * self.lanes];
        for (from, to) in numbers.chunks_exact(clusters * rank).zip(all.chunks_exact_mut(rank * self.lanes)) {
            for (c, from) in from.chunks_exact(rank).enumerate() {
                let to = to.chunks_exact_mut(self.lanes).zip(from);
                to.for_each(|(to, &u)| to[c * repeats..][..repeats].fill(u));
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
            for (c, from) in from.chunks_exact(others * rank).enumerate() {
                for (from, to) in from.chunks_exact(rank).zip(to.chunks_exact_mut(self.lanes)) {
                    to[c * rank..].iter_mut().zip(from).for_each(|(to, z)| *to = weight * z);
                }
            }
        }
        Partial { cells: vec![0], cores: all }
    }

    /// Basis numbers of mode b, which are stored as `[I_b, K_b, cells but b, R_b]`.
    fn sorted(&self, basis: &[f32]) -> Vec<f32> {
        let b = self.depth + 1;
        let (rank, clusters, size) = (self.node.ranks[b], self.node.clusters[b], self.basis());
        let cells = self.node.cells() / clusters;
        let mut sorted = vec![0.0; cells * size];
        let mut filled = vec![0; clusters];
        for (&c, numbers) in self.node.members(b).iter().zip(basis.chunks_exact(cells * rank)) {
            let c = usize::from(c);
            let (start, width) = (self.places.starts[c], self.places.starts[c + 1] - self.places.starts[c]);
            let at = start * rank + filled[c];
            filled[c] += 1;
            for (numbers, sorted) in numbers.chunks_exact(rank).zip(sorted.chunks_exact_mut(size)) {
                sorted[at..].iter_mut().step_by(width).zip(numbers).for_each(|(to, &u)| *to = u);
            }
        }
        sorted
    }

    /// Numbers of all clusters of mode b for one cell of the others.
    pub fn basis(&self) -> usize {
        self.node.ranks[self.depth + 1] * self.places.starts[self.node.clusters[self.depth + 1]]
    }

    /// Where the tuples of a bundle start, of all that there are for each tuple of the modes before.
    fn starts(&self, number: usize, target: &Target, starts: &mut Vec<*mut f32>) {
        let (before, bundle) = (number / self.bundles.len(), number % self.bundles.len());
        let rows = if self.depth > 0 { self.node.sizes[self.depth - 1] } else { 1 };
        starts.clear();
        starts.extend(self.bundles[bundle].iter().map(|&row| target.tuple(before * rows + row as usize)));
    }

    /// Add the model to the bundles `range` of those below the present leading rows, which come after `before` others.
    fn descend(
        &self,
        (level, before): (usize, usize),
        range: Range<usize>,
        present: &Partial,
        levels: &mut [Partial],
        buffers: &mut Buffers,
        target: &Target,
    ) {
        let Some((next, levels)) = levels.split_first_mut() else {
            return self.add(before, present, buffers, target);
        };
        if levels.is_empty() {
            for bundle in range {
                dispatch(Choose { lines: self, level, rows: &self.bundles[bundle], present, next });
                self.add(before + bundle, next, buffers, target);
            }
            return;
        }
        let span = self.node.sizes[level + 1..self.depth - 1].iter().product::<usize>() * self.bundles.len();
        for i in range.start / span..range.end.div_ceil(span) {
            let start = i * span;
            let below = range.start.max(start) - start..range.end.min(start + span) - start;
            dispatch(Choose { lines: self, level, rows: &[i as u32], present, next });
            self.descend((level + 1, before + start), below, next, levels, buffers, target);
        }
    }

    /// Add the model to one bundle.
    fn add(&self, number: usize, present: &Partial, buffers: &mut Buffers, target: &Target) {
        self.starts(number, target, &mut buffers.starts);
        self.starts(number + 1, target, &mut buffers.ahead);
        // SAFETY: the bundle's lines lie in the tensor, and this thread alone works on them.
        dispatch(unsafe { Bundle::new(self, present, buffers, target.step()) });
    }
}

/// Up to `ROWS` rows of mode a that share their subsets.
pub struct Group {
    pub subsets: Vec<u16>,
    pub rows: Vec<u32>,
    /// Their basis numbers `[K_a, cells of the other modes, R_a, ROWS]`.
    pub basis: Vec<f32>,
}

/// All rows of mode a, whose basis is stored as `[I_a, K_a, cells of the other modes, R_a]`.
fn groups(node: &Node, a: usize, basis: &[f32]) -> Vec<Group> {
    let length = basis.len() / node.sizes[a];
    let group = |rows: Vec<u32>| {
        let mut numbers = vec![0.0; length * ROWS];
        for (at, &row) in rows.iter().enumerate() {
            let from = &basis[row as usize * length..][..length];
            numbers[at..].iter_mut().step_by(ROWS).zip(from).for_each(|(to, &u)| *to = u);
        }
        Group { subsets: subsets(node, a, rows[0]).to_vec(), rows, basis: numbers }
    };
    alike(node, a, ROWS).into_iter().map(group).collect()
}

/// The rows of a mode with the same subsets, at most so many at a time.
fn alike(node: &Node, n: usize, most: usize) -> Vec<Vec<u32>> {
    let mut rows: Vec<u32> = (0..node.sizes[n] as u32).collect();
    rows.sort_by_key(|&row| subsets(node, n, row));
    let same = rows.chunk_by(|&i, &j| subsets(node, n, i) == subsets(node, n, j));
    same.flat_map(|rows| rows.chunks(rows.len().div_ceil(rows.len().div_ceil(most)))).map(<[u32]>::to_vec).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::reconstruct::by_cells;
    use crate::testing::{close, numbers};

    #[test]
    fn agrees_with_reconstruction_cell_by_cell() {
        on_all_machines(|| {
            // Few lines of several vectors, lines of one column, no leading mode, bundles of several rows, high ranks.
            compare_with_cells(&[3, 21, 37], &[2, 3, 5], &[2, 2, 3], &[2, 3, 2], None);
            compare_with_cells(&[3, 21, 37], &[1, 3, 5], &[1, 2, 3], &[3, 3, 2], Some(0));
            compare_with_cells(&[3, 4, 180], &[2, 3, 5], &[2, 2, 3], &[2, 3, 2], None);
            compare_with_cells(&[3, 40, 1], &[2, 3, 5], &[2, 2, 3], &[2, 3, 2], None);
            compare_with_cells(&[19, 50], &[2, 3], &[2, 2], &[3, 4], None);
            compare_with_cells(&[9, 4, 20, 13], &[3, 1, 2, 4], &[2, 1, 2, 2], &[2, 4, 3, 1], Some(1));
            compare_with_cells(&[5, 7, 6, 30], &[2, 3, 2, 2], &[1, 2, 2, 2], &[2, 1, 5, 6], None);
        });
    }

    /// With the rows of every mode that has bases.
    fn compare_with_cells(sizes: &[usize], c: &[usize], k: &[usize], ranks: &[usize], undecomposed: Option<usize>) {
        let order = sizes.len();
        let of_rows = |n: usize| (0..sizes[n]).flat_map(move |i| (0..k[n]).map(move |k| ((i + k) % c[n]) as u16));
        let members: Vec<Vec<u16>> = (0..order).map(|n| of_rows(n).collect()).collect();
        let flags: Vec<bool> = (0..order).map(|n| Some(n) == undecomposed).collect();
        let shape = (sizes.to_vec(), c.to_vec(), k.to_vec(), ranks.to_vec(), flags.clone());
        let node = Node::new(shape, members.iter().map(|m| m.as_slice()).collect()).unwrap();
        let bases: Vec<Vec<f32>> = (0..order).map(|n| numbers(node.basis_size(n), n as u64)).collect();
        let bases: Vec<&[f32]> = bases.iter().map(|b| b.as_slice()).collect();
        let cores = numbers(node.cells() * node.core_size(), 7);
        let before = numbers(sizes.iter().product(), 8);
        let mut expected = before.clone();
        by_cells(&node, &mut expected, &bases, &cores, -0.5);
        assert!(mode_of_rows(&node).is_some());
        for mode in (0..order - 1).filter(|&n| !flags[n]) {
            let mut found = before.clone();
            accumulate(&node, mode, &mut found, &bases, &cores, -0.5);
            found.iter().zip(&expected).for_each(|(&x, &y)| close(x, f64::from(y)));
        }
    }
}
