//! Projection of a tensor on the bases of all cells in two modes, in one pass over its elements.
//!
//! `P[t][c] = T[t] x_a U_{a,c}^T x_b U_{b,c}^T` for every tuple t of rows of the other modes, which are kept, whatever
//! their subsets. Cells that share their clusters of modes a and b lie side by side, so that they are the lanes of a
//! vector: a block of `T[t]` is multiplied by the columns of all their bases of mode b at once, and while the products
//! are in registers they are added up along mode a.

use crate::cells::Node;
use crate::machine::{dispatch, dispatch_narrow, prefetch};
use crate::threads::{PARALLEL, Scratch, for_each, room, with_scratch};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Lanes are padded to a multiple of half the longest vector; what is left of whole ones is worked on by half ones.
const PAD: usize = 8;
const WHOLE: usize = 16;
/// Tuples gathered at a time: a cache line of neighbours.
const TUPLES: usize = 16;
/// Numbers gathered at a time, some rows of mode a of all these tuples: the level 2 cache holds them.
const GATHERED: usize = 64 * 1024;
/// How many cache lines ahead of those being gathered are asked for: each lies on a page of its own.
const AHEAD: usize = 12;
/// Fewest and most tuples worked on at a time where their numbers can be read from the tensor: more where they have few.
const IN_PLACE: (usize, usize) = (4, 64);

/// Numbers of the result for each tuple: `[C_a, C_b, R_a, PC / (C_a C_b), R_b]`.
pub fn width(node: &Node, (a, b): (usize, usize)) -> usize {
    node.cells() * node.ranks[a] * node.ranks[b]
}

/// `P`, `[prod of the kept modes, width]`.
pub fn project_pair(node: &Node, tensor: &[f32], bases: &[&[f32]], modes: (usize, usize)) -> Vec<f32> {
    let pair = Pair::new(node, bases, modes);
    let tuples = tensor.len() / (node.sizes[modes.0] * node.sizes[modes.1]);
    let width = width(node, modes);
    let mut all = vec![0.0f32; tuples * width];
    let tasks = all.chunks_mut(pair.group * width).enumerate().collect();
    for_each(tensor.len() >= PARALLEL, tasks, |(number, out)| {
        with_scratch(|Scratch { slab, steps, .. }| pair.tuples(tensor, number * pair.group, slab, &mut steps[0], out));
    });
    all
}

/// Bases of the cells that share a cluster of mode a and one of mode b.
struct Panel {
    /// `[members of mode b, lanes]`, a lane for each of these cells and column of its basis of mode b.
    columns: Vec<f32>,
    /// `[members of mode a, R_a, lanes]`, the same for all columns of mode b.
    weights: Vec<f32>,
}

struct Pair<'a> {
    node: &'a Node<'a>,
    a: usize,
    b: usize,
    /// `[C_a, C_b]`
    panels: Vec<Panel>,
    lanes: usize,
    padded: usize,
    /// Tuples and rows of mode a worked on at a time.
    group: usize,
    rows: usize,
    /// Neighbours in a row of modes a and b: the numbers below both.
    inner: usize,
    /// Where the elements of modes a and b lie from a tuple's first, `[I_a, I_b]`, if there are neighbours to gather.
    lines: Vec<usize>,
}

impl<'a> Pair<'a> {
    fn new(node: &'a Node, bases: &[&[f32]], (a, b): (usize, usize)) -> Self {
        let lanes = node.cells() / (node.clusters[a] * node.clusters[b]) * node.ranks[b];
        let padded = lanes.next_multiple_of(PAD);
        let members = |n: usize, k: usize| node.rows(n, k).len();
        let empty = |(ka, kb)| Panel {
            columns: vec![0.0; members(b, kb) * padded],
            weights: vec![0.0; members(a, ka) * node.ranks[a] * padded],
        };
        let numbers = (0..node.clusters[a]).flat_map(|ka| (0..node.clusters[b]).map(move |kb| (ka, kb)));
        let inner = node.sizes[a.max(b) + 1..].iter().product();
        let fitting = GATHERED / (node.sizes[a] * node.sizes[b]);
        let group = if inner > 1 { TUPLES } else { fitting.clamp(IN_PLACE.0, IN_PLACE.1) };
        let rows =
            if inner > 1 { (GATHERED / (TUPLES * node.sizes[b])).clamp(1, node.sizes[a]) } else { node.sizes[a] };
        let panels = numbers.map(empty).collect();
        let stride = |n: usize| node.sizes[n + 1..].iter().product::<usize>();
        let line = |i: usize| (0..node.sizes[b]).map(move |j| i * stride(a) + j * stride(b));
        let lines = if inner > 1 { (0..node.sizes[a]).flat_map(line).collect() } else { vec![] };
        let mut pair = Pair { node, a, b, panels, lanes, padded, group, rows, inner, lines };
        (0..node.cells()).for_each(|number| pair.load(number, bases));
        pair
    }

    /// Put a cell's bases into its lanes.
    fn load(&mut self, number: usize, bases: &[&[f32]]) {
        let Pair { node, a, b, padded, .. } = *self;
        let cell = node.cell(number);
        let kept = (0..node.order()).filter(|&m| m != a && m != b);
        let rank = node.ranks[b];
        let first = kept.fold(0, |at, m| at * node.clusters[m] + cell.subset[m]) * rank;
        let panel = &mut self.panels[cell.subset[a] * node.clusters[b] + cell.subset[b]];
        let basis = node.load_basis(&cell, b, bases[b]);
        let members = basis.len() / rank;
        for (at, &value) in basis.iter().enumerate() {
            panel.columns[at % members * padded + first + at / members] = value;
        }
        let basis = node.load_basis(&cell, a, bases[a]);
        let members = basis.len() / node.ranks[a];
        for (at, &value) in basis.iter().enumerate() {
            let (r, i) = (at / members, at % members);
            panel.weights[(i * node.ranks[a] + r) * padded + first..][..rank].fill(value);
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
        let Pair { lanes, padded, .. } = *self;
        if lanes == padded {
            // Pages of fresh zeros that are read before they are written cost two faults and a flush of all cores.
            out.fill(0.0);
            return self.add_up(tensor, first, block, out);
        }
        let sums = room(sums, out.len() / lanes * padded);
        sums.fill(0.0);
        self.add_up(tensor, first, block, sums);
        for (out, sums) in out.chunks_exact_mut(lanes).zip(sums.chunks_exact(padded)) {
            out.copy_from_slice(&sums[..lanes]);
        }
    }

    /// All tuples of `sums` `[tuples, C_a, C_b, R_a, padded lanes]`, which is zero, from `first` on.
    fn add_up(&self, tensor: &[f32], first: usize, block: &mut Vec<f32>, sums: &mut [f32]) {
        let Pair { node, a, b, padded, inner, .. } = *self;
        let count = sums.len() / (self.panels.len() * node.ranks[a] * padded);
        if inner == 1 {
            let starts = (0..count).map(|t| self.offset(first + t)).collect::<Vec<_>>();
            return self.contract(tensor, &starts, (self.stride(a), self.stride(b)), 0..node.sizes[a], sums);
        }
        let starts = (0..count).collect::<Vec<_>>();
        for from in (0..node.sizes[a]).step_by(self.rows) {
            let rows = from..node.sizes[a].min(from + self.rows);
            let block = room(block, rows.len() * node.sizes[b] * TUPLES);
            self.gather(tensor, first, count, &rows, block);
            self.contract(block, &starts, (node.sizes[b] * TUPLES, TUPLES), rows, sums);
        }
    }

    fn stride(&self, n: usize) -> usize {
        self.node.sizes[n + 1..].iter().product()
    }

    /// Some rows of mode a of `count` tuples from `first` on: `[rows, I_b, TUPLES]`.
    fn gather(&self, tensor: &[f32], first: usize, count: usize, rows: &Range<usize>, block: &mut [f32]) {
        let columns = self.node.sizes[self.b];
        let lines = &self.lines[rows.start * columns..rows.end * columns];
        let mut done = 0;
        while done < count {
            let run = (self.inner - (first + done) % self.inner).min(count - done);
            let from = &tensor[self.offset(first + done)..];
            for (number, to) in block.chunks_exact_mut(TUPLES).enumerate() {
                if let Some(&line) = lines.get(number + AHEAD) {
                    // The numbers before the last came with the tuples before these.
                    prefetch(&from[line + run - 1..][..1]);
                }
                copy(&from[lines[number]..][..run], &mut to[done..]);
            }
            done += run;
        }
    }

    /// Add what some rows of some tuples are worth to `sums` `[tuples, C_a, C_b, R_a, padded lanes]`.
    ///
    /// In `x` tuples start at `starts`, each with these rows, and modes a and b have the given strides.
    fn contract(&self, x: &[f32], starts: &[usize], strides: (usize, usize), rows: Range<usize>, sums: &mut [f32]) {
        let Pair { node, a, b, padded, .. } = *self;
        let (rank, size) = (node.ranks[a], node.ranks[a] * padded);
        for kb in 0..node.clusters[b] {
            let columns: Vec<usize> = node.rows(b, kb).iter().map(|&j| j as usize * strides.1).collect();
            for ka in 0..node.clusters[a] {
                let members = node.rows(a, ka);
                let before = |end: usize| members.partition_point(|&i| (i as usize) < end);
                let inside = before(rows.start)..before(rows.end);
                let places: Vec<usize> =
                    members[inside.clone()].iter().map(|&i| (i as usize - rows.start) * strides.0).collect();
                let number = ka * node.clusters[b] + kb;
                let Panel { columns: panel, weights } = &self.panels[number];
                let weights = &weights[inside.start * size..inside.end * size];
                let (rows, columns, sums) = (&places[..], &columns[..], &mut sums[number * size..]);
                let step = self.panels.len() * size;
                let mut product = Product { x, starts, rows, columns, panel, weights, rank, padded, sums, step };
                let whole = padded - padded % WHOLE;
                if whole > 0 {
                    dispatch(Lanes(&mut product, 0..whole));
                }
                if whole < padded {
                    dispatch_narrow(Lanes(&mut product, whole..padded));
                }
            }
        }
    }
}

/// A line of numbers, mostly a whole one.
fn copy(from: &[f32], to: &mut [f32]) {
    match <&[f32; TUPLES]>::try_from(from) {
        Ok(whole) => to.copy_from_slice(whole),
        Err(_) => to[..from.len()].copy_from_slice(from),
    }
}

/// `sums[t, r, l] += sum over rows i of weights[i, r, l] sum over columns j of x[t, i, j] panel[j, l]`; a number of `x` is
/// where its tuple starts, its row and its column.
struct Product<'a> {
    x: &'a [f32],
    starts: &'a [usize],
    rows: &'a [usize],
    columns: &'a [usize],
    panel: &'a [f32],
    weights: &'a [f32],
    rank: usize,
    padded: usize,
    sums: &'a mut [f32],
    /// From the sums of one tuple to those of the next.
    step: usize,
}

/// Some of a product's lanes.
struct Lanes<'a, 'p>(&'a mut Product<'p>, Range<usize>);

impl WithSimd for Lanes<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        self.0.lanes(simd, self.1);
    }
}

impl Product<'_> {
    #[inline(always)]
    fn lanes<S: Simd>(&mut self, simd: S, some: Range<usize>) {
        let Product { starts, rows, columns, rank, padded, step, .. } = *self;
        let last = starts.iter().max().zip(rows.iter().max().zip(columns.iter().max()));
        assert!(last.is_none_or(|(start, (row, column))| start + row + column < self.x.len()));
        assert!(
            some.len().is_multiple_of(S::F32_LANES) && some.end <= padded && self.panel.len() >= columns.len() * padded
        );
        assert!(self.sums.len() >= starts.len().saturating_sub(1) * step + rank * padded);
        assert!(self.weights.len() >= rows.len() * rank * padded);
        let lanes = S::F32_LANES;
        let wide = if S::REGISTER_COUNT >= 32 { 4 } else { 2 };
        for lane in some.clone().step_by(wide * lanes) {
            // SAFETY: all tuples, rows, columns and lanes lie within the slices.
            unsafe {
                match (wide, (some.end - lane) / lanes) {
                    (_, 1) => self.rows::<S, 8, 1>(simd, lane),
                    (2, _) => self.rows::<S, 6, 2>(simd, lane),
                    (_, 2) => self.rows::<S, 8, 2>(simd, lane),
                    (_, 3) => self.rows::<S, 8, 3>(simd, lane),
                    _ => self.rows::<S, 6, 4>(simd, lane),
                }
            }
        }
    }

    /// All rows of `V` vectors of lanes, `M` at a time: their numbers of all tuples are neighbours, and stay in the cache.
    #[inline(always)]
    unsafe fn rows<S: Simd, const M: usize, const V: usize>(&mut self, simd: S, lane: usize) {
        let (mut row, count) = (0, self.rows.len());
        unsafe {
            while row + M <= count {
                self.tiles::<S, M, V>(simd, row, lane);
                row += M;
            }
            // At once, as few rows at a time would wait for sums.
            match count - row {
                0 => (),
                1 => self.tiles::<S, 1, V>(simd, row, lane),
                2 => self.tiles::<S, 2, V>(simd, row, lane),
                3 => self.tiles::<S, 3, V>(simd, row, lane),
                4 => self.tiles::<S, 4, V>(simd, row, lane),
                5 => self.tiles::<S, 5, V>(simd, row, lane),
                6 => self.tiles::<S, 6, V>(simd, row, lane),
                _ => self.tiles::<S, 7, V>(simd, row, lane),
            }
        }
    }

    #[inline(always)]
    unsafe fn tiles<S: Simd, const M: usize, const V: usize>(&mut self, simd: S, row: usize, lane: usize) {
        for t in 0..self.starts.len() {
            unsafe { self.tile::<S, M, V>(simd, t, row, lane) };
        }
    }

    #[inline(always)]
    unsafe fn tile<S: Simd, const M: usize, const V: usize>(&mut self, simd: S, t: usize, row: usize, lane: usize) {
        let read =
            |from: *const f32, v: usize| unsafe { from.add(v * S::F32_LANES).cast::<S::f32s>().read_unaligned() };
        let mut products = [[simd.splat_f32s(0.0); V]; M];
        unsafe {
            let mut x = [self.x.as_ptr(); M];
            for (i, x) in x.iter_mut().enumerate() {
                *x = x.add(self.starts[t] + self.rows[row + i]);
            }
            for (j, &column) in self.columns.iter().enumerate() {
                let panel = self.panel.as_ptr().add(j * self.padded + lane);
                let values: [S::f32s; V] = std::array::from_fn(|v| read(panel, v));
                for (products, x) in products.iter_mut().zip(x) {
                    let weight = simd.splat_f32s(*x.add(column));
                    for (product, value) in products.iter_mut().zip(values) {
                        *product = simd.mul_add_e_f32s(weight, value, *product);
                    }
                }
            }
            for r in 0..self.rank {
                let sums = self.sums.as_mut_ptr().add(t * self.step + r * self.padded + lane);
                let mut total: [S::f32s; V] = std::array::from_fn(|v| read(sums, v));
                for (i, products) in products.iter().enumerate() {
                    let weights = self.weights.as_ptr().add(((row + i) * self.rank + r) * self.padded + lane);
                    for (v, (total, &product)) in total.iter_mut().zip(products).enumerate() {
                        *total = simd.mul_add_e_f32s(read(weights, v), product, *total);
                    }
                }
                for (v, total) in total.into_iter().enumerate() {
                    sums.add(v * S::F32_LANES).cast::<S::f32s>().write_unaligned(total);
                }
            }
        }
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
