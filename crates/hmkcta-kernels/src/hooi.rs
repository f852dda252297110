//! One HOOI round (paper, section 3.1) on the block of one cell, in three passes over its elements.
//!
//! Pass 1 takes the cell's part back into the residual and projects the second half of the modes, slab by slab; the
//! first half is updated from what comes out. Pass 2 projects the first half, columns by columns; the second half is
//! updated. Pass 3 puts block minus new model in the block's place. Slabs and columns do not depend on the number of
//! threads and write to places of their own, so results do not either.

use crate::block::Block;
use crate::chain::{Chain, unfold};
use crate::gemm::{Matrix, multiply};
use crate::shared::Shared;
use crate::subspace::Buffers;
use crate::threads::{Scratch, for_each, room, with_scratch};
use crate::tucker::{ModelBuffers, Tucker};
use std::ops::Range;

/// Columns of the block worked on at a time in pass 2.
const COLUMNS: usize = 256;
/// Slices projected before they are summed up along a mode.
const SLICES: usize = 8;

/// Buffers that are used for one cell after the other.
#[derive(Default)]
pub struct Workspace {
    block: Vec<f32>,
    pair: Vec<f32>,
    panels: Vec<f32>,
    reduced: Vec<f32>,
    unfolded: Vec<f32>,
    pub model: ModelBuffers,
    pub subspace: Buffers,
}

/// Fit `part` to `residual + own`, where `own` is the part the residual was computed with, and update the residual.
///
/// # Safety
/// Nobody else uses the elements of the block meanwhile.
pub unsafe fn round(
    block: &Block,
    part: &mut Tucker,
    own: Option<&Tucker>,
    residual: Shared,
    iterations: usize,
    ws: &mut Workspace,
) {
    if block.whole {
        // SAFETY: all elements are the block's.
        let residual = unsafe { residual.all() };
        take(block, part, own, residual, ws, |_, _| ());
        update_all(block, part, residual, iterations, ws);
        return part.add_onto_all(block, -1.0, residual, &mut ws.model);
    }
    let mut buffer = std::mem::take(&mut ws.block);
    let data = room(&mut buffer, block.tuples.len() * block.pick.len());
    // SAFETY: all elements are the block's, and nobody writes to them before the new model is known.
    take(block, part, own, data, ws, |tuples, slab| unsafe { residual.copy(block, tuples, slab) });
    update_all(block, part, data, iterations, ws);
    // SAFETY: all elements are the block's, and each slab has tuples of its own.
    give(block, part, data, ws, |tuples, slab| unsafe { residual.put(block, tuples, slab) });
    ws.block = buffer;
}

/// Update all bases and the core from the block and the pair tensor of pass 1.
fn update_all(block: &Block, part: &mut Tucker, data: &[f32], iterations: usize, ws: &mut Workspace) {
    let [first, second] = [0..block.half, block.half..block.order()];
    let [whole_first, whole_second] =
        [&first, &second].map(|half| part.bases[half.clone()].iter().all(Option::is_none));
    let mut pair = std::mem::take(&mut ws.pair);
    let from = if whole_second { data } else { &pair };
    update(block, part, first, block.mixed(block.half, false), from, iterations, ws);
    if !whole_second {
        if !whole_first {
            project_first(block, part, data, &mut pair, ws);
        }
        let from = if whole_first { data } else { &pair };
        update(block, part, second, block.mixed(block.half, true), from, iterations, ws);
    }
    ws.pair = pair;
}

/// Pass 1: data = residual + own, and the pair tensor, its projection on the second half of the modes.
///
/// `fill` puts the residual in a slab's place. Where nothing is projected no pair tensor is made.
fn take(
    block: &Block,
    part: &Tucker,
    own: Option<&Tucker>,
    data: &mut [f32],
    ws: &mut Workspace,
    fill: impl Fn(&[usize], &mut [f32]) + Sync + Send,
) {
    let own = own.unwrap_or(part);
    let known = !own.is_zero();
    let head = own.expand_head(block, 1.0, &mut ws.model);
    let project = part.project_rest(block);
    let (count, row) = (block.tuples.len(), block.pick.len());
    let reduced = if project.is_identity() { 0 } else { project.output() };
    let slabs = block.tuples.chunks(block.group).enumerate();
    let mut pairs = room(&mut ws.pair, count * reduced).chunks_mut((block.group * reduced).max(1));
    let targets = data.chunks_mut(block.group * row).map(|slab| (slab, pairs.next().unwrap_or_default()));
    for_each(block.parallel, slabs.zip(targets).collect(), |((number, tuples), (slab, pair))| {
        with_scratch(|scratch| {
            fill(tuples, slab);
            if known {
                head.expand(number * block.group, tuples.len(), true, slab, scratch);
            }
            if !pair.is_empty() {
                project.run(slab, pair, &mut scratch.steps);
            }
        });
    });
}

/// Pass 2: the pair tensor becomes the block's projection on the first half of the modes.
fn project_first(block: &Block, part: &Tucker, data: &[f32], pair: &mut Vec<f32>, ws: &mut Workspace) {
    let columns: usize = block.sizes[block.half..].iter().product();
    let rows: usize = block.ranks[..block.half].iter().product();
    let first = FirstHalf { block: data, sizes: &block.sizes[..block.half], bases: &part.bases, columns };
    let panels = room(&mut ws.panels, rows * columns);
    let tasks = panels.chunks_mut(rows * COLUMNS).enumerate().collect();
    for_each(block.parallel, tasks, |(number, panel)| {
        with_scratch(|Scratch { levels, .. }| {
            let from = number * COLUMNS;
            let width = panel.len() / rows;
            levels.resize_with(levels.len().max(block.half), Vec::new);
            first.project(0, 0, from..from + width, levels, panel);
        });
    });
    // Panels become rows of the pair tensor.
    let panels = &*panels;
    let pair = room(pair, rows * columns);
    for_each(block.parallel, pair.chunks_exact_mut(columns).enumerate().collect(), |(row, pair)| {
        for (to, panel) in pair.chunks_mut(COLUMNS).zip(panels.chunks(rows * COLUMNS)) {
            to.copy_from_slice(&panel[row * to.len()..][..to.len()]);
        }
    });
}

/// The block seen as `[m_1, .., m_half, columns]`.
struct FirstHalf<'a> {
    block: &'a [f32],
    sizes: &'a [usize],
    bases: &'a [Option<Vec<f32>>],
    columns: usize,
}

impl FirstHalf<'_> {
    /// Project modes `level` and up of the rows below `row` (flat over the modes before) for some columns.
    fn project(&self, level: usize, row: usize, columns: Range<usize>, buffers: &mut [Vec<f32>], out: &mut [f32]) {
        let Some(&m) = self.sizes.get(level) else {
            return out.copy_from_slice(&self.block[row * self.columns..][columns]);
        };
        let Some(basis) = &self.bases[level] else {
            let slice = out.len() / m;
            for (i, out) in out.chunks_exact_mut(slice).enumerate() {
                self.project(level + 1, row * m + i, columns.clone(), buffers, out);
            }
            return;
        };
        let rank = basis.len() / m;
        if level + 1 == self.sizes.len() {
            let rows = &self.block[row * m * self.columns + columns.start..];
            let rows = Matrix::new(rows, m, columns.len()).with_row_step(self.columns);
            return multiply(Matrix::new(basis, rank, m), rows, false, out);
        }
        let (buffer, buffers) = buffers.split_at_mut(1);
        let slice = out.len() / rank;
        for from in (0..m).step_by(SLICES) {
            let count = SLICES.min(m - from);
            let slices = room(&mut buffer[0], count * slice);
            for (i, slice) in slices.chunks_exact_mut(slice).enumerate() {
                self.project(level + 1, row * m + from + i, columns.clone(), buffers, slice);
            }
            let basis = Matrix::new(basis, rank, m).columns(from, count);
            multiply(basis, Matrix::new(slices, count, slice), from > 0, out);
        }
    }
}

/// Update the bases of some modes from a tensor in which all others are projected, and the core.
fn update(
    block: &Block,
    part: &mut Tucker,
    modes: Range<usize>,
    sizes: Vec<usize>,
    pair: &[f32],
    iterations: usize,
    ws: &mut Workspace,
) {
    let Workspace { reduced, unfolded, subspace, model: ModelBuffers { steps, .. }, .. } = ws;
    let pair = &pair[..sizes.iter().product()];
    for n in modes.clone() {
        let Some(mut basis) = part.bases[n].take() else { continue };
        let mut left = sizes.clone();
        let chain = Chain::project(&mut left, modes.clone().filter(|&m| m != n), &part.bases).on(block.parallel);
        let mut e = pair;
        if !chain.is_identity() {
            let out = room(reduced, chain.output());
            chain.run(pair, out, steps);
            e = out;
        }
        if left[..n].iter().any(|&size| size > 1) {
            let out = room(unfolded, e.len());
            unfold(block.parallel, e, &left, n, out);
            e = out;
        }
        subspace.iterate(e, &mut basis, block.ranks[n], iterations, block.parallel);
        part.bases[n] = Some(basis);
    }
    Chain::project(&mut sizes.clone(), modes, &part.bases).on(block.parallel).run(pair, &mut part.core, steps);
}

/// Pass 3: residual = data - model. `put` takes what becomes of a slab.
fn give(
    block: &Block,
    part: &Tucker,
    data: &mut [f32],
    ws: &mut Workspace,
    put: impl Fn(&[usize], &[f32]) + Sync + Send,
) {
    let head = part.expand_head(block, -1.0, &mut ws.model);
    let slabs = data.chunks_mut(block.group * block.pick.len());
    let tasks = slabs.zip(block.tuples.chunks(block.group)).enumerate().collect();
    for_each(block.parallel, tasks, |(number, (slab, tuples))| {
        with_scratch(|scratch| head.expand(number * block.group, tuples.len(), true, slab, scratch));
        put(tuples, slab);
    });
}
