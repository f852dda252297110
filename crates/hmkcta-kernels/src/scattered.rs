//! Scattered elements: batches of them walk down the tree level by level, sorted by node, so that neighbours share what
//! is in the cache. The twin of `hmkcta.decode.scattered`.

use crate::element::{Decode, Elements};
use crate::packed::{Level, MOST_MODES, Node, NodeView, Position};
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
    for_each(true, tasks, |((coords, out), result)| *result = Batch::new(out).walk(levels, coords, order));
    results.into_iter().collect()
}

struct Batch<'b, T> {
    out: &'b mut [T],
    elements: Elements<T>,
    /// What one node gives its elements.
    values: Vec<T>,
}

/// Elements that go on, in the order of their nodes.
#[derive(Default)]
struct Walkers {
    /// The present node of each.
    node: Vec<u32>,
    /// Its position there.
    pos: Vec<Position>,
    /// Its number in the batch.
    number: Vec<u32>,
}

impl<'b, T: Decode> Batch<'b, T> {
    fn new(out: &'b mut [T]) -> Self {
        Batch { out, elements: Elements::default(), values: vec![] }
    }

    fn walk(mut self, levels: &[Level], coords: &[i64], order: usize) -> Result<(), String> {
        let (mut present, mut next, mut keys) = (Walkers::all(coords, order), Walkers::default(), vec![]);
        for (depth, level) in levels.iter().enumerate() {
            next.clear();
            let mut from = 0;
            for group in present.node.chunk_by(|a, b| a == b) {
                let range = from..from + group.len();
                from = range.end;
                let s = group[0] as usize;
                let clusters = match level.node(s)? {
                    Node::Empty => continue,
                    Node::Cut(clusters) => clusters,
                    Node::Cells(node) => {
                        self.add(&node, &present.pos[range.clone()], &present.number[range.clone()])?;
                        node.clusters
                    }
                };
                if depth + 1 < levels.len() {
                    let (pos, number) = (&present.pos[range.clone()], &present.number[range]);
                    next.descend((level, &levels[depth + 1]), s, &clusters, pos, number)?;
                }
            }
            next.sort(&mut keys, &mut present);
        }
        Ok(())
    }

    /// Add what a node gives its elements.
    fn add(&mut self, node: &NodeView, pos: &[Position], number: &[u32]) -> Result<(), String> {
        self.values.clear();
        self.values.resize(pos.len(), T::ZERO);
        self.elements.add(node, pos, &mut self.values)?;
        for (&number, &value) in number.iter().zip(&self.values) {
            let out = &mut self.out[number as usize];
            *out = *out + value;
        }
        Ok(())
    }
}

impl Walkers {
    /// The elements at `coords` `[elements, N]`, at the root.
    fn all(coords: &[i64], order: usize) -> Walkers {
        let position = |coords: &[i64]| std::array::from_fn(|n| coords.get(n).map_or(0, |&i| i as u32));
        let pos: Vec<Position> = coords.chunks_exact(order).map(position).collect();
        Walkers { node: vec![0; pos.len()], number: (0..pos.len() as u32).collect(), pos }
    }

    fn clear(&mut self) {
        self.node.clear();
        self.pos.clear();
        self.number.clear();
    }

    /// Take up the elements of node `s`, at their child node and position in it; those of a leaf stop.
    fn descend(
        &mut self,
        levels: (&Level, &Level),
        s: usize,
        clusters: &[usize; MOST_MODES],
        pos: &[Position],
        number: &[u32],
    ) -> Result<(), String> {
        let (level, below) = levels;
        let Some(first) = level.first_child(s, clusters, below)? else { return Ok(()) };
        let ways = (0..level.order()).map(|n| level.way_down(s, n)).collect::<Result<Vec<_>, _>>()?;
        self.number.extend_from_slice(number);
        for &pos in pos {
            let (mut flat, mut inside) = (0, pos);
            for ((way, clusters), position) in ways.iter().zip(clusters).zip(&mut inside) {
                let (part, local) = way.of(*position)?;
                if part >= *clusters {
                    return Err(format!("node {s} has no part {part}"));
                }
                flat = flat * clusters + part;
                *position = local;
            }
            self.node.push(u32::try_from(first + flat).map_err(|_| format!("node {s} has no child {flat}"))?);
            self.pos.push(inside);
        }
        Ok(())
    }

    /// Into the order of their nodes, as `sorted`; `keys` is a buffer.
    fn sort(&mut self, keys: &mut Vec<u64>, sorted: &mut Walkers) {
        if self.node.is_sorted() {
            return std::mem::swap(self, sorted);
        }
        keys.clear();
        keys.extend(self.node.iter().zip(0u64..).map(|(&node, at)| u64::from(node) << 32 | at));
        keys.sort_unstable();
        let order = || keys.iter().map(|key| (key & 0xffff_ffff) as usize);
        sorted.clear();
        sorted.node.extend(keys.iter().map(|key| (key >> 32) as u32));
        sorted.pos.extend(order().map(|at| self.pos[at]));
        sorted.number.extend(order().map(|at| self.number[at]));
    }
}
