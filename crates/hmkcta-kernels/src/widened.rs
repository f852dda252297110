//! Cores and basis rows of a node as floats: all of them, or what one choice of clusters needs at a time.

use crate::layout::{Layout, NOWHERE};
use crate::packed::{MOST_MODES, NodeView, Position};
use crate::real::{Real, widen_all};
use crate::threads::room;

/// Buffers for widened numbers.
#[derive(Default)]
pub struct Tables<T> {
    core: Vec<T>,
    bases: [Vec<T>; MOST_MODES],
    plain: Vec<T>,
}

/// Where the numbers of an element come from.
///
/// # Safety
/// Pointers are good for the block of `Layout` and for rows of the padded lengths, for every choice that
/// `Steps::choices` gives with the row lengths of this source.
pub unsafe trait Source<T> {
    /// Turn to an element, by its row positions, which `Steps::choices` has checked.
    fn element(&mut self, pos: &Position);

    /// Turn to one of its choices of clusters: the core, undecomposed modes fixed, in the order of `Layout`.
    ///
    /// # Safety
    /// The choice is one of `Steps::choices` for the element turned to.
    unsafe fn choose(&mut self, choice: &[u32]) -> *const T;

    /// Where the basis rows of decomposed mode number `f` are found: the pointer, and which of a choice's offsets counts
    /// from there.
    fn rows(&mut self, f: usize) -> (*const T, usize);
}

/// All numbers of a node.
pub struct Widened<'w, T> {
    node: &'w NodeView<'w>,
    layout: &'w Layout,
    core: &'w [T],
    bases: [&'w [T]; MOST_MODES],
    /// Numbers of a cell.
    stride: usize,
    /// The element's block of the first cell.
    start: *const T,
}

impl<'w, T: Real> Widened<'w, T> {
    #[inline(always)]
    pub fn new(node: &'w NodeView, layout: &'w Layout, tables: &'w mut Tables<T>) -> Self {
        let Tables { core, bases, plain } = tables;
        let starts = layout.stored_starts(node);
        let stored = room(plain, node.core.len());
        widen_all(node.core, stored);
        let core = room(core, node.cells() * starts.len() * layout.block());
        let mut blocks = core.chunks_exact_mut(layout.block());
        for cell in stored.chunks_exact(node.core_size()) {
            for (&start, block) in starts.iter().zip(&mut blocks) {
                layout.arrange(&cell[start..], block, T::ZERO, |x| x);
            }
        }
        for (f, &n) in layout.free.iter().enumerate() {
            let (stored, rank) = (node.basis[n], node.ranks[n]);
            if Some(f) != layout.vector || rank == layout.row {
                widen_all(stored, room(&mut bases[f], stored.len()));
                continue;
            }
            let numbers = room(plain, stored.len());
            widen_all(stored, numbers);
            let padded = room(&mut bases[f], stored.len() / rank * layout.row);
            for (row, to) in numbers.chunks_exact(rank).zip(padded.chunks_exact_mut(layout.row)) {
                to[..rank].copy_from_slice(row);
                to[rank..].fill(T::ZERO);
            }
        }
        let bases: [&[T]; MOST_MODES] = std::array::from_fn(|f| bases[f].as_slice());
        Widened { node, layout, core, bases, stride: starts.len() * layout.block(), start: core.as_ptr() }
    }
}

// SAFETY: `NodeView` has checked that the stored arrays are as long as the node's shape says, the widened ones have been
// made as long as padding needs, and `Steps::choices` gives offsets of clusters and rows that exist.
unsafe impl<T: Real> Source<T> for Widened<'_, T> {
    #[inline(always)]
    fn element(&mut self, pos: &Position) {
        self.start = self.core[self.layout.block_number(self.node, pos) * self.layout.block()..].as_ptr();
    }

    #[inline(always)]
    unsafe fn choose(&mut self, choice: &[u32]) -> *const T {
        unsafe { self.start.add(choice[0] as usize * self.stride) }
    }

    #[inline(always)]
    fn rows(&mut self, f: usize) -> (*const T, usize) {
        (self.bases[f].as_ptr(), f + 1)
    }
}

/// What one choice of clusters needs, widened for it.
pub struct Picked<'w, T> {
    node: &'w NodeView<'w>,
    layout: &'w Layout,
    core: &'w mut [T],
    /// For each decomposed mode, the buffer of one row.
    bases: [*mut T; MOST_MODES],
    start: usize,
}

impl<'w, T: Real> Picked<'w, T> {
    #[inline(always)]
    pub fn new(node: &'w NodeView, layout: &'w Layout, tables: &'w mut Tables<T>) -> Self {
        let mut lengths = layout.row_lengths(node, true).into_iter();
        let Tables { core, bases, .. } = tables;
        let bases = bases.each_mut().map(|basis| {
            let row = room(basis, lengths.next().unwrap_or(0));
            row.fill(T::ZERO);
            row.as_mut_ptr()
        });
        Picked { node, layout, core: room(core, layout.block()), bases, start: 0 }
    }
}

// SAFETY: pointers are those of buffers of the padded lengths.
unsafe impl<T: Real> Source<T> for Picked<'_, T> {
    #[inline(always)]
    fn element(&mut self, pos: &Position) {
        self.start = self.layout.stored_start(pos);
    }

    #[inline(always)]
    unsafe fn choose(&mut self, choice: &[u32]) -> *const T {
        let stored = &self.node.core[choice[0] as usize * self.node.core_size() + self.start..];
        self.layout.arrange(stored, self.core, T::ZERO, T::widen);
        for (f, &n) in self.layout.free.iter().enumerate() {
            let rank = self.node.ranks[n];
            let stored = &self.node.basis[n][choice[f + 1] as usize..][..rank];
            // SAFETY: the buffer holds a padded row, and nobody else refers to it while this runs.
            unsafe { widen_all(stored, std::slice::from_raw_parts_mut(self.bases[f], rank)) };
        }
        self.core.as_ptr()
    }

    #[inline(always)]
    fn rows(&mut self, f: usize) -> (*const T, usize) {
        (self.bases[f], NOWHERE)
    }
}
