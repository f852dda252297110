//! Projection of a tensor on the bases of all cells in two modes, in one pass over its elements.
//!
//! `P[t][c] = T[t] x_a U_{a,c}^T x_b U_{b,c}^T` for every tuple t of rows of the other modes, which are kept, whatever
//! their subsets. Some tuples are the lanes of vectors: their elements are gathered side by side, a block for each choice
//! of clusters of modes a and b is multiplied by the columns of all bases of mode b there, and while the products are in
//! registers they are added up along mode a.

use crate::cells::Node;
use crate::machine::{prefetch, prefetch_from};
use crate::sizes::zeros;
use crate::threads::{PARALLEL, Scratch, for_each, room, with_scratch};
use crate::transpose::{SIDE, turn_over};
use crate::tuple_lanes::{Product, TUPLES};
use std::ops::Range;

/// Numbers gathered at a time, some rows of mode a of all these tuples: the level 2 cache holds them.
const GATHERED: usize = 64 * 1024;
/// How many cache lines ahead of those being gathered are asked for: each lies on a page of its own.
const AHEAD: usize = 24;

/// Numbers of the result for each tuple: `[C_a, C_b, R_a, PC / (C_a C_b), R_b]`.
pub fn width(node: &Node, (a, b): (usize, usize)) -> usize {
    node.cells() * node.ranks[a] * node.ranks[b]
}

/// `P`, `[prod of the kept modes, width]`.
pub fn project_pair(node: &Node, tensor: &[f32], bases: &[&[f32]], modes: (usize, usize)) -> Vec<f32> {
    let pair = Pair::new(node, bases, modes);
    let tuples = tensor.len() / (node.sizes[modes.0] * node.sizes[modes.1]);
    let width = width(node, modes);
    let mut all = zeros(tuples * width);
    let tasks = all.chunks_mut(TUPLES * width).enumerate().collect();
    for_each(tensor.len() >= PARALLEL, tasks, |(number, out)| {
        with_scratch(|Scratch { slab, steps, .. }| pair.tuples(tensor, number * TUPLES, slab, &mut steps[0], out));
    });
    all
}

/// Bases of the cells that share a cluster of mode a and one of mode b.
struct Panel {
    /// `[members of mode b, columns]`, one for each of these cells and column of its basis of mode b.
    columns: Vec<f32>,
    /// `[members of mode a, R_a, columns]`, the same for all columns of mode b.
    weights: Vec<f32>,
}

struct Pair<'a> {
    node: &'a Node<'a>,
    a: usize,
    b: usize,
    /// `[C_a, C_b]`
    panels: Vec<Panel>,
    columns: usize,
    /// Rows of mode a worked on at a time.
    rows: usize,
    /// Neighbours in a row of modes a and b: the numbers below both.
    inner: usize,
    /// Where the elements of modes a and b lie from a tuple's first, `[I_a, I_b]`, if there are neighbours.
    places: Vec<usize>,
}

impl<'a> Pair<'a> {
    fn new(node: &'a Node, bases: &[&[f32]], (a, b): (usize, usize)) -> Self {
        let columns = node.cells() / (node.clusters[a] * node.clusters[b]) * node.ranks[b];
        let members = |n: usize, k: usize| node.rows(n, k).len();
        let empty = |(ka, kb)| Panel {
            columns: zeros(members(b, kb) * columns),
            weights: zeros(members(a, ka) * node.ranks[a] * columns),
        };
        let numbers = (0..node.clusters[a]).flat_map(|ka| (0..node.clusters[b]).map(move |kb| (ka, kb)));
        let panels = numbers.map(empty).collect();
        let rows = (GATHERED / (TUPLES * node.sizes[b])).clamp(1, node.sizes[a]);
        let stride = |n: usize| node.sizes[n + 1..].iter().product::<usize>();
        let line = |i: usize| (0..node.sizes[b]).map(move |j| i * stride(a) + j * stride(b));
        let inner = stride(a.max(b));
        let places = if inner > 1 { (0..node.sizes[a]).flat_map(line).collect() } else { vec![] };
        let mut pair = Pair { node, a, b, panels, columns, rows, inner, places };
        (0..node.cells()).for_each(|number| pair.load(number, bases));
        pair
    }

    /// Put a cell's bases into its columns.
    fn load(&mut self, number: usize, bases: &[&[f32]]) {
        let Pair { node, a, b, columns, .. } = *self;
        let cell = node.cell(number);
        let kept = (0..node.order()).filter(|&m| m != a && m != b);
        let rank = node.ranks[b];
        let first = kept.fold(0, |at, m| at * node.clusters[m] + cell.subset[m]) * rank;
        let panel = &mut self.panels[cell.subset[a] * node.clusters[b] + cell.subset[b]];
        let basis = node.load_basis(&cell, b, bases[b]);
        let members = basis.len() / rank;
        for (at, &value) in basis.iter().enumerate() {
            panel.columns[at % members * columns + first + at / members] = value;
        }
        let basis = node.load_basis(&cell, a, bases[a]);
        let members = basis.len() / node.ranks[a];
        for (at, &value) in basis.iter().enumerate() {
            let (r, i) = (at / members, at % members);
            panel.weights[(i * node.ranks[a] + r) * columns + first..][..rank].fill(value);
        }
    }

    /// Where a tuple's element (0, 0) of modes a and b lies.
    fn offset(&self, tuple: usize) -> usize {
        let Pair { node, a, b, inner, .. } = *self;
        let (mut rest, mut stride, mut at) = (tuple / inner, inner, tuple % inner);
        for m in (0..=a.max(b)).rev() {
            if m != a && m != b {
                at += rest % node.sizes[m] * stride;
                rest /= node.sizes[m];
            }
            stride *= node.sizes[m];
        }
        at
    }

    /// All tuples of `out`, from `first` on.
    fn tuples(&self, tensor: &[f32], first: usize, block: &mut Vec<f32>, sums: &mut Vec<f32>, out: &mut [f32]) {
        let Pair { node, a, b, inner, .. } = *self;
        let width = width(node, (a, b));
        let count = out.len() / width;
        let sums = room(sums, width * TUPLES);
        sums.fill(0.0);
        for from in (0..node.sizes[a]).step_by(self.rows) {
            let rows = from..node.sizes[a].min(from + self.rows);
            // Of the last tuples more is copied than there are.
            let block = room(block, rows.len() * node.sizes[b] * TUPLES + TUPLES);
            match inner {
                1 => self.turn(tensor, first, count, &rows, block),
                _ => self.gather(tensor, first, count, &rows, block),
            }
            self.contract(block, rows, sums);
        }
        scatter(sums, width, out);
    }

    fn stride(&self, n: usize) -> usize {
        self.node.sizes[n + 1..].iter().product()
    }

    /// Some rows of mode a of `count` tuples from `first` on: `[rows, I_b, TUPLES]`.
    fn gather(&self, tensor: &[f32], first: usize, count: usize, rows: &Range<usize>, block: &mut [f32]) {
        let columns = self.node.sizes[self.b];
        let places = &self.places[rows.start * columns..rows.end * columns];
        // Where tuples that are neighbours start, in the tensor and among these tuples, and how many there are.
        let (mut runs, mut done) = (vec![], 0);
        while done < count {
            let run = (self.inner - (first + done) % self.inner).min(count - done);
            runs.push((self.offset(first + done), done, run));
            done += run;
        }
        let end = runs.iter().map(|&(start, ..)| start).max().unwrap_or(0) + places[places.len() - 1];
        for (number, &place) in places.iter().enumerate() {
            for &(start, at, run) in &runs {
                if let Some(&place) = places.get(number + AHEAD) {
                    // The numbers before the last came with the tuples before these.
                    prefetch(&tensor[start + place + run - 1..][..1]);
                }
                let to = &mut block[number * TUPLES + at..];
                if end + TUPLES <= tensor.len() {
                    // What is too much is written over by the next, in as little time as a move takes.
                    to[..TUPLES].copy_from_slice(&tensor[start + place..][..TUPLES]);
                } else {
                    to[..run].copy_from_slice(&tensor[start + place..][..run]);
                }
            }
        }
    }

    /// The same of tuples that are no neighbours, because the rows of one of the two modes are.
    fn turn(&self, tensor: &[f32], first: usize, count: usize, rows: &Range<usize>, block: &mut [f32]) {
        let Pair { node, a, b, .. } = *self;
        let (line, columns) = (node.sizes[b] * TUPLES, node.sizes[b]);
        // Of the other mode, and of the one whose rows are neighbours.
        let (others, from_step, to_step, run, run_step) = match a < b {
            true => (rows.len(), self.stride(a), line, columns, TUPLES),
            false => (columns, self.stride(b), TUPLES, rows.len(), line),
        };
        let start = rows.start * self.stride(a);
        let starts: [usize; TUPLES] = std::array::from_fn(|t| self.offset(first + t.min(count - 1)) + start);
        for other in 0..others {
            for (t, starts) in starts.chunks_exact(SIDE).enumerate() {
                let from: [&[f32]; SIDE] = std::array::from_fn(|k| &tensor[starts[k] + other * from_step..][..run]);
                if other + 1 < others {
                    from.iter().for_each(|from| prefetch_from(from.as_ptr().wrapping_add(from_step), run));
                }
                turn_over(from, &mut block[other * to_step + t * SIDE..], run_step);
            }
        }
    }

    /// Add what some rows of mode a are worth, gathered as `x`, to the sums `[C_a, C_b, R_a, columns, TUPLES]`.
    fn contract(&self, x: &[f32], rows: Range<usize>, sums: &mut [f32]) {
        let Pair { node, a, b, .. } = *self;
        let (rank, size) = (node.ranks[a], node.ranks[a] * self.columns);
        for kb in 0..node.clusters[b] {
            let columns: Vec<usize> = node.rows(b, kb).iter().map(|&j| j as usize * TUPLES).collect();
            for ka in 0..node.clusters[a] {
                let members = node.rows(a, ka);
                let before = |end: usize| members.partition_point(|&i| (i as usize) < end);
                let inside = before(rows.start)..before(rows.end);
                let line = node.sizes[b] * TUPLES;
                let places: Vec<usize> =
                    members[inside.clone()].iter().map(|&i| (i as usize - rows.start) * line).collect();
                let number = ka * node.clusters[b] + kb;
                let Panel { columns: panel, weights } = &self.panels[number];
                let weights = &weights[inside.start * size..inside.end * size];
                let sums = &mut sums[number * size * TUPLES..][..size * TUPLES];
                Product { x, rows: &places, columns: &columns, panel, weights, rank, width: self.columns, sums }
                    .add_up();
            }
        }
    }
}

/// Sums `[width, TUPLES]` as `[tuples, width]`.
fn scatter(sums: &[f32], width: usize, out: &mut [f32]) {
    let (count, whole) = (out.len() / width, width - width % SIDE);
    for at in (0..whole).step_by(SIDE) {
        turn_over(std::array::from_fn(|i| &sums[(at + i) * TUPLES..][..count]), &mut out[at..], width);
    }
    for (at, sums) in sums.chunks_exact(TUPLES).enumerate().skip(whole) {
        out[at..].iter_mut().step_by(width).zip(sums).for_each(|(out, &sum)| *out = sum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::{close, numbers};

    #[test]
    fn agrees_with_the_definition() {
        on_all_machines(|| {
            compare(vec![9, 5, 21, 17], (2, 3));
            compare(vec![23, 10, 4, 19], (1, 0));
            compare(vec![6, 11, 3, 2], (0, 1));
            // Rows of the last mode summed over last; more rows of mode a than are gathered at a time.
            compare(vec![5, 7, 21, 17], (3, 2));
            compare(vec![2, 40, 3, 150], (1, 3));
            compare(vec![150, 40, 3, 6], (1, 0));
        });
    }

    /// Every number of P by its formula; every third row of a mode is in clusters 0 and 1, the others in 1 and 2.
    fn compare(sizes: Vec<usize>, (a, b): (usize, usize)) {
        let members: Vec<Vec<u16>> = sizes.iter().map(|&size| (0..size).flat_map(pair_of).collect()).collect();
        let shape = (sizes.clone(), vec![3; 4], vec![2; 4], vec![2, 3, 2, 3], vec![false; 4]);
        let node = Node::new(shape, members.iter().map(Vec::as_slice).collect()).unwrap();
        let stored: Vec<Vec<f32>> = (0..4).map(|n| numbers(node.basis_size(n), n as u64 + 1)).collect();
        let stored: Vec<&[f32]> = stored.iter().map(Vec::as_slice).collect();
        let tensor = numbers(sizes.iter().product(), 7);
        let p = project_pair(&node, &tensor, &stored, (a, b));
        let kept: Vec<usize> = (0..4).filter(|&m| m != a && m != b).collect();
        let stride = |n: usize| sizes[n + 1..].iter().product::<usize>();
        let (ra, rb) = (node.ranks[a], node.ranks[b]);
        for (at, &value) in p.iter().enumerate().step_by(37) {
            let (rest, q) = (at / rb, at % rb);
            let (rest, second, first) = (rest / 9, rest % 3, rest / 3 % 3);
            let (rest, r) = (rest / ra, rest % ra);
            let (tuple, kb, ka) = (rest / 9, rest % 3, rest / 3 % 3);
            let mut subset = [0; 4];
            (subset[a], subset[b], subset[kept[0]], subset[kept[1]]) = (ka, kb, first, second);
            let cell = node.cell(subset.iter().fold(0, |number, k| number * 3 + k));
            let start = tuple / sizes[kept[1]] * stride(kept[0]) + tuple % sizes[kept[1]] * stride(kept[1]);
            let mut expected = 0.0;
            for (i, x) in (0..sizes[a]).filter_map(|i| Some((i, node.place(&cell, a, i)?))) {
                for (j, y) in (0..sizes[b]).filter_map(|j| Some((j, node.place(&cell, b, j)?))) {
                    let value = tensor[start + i * stride(a) + j * stride(b)];
                    expected += f64::from(value) * f64::from(stored[a][x + r]) * f64::from(stored[b][y + q]);
                }
            }
            close(value, expected);
        }
    }

    fn pair_of(row: usize) -> [u16; 2] {
        if row.is_multiple_of(3) { [0, 1] } else { [1, 2] }
    }
}
