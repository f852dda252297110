//! The model of one cell, and how slabs of it are made.

use crate::block::Block;
use crate::cells::{Cell, Node};
use crate::chain::Chain;
use crate::gemm::{Matrix, multiply};
use crate::shared::Shared;
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

    /// Store the bases and the core of one cell.
    pub fn store(&self, node: &Node, cell: &Cell, bases: &mut [&mut [f32]], core: &mut [f32]) {
        core.copy_from_slice(&self.core);
        for (n, basis) in self.bases.iter().enumerate() {
            if let Some(basis) = basis {
                node.store_basis(cell, n, basis, bases[n]);
            }
        }
    }

    /// Whether the model is zero everywhere.
    pub fn is_zero(&self) -> bool {
        self.core.iter().all(|&z| z == 0.0)
    }

    /// What all slabs start from, times `weight`: the core with its leading modes expanded, the last of them by slabs.
    pub fn expand_head<'w>(&'w self, block: &Block, weight: f32, buffers: &'w mut ModelBuffers) -> Head<'w> {
        let last = block.leading - 1;
        let chain = Chain::expand(&mut block.ranks.clone(), 0..last, &self.bases);
        let numbers = room(&mut buffers.head, chain.output());
        chain.run(&self.core, numbers, &mut buffers.steps);
        numbers.iter_mut().for_each(|z| *z *= weight);
        let (rows, rank) = (block.sizes[last], block.ranks[last]);
        let each = block.ranks[block.leading..].iter().product();
        Head { numbers, basis: self.bases[last].as_deref(), rows, rank, each, rest: self.expand_rest(block) }
    }

    /// What makes slabs of the model from the head.
    fn expand_rest(&self, block: &Block) -> Chain<'_> {
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
    ///
    /// # Safety
    /// Nobody else uses the elements of the block meanwhile.
    pub unsafe fn add_onto(&self, block: &Block, weight: f32, tensor: Shared, buffers: &mut ModelBuffers) {
        if block.whole {
            // SAFETY: all elements are the block's.
            return self.add_onto_all(block, weight, unsafe { tensor.all() }, buffers);
        }
        let head = self.expand_head(block, weight, buffers);
        let group = block.group;
        for_each(block.parallel, block.tuples.chunks(group).enumerate().collect(), |(number, tuples)| {
            with_scratch(|scratch| {
                let mut buffer = std::mem::take(&mut scratch.slab);
                let slab = room(&mut buffer, tuples.len() * block.pick.len());
                head.expand(number * group, tuples.len(), false, slab, scratch);
                // SAFETY: no two slabs have a tuple in common, and all elements are the block's.
                unsafe { tensor.add(block, tuples, slab) };
                scratch.slab = buffer;
            });
        });
    }

    /// The same where the block is the whole tensor.
    pub fn add_onto_all(&self, block: &Block, weight: f32, tensor: &mut [f32], buffers: &mut ModelBuffers) {
        let head = self.expand_head(block, weight, buffers);
        let (row, group) = (block.pick.len(), block.group);
        let slabs = tensor.chunks_mut(group * row).enumerate().collect();
        for_each(block.parallel, slabs, |(number, slab)| {
            with_scratch(|scratch| head.expand(number * group, slab.len() / row, true, slab, scratch))
        });
    }
}

/// A core of which all leading modes but the last are expanded, and what makes slabs of it.
pub struct Head<'a> {
    /// For each combination of rows of those modes, `[rank, each]`.
    numbers: &'a [f32],
    /// `[rank, rows]` of the last leading mode; None where it is undecomposed.
    basis: Option<&'a [f32]>,
    rows: usize,
    rank: usize,
    /// Numbers of the core for each combination of leading rows.
    each: usize,
    rest: Chain<'a>,
}

impl Head<'_> {
    /// The model of `count` combinations of leading rows from `first` on; or add it to what `out` holds.
    pub fn expand(&self, first: usize, count: usize, add: bool, out: &mut [f32], scratch: &mut Scratch) {
        let &Head { numbers, each, ref rest, .. } = self;
        let Some(basis) = self.basis else {
            return rest.apply(&numbers[first * each..][..count * each], out, &mut scratch.steps, add);
        };
        if rest.is_identity() {
            return self.lead(basis, first, count, add, out);
        }
        let buffer = room(&mut scratch.head, count * each);
        self.lead(basis, first, count, false, buffer);
        rest.apply(buffer, out, &mut scratch.steps, add);
    }

    /// Rows of the last leading mode times the numbers of each combination of those before.
    fn lead(&self, basis: &[f32], first: usize, count: usize, add: bool, out: &mut [f32]) {
        let &Head { numbers, rows, rank, each, .. } = self;
        let (mut at, end) = (first, first + count);
        while at < end {
            let (before, row) = (at / rows, at % rows);
            let stretch = (rows - row).min(end - at);
            let u = Matrix::new(basis, rank, rows).columns(row, stretch).transposed();
            let z = Matrix::new(&numbers[before * rank * each..], rank, each);
            multiply(u, z, add, &mut out[(at - first) * each..][..stretch * each]);
            at += stretch;
        }
    }
}
