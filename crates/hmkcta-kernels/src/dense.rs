//! Dense blocks: the elements of an outer product of row lists, node by node down the tree.
//! The twin of `hmkcta.decode.dense`.
//!
//! The block is cut into runs of its leading indices, for threads to share. Within a run a node adds its part as the
//! fitting kernels do it, or element by element where that is less work.

use crate::element::Elements;
use crate::packed::{Level, NodeView};
use crate::part::{Part, Requested};
use crate::sizes::zeros;
use crate::threads::for_each;

/// Elements of a run: many, since each run widens the numbers of its nodes for itself.
const SMALLEST: usize = 1 << 22;
const LARGEST: usize = 1 << 26;
/// Runs that a block is cut into, sizes permitting.
const RUNS: usize = 16;
/// Elements that a node puts together before they are added to the block.
const TOGETHER: usize = 1 << 21;

/// Add the block of the outer product of `rows`, one list a mode, to `out`; levels before `first` add nothing.
pub fn decode(levels: &[Level], rows: &[&[i64]], first: usize, out: &mut [f32]) -> Result<(), String> {
    let sizes: Vec<usize> = rows.iter().map(|rows| rows.len()).collect();
    let limit = (out.len() / RUNS).clamp(SMALLEST, LARGEST);
    let runs = runs(&sizes, limit);
    let mut results: Vec<Result<(), String>> = vec![Ok(()); runs.len()];
    let mut rest = out;
    let mut tasks = vec![];
    for (run, result) in runs.into_iter().zip(&mut results) {
        let (out, left) = rest.split_at_mut(run.iter().map(|&(from, to)| to - from).product());
        rest = left;
        tasks.push((run, out, result));
    }
    for_each(true, tasks, |(run, out, result)| {
        let requested: Vec<Requested> = run
            .iter()
            .zip(rows)
            .map(|(&(from, to), rows)| Requested {
                pos: rows[from..to].iter().map(|&i| i as u32).collect(),
                place: (0..(to - from) as u32).collect(),
            })
            .collect();
        let sizes = run.iter().map(|&(from, to)| to - from).collect();
        let mut walk = Walk { levels, first, sizes, out, elements: Elements::default() };
        *result = walk.node(0, 0, &requested.iter().collect::<Vec<_>>());
    });
    results.into_iter().collect()
}

/// Cut an outer product into parts of up to `limit` elements that lie one behind the other in C order.
fn runs(sizes: &[usize], limit: usize) -> Vec<Vec<(usize, usize)>> {
    let mut axis = 0;
    while axis + 1 < sizes.len() && sizes[axis + 1..].iter().product::<usize>() > limit {
        axis += 1;
    }
    let length = (limit / sizes[axis + 1..].iter().product::<usize>().max(1)).max(1);
    let count: usize = sizes[..axis].iter().product();
    let mut all = vec![];
    for number in 0..count {
        let mut lead = vec![];
        let mut rest = number;
        for &size in sizes[..axis].iter().rev() {
            lead.push((rest % size, rest % size + 1));
            rest /= size;
        }
        lead.reverse();
        for from in (0..sizes[axis]).step_by(length) {
            let mut run = lead.clone();
            run.push((from, sizes[axis].min(from + length)));
            run.extend(sizes[axis + 1..].iter().map(|&size| (0, size)));
            all.push(run);
        }
    }
    all
}

/// One run on its way down the tree.
struct Walk<'w> {
    levels: &'w [Level<'w>],
    first: usize,
    sizes: Vec<usize>,
    out: &'w mut [f32],
    elements: Elements<f32>,
}

impl Walk<'_> {
    /// Add a node and all below it for the requested rows, of which every mode has some.
    fn node(&mut self, depth: usize, s: usize, requested: &[&Requested]) -> Result<(), String> {
        let level = &self.levels[depth];
        let Some(node) = level.node(s)? else { return Ok(()) };
        if depth >= self.first {
            self.add(&node, requested)?;
        }
        let Some(first) = level.first_child(s).filter(|_| depth + 1 < self.levels.len()) else { return Ok(()) };
        let parts: Vec<Vec<Requested>> =
            (0..node.order).map(|n| split(level, s, n, node.clusters[n], requested[n])).collect::<Result<_, _>>()?;
        for flat in 0..node.cells() {
            let mut rest = flat;
            let mut chosen = vec![];
            for (n, parts) in parts.iter().enumerate().rev() {
                chosen.push(&parts[rest % node.clusters[n]]);
                rest /= node.clusters[n];
            }
            chosen.reverse();
            if chosen.iter().all(|part| !part.pos.is_empty()) {
                self.node(depth + 1, first + flat, &chosen)?;
            }
        }
        Ok(())
    }

    fn add(&mut self, node: &NodeView, requested: &[&Requested]) -> Result<(), String> {
        let part = Part { node, requested };
        if part.single_elements_pay() {
            return part.add_elements(&self.sizes, self.out, &mut self.elements);
        }
        if part.covers(&self.sizes) {
            return part.accumulate(self.out);
        }
        if part.len() > TOGETHER
            && let Some(n) = (0..node.order).find(|&n| requested[n].pos.len() > 1)
        {
            for half in halves(requested[n]) {
                let mut requested = requested.to_vec();
                requested[n] = &half;
                self.add(node, &requested)?;
            }
            return Ok(());
        }
        let mut model = zeros(part.len());
        part.accumulate(&mut model)?;
        part.put(&model, &self.sizes, self.out);
        Ok(())
    }
}

fn halves(requested: &Requested) -> [Requested; 2] {
    let middle = requested.pos.len() / 2;
    [0..middle, middle..requested.pos.len()]
        .map(|half| Requested { pos: requested.pos[half.clone()].to_vec(), place: requested.place[half].to_vec() })
}

/// The requested rows of one mode by the part they go to, with their positions in it.
fn split(level: &Level, s: usize, n: usize, parts: usize, requested: &Requested) -> Result<Vec<Requested>, String> {
    let mut all = vec![Requested::default(); parts];
    let way = level.way_down(s, n)?;
    for (&position, &place) in requested.pos.iter().zip(&requested.place) {
        let (part, local) = way.of(position)?;
        let part = all.get_mut(part).ok_or_else(|| format!("node {s} has no part {part}"))?;
        part.pos.push(local);
        part.place.push(place);
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_follow_one_another() {
        assert_eq!(runs(&[2, 3], 3), [[(0, 1), (0, 3)], [(1, 2), (0, 3)]]);
        assert_eq!(runs(&[2, 3], 2), [[(0, 1), (0, 2)], [(0, 1), (2, 3)], [(1, 2), (0, 2)], [(1, 2), (2, 3)]]);
        assert_eq!(runs(&[5], 9), [[(0, 5)]]);
    }
}
