//! Gauss-Seidel over cells: each cell in turn takes its own part back into the residual and fits itself to the sum.
//! The error never rises, whatever the overlap of the cells.

use crate::block::Block;
use crate::cells::Node;
use crate::hooi::{Workspace, round};
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
    sweep(&node, residual, bases, cores, effort);
    if let Some(sorting) = &sorting {
        sorting.in_parallel(residual, parallel, Sorting::restore);
    }
}

fn sweep(node: &Node, residual: &mut [f32], bases: &mut [&mut [f32]], cores: &mut [f32], effort: Effort) {
    let mut workspace = Workspace::default();
    for number in 0..effort.sweeps {
        for (cell, core) in (0..node.cells()).zip(cores.chunks_exact_mut(node.core_size())) {
            let cell = node.cell(cell);
            if node.is_empty(&cell) {
                continue;
            }
            let mut part = Tucker::load(node, &cell, bases, core);
            // Whatever bases the caller has are orthonormal after their first turn.
            let own = if number == 0 { orthonormal(node, &mut part, &mut workspace.subspace) } else { None };
            let block = Block::new(node, &cell);
            round(&block, &mut part, own.as_ref(), residual, effort.iterations, &mut workspace);
            core.copy_from_slice(&part.core);
            for (n, basis) in part.bases.iter().enumerate() {
                if let Some(basis) = basis {
                    node.store_basis(&cell, n, basis, bases[n]);
                }
            }
        }
    }
}

/// Orthonormalise the bases that HOOI projects on before it has updated them; returns what they were if that was needed.
///
/// Their spans stay the same, so the fit that follows is no worse than the model before.
fn orthonormal(node: &Node, part: &mut Tucker, buffers: &mut Buffers) -> Option<Tucker> {
    let mut before = None;
    let skew: Vec<usize> = (0..node.order())
        .filter(|&n| part.bases[n].as_ref().is_some_and(|basis| !buffers.is_orthonormal(basis, node.ranks[n])))
        .collect();
    for n in skew {
        before.get_or_insert_with(|| part.clone());
        if let Some(basis) = &mut part.bases[n] {
            buffers.orthonormalise(basis, node.ranks[n]);
        }
    }
    before
}
