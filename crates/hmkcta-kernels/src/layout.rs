//! How the numbers of a node are laid out while elements are decoded: one mode, padded, runs along the lanes, or two.

use crate::packed::{MOST_MODES, NodeView};

/// What a choice of clusters needs: the core, and a basis row of each decomposed mode. Those of `HEADS` are contracted one
/// after the other, the last of these modes first; `BESIDE` and `VECTOR` run along lanes.
pub const CORE: usize = 0;
pub const OUTER: usize = 1;
pub const MID: usize = 2;
pub const INNER: usize = 3;
pub const BESIDE: usize = 4;
pub const VECTOR: usize = 5;
const HEADS: [usize; MOST_MODES - 1] = [INNER, MID, OUTER, 6, 7, 8, 9];
/// Slots, of which one vector of offsets holds so many.
const FEW: usize = 8;
/// The most lanes and slots there are.
pub const LANES: usize = 16;
const PADDING: u32 = u32::MAX;

/// The order in which a core is contracted, and how it is padded.
pub struct Layout {
    /// Decomposed modes, ascending.
    pub free: Vec<usize>,
    /// The slot of each of them.
    pub slots: Vec<usize>,
    /// Where there are more than three heads, slots and ranks of all but the last two, ascending: their products stand for
    /// the row of the outer one.
    pub more: Vec<(usize, usize)>,
    /// Lengths of the loops over heads, the outer one first.
    pub ranks: [usize; 3],
    /// Whether there is a mode of rank two beside that of the lanes, which fills four of eight.
    pub beside: bool,
    /// The rank of the lanes' mode, which is the largest, padded to whole vectors.
    pub row: usize,
    /// Numbers along the lanes: those of a row, or of all products with the two beside it.
    pub width: usize,
    /// Undecomposed modes with the stride of their position in the stored core, ascending.
    pub fixed: Vec<(usize, usize)>,
    /// For each number of a padded core with its undecomposed modes fixed, where it stands in the stored core; padding has none.
    index: Vec<u32>,
}

impl Layout {
    pub fn new(node: &NodeView) -> Layout {
        let order = node.order;
        let free: Vec<usize> = node.free().collect();
        let stride = |n: usize| node.ranks[n + 1..order].iter().product::<usize>();
        let rank_of = |f: usize| node.ranks[free[f]];
        let vector = (0..free.len()).max_by_key(|&f| rank_of(f));
        let rank = vector.map_or(1, rank_of);
        let row = match rank {
            _ if free.len() + 2 > FEW => rank.next_multiple_of(LANES),
            0..=4 => 4,
            5..=8 => 8,
            _ => rank.next_multiple_of(LANES),
        };
        let beside = (0..free.len()).rev().find(|&f| row == 4 && Some(f) != vector && rank_of(f) == 2);
        let heads: Vec<usize> = (0..free.len()).filter(|&f| Some(f) != vector && Some(f) != beside).collect();
        let mut starts = vec![0];
        for &f in heads.iter().chain(&beside) {
            let step = stride(free[f]);
            starts = starts.iter().flat_map(|at| (0..rank_of(f)).map(move |r| at + r * step)).collect();
        }
        let step = vector.map_or(0, |f| stride(free[f]));
        let line = |at: usize| (0..row).map(move |r| if r < rank { (at + r * step) as u32 } else { PADDING });
        let index = starts.iter().flat_map(|&at| line(at)).collect();
        let slot = |f: usize| match heads.iter().rev().position(|&head| head == f) {
            Some(back) => HEADS[back],
            None if beside == Some(f) => BESIDE,
            None => VECTOR,
        };
        let rank_of_head = |back: usize| heads.len().checked_sub(back).map_or(1, |at| rank_of(heads[at]));
        let first = &heads[..heads.len().saturating_sub(2)];
        Layout {
            slots: (0..free.len()).map(slot).collect(),
            more: if first.len() > 1 { first.iter().map(|&f| (slot(f), rank_of(f))).collect() } else { vec![] },
            ranks: [first.iter().map(|&f| rank_of(f)).product(), rank_of_head(2), rank_of_head(1)],
            beside: beside.is_some(),
            row,
            width: if beside.is_some() { 2 * row } else { row },
            fixed: (0..order).filter(|&n| !node.decomposed[n]).map(|n| (n, stride(n))).collect(),
            index,
            free,
        }
    }

    /// Numbers of a padded core with its undecomposed modes fixed.
    #[inline(always)]
    pub fn block(&self) -> usize {
        self.index.len()
    }

    /// Numbers of a row of decomposed mode number `f`, padded.
    pub fn padded(&self, node: &NodeView, f: usize) -> usize {
        if self.slots[f] == VECTOR { self.row } else { node.ranks[self.free[f]] }
    }

    /// Where the blocks of one stored core start.
    pub fn stored_starts(&self, node: &NodeView) -> Vec<usize> {
        let mut starts = vec![0];
        for &(n, stride) in &self.fixed {
            starts = starts.iter().flat_map(|at| (0..node.rows[n]).map(move |i| at + i * stride)).collect();
        }
        starts
    }

    /// One block from a core, zeros in its padding.
    #[inline(always)]
    pub fn arrange<F: Copy, T>(&self, core: &[F], block: &mut [T], zero: T, convert: impl Fn(F) -> T)
    where
        T: Copy,
    {
        for (to, &at) in block.iter_mut().zip(&self.index) {
            *to = if at == PADDING { zero } else { convert(core[at as usize]) };
        }
    }
}
