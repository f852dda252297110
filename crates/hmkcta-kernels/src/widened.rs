//! Cores, times their scales, and basis rows of a node as floats: all of them, or what one choice of clusters needs at a
//! time.

use crate::layout::{CORE, LANES, Layout};
use crate::packed::NodeView;
use crate::real::{Real, widen_all};
use crate::steps::{Addresses, Offsets};
use crate::threads::room;

/// Buffers for widened numbers.
#[derive(Default)]
pub struct Tables<T> {
    all: Vec<T>,
    plain: Vec<T>,
}

/// Where the numbers of an element come from.
///
/// # Safety
/// Pointers are good for the block of `Layout` and for padded rows, for every choice that `Steps::choices` gives with the
/// addresses of this source. Slots without a mode hold a one, and zeros behind it.
pub unsafe trait Source<T> {
    fn addresses(&self) -> &Addresses;

    /// Turn to a choice of clusters.
    ///
    /// # Safety
    /// The choice is one of `Steps::choices`, here and below.
    unsafe fn choose<const W: usize>(&mut self, choice: &Offsets<W>);

    /// The numbers of a slot for the choice turned to: undecomposed modes fixed, in the order of `Layout`.
    ///
    /// # Safety
    /// As above.
    unsafe fn numbers<const W: usize>(&self, slot: usize, choice: &Offsets<W>) -> *const T;
}

/// What stands for the row of a mode that a node does not have.
fn ones<T: Real>(to: &mut [T]) {
    to.fill(T::ZERO);
    to[0] = T::ONE;
}

/// All numbers of a node, in one array.
pub struct Widened<'w, T> {
    all: &'w [T],
    addresses: Addresses,
}

impl<'w, T: Real> Widened<'w, T> {
    #[inline(always)]
    pub fn new(node: &NodeView, layout: &Layout, tables: &'w mut Tables<T>) -> Self {
        let starts = layout.stored_starts(node);
        let cell = starts.len() * layout.block();
        let rows: Vec<usize> = (0..layout.free.len()).map(|f| layout.padded(node, f)).collect();
        let counts: Vec<usize> = layout.free.iter().map(|&n| node.basis[n].len() / node.ranks[n]).collect();
        let bases = rows.iter().zip(&counts).map(|(row, count)| row * count).sum::<usize>();
        let Tables { all, plain } = tables;
        let all = room(all, LANES + node.cells() * cell + bases);
        let (one, rest) = all.split_at_mut(LANES);
        let (core, mut rest) = rest.split_at_mut(node.cells() * cell);
        ones(one);
        widen_core(node, layout, &starts, plain, core);
        let mut offsets = [0; LANES];
        offsets[CORE] = LANES as u32;
        let mut at = LANES + core.len();
        for (f, &n) in layout.free.iter().enumerate() {
            let (basis, behind) = rest.split_at_mut(rows[f] * counts[f]);
            widen_rows(node.basis[n], node.ranks[n], basis, rows[f], plain);
            offsets[layout.slots[f]] = at as u32;
            at += basis.len();
            rest = behind;
        }
        // Blocks of an undecomposed mode lie as far apart as there are blocks of those behind it.
        let mut step = cell;
        let step_of = |&(n, _): &(usize, usize)| {
            step /= node.rows[n];
            step
        };
        let fixed = layout.fixed.iter().map(step_of).collect();
        Widened { all, addresses: Addresses { starts: offsets, cell, fixed, rows } }
    }
}

/// The blocks of all cores, times their scales.
#[inline(always)]
fn widen_core<T: Real>(node: &NodeView, layout: &Layout, starts: &[usize], plain: &mut Vec<T>, core: &mut [T]) {
    let stored = room(plain, node.core.len());
    widen_all(node.core, stored);
    let mut blocks = core.chunks_exact_mut(layout.block());
    for (cell, &scale) in stored.chunks_exact(node.core_size()).zip(node.scale) {
        let scale = T::from_f32(scale);
        for (&start, block) in starts.iter().zip(&mut blocks) {
            layout.arrange(&cell[start..], block, T::ZERO, |x| x * scale);
        }
    }
}

/// Rows of `rank` numbers, padded to `row`.
#[inline(always)]
fn widen_rows<T: Real>(stored: &[u16], rank: usize, rows: &mut [T], row: usize, plain: &mut Vec<T>) {
    if rank == row {
        return widen_all(stored, rows);
    }
    let numbers = room(plain, stored.len());
    widen_all(stored, numbers);
    for (numbers, to) in numbers.chunks_exact(rank).zip(rows.chunks_exact_mut(row)) {
        to[..rank].copy_from_slice(numbers);
        to[rank..].fill(T::ZERO);
    }
}

// SAFETY: `NodeView` has checked that the stored arrays are as long as the node's shape says, the widened ones have been
// made as long as padding needs, and `Steps::choices` gives offsets of clusters and rows that exist. Slots without a mode
// keep offset 0, where the one is.
unsafe impl<T: Real> Source<T> for Widened<'_, T> {
    #[inline(always)]
    fn addresses(&self) -> &Addresses {
        &self.addresses
    }

    #[inline(always)]
    unsafe fn choose<const W: usize>(&mut self, _: &Offsets<W>) {}

    #[inline(always)]
    unsafe fn numbers<const W: usize>(&self, slot: usize, choice: &Offsets<W>) -> *const T {
        // SAFETY: the choice is one of these addresses, all of which lie within `all`, as the caller promises.
        unsafe { self.all.as_ptr().add(choice[slot] as usize) }
    }
}

/// What one choice of clusters needs, widened for it.
pub struct Picked<'w, T> {
    node: &'w NodeView<'w>,
    layout: &'w Layout,
    /// The buffer of each slot.
    buffers: [*mut T; LANES],
    addresses: Addresses,
}

impl<'w, T: Real> Picked<'w, T> {
    #[inline(always)]
    pub fn new(node: &'w NodeView, layout: &'w Layout, tables: &'w mut Tables<T>) -> Self {
        let rows: Vec<usize> = layout.free.iter().map(|&n| node.ranks[n]).collect();
        let padded = (0..rows.len()).map(|f| layout.padded(node, f)).sum::<usize>();
        let (one, rest) = room(&mut tables.all, LANES + layout.block() + padded).split_at_mut(LANES);
        let (core, mut rest) = rest.split_at_mut(layout.block());
        ones(one);
        let mut buffers = [one.as_mut_ptr(); LANES];
        buffers[CORE] = core.as_mut_ptr();
        for (f, &slot) in layout.slots.iter().enumerate() {
            let (row, behind) = rest.split_at_mut(layout.padded(node, f));
            row.fill(T::ZERO);
            buffers[slot] = row.as_mut_ptr();
            rest = behind;
        }
        let fixed = layout.fixed.iter().map(|&(_, stride)| stride).collect();
        let addresses = Addresses { starts: [0; LANES], cell: node.core_size(), fixed, rows };
        Picked { node, layout, buffers, addresses }
    }
}

// SAFETY: pointers are those of buffers of the padded lengths.
unsafe impl<T: Real> Source<T> for Picked<'_, T> {
    #[inline(always)]
    fn addresses(&self) -> &Addresses {
        &self.addresses
    }

    #[inline(always)]
    unsafe fn choose<const W: usize>(&mut self, choice: &Offsets<W>) {
        let start = choice[CORE] as usize;
        let scale = T::from_f32(self.node.scale[start / self.addresses.cell]);
        // SAFETY: the buffers hold a block and padded rows, and nobody else refers to them while this runs.
        let buffer = |slot: usize, length: usize| unsafe { std::slice::from_raw_parts_mut(self.buffers[slot], length) };
        let block = buffer(CORE, self.layout.block());
        self.layout.arrange(&self.node.core[start..], block, T::ZERO, |bits| T::widen(bits) * scale);
        for ((&n, &slot), &rank) in self.layout.free.iter().zip(&self.layout.slots).zip(&self.addresses.rows) {
            widen_all(&self.node.basis[n][choice[slot] as usize..][..rank], buffer(slot, rank));
        }
    }

    #[inline(always)]
    unsafe fn numbers<const W: usize>(&self, slot: usize, _: &Offsets<W>) -> *const T {
        self.buffers[slot]
    }
}
