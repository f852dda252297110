//! The model of one cell, and how slabs of it are made.

use crate::block::Block;
use crate::cells::{Cell, Node};
use crate::chain::Chain;
use crate::threads::{Scratch, for_each, room, with_scratch};

/// One cell's bases `[R_n, m_n]` (None for an undecomposed mode) and core.
#[derive(Clone)]
pub struct Tucker {
    pub bases: Vec<Option<Vec<f32>>>,
    pub core: Vec<f32>,
}

/// Buffers for making a model.
#[derive(Default)]
pub struct ModelBuffers {
    head: Vec<f32>,
    pub steps: [Vec<f32>; 2],
}

impl Tucker {
    /// The bases and the core of one cell.
    pub fn load<B: AsRef<[f32]>>(node: &Node, cell: &Cell, bases: &[B], core: &[f32]) -> Tucker {
        let basis = |n: usize| (!node.undecomposed[n]).then(|| node.load_basis(cell, n, bases[n].as_ref()));
        Tucker { bases: (0..node.order()).map(basis).collect(), core: core.to_vec() }
    }

    /// Whether the model is zero everywhere.
    pub fn is_zero(&self) -> bool {
        self.core.iter().all(|&z| z == 0.0)
    }

    /// Expand the leading modes of the core, which all slabs start from, and multiply by `weight`.
    pub fn expand_head<'w>(&self, block: &Block, weight: f32, buffers: &'w mut ModelBuffers) -> &'w [f32] {
        let chain = Chain::expand(&mut block.ranks.clone(), 0..block.leading, &self.bases);
        let head = room(&mut buffers.head, chain.output());
        chain.run(&self.core, head, &mut buffers.steps);
        head.iter_mut().for_each(|z| *z *= weight);
        head
    }

    /// What makes slabs of the model from the head.
    pub fn expand_rest(&self, block: &Block) -> Chain<'_> {
        let mut sizes = block.ranks.clone();
        sizes[..block.leading].fill(1);
        Chain::expand(&mut sizes, (block.leading..block.order()).rev(), &self.bases)
    }

    /// What projects the second half of the modes of slabs of the block.
    pub fn project_rest(&self, block: &Block) -> Chain<'_> {
        let mut sizes = block.sizes.clone();
        sizes[..block.leading].fill(1);
        Chain::project(&mut sizes, block.half..block.order(), &self.bases)
    }

    /// Add `weight * model` to a tensor.
    pub fn add_onto(&self, block: &Block, weight: f32, tensor: &mut [f32], buffers: &mut ModelBuffers) {
        let head = self.expand_head(block, weight, buffers);
        let expand = self.expand_rest(block);
        let (row, head_row) = (block.pick.len(), head.len() / block.tuples.len());
        let heads = head.chunks(block.group * head_row);
        if block.whole {
            let slabs = tensor.chunks_mut(block.group * row).zip(heads).collect();
            return for_each(block.parallel, slabs, |(slab, head)| {
                with_scratch(|scratch| expand.add(head, slab, &mut scratch.steps))
            });
        }
        let mut targets = block.places(tensor);
        for_each(block.parallel, targets.chunks_mut(block.group).zip(heads).collect(), |(targets, head)| {
            with_scratch(|Scratch { steps, slab, .. }| {
                let slab = room(slab, targets.len() * row);
                expand.run(head, slab, steps);
                for (target, row) in targets.iter_mut().zip(slab.chunks_exact(row)) {
                    block.pick.add_onto(target, row);
                }
            });
        });
    }
}
