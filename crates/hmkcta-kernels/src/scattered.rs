//! Scattered elements: batches of them walk down the tree level by level, sorted by node, so that neighbours share what
//! is in the cache. The twin of `hmkcta.decode_scattered`.

use crate::element::{Decode, Elements};
use crate::packed::{Level, NodeView, Position};
use crate::threads::{count, for_each};

/// Elements walked together at most: the more, the more share what is widened of a node; some 90 bytes each and thread.
const BATCH: usize = 1 << 18;
/// So few are not worth a task of their own.
const FEW: usize = 1 << 11;

/// Add the values of the elements at `coords` `[elements, N]` to `out`.
pub fn decode<T: Decode>(levels: &[Level], coords: &[i64], out: &mut [T]) -> Result<(), String> {
    let order = levels.first().map_or(1, Level::order);
    let batch = out.len().div_ceil(count()).clamp(FEW, BATCH);
    let mut results: Vec<Result<(), String>> = vec![Ok(()); out.len().div_ceil(batch)];
    let tasks: Vec<_> = coords.chunks(batch * order).zip(out.chunks_mut(batch)).zip(&mut results).collect();
    for_each(true, tasks, |((coords, out), result)| *result = Batch::new(coords, order, out).walk(levels));
    results.into_iter().collect()
}

struct Batch<'b, T> {
    /// Of each element in its present node.
    pos: Vec<Position>,
    out: &'b mut [T],
    elements: Elements<T>,
    /// Positions and values of one group.
    group: (Vec<Position>, Vec<T>),
}

impl<'b, T: Decode> Batch<'b, T> {
    fn new(coords: &[i64], order: usize, out: &'b mut [T]) -> Self {
        let position = |coords: &[i64]| std::array::from_fn(|n| coords.get(n).map_or(0, |&i| i as u32));
        let pos = coords.chunks_exact(order).map(position).collect();
        Batch { pos, out, elements: Elements::default(), group: (vec![], vec![]) }
    }

    fn walk(mut self, levels: &[Level]) -> Result<(), String> {
        // Node and number of each element that goes on, to be sorted as one integer.
        let mut present: Vec<u64> = (0..self.out.len() as u64).collect();
        let mut next = vec![];
        for (depth, level) in levels.iter().enumerate() {
            next.clear();
            for group in present.chunk_by(|a, b| a >> 32 == b >> 32) {
                let s = (group[0] >> 32) as usize;
                let Some(node) = level.node(s)? else { continue };
                self.add(&node, group)?;
                if depth + 1 < levels.len() {
                    self.descend(level, s, &node, group, &mut next);
                }
            }
            next.sort_unstable();
            std::mem::swap(&mut present, &mut next);
        }
        Ok(())
    }

    /// Add what a node gives its elements.
    fn add(&mut self, node: &NodeView, group: &[u64]) -> Result<(), String> {
        let (pos, values) = &mut self.group;
        pos.clear();
        pos.extend(group.iter().map(|&item| self.pos[number(item)]));
        values.clear();
        values.resize(group.len(), T::ZERO);
        self.elements.add(node, pos, values)?;
        for (&item, &value) in group.iter().zip(values.iter()) {
            let out = &mut self.out[number(item)];
            *out = *out + value;
        }
        Ok(())
    }

    /// Child node and position in it of the elements of node `s`; those of a leaf stop.
    fn descend(&mut self, level: &Level, s: usize, node: &NodeView, group: &[u64], next: &mut Vec<u64>) {
        let Some(first) = level.first_child(s) else { return };
        for &item in group {
            let pos = &mut self.pos[number(item)][..node.order];
            let mut flat = 0;
            for (n, position) in pos.iter_mut().enumerate() {
                let (part, local) = level.way_down(s, n, *position);
                flat = flat * node.clusters[n] + part;
                *position = local;
            }
            next.push(((first + flat) as u64) << 32 | item & 0xffff_ffff);
        }
    }
}

/// Which element of the batch it is.
fn number(item: u64) -> usize {
    (item & 0xffff_ffff) as usize
}
