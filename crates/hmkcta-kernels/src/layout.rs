//! How the numbers of a node are laid out while elements are decoded: one mode, padded, runs along the lanes, or two.

use crate::packed::{MOST_MODES, NodeView, Position};

/// Where there is no row: modulo the number of offsets the last of them, always zero.
pub const NOWHERE: usize = usize::MAX;
/// Offsets that one vector holds.
const FEW: usize = 8;
/// The most lanes and offsets there are.
pub const LANES: usize = 16;
const PADDING: u32 = u32::MAX;

/// What a choice of clusters leads to: the cell's number, then where each decomposed mode's basis row starts.
pub type Offsets<const W: usize> = [u32; W];

/// The order in which a core is contracted: undecomposed modes select, those of `loops` and `more` are summed one after the
/// other, `beside` and `vector` run along lanes.
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
    /// The place in `free` of a mode of rank two that runs along eight lanes together with it, which fills four.
    pub beside: Option<usize>,
    /// The rank of `vector`, padded to whole vectors.
    pub row: usize,
    /// Numbers along the lanes: those of a row, or of all products with the two of `beside`.
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
        let rank_of = |f: &usize| node.ranks[free[*f]];
        let rank = vector.map_or(1, |f| rank_of(&f));
        let row = match rank {
            _ if free.len() + 2 > FEW => rank.next_multiple_of(LANES),
            0..=4 => 4,
            5..=8 => 8,
            _ => rank.next_multiple_of(LANES),
        };
        let beside = (0..free.len()).rev().find(|f| row == 4 && Some(*f) != vector && rank_of(f) == 2);
        let heads: Vec<usize> = (0..free.len()).filter(|&f| Some(f) != vector && Some(f) != beside).collect();
        let mut starts = vec![0];
        for f in heads.iter().chain(&beside) {
            let step = stride(free[*f]);
            starts = starts.iter().flat_map(|at| (0..rank_of(f)).map(move |r| at + r * step)).collect();
        }
        let step = vector.map_or(0, |f| stride(free[f]));
        let line = |at: usize| (0..row).map(move |r| if r < rank { (at + r * step) as u32 } else { PADDING });
        let index: Vec<u32> = starts.iter().flat_map(|&at| line(at)).collect();
        let fixed = (0..order).filter(|&n| !node.decomposed[n]).map(|n| (n, stride(n))).collect();
        let back = |back: usize| heads.len().checked_sub(back).map(|at| heads[at]);
        let first = &heads[..heads.len().saturating_sub(2)];
        let ranks = [
            first.iter().map(rank_of).product(),
            back(2).map_or(1, |f| rank_of(&f)),
            back(1).map_or(1, |f| rank_of(&f)),
        ];
        let more = if first.len() > 1 { first.iter().map(|f| (*f, rank_of(f))).collect() } else { vec![] };
        let width = beside.map_or(row, |_| 2 * row);
        Layout { loops: [back(3), back(2), back(1)], more, ranks, free, vector, beside, row, width, index, fixed }
    }

    /// Numbers of a padded core with its undecomposed modes fixed.
    #[inline(always)]
    pub fn block(&self) -> usize {
        self.index.len()
    }

    /// Where the stored core of an element begins whose undecomposed modes have these positions.
    #[inline(always)]
    pub fn stored_start(&self, pos: &Position) -> usize {
        self.fixed.iter().map(|&(n, stride)| pos[n] as usize * stride).sum()
    }

    /// Which of the blocks of a core it is.
    #[inline(always)]
    pub fn block_number(&self, node: &NodeView, pos: &Position) -> usize {
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
            lengths[f] = if padded && Some(f) == self.vector { self.row } else { node.ranks[n] };
        }
        lengths
    }
}

/// What the row and the cluster subsets of one element add to its offsets.
pub struct Steps<const W: usize> {
    /// For each decomposed mode, k and c_n, `[F, K_n, C_n]`.
    by_cluster: Vec<Vec<Offsets<W>>>,
    /// For each decomposed mode, what one row further adds.
    by_row: Vec<Offsets<W>>,
}

impl<const W: usize> Steps<W> {
    pub fn new(node: &NodeView, layout: &Layout, lengths: &[usize; MOST_MODES]) -> Steps<W> {
        assert!(layout.free.len() + 2 <= W);
        let of_mode = |(f, &n): (usize, &usize)| {
            let stride: usize = node.clusters[n + 1..node.order].iter().product();
            let mut step = [0; W];
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
            let mut row = [0; W];
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
        pos: &Position,
        choices: &mut [Offsets<W>],
    ) -> Result<(), String> {
        for &(n, _) in &layout.fixed {
            if pos[n] as usize >= node.rows[n] {
                return Err(missing("row", pos[n] as usize, n));
            }
        }
        let mut first = [0u32; W];
        for (&n, row) in layout.free.iter().zip(&self.by_row) {
            first = sum(first, row.map(|step| step.wrapping_mul(pos[n])));
        }
        choices[0] = first;
        let mut count = 1;
        for (&n, steps) in layout.free.iter().zip(&self.by_cluster) {
            let (position, mixture, clusters) = (pos[n] as usize, node.mixture[n], node.clusters[n]);
            let subsets = node.cluster[n].get(position * mixture..(position + 1) * mixture);
            let Some(subsets) = subsets else { return Err(missing("row", position, n)) };
            let step = |k: usize| {
                let c = usize::from(subsets[k]);
                steps.get(k * clusters + c).filter(|_| c < clusters).ok_or_else(|| missing("cluster", c, n))
            };
            if mixture == 2 {
                // What is most common takes half as long so.
                let (first, second) = (*step(0)?, *step(1)?);
                let (begun, new) = choices.split_at_mut(count);
                for (begun, new) in begun.iter_mut().zip(new) {
                    *new = sum(*begun, second);
                    *begun = sum(*begun, first);
                }
            } else {
                // The first choice last: the others start from what it overwrites.
                for k in (0..mixture).rev() {
                    let step = *step(k)?;
                    for at in 0..count {
                        choices[k * count + at] = sum(choices[at], step);
                    }
                }
            }
            count *= mixture;
        }
        Ok(())
    }
}

#[inline(always)]
fn sum<const W: usize>(a: Offsets<W>, b: Offsets<W>) -> Offsets<W> {
    std::array::from_fn(|l| a[l].wrapping_add(b[l]))
}

#[cold]
fn missing(what: &str, number: usize, n: usize) -> String {
    format!("a node has no {what} {number} in mode {}", n + 1)
}
