//! Reconstruction of all cells onto a tensor.

use crate::apart::{self, Turn, each_cell};
use crate::block::Block;
use crate::cells::{Cell, Node};
use crate::chain::Chain;
use crate::gemm::{Matrix, multiply};
use crate::lines;
use crate::permuted;
use crate::shared::Shared;
use crate::threads::{PARALLEL, Scratch, for_each, room, with_scratch};
use crate::tree::Tree;
use crate::tucker::{ModelBuffers, Tucker};
use std::ops::Range;

/// Pieces the tensor is cut into, for threads to share.
const PIECES: usize = 64;

/// Up to this many cells an element may belong to for the tensor to be visited cell by cell.
const OVERLAP: usize = 4;

/// `tensor += weight * model`
pub fn accumulate(node: Node, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    let overlapping = node.mixture.iter().any(|&k| k > 1);
    if permuted::pays(&node) {
        permuted::accumulate(&node, tensor, bases, cores, weight);
    } else if overlapping && let Some(mode) = lines::mode_of_rows(&node) {
        lines::accumulate(&node, mode, tensor, bases, cores, weight);
    } else if node.mixture.iter().product::<usize>() <= OVERLAP {
        by_cells(&node, tensor, bases, cores, weight);
    } else {
        by_leaves(node, tensor, bases, cores, weight);
    }
}

/// Slab by slab of each cell, which is best for long rows and bases.
pub fn by_cells(node: &Node, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    let tensor = Shared::new(tensor);
    let cores = cores.chunks_exact(node.core_size());
    if apart::pays(node) {
        return each_cell(node, cores.collect(), |turn: Turn<&[f32]>, buffers| {
            // SAFETY: no other cell has the elements of this one, whose turn comes once.
            unsafe { add_cell(node, &turn.cell, (bases, turn.item), weight, tensor, turn.shared, buffers) };
        });
    }
    let mut buffers = ModelBuffers::default();
    for (cell, core) in (0..node.cells()).map(|number| node.cell(number)).zip(cores) {
        if !node.is_empty(&cell) {
            // SAFETY: cells come one after the other.
            unsafe { add_cell(node, &cell, (bases, core), weight, tensor, true, &mut buffers) };
        }
    }
}

/// `tensor += weight * model` of a cell that is not empty.
///
/// # Safety
/// Nobody else uses its elements meanwhile.
unsafe fn add_cell(
    node: &Node,
    cell: &Cell,
    (bases, core): (&[&[f32]], &[f32]),
    weight: f32,
    tensor: Shared,
    shared: bool,
    buffers: &mut ModelBuffers,
) {
    let part = Tucker::load(node, cell, bases, core);
    if !part.is_zero() {
        // SAFETY: the caller has the elements of the cell alone.
        unsafe { part.add_onto(&Block::new(node, cell, shared), weight, tensor, buffers) };
    }
}

/// Leaf by leaf of the tensor, so that each element comes into the cache once for all its cells.
fn by_leaves(node: Node, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    let size = node.core_size();
    let core = |number: usize| &cores[number * size..(number + 1) * size];
    let tree = Tree::new(node, bases, None, |cell| core(cell.number).iter().any(|&z| z != 0.0));
    let weighted = tree.members.iter().flat_map(|member| core(member.cell.number).iter().map(|z| weight * z)).collect();
    let all = Partial { members: (0..tree.members.len()).collect(), cores: weighted };
    let parallel = tensor.len() >= PARALLEL;
    let leaves = tensor.len() / tree.leaf_size();
    let piece = leaves.div_ceil(PIECES);
    let tasks = tensor.chunks_mut(piece * tree.leaf_size()).enumerate().collect();
    let expansion = Expansion::new(tree);
    for_each(parallel, tasks, |(number, piece_of)| {
        let mut levels = vec![Partial::default(); expansion.tree.depth];
        let from = number * piece;
        let count = piece_of.len() / expansion.tree.leaf_size();
        expansion.descend(0, from..from + count, &all, &mut levels, piece_of);
    });
}

struct Expansion<'a> {
    tree: Tree<'a>,
    /// For each level, numbers of a core whose modes above the level have been contracted with one row each.
    core_sizes: Vec<usize>,
    /// For each level, the leaves below one row of that level.
    spans: Vec<usize>,
}

/// Cells that have elements at the present leading indices, and their cores contracted with the rows of these.
#[derive(Clone, Default)]
struct Partial {
    members: Vec<usize>,
    cores: Vec<f32>,
}

impl<'a> Expansion<'a> {
    fn new(tree: Tree<'a>) -> Self {
        let (depth, node) = (tree.depth, &tree.node);
        let core_sizes = (0..=depth).map(|level| node.ranks[level..].iter().product()).collect();
        let spans = (0..depth).map(|level| node.sizes[level + 1..depth].iter().product()).collect();
        Expansion { tree, core_sizes, spans }
    }

    /// Add the model of the given cells to `x`, the leaves `range` of those below the present leading indices.
    fn descend(&self, level: usize, range: Range<usize>, active: &Partial, levels: &mut [Partial], x: &mut [f32]) {
        let Some((next, levels)) = levels.split_first_mut() else { return self.leaf(active, x) };
        let (span, leaf) = (self.spans[level], self.tree.leaf_size());
        for i in range.start / span..range.end.div_ceil(span) {
            let below = range.start.max(i * span)..range.end.min((i + 1) * span);
            let part = &mut x[(below.start - range.start) * leaf..(below.end - range.start) * leaf];
            self.contract(level, i, active, next);
            self.descend(level + 1, below.start - i * span..below.end - i * span, next, levels, part);
        }
    }

    /// Keep the cells that have row `i` of mode `level`, contract their cores with it.
    fn contract(&self, level: usize, i: usize, active: &Partial, next: &mut Partial) {
        let (size, rest) = (self.core_sizes[level], self.core_sizes[level + 1]);
        next.members.clear();
        next.cores.clear();
        for (&number, core) in active.members.iter().zip(active.cores.chunks_exact(size)) {
            let Some(row) = self.tree.row(&self.tree.members[number], level, i) else { continue };
            next.members.push(number);
            if row.is_empty() {
                next.cores.extend_from_slice(&core[i * rest..(i + 1) * rest]);
                continue;
            }
            let start = next.cores.len();
            next.cores.resize(start + rest, 0.0);
            multiply(
                Matrix::new(row, 1, row.len()),
                Matrix::new(core, row.len(), rest),
                false,
                &mut next.cores[start..],
            );
        }
    }

    fn leaf(&self, active: &Partial, x: &mut [f32]) {
        let depth = self.tree.depth;
        with_scratch(|Scratch { steps, slab, sorted, .. }| {
            if let Some(sorting) = &self.tree.sorting {
                sorting.sort(x, sorted);
            }
            for (&number, core) in active.members.iter().zip(active.cores.chunks_exact(self.core_sizes[depth])) {
                let member = &self.tree.members[number];
                let mut sizes = self.tree.node.ranks.clone();
                sizes[..depth].fill(1);
                let chain = Chain::expand(&mut sizes, (depth..self.tree.node.order()).rev(), &member.bases);
                let model = room(slab, chain.output());
                chain.run(core, model, steps);
                self.tree.pick(member).add_onto(x, model);
            }
            if let Some(sorting) = &self.tree.sorting {
                sorting.restore(x, sorted);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, numbers, on_any_threads, same_bits};

    #[test]
    fn disjoint_cells_are_added_as_if_one_after_the_other() {
        compare_with_single_cells(&[30, 90, 80], &[6, 5, 7], &[2, 2, 2], None);
        compare_with_single_cells(&[600, 700], &[2, 1], &[3, 3], None);
        compare_with_single_cells(&[5, 300, 200], &[1, 7, 2], &[5, 2, 2], Some(0));
    }

    fn compare_with_single_cells(sizes: &[usize], c: &[usize], ranks: &[usize], undecomposed: Option<usize>) {
        let example = Example::new(sizes, c, &vec![1; sizes.len()], ranks, undecomposed);
        let node = example.node();
        let (bases, cores) = example.numbers();
        let bases: Vec<&[f32]> = bases.iter().map(Vec::as_slice).collect();
        let before = numbers(node.sizes.iter().product(), 8);
        let mut expected = before.clone();
        for (number, core) in cores.chunks_exact(node.core_size()).enumerate() {
            let (cell, tensor) = (node.cell(number), Shared::new(&mut expected));
            // SAFETY: nobody else knows of the tensor.
            unsafe { add_cell(&node, &cell, (&bases, core), 0.5, tensor, false, &mut ModelBuffers::default()) };
        }
        let found = on_any_threads(|| {
            let mut tensor = before.clone();
            accumulate(example.node(), &mut tensor, &bases, &cores, 0.5);
            tensor
        });
        assert!(same_bits(&found, &expected));
    }
}
