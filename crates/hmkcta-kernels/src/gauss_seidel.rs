//! Gauss-Seidel over cells: each cell in turn takes its own part back into the residual and fits itself to the sum.
//! The error never rises, whatever the overlap of the cells.

use crate::apart::{self, Turn, each_cell};
use crate::block::Block;
use crate::cells::Node;
use crate::hooi::{Workspace, round};
use crate::shared::Shared;
use crate::sorting::Sorting;
use crate::subspace::Buffers;
use crate::threads::PARALLEL;
use crate::tucker::Tucker;

/// How hard each cell is fitted when its turn comes.
#[derive(Clone, Copy)]
pub struct Effort {
    /// Rounds over all cells.
    pub sweeps: usize,
    /// Subspace iterations a mode update, started from the present basis.
    pub iterations: usize,
}

/// Fit all cells of `node` to `residual + model`, leaving in `residual` what they do not explain.
pub fn fit(mut node: Node, residual: &mut [f32], bases: &mut [&mut [f32]], cores: &mut [f32], effort: Effort) {
    let sorting = node.sort_rows(0);
    let parallel = residual.len() >= PARALLEL;
    if let Some(sorting) = &sorting {
        sorting.in_parallel(residual, parallel, Sorting::sort);
    }
    if apart::pays(&node) {
        each_by_itself(&node, residual, bases, cores, effort);
    } else {
        sweep(&node, residual, bases, cores, effort);
    }
    if let Some(sorting) = &sorting {
        sorting.in_parallel(residual, parallel, Sorting::restore);
    }
}

/// Cells that may share elements take turns.
fn sweep(node: &Node, residual: &mut [f32], bases: &mut [&mut [f32]], cores: &mut [f32], effort: Effort) {
    let (residual, mut workspace) = (Shared::new(residual), Workspace::default());
    for number in 0..effort.sweeps {
        for (cell, core) in (0..node.cells()).zip(cores.chunks_exact_mut(node.core_size())) {
            let cell = node.cell(cell);
            if node.is_empty(&cell) {
                continue;
            }
            let mut part = Tucker::load(node, &cell, bases, core);
            let block = Block::new(node, &cell, true);
            // SAFETY: cells come one after the other.
            unsafe { turn(&block, &mut part, number == 0, residual, effort.iterations, &mut workspace) };
            part.store(node, &cell, bases, core);
        }
    }
}

/// Where no element belongs to two cells none has to wait for another, and each makes all its rounds at once.
fn each_by_itself(node: &Node, residual: &mut [f32], bases: &mut [&mut [f32]], cores: &mut [f32], effort: Effort) {
    let (residual, mut parts) = (Shared::new(residual), vec![None; node.cells()]);
    let (before, starts) = (&*bases, cores.chunks_exact(node.core_size()));
    let items = parts.iter_mut().zip(starts).collect();
    each_cell(node, items, |Turn { cell, item: (fitted, core), shared, .. }, workspace| {
        let mut part = Tucker::load(node, &cell, before, core);
        let block = Block::new(node, &cell, shared);
        for number in 0..effort.sweeps {
            // SAFETY: no other cell has the elements of this one, whose turn comes once.
            unsafe { turn(&block, &mut part, number == 0, residual, effort.iterations, workspace) };
        }
        *fitted = Some(part);
    });
    for (number, (part, core)) in parts.iter().zip(cores.chunks_exact_mut(node.core_size())).enumerate() {
        if let Some(part) = part {
            part.store(node, &node.cell(number), bases, core);
        }
    }
}

/// A cell takes its part back into the residual and fits itself to the sum.
///
/// # Safety
/// Nobody else uses the elements of the block meanwhile.
unsafe fn turn(
    block: &Block,
    part: &mut Tucker,
    first: bool,
    residual: Shared,
    iterations: usize,
    workspace: &mut Workspace,
) {
    // Whatever bases the caller has are orthonormal after their first turn.
    let own = if first { orthonormal(block, part, &mut workspace.subspace) } else { None };
    // SAFETY: the caller has the elements alone.
    unsafe { round(block, part, own.as_ref(), residual, iterations, workspace) };
}

/// Orthonormalise the bases that HOOI projects on before it has updated them; returns what they were if that was needed.
///
/// Their spans stay the same, so the fit that follows is no worse than the model before.
fn orthonormal(block: &Block, part: &mut Tucker, buffers: &mut Buffers) -> Option<Tucker> {
    let mut before = None;
    let mut is_skew = |n: usize, basis: &[f32]| !buffers.is_orthonormal(basis, block.ranks[n], block.parallel);
    let skew: Vec<usize> =
        (0..block.order()).filter(|&n| part.bases[n].as_ref().is_some_and(|basis| is_skew(n, basis))).collect();
    for n in skew {
        before.get_or_insert_with(|| part.clone());
        if let Some(basis) = &mut part.bases[n] {
            buffers.orthonormalise(basis, block.ranks[n], block.parallel);
        }
    }
    before
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, numbers, on_any_threads, same_bits};

    /// The residual, the cores and the bases that a fit leaves.
    fn fitted(example: &Example, by: impl Fn(&Node, &mut [f32], &mut [&mut [f32]], &mut [f32], Effort)) -> Vec<f32> {
        let node = example.node();
        let (mut bases, mut cores) = example.numbers();
        let mut residual = numbers(node.sizes.iter().product(), 9);
        let mut slices: Vec<&mut [f32]> = bases.iter_mut().map(Vec::as_mut_slice).collect();
        by(&node, &mut residual, &mut slices, &mut cores, Effort { sweeps: 2, iterations: 2 });
        [residual, cores, bases.concat()].concat()
    }

    fn compare_with_turns(sizes: &[usize], c: &[usize], ranks: &[usize], undecomposed: Option<usize>) {
        let example = Example::new(sizes, c, &vec![1; sizes.len()], ranks, undecomposed);
        let expected = fitted(&example, sweep);
        let found = on_any_threads(|| fitted(&example, each_by_itself));
        assert!(same_bits(&found, &expected));
        let found = on_any_threads(|| {
            fitted(&example, |_, residual, bases, cores, effort| fit(example.node(), residual, bases, cores, effort))
        });
        // Sorted or not, each row of a cell comes in the same order.
        assert!(same_bits(&found, &expected));
    }

    #[test]
    fn disjoint_cells_are_fitted_as_if_they_took_turns() {
        // Many cells and some, of which some are empty; a few large ones, which threads share or not; one.
        compare_with_turns(&[30, 90, 80], &[6, 5, 7], &[2, 2, 2], None);
        compare_with_turns(&[3, 90, 260, 3], &[5, 2, 3, 1], &[1, 2, 2, 3], Some(3));
        compare_with_turns(&[600, 700], &[2, 1], &[3, 3], None);
        compare_with_turns(&[300, 700], &[1, 1], &[300, 3], Some(0));
        compare_with_turns(&[7, 8, 9], &[2, 3, 2], &[2, 2, 2], None);
    }
}
