//! How the numbers of a node are laid out while elements are decoded: one mode, padded, runs along the lanes.

use crate::packed::{MOST_MODES, NodeView};

/// More entries than an element's choice of clusters needs: the cell, and a basis row of each mode.
pub const LANES: usize = 16;
/// The last of them, always zero.
pub const NOWHERE: usize = LANES - 1;
const PADDING: u32 = u32::MAX;

/// What a choice of clusters leads to: the cell's number, then where each decomposed mode's basis row starts.
pub type Offsets = [u32; LANES];

/// The order in which a core is contracted: undecomposed modes select, `heads` are summed, `vector` runs along lanes.
pub struct Layout {
    /// Decomposed modes, ascending.
    pub free: Vec<usize>,
    /// The places in `free` of the last three of the other modes, if there are so many, in the order of the loops.
    pub loops: [Option<usize>; 3],
    /// Where there are more than three, all but the last two with their ranks: their products stand for the first loop.
    pub more: Vec<(usize, usize)>,
    /// Lengths of the loops.
    pub ranks: [usize; 3],
    /// The place in `free` of the decomposed mode of the largest rank; None if there is none.
    pub vector: Option<usize>,
    /// Its rank, padded to whole vectors.
    pub width: usize,
    /// For each number of a padded core with its undecomposed modes fixed, where it stands in the stored core; padding has none.
    index: Vec<u32>,
    /// Undecomposed modes with the stride of their position in the stored core, ascending.
    fixed: Vec<(usize, usize)>,
}

impl Layout {
    pub fn new(node: &NodeView) -> Layout {
        let order = node.order;
        let free: Vec<usize> = node.free().collect();
        let stride = |n: usize| node.ranks[n + 1..order].iter().product::<usize>();
        let vector = (0..free.len()).max_by_key(|&f| node.ranks[free[f]]);
        let heads: Vec<usize> = (0..free.len()).filter(|&f| Some(f) != vector).collect();
        let rank = vector.map_or(1, |f| node.ranks[free[f]]);
        let width = match rank {
            0..=4 => 4,
            5..=8 => 8,
            _ => rank.next_multiple_of(LANES),
        };
        let mut starts = vec![0];
        for &f in &heads {
            let n = free[f];
            starts = starts.iter().flat_map(|at| (0..node.ranks[n]).map(move |r| at + r * stride(n))).collect();
        }
        let step = vector.map_or(0, |f| stride(free[f]));
        let line = |at: usize| (0..width).map(move |r| if r < rank { (at + r * step) as u32 } else { PADDING });
        let index: Vec<u32> = starts.iter().flat_map(|&at| line(at)).collect();
        let fixed = (0..order).filter(|&n| !node.decomposed[n]).map(|n| (n, stride(n))).collect();
        let back = |back: usize| heads.len().checked_sub(back).map(|at| heads[at]);
        let rank_of = |f: &usize| node.ranks[free[*f]];
        let first = &heads[..heads.len().saturating_sub(2)];
        let ranks = [
            first.iter().map(rank_of).product(),
            back(2).map_or(1, |f| rank_of(&f)),
            back(1).map_or(1, |f| rank_of(&f)),
        ];
        let more = if first.len() > 1 { first.iter().map(|f| (*f, rank_of(f))).collect() } else { vec![] };
        Layout { loops: [back(3), back(2), back(1)], more, ranks, free, vector, width, index, fixed }
    }

    /// Numbers of a padded core with its undecomposed modes fixed.
    #[inline(always)]
    pub fn block(&self) -> usize {
        self.index.len()
    }

    /// Where the stored core of an element begins whose undecomposed modes have these positions.
    #[inline(always)]
    pub fn stored_start(&self, pos: &[u32]) -> usize {
        self.fixed.iter().map(|&(n, stride)| pos[n] as usize * stride).sum()
    }

    /// Which of the blocks of a core it is.
    #[inline(always)]
    pub fn block_number(&self, node: &NodeView, pos: &[u32]) -> usize {
        self.fixed.iter().fold(0, |at, &(n, _)| at * node.rows[n] + pos[n] as usize)
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

    /// Numbers that a row of each decomposed mode takes.
    pub fn row_lengths(&self, node: &NodeView, padded: bool) -> [usize; MOST_MODES] {
        let mut lengths = [0; MOST_MODES];
        for (f, &n) in self.free.iter().enumerate() {
            lengths[f] = if padded && Some(f) == self.vector { self.width } else { node.ranks[n] };
        }
        lengths
    }
}

/// What the row and the cluster subsets of one element add to its offsets.
pub struct Steps {
    /// For each decomposed mode, k and c_n, `[F, K_n, C_n]`.
    by_cluster: Vec<Vec<Offsets>>,
    /// For each decomposed mode, what one row further adds.
    by_row: Vec<Offsets>,
}

impl Steps {
    pub fn new(node: &NodeView, layout: &Layout, lengths: &[usize; MOST_MODES]) -> Steps {
        let of_mode = |(f, &n): (usize, &usize)| {
            let stride: usize = node.clusters[n + 1..node.order].iter().product();
            let mut step = [0; LANES];
            step[0] = stride as u32;
            for (g, &m) in layout.free.iter().enumerate().filter(|&(g, _)| g != f) {
                // flat(c_-m) leaves mode m out.
                let without = if m > n { stride / node.clusters[m] } else { stride };
                step[g + 1] = (without * lengths[g]) as u32;
            }
            let choice = (node.others(n) * lengths[f]) as u32;
            let choices = (0..node.mixture[n] as u32).flat_map(|k| (0..node.clusters[n] as u32).map(move |c| (k, c)));
            let steps = choices.map(|(k, c)| {
                let mut step = step.map(|s| s.wrapping_mul(c));
                step[f + 1] = k.wrapping_mul(choice);
                step
            });
            let mut row = [0; LANES];
            row[f + 1] = choice.wrapping_mul(node.mixture[n] as u32);
            (steps.collect(), row)
        };
        let (by_cluster, by_row) = layout.free.iter().enumerate().map(of_mode).unzip();
        Steps { by_cluster, by_row }
    }

    /// The offsets of all choices of clusters of the element at `pos`, into `choices`, prod K_n of them.
    #[inline(always)]
    pub fn choices(
        &self,
        node: &NodeView,
        layout: &Layout,
        pos: &[u32],
        choices: &mut [Offsets],
    ) -> Result<(), String> {
        let mut first = [0u32; LANES];
        for (&n, row) in layout.free.iter().zip(&self.by_row) {
            add(&mut first, row, pos[n]);
        }
        choices[0] = first;
        let mut count = 1;
        for (&n, steps) in layout.free.iter().zip(&self.by_cluster) {
            let (position, mixture) = (pos[n] as usize, node.mixture[n]);
            let subsets = node.cluster[n].get(position * mixture..(position + 1) * mixture);
            let Some(subsets) = subsets else { return Err(missing("row", position, n)) };
            // The first choice last: the others start from what it overwrites.
            for (k, &c) in subsets.iter().enumerate().rev() {
                let (c, clusters) = (usize::from(c), node.clusters[n]);
                let Some(step) = steps.get(k * clusters + c).filter(|_| c < clusters) else {
                    return Err(missing("cluster", c, n));
                };
                for at in 0..count {
                    let mut sum = choices[at];
                    add(&mut sum, step, 1);
                    choices[k * count + at] = sum;
                }
            }
            count *= mixture;
        }
        let outside = |&n: &usize| !node.decomposed[n] && pos[n] as usize >= node.rows[n];
        (0..node.order).find(outside).map_or(Ok(()), |n| Err(missing("row", pos[n] as usize, n)))
    }
}

/// `sum += times * step`
#[inline(always)]
fn add(sum: &mut Offsets, step: &Offsets, times: u32) {
    for l in 0..LANES {
        sum[l] = sum[l].wrapping_add(step[l].wrapping_mul(times));
    }
}

#[cold]
fn missing(what: &str, number: usize, n: usize) -> String {
    format!("a node has no {what} {number} in mode {}", n + 1)
}
