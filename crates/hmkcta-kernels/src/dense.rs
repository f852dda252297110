//! Dense blocks: the elements of an outer product of row lists, node by node down the tree.
//! The twin of `hmkcta.decode.dense`.
//!
//! Threads share the block: what the children of a cut at the top have in it or, where the root has numbers itself, runs
//! of its leading indices. A node adds its part as the fitting kernels do it, by products in the cache where it is small,
//! or element by element where that is less work.

use crate::element::Elements;
use crate::packed::{Level, MOST_MODES, Node, NodeView};
use crate::part::{Part, Requested};
use crate::shared::Shared;
use crate::sizes::zeros;
use crate::small::Products;
use crate::threads::{PARALLEL, for_each_with};
use std::ops::Range;

/// Elements of a run: many, since each run widens the numbers of its nodes for itself.
const SMALLEST: usize = 1 << 22;
const LARGEST: usize = 1 << 26;
/// Runs that a block is cut into, sizes permitting.
const RUNS: usize = 16;
/// Elements of neighbouring children that one thread decodes.
const TASK: usize = 1 << 16;
/// Elements that a node puts together before they are added to the block.
const TOGETHER: usize = 1 << 21;

/// Add the block of the outer product of `rows`, one list a mode, to `out`; stages before `first` add nothing.
pub fn decode(levels: &[Level], rows: &[&[i64]], first: usize, out: &mut [f32]) -> Result<(), String> {
    let whole = rows.iter().map(|rows| (0, rows.len())).collect::<Vec<_>>();
    let parallel = out.len() >= PARALLEL;
    let mut tasks = vec![];
    if matches!(levels[0].node(0)?, Node::Cut(_)) && levels.len() > 1 {
        let (sizes, out) = (whole.iter().map(|run| run.1).collect::<Vec<_>>(), Shared::new(out));
        let mut families = vec![];
        collect(levels, 0, 0, &requested(rows, &whole).iter().collect::<Vec<_>>(), &mut families)?;
        for family in &families {
            let children = family.children();
            let each = (TASK * children / family.elements).clamp(1, children);
            let ranges = (0..children).step_by(each).map(|from| from..children.min(from + each));
            tasks.extend(ranges.map(|range| (family, range, Ok(()))));
        }
        for_each_with(parallel, tasks.iter_mut().collect(), |(family, range, result), buffers: &mut Buffers| {
            // SAFETY: rows of different children have different places, so that no two tasks have an element in common.
            let mut walk = Walk { levels, first, sizes: &sizes, out, buffers };
            *result = walk.children(family, range.clone());
        });
        return tasks.into_iter().try_for_each(|(_, _, result)| result);
    }
    let limit = (out.len() / RUNS).clamp(SMALLEST, LARGEST);
    let runs = runs(&whole.iter().map(|run| run.1).collect::<Vec<_>>(), limit);
    let mut results: Vec<Result<(), String>> = vec![Ok(()); runs.len()];
    let (mut rest, mut tasks) = (out, vec![]);
    for (run, result) in runs.into_iter().zip(&mut results) {
        let (out, left) = rest.split_at_mut(run.iter().map(|&(from, to)| to - from).product());
        rest = left;
        tasks.push((run, out, result));
    }
    for_each_with(true, tasks, |(run, out, result), buffers: &mut Buffers| {
        let sizes: Vec<usize> = run.iter().map(|&(from, to)| to - from).collect();
        let mut walk = Walk { levels, first, sizes: &sizes, out: Shared::new(out), buffers };
        *result = walk.node(0, 0, &requested(rows, &run).iter().collect::<Vec<_>>());
    });
    results.into_iter().collect()
}

/// The rows of each mode from one number on to another, at their places in a run of these.
fn requested(rows: &[&[i64]], run: &[(usize, usize)]) -> Vec<Requested> {
    let of_mode = |(&(from, to), rows): (&(usize, usize), &&[i64])| {
        Requested::new(rows[from..to].iter().map(|&i| i as u32).collect(), (0..(to - from) as u32).collect())
    };
    run.iter().zip(rows).map(of_mode).collect()
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

/// The children of a node, and the requested rows of each of its parts, mode by mode.
struct Family {
    depth: usize,
    first: usize,
    clusters: [usize; MOST_MODES],
    parts: Vec<Vec<Requested>>,
    elements: usize,
}

impl Family {
    /// None of a leaf.
    fn new(
        levels: &[Level],
        depth: usize,
        s: usize,
        clusters: [usize; MOST_MODES],
        requested: &[&Requested],
    ) -> Result<Option<Family>, String> {
        let level = &levels[depth];
        let Some(next) = levels.get(depth + 1) else { return Ok(None) };
        let Some(first) = level.first_child(s, &clusters, next)? else { return Ok(None) };
        let parts = requested.iter().enumerate().map(|(n, requested)| split(level, s, n, clusters[n], requested));
        let elements = requested.iter().map(|rows| rows.pos.len()).product();
        Ok(Some(Family { depth: depth + 1, first, clusters, parts: parts.collect::<Result<_, _>>()?, elements }))
    }

    fn children(&self) -> usize {
        self.parts.iter().map(|parts| parts.len()).product()
    }

    /// The rows of one child; false if some mode has none.
    fn rows<'f>(&'f self, flat: usize, chosen: &mut Vec<&'f Requested>) -> bool {
        let mut rest = flat;
        chosen.clear();
        for (n, parts) in self.parts.iter().enumerate().rev() {
            chosen.push(&parts[rest % self.clusters[n]]);
            rest /= self.clusters[n];
        }
        chosen.reverse();
        chosen.iter().all(|part| !part.pos.is_empty())
    }
}

/// The children of a cut node, and of large cuts below it those of theirs instead.
fn collect(
    levels: &[Level],
    depth: usize,
    s: usize,
    requested: &[&Requested],
    families: &mut Vec<Family>,
) -> Result<(), String> {
    let Node::Cut(clusters) = levels[depth].node(s)? else { return Ok(()) };
    let Some(family) = Family::new(levels, depth, s, clusters, requested)? else { return Ok(()) };
    let mut chosen = vec![];
    let mut cut = levels.len() > depth + 2 && family.elements / family.children() > TASK;
    for flat in 0..family.children() {
        cut = cut
            && (!family.rows(flat, &mut chosen)
                || matches!(levels[depth + 1].node(family.first + flat)?, Node::Cut(_)));
    }
    if !cut {
        families.push(family);
        return Ok(());
    }
    for flat in 0..family.children() {
        if family.rows(flat, &mut chosen) {
            collect(levels, depth + 1, family.first + flat, &chosen, families)?;
        }
    }
    Ok(())
}

/// Kept from one node to the next.
#[derive(Default)]
struct Buffers {
    elements: Elements<f32>,
    products: Products,
}

/// A run, or some children, on the way down the tree.
struct Walk<'w> {
    levels: &'w [Level<'w>],
    first: usize,
    sizes: &'w [usize],
    /// The elements of the requested rows are this walk's alone.
    out: Shared<'w>,
    buffers: &'w mut Buffers,
}

impl Walk<'_> {
    /// Add a node and all below it for the requested rows, of which every mode has some.
    fn node(&mut self, depth: usize, s: usize, requested: &[&Requested]) -> Result<(), String> {
        let clusters = match self.levels[depth].node(s)? {
            Node::Empty => return Ok(()),
            Node::Cut(clusters) => clusters,
            Node::Cells(node) => {
                if depth >= self.first {
                    self.add(&node, requested)?;
                }
                node.clusters
            }
        };
        match Family::new(self.levels, depth, s, clusters, requested)? {
            Some(family) => self.children(&family, 0..family.children()),
            None => Ok(()),
        }
    }

    fn children(&mut self, family: &Family, range: Range<usize>) -> Result<(), String> {
        let mut chosen = vec![];
        for flat in range {
            if family.rows(flat, &mut chosen) {
                self.node(family.depth, family.first + flat, &chosen)?;
            }
        }
        Ok(())
    }

    fn add(&mut self, node: &NodeView, requested: &[&Requested]) -> Result<(), String> {
        let part = Part { node, requested };
        if Products::pay(node, requested) {
            part.put(self.buffers.products.block(node, requested)?, self.sizes, self.out);
            return Ok(());
        }
        if part.single_elements_pay() {
            return part.add_elements(self.sizes, self.out, &mut self.buffers.elements);
        }
        if part.covers(self.sizes) {
            // SAFETY: the requested rows are all there are, and their elements are this walk's alone.
            return part.accumulate(unsafe { self.out.all() });
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
        part.put(&model, self.sizes, self.out);
        Ok(())
    }
}

fn halves(requested: &Requested) -> [Requested; 2] {
    let middle = requested.pos.len() / 2;
    [0..middle, middle..requested.pos.len()]
        .map(|half| Requested::new(requested.pos[half.clone()].to_vec(), requested.place[half].to_vec()))
}

/// The requested rows of one mode by the part they go to, with their positions in it.
fn split(level: &Level, s: usize, n: usize, parts: usize, requested: &Requested) -> Result<Vec<Requested>, String> {
    let mut all = vec![(vec![], vec![]); parts];
    let way = level.way_down(s, n)?;
    for (&position, &place) in requested.pos.iter().zip(&requested.place) {
        let (part, local) = way.of(position)?;
        let (positions, places) =
            all.get_mut(part).ok_or_else(|| format!("a node has no part {part} in mode {}", n + 1))?;
        positions.push(local);
        places.push(place);
    }
    Ok(all.into_iter().map(|(pos, place)| Requested::new(pos, place)).collect())
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
