//! A tensor of which several threads change elements at a time, each those of cells of its own.
//!
//! Rows of the blocks of two cells lie in the same stretches of the tensor, so that it cannot be cut into slices, one for
//! each thread. Which elements a thread may use is left to those who share the cells out.

use crate::block::Block;
use std::marker::PhantomData;

/// The elements of a tensor, lent as long as it lives.
#[derive(Clone, Copy)]
pub struct Shared<'a> {
    start: *mut f32,
    length: usize,
    tensor: PhantomData<&'a mut [f32]>,
}

// SAFETY: elements are reached through unsafe functions alone, whose callers see to it that no two threads use the same.
unsafe impl Send for Shared<'_> {}
// SAFETY: as above.
unsafe impl Sync for Shared<'_> {}

impl<'a> Shared<'a> {
    pub fn new(tensor: &'a mut [f32]) -> Self {
        Shared { start: tensor.as_mut_ptr(), length: tensor.len(), tensor: PhantomData }
    }

    /// All elements.
    ///
    /// # Safety
    /// Nobody else uses any of them while the slice lives.
    pub unsafe fn all(self) -> &'a mut [f32] {
        // SAFETY: start and length are those of a slice, and the caller has it alone.
        unsafe { std::slice::from_raw_parts_mut(self.start, self.length) }
    }

    /// Where the elements from one on lie. What is there must be shared out as for the other functions.
    pub fn place(self, at: usize) -> *mut f32 {
        assert!(at <= self.length);
        self.start.wrapping_add(at)
    }

    /// Where so many elements from one on lie, all inside; they must be shared out as for the other functions.
    #[inline(always)]
    pub fn within(self, at: usize, count: usize) -> *mut f32 {
        assert!(count <= self.length && at <= self.length - count);
        self.start.wrapping_add(at)
    }

    /// Copy the elements of some of a block's `tuples` of leading rows.
    ///
    /// # Safety
    /// Nobody writes to them meanwhile.
    pub unsafe fn copy(self, block: &Block, tuples: &[usize], slab: &mut [f32]) {
        for (&tuple, row) in tuples.iter().zip(slab.chunks_exact_mut(block.pick.len())) {
            // SAFETY: `stride` gives a place with all elements of the pick, and the caller keeps writers away.
            unsafe { block.pick.copy_from(self.stride(block, tuple), row) };
        }
    }

    /// Put a slab in their place.
    ///
    /// # Safety
    /// Nobody else uses them meanwhile.
    pub unsafe fn put(self, block: &Block, tuples: &[usize], slab: &[f32]) {
        for (&tuple, row) in tuples.iter().zip(slab.chunks_exact(block.pick.len())) {
            // SAFETY: `stride` gives a place with all elements of the pick, which the caller has alone.
            unsafe { block.pick.put_into(self.stride(block, tuple), row) };
        }
    }

    /// Add a slab to them.
    ///
    /// # Safety
    /// Nobody else uses them meanwhile.
    pub unsafe fn add(self, block: &Block, tuples: &[usize], slab: &[f32]) {
        for (&tuple, row) in tuples.iter().zip(slab.chunks_exact(block.pick.len())) {
            // SAFETY: as in `put`.
            unsafe { block.pick.add_into(self.stride(block, tuple), row) };
        }
    }

    /// Where the elements of a tuple of leading rows start: `block.stride` of them, which the pick does not leave.
    fn stride(self, block: &Block, tuple: usize) -> *mut f32 {
        assert!((tuple + 1) * block.stride <= self.length && block.pick.end() <= block.stride);
        self.start.wrapping_add(tuple * block.stride)
    }
}
