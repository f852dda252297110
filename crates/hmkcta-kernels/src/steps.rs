//! Where a choice of clusters finds its core and its basis rows: offsets that are summed up, mode by mode.

use crate::layout::{CORE, LANES, Layout};
use crate::packed::{NodeView, Position};

/// Where each slot of `Layout` starts for one choice of clusters.
pub type Offsets<const W: usize> = [u32; W];

/// Where a source keeps the numbers of a node.
pub struct Addresses {
    /// The block of the first cell, and the first row of each mode, by slot.
    pub starts: Offsets<LANES>,
    /// Numbers from one cell to the next.
    pub cell: usize,
    /// Numbers from one position to the next of each undecomposed mode.
    pub fixed: Vec<usize>,
    /// Numbers of a row of each decomposed mode.
    pub rows: Vec<usize>,
}

/// What the row and the cluster subsets of one element add to its offsets.
pub struct Steps<'a, const W: usize> {
    starts: Offsets<W>,
    /// For each undecomposed mode: its number, rows, and what one row further adds to the offset of the core.
    fixed: Vec<(usize, usize, u32)>,
    free: Vec<Mode<'a, W>>,
}

/// One decomposed mode.
struct Mode<'a, const W: usize> {
    n: usize,
    /// K_n clusters of each row.
    subsets: &'a [u16],
    mixture: usize,
    clusters: usize,
    /// What one row further adds.
    by_row: Offsets<W>,
    /// For each k and c_n, `[K_n, C_n]`.
    by_cluster: Vec<Offsets<W>>,
}

impl<'a, const W: usize> Steps<'a, W> {
    pub fn new(node: &NodeView<'a>, layout: &Layout, addresses: &Addresses) -> Steps<'a, W> {
        assert!(layout.slots.iter().all(|&slot| slot < W));
        let of_mode = |(f, &n): (usize, &usize)| {
            let stride: usize = node.clusters[n + 1..node.order].iter().product();
            let mut step = [0; W];
            step[CORE] = (stride * addresses.cell) as u32;
            for (g, &m) in layout.free.iter().enumerate().filter(|&(g, _)| g != f) {
                // flat(c_-m) leaves mode m out.
                let without = if m > n { stride / node.clusters[m] } else { stride };
                step[layout.slots[g]] = (without * addresses.rows[g]) as u32;
            }
            let slot = layout.slots[f];
            let choice = (node.others(n) * addresses.rows[f]) as u32;
            let choices = (0..node.mixture[n] as u32).flat_map(|k| (0..node.clusters[n] as u32).map(move |c| (k, c)));
            let by_cluster = choices.map(|(k, c)| {
                let mut step = step.map(|s| s.wrapping_mul(c));
                step[slot] = k.wrapping_mul(choice);
                step
            });
            let mut by_row = [0; W];
            by_row[slot] = choice.wrapping_mul(node.mixture[n] as u32);
            let (subsets, mixture, clusters) = (node.cluster[n], node.mixture[n], node.clusters[n]);
            Mode { n, subsets, mixture, clusters, by_row, by_cluster: by_cluster.collect() }
        };
        Steps {
            starts: std::array::from_fn(|slot| addresses.starts[slot]),
            fixed: layout
                .fixed
                .iter()
                .zip(&addresses.fixed)
                .map(|(&(n, _), &step)| (n, node.rows[n], step as u32))
                .collect(),
            free: layout.free.iter().enumerate().map(of_mode).collect(),
        }
    }

    /// The offsets of all choices of clusters of the element at `pos`, into `choices`, prod K_n of them.
    #[inline(always)]
    pub fn choices(&self, pos: &Position, choices: &mut [Offsets<W>]) -> Result<(), String> {
        let mut first = self.starts;
        for &(n, rows, step) in &self.fixed {
            if pos[n] as usize >= rows {
                return Err(missing("row", pos[n] as usize, n));
            }
            first[CORE] = first[CORE].wrapping_add(step.wrapping_mul(pos[n]));
        }
        for mode in &self.free {
            first = sum(first, mode.by_row.map(|step| step.wrapping_mul(pos[mode.n])));
        }
        choices[0] = first;
        let mut count = 1;
        for mode in &self.free {
            let subsets = mode.subsets(pos)?;
            let (begun, new) = choices.split_at_mut(count);
            if let &[first, second] = subsets {
                // What is most common takes half as long so.
                let (first, second) = (mode.step(0, first)?, mode.step(1, second)?);
                for (begun, new) in begun.iter_mut().zip(new) {
                    *new = sum(*begun, *second);
                    *begun = sum(*begun, *first);
                }
            } else {
                // The first choice last: the others start from what it overwrites.
                for (new, k) in new.chunks_exact_mut(count).zip(1..mode.mixture) {
                    let step = mode.step(k, subsets[k])?;
                    new.iter_mut().zip(begun.iter()).for_each(|(new, begun)| *new = sum(*begun, *step));
                }
                let step = mode.step(0, subsets[0])?;
                begun.iter_mut().for_each(|begun| *begun = sum(*begun, *step));
            }
            count *= mode.mixture;
        }
        Ok(())
    }
}

impl<const W: usize> Mode<'_, W> {
    /// The clusters of an element's row.
    #[inline(always)]
    fn subsets(&self, pos: &Position) -> Result<&[u16], String> {
        let position = pos[self.n] as usize;
        let subsets = self.subsets.get(position * self.mixture..(position + 1) * self.mixture);
        subsets.ok_or_else(|| missing("row", position, self.n))
    }

    /// What cluster `c` as choice `k` adds.
    #[inline(always)]
    fn step(&self, k: usize, c: u16) -> Result<&Offsets<W>, String> {
        let c = usize::from(c);
        let step = self.by_cluster.get(k * self.clusters + c).filter(|_| c < self.clusters);
        step.ok_or_else(|| missing("cluster", c, self.n))
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
