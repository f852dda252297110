//! How the block of one cell is cut: into slabs of its leading modes, and its modes into two halves.

use crate::cells::{Cell, Node};
use crate::pick::{Pick, offsets};
use crate::threads::PARALLEL;

/// Elements of a slab, small enough for slab, model and what is projected from it to stay in a core's level 2 cache.
const SLAB: usize = 32 * 1024;
/// Rows a slab should have, up to eight times `SLAB`: each read of a long basis then serves that many rows.
const SLAB_ROWS: usize = 8;

/// Multiply-adds that the updates of modes take for each number of the projection they start from, roughly.
const UPDATES: f64 = 32.0;

/// The block of one cell and where its elements lie in the tensor.
pub struct Block {
    /// Member rows m_n of each mode.
    pub sizes: Vec<usize>,
    /// R_n, an undecomposed mode's being its size.
    pub ranks: Vec<usize>,
    /// Modes below `half` are updated with the others projected away, then the others.
    pub half: usize,
    /// Modes that are split among slabs; at most `half`.
    pub leading: usize,
    /// Where, in units of `stride`, each combination of leading rows starts in the tensor, ascending.
    pub tuples: Vec<usize>,
    /// Elements of the tensor for each combination of leading indices.
    pub stride: usize,
    /// The elements of the block among those.
    pub pick: Pick,
    /// Combinations of leading rows of a slab.
    pub group: usize,
    /// Whether it is the whole tensor.
    pub whole: bool,
    /// Whether several threads shall work on it.
    pub parallel: bool,
}

impl Block {
    /// The block of a cell that is not empty, and whether threads may share the work on it, if it is large.
    pub fn new(node: &Node, cell: &Cell, shared: bool) -> Block {
        let rows = node.cell_rows(cell);
        let sizes: Vec<usize> = rows.iter().map(|rows| rows.len()).collect();
        let ranks = node.ranks.clone();
        let half = choose_half(&sizes, &ranks, &node.undecomposed);
        let trailing = |leading: usize| -> usize { sizes[leading..].iter().product() };
        let leading = (1..half).find(|&leading| trailing(leading) <= 2 * SLAB).unwrap_or(half);
        let row = trailing(leading);
        let group = (SLAB / row).max(SLAB_ROWS.min(8 * SLAB / row)).max(1);
        Block {
            half,
            leading,
            tuples: offsets(&node.sizes[..leading], &rows[..leading], 1),
            stride: node.sizes[leading..].iter().product(),
            pick: Pick::new(&node.sizes[leading..], &rows[leading..]),
            group,
            whole: sizes == node.sizes,
            parallel: shared && trailing(0) >= PARALLEL,
            sizes,
            ranks,
        }
    }

    pub fn order(&self) -> usize {
        self.sizes.len()
    }

    /// Sizes of the block with the modes of one side of `split` still or already reduced to their ranks.
    pub fn mixed(&self, split: usize, reduced_first: bool) -> Vec<usize> {
        let size = |n: usize| if (n < split) == reduced_first { self.ranks[n] } else { self.sizes[n] };
        (0..self.order()).map(size).collect()
    }
}

/// Where to part the modes so that the two passes over the block, and what follows on its projections, cost least.
///
/// What is computed is the same wherever the modes are parted.
fn choose_half(sizes: &[usize], ranks: &[usize], undecomposed: &[bool]) -> usize {
    let order = sizes.len();
    let cost = |half: usize| -> f64 {
        let mut total = 0.0;
        for modes in [(half..order).collect::<Vec<_>>(), (0..half).rev().collect()] {
            let mut numbers = sizes.iter().product::<usize>() as f64;
            for n in modes.into_iter().filter(|&n| !undecomposed[n]) {
                let inner = sizes[half.max(n + 1)..].iter().product();
                total += numbers * ranks[n] as f64 / lanes_in_use(inner);
                numbers *= ranks[n] as f64 / sizes[n] as f64;
            }
            total += UPDATES * numbers;
        }
        total
    };
    (1..order).min_by(|&a, &b| cost(a).total_cmp(&cost(b))).unwrap_or(1)
}

/// The share of 16 lanes that rows of `inner` numbers keep busy; single numbers are summed along rows instead.
fn lanes_in_use(inner: usize) -> f64 {
    if inner == 1 { 0.5 } else { inner as f64 / (inner.div_ceil(16) * 16) as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_are_parted_where_it_costs_least() {
        assert_eq!(choose_half(&[35, 43, 43, 43], &[4; 4], &[false; 4]), 2);
        assert_eq!(choose_half(&[216, 25600], &[14; 2], &[false; 2]), 1);
        assert_eq!(choose_half(&[1], &[1], &[false]), 1);
        // With few numbers in the last mode the third would be projected by half-empty vectors.
        assert_eq!(choose_half(&[60, 60, 60, 3], &[4, 4, 4, 3], &[false, false, false, true]), 1);
    }
}
