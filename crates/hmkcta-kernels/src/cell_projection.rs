//! Projection of a tensor on the bases of all cells in all modes but one.

use crate::cells::Node;
use crate::chain::{Chain, unfold};
use crate::gemm::{Matrix, multiply};
use crate::sizes::zeros;
use crate::threads::{PARALLEL, Scratch, for_each, room, with_scratch};
use crate::tree::Tree;

/// Groups of cells worked on independently, for threads to share.
const GROUPS: usize = 16;
/// Leaves gathered at a time where they share one projection, up to so many elements.
const ROWS: usize = 8;
const GATHERED: usize = 256 * 1024;

/// `Y_n[c] = T x_{m != n} U_{m,c}^T` for all rows of mode `n`: `[PC, I_n, prod_{m != n} R_m]`, zero for empty cells.
pub fn project_cells(node: Node, tensor: &[f32], bases: &[&[f32]], n: usize) -> Vec<f32> {
    let size = node.core_size() / node.ranks[n] * node.sizes[n];
    let mut all = zeros(node.cells() * size);
    let tree = Tree::new(node, bases, Some(n), |_| true);
    let projection = Projection::new(&tree, tensor, n);
    let mut targets: Vec<Option<&mut [f32]>> = all.chunks_exact_mut(size).map(Some).collect();
    let numbers: Vec<usize> = (0..tree.members.len()).collect();
    let parallel = tensor.len() >= PARALLEL;
    let group = if parallel { numbers.len().div_ceil(GROUPS) } else { numbers.len() }.max(1);
    let tasks: Vec<(&[usize], Vec<&mut [f32]>)> = numbers
        .chunks(group)
        .map(|group| {
            (group, group.iter().filter_map(|&number| targets[tree.members[number].cell.number].take()).collect())
        })
        .collect();
    for_each(parallel, tasks, |(group, targets)| {
        let mut y = zeros(group.len() * size);
        projection.descend(0, 0, group, &mut vec![Level::default(); tree.depth], &mut y);
        for (target, y) in targets.into_iter().zip(y.chunks_exact(size)) {
            unfold(false, y, &projection.sizes, n, target);
        }
    });
    all
}

struct Projection<'a> {
    tree: &'a Tree<'a>,
    tensor: &'a [f32],
    /// R_m, but I_n for mode n.
    sizes: Vec<usize>,
}

/// Cells that have elements at the present leading indices, and their projections of what lies below these.
#[derive(Clone, Default)]
struct Level {
    members: Vec<usize>,
    projections: Vec<f32>,
}

impl<'a> Projection<'a> {
    fn new(tree: &'a Tree<'a>, tensor: &'a [f32], n: usize) -> Self {
        let mut sizes = tree.node.ranks.clone();
        sizes[n] = tree.node.sizes[n];
        Projection { tree, tensor, sizes }
    }

    /// Project what lies below leading index `at` (flat) for the given cells; `out` is `[cells, sizes of level..]`.
    fn descend(&self, level: usize, at: usize, active: &[usize], levels: &mut [Level], out: &mut [f32]) {
        let Some((next, levels)) = levels.split_first_mut() else {
            let size = self.sizes[level..].iter().product();
            return self.leaves(at, 1, active, out.chunks_exact_mut(size));
        };
        let size = self.tree.node.sizes[level];
        let rest: usize = self.sizes[level + 1..].iter().product();
        if levels.is_empty() && !self.tree.applies(level) {
            return self.rows(at * size, size, active, out);
        }
        out.fill(0.0);
        for i in 0..size {
            let inside = |&number: &usize| self.tree.row(&self.tree.members[number], level, i).is_some();
            next.members.clear();
            next.members.extend(active.iter().copied().filter(inside));
            let below = room(&mut next.projections, next.members.len() * rest);
            self.descend(level + 1, at * size + i, &next.members, levels, below);
            self.add_row(level, i, active, below, out);
        }
    }

    /// Multiply projections of what lies below row `i` of a mode by the row's basis numbers and add them up.
    fn add_row(&self, level: usize, i: usize, active: &[usize], below: &[f32], out: &mut [f32]) {
        let rest: usize = self.sizes[level + 1..].iter().product();
        let mut below = below.chunks_exact(rest);
        for (&number, out) in active.iter().zip(out.chunks_exact_mut(self.sizes[level] * rest)) {
            let Some(row) = self.tree.row(&self.tree.members[number], level, i) else { continue };
            let Some(below_row) = below.next() else { break };
            if row.is_empty() {
                out[i * rest..(i + 1) * rest].copy_from_slice(below_row);
            } else {
                multiply(Matrix::new(row, row.len(), 1), Matrix::new(below_row, 1, rest), true, out);
            }
        }
    }

    /// The last leading mode, `size` leaves from `at` on, where that has no bases: several leaves at a time.
    fn rows(&self, at: usize, size: usize, active: &[usize], out: &mut [f32]) {
        let rest: usize = self.sizes[self.tree.depth..].iter().product();
        let group = (GATHERED / self.tree.leaf_size()).clamp(1, ROWS);
        for from in (0..size).step_by(group) {
            let count = group.min(size - from);
            let rows = out.chunks_exact_mut(size * rest).map(|out| &mut out[from * rest..(from + count) * rest]);
            self.leaves(at + from, count, active, rows);
        }
    }

    /// Project `count` leaves from `at` on.
    fn leaves<'o>(&self, at: usize, count: usize, active: &[usize], outs: impl Iterator<Item = &'o mut [f32]>) {
        let (depth, size) = (self.tree.depth, self.tree.leaf_size());
        let leaves = &self.tensor[at * size..(at + count) * size];
        with_scratch(|Scratch { steps, slab, .. }| {
            let mut present = None;
            for (&number, out) in active.iter().zip(outs) {
                let member = &self.tree.members[number];
                let pick = self.tree.pick(member);
                let block = room(slab, count * pick.len());
                if present != Some(member.pick) {
                    for (leaf, block) in leaves.chunks_exact(size).zip(block.chunks_exact_mut(pick.len())) {
                        pick.copy(leaf, block);
                    }
                    present = Some(member.pick);
                }
                let mut sizes = self.sizes.clone();
                sizes[..depth].fill(1);
                for (m, basis) in member.bases.iter().enumerate() {
                    if let Some(basis) = basis {
                        sizes[m] = basis.len() / self.tree.node.ranks[m];
                    }
                }
                Chain::project(&mut sizes, depth..self.tree.node.order(), &member.bases).run(block, out, steps);
            }
        });
    }
}
