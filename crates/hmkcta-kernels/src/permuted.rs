//! Reconstruction of cells line by line where the last mode b has so few clusters and ranks that a vector holds a number
//! for each.
//!
//! For fixed rows of the other modes the cores of the cells that meet there are contracted to `[C_b, R_b]` each, one
//! vector. From it each column of the line takes the numbers of its clusters, by a permutation, and multiplies them by
//! its basis row.

use crate::cells::Node;
use crate::leading::{Leading, PAD, Padded, Partial, alike, subsets};
use crate::lines::Target;
use crate::machine::{dispatch, lanes, prefetch_from};
use crate::mode_order::Turned;
use crate::places::cut;
use crate::shuffle::{Order, Shuffle};
use crate::threads::{PARALLEL, for_each, room};
use pulp::{Simd, WithSimd};

/// Lines worked on at a time, which share what is read of the basis of mode b.
const LINES: usize = 8;
/// How many groups of lines ahead lines are fetched.
const AHEAD: usize = 3;
/// Groups whose cores are contracted before any lines are made: what was just written takes long to read.
const TOGETHER: usize = 16;
/// Most permutations for a column where cells overlap; with more, lines of products take less.
const MOST: usize = 8;
/// Pieces the tensor is cut into, for threads to share.
const PIECES: usize = 64;

/// Whether a node is one for it: with few numbers to permute, and all that is padded small beside the tensor.
///
/// Cells that do not overlap would take a fifth to a half of the time, but must be rounded as each is alone: a fit that
/// holds them one by one ends in the same file, bit by bit.
pub fn pays(node: &Node) -> bool {
    let (b, overlap, lanes) = (node.order() - 1, node.mixture.iter().product::<usize>(), lanes());
    let numbers = node.clusters[b] * node.ranks[b];
    let fits =
        b > 0 && node.cells() > 1 && !node.undecomposed[b] && numbers <= lanes && (8..=node.sizes[b]).contains(&lanes);
    let few = node.ranks[b] == 1 && (2..=MOST).contains(&overlap);
    let leading: usize = (0..b).map(|n| node.basis_size(n) / node.clusters[b]).sum();
    let cores = node.cells() * node.core_size() / numbers;
    let last = node.basis_size(b) / lanes;
    fits && few && (leading + cores + last) * PAD <= node.sizes.iter().product::<usize>() / 4
}

/// `tensor += weight * model`
pub fn accumulate(node: &Node, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    assert_eq!(tensor.len(), node.sizes.iter().product::<usize>());
    let mode = mode_of_rows(node);
    let turned = Turned::new(node, mode, bases, cores);
    let permuted = Permuted::new(&turned.node, &turned.bases);
    let all = permuted.leading.cores(&turned.cores, weight);
    let inner = node.sizes[mode + 1..node.order() - 1].iter().product();
    let target = Target::new(tensor.as_mut_ptr(), permuted.rows, permuted.columns, inner);
    let (count, parallel) = (permuted.leading.count(), tensor.len() >= PARALLEL);
    // Few planes are cut, too.
    let (piece, parts) = if parallel { (count.div_ceil(PIECES), PIECES.div_ceil(count)) } else { (count, 1) };
    let part = permuted.groups.len().div_ceil(parts);
    let pieces = (0..count).step_by(piece).flat_map(|from| permuted.groups.chunks(part).map(move |part| (from, part)));
    for_each(parallel, pieces.collect(), |(from, groups)| {
        let mut buffers = Buffers::default();
        permuted.leading.each(from..count.min(from + piece), &all, |number, present| {
            let [start, next] = [number, number + 1].map(|number| {
                let (rows, first) = permuted.leading.bundle(number);
                target.tuple(first + rows[0] as usize)
            });
            let step = target.step();
            dispatch(Plane { permuted: &permuted, groups, present, start, next, step, buffers: &mut buffers });
        });
    });
}

/// The mode whose rows share their subsets with most others.
fn mode_of_rows(node: &Node) -> usize {
    let each = |n: usize| node.sizes[n] as f64 / alike(node, n, LINES).len() as f64;
    (0..node.order() - 1).map(|n| (each(n), n)).max_by(|x, y| x.0.total_cmp(&y.0)).map_or(0, |(_, n)| n)
}

/// A node prepared for it. Modes a and b are the last two; `Leading` has PAD lanes.
struct Permuted<'a> {
    leading: Leading<'a>,
    /// Of the vectors.
    lanes: usize,
    rows: usize,
    columns: usize,
    /// Rows of mode a with the same subsets, some at a time.
    groups: Vec<Vec<u32>>,
    /// The basis of mode a, a number for each lane: `[I_a, K_a, cells of the modes before, R_a]`.
    weights: Vec<Padded>,
    /// The columns cut into vectors: where each starts.
    starts: Vec<usize>,
    /// `K_b R_b`
    slots: usize,
    /// For each vector of columns, and each of `K_b R_b` numbers of a column, which number of a cell it is multiplied by.
    orders: Vec<Order>,
    /// For each cell of the modes but b the basis of mode b like that; 0 for columns of another vector.
    basis: Vec<Padded>,
}

impl<'a> Permuted<'a> {
    fn new(node: &'a Node<'a>, bases: &[Vec<f32>]) -> Self {
        let (a, b) = (node.order() - 2, node.order() - 1);
        let leading = Leading::new(node, bases, 1);
        assert!(node.clusters[b] * node.ranks[b] <= lanes());
        let mut permuted = Permuted {
            lanes: lanes(),
            rows: node.sizes[a],
            columns: node.sizes[b],
            weights: if node.undecomposed[a] { vec![] } else { leading.expand(&bases[a], node.ranks[a]).0 },
            groups: alike(node, a, LINES),
            slots: node.mixture[b] * node.ranks[b],
            starts: vec![],
            orders: vec![],
            basis: vec![],
            leading,
        };
        permuted.cut(&bases[b]);
        permuted
    }

    /// Cut the columns, with the basis of mode b, which is stored as `[I_b, K_b, cells but b, R_b]`.
    fn cut(&mut self, stored: &[f32]) {
        let (node, b) = (self.leading.node, self.leading.node.order() - 1);
        let (mixture, rank, cells) = (node.mixture[b], node.ranks[b], node.cells() / node.clusters[b]);
        let cuts: Vec<(usize, usize)> = cut(self.columns, self.lanes).collect();
        self.orders = vec![Order::default(); mixture * rank * cuts.len()];
        self.basis = vec![Padded::default(); cells * self.orders.len()];
        for (number, &(first, new)) in cuts.iter().enumerate() {
            for j in first..self.columns.min(first + self.lanes) {
                for (k, r) in (0..mixture).flat_map(|k| (0..rank).map(move |r| (k, r))) {
                    let (slot, at) = (j * mixture + k, (number * mixture + k) * rank + r);
                    self.orders[at][j - first] = (usize::from(node.members(b)[slot]) * rank + r) as u32;
                    for cell in (0..cells).filter(|_| j >= new) {
                        self.basis[cell * self.orders.len() + at].0[j - first] =
                            stored[(slot * cells + cell) * rank + r];
                    }
                }
            }
        }
        self.starts = cuts.into_iter().map(|(first, _)| first).collect();
    }
}

/// Some groups of lines in the plane of one tuple of the leading modes, and the next plane.
struct Plane<'p> {
    permuted: &'p Permuted<'p>,
    groups: &'p [Vec<u32>],
    present: &'p Partial,
    start: *mut f32,
    next: *mut f32,
    /// From one row of mode a to the next.
    step: usize,
    buffers: &'p mut Buffers,
}

/// The cells that the lines of each group belong to.
#[derive(Default)]
struct Buffers {
    /// Where the basis of mode b starts.
    bases: Vec<usize>,
    /// What is contracted of their cores, `[cells, lines]` for each group; unused where mode a is undecomposed, so that
    /// each of its rows has cores of its own.
    numbers: Vec<Padded>,
}

/// What a group of lines is made from.
struct Group<'p> {
    /// Where the basis of mode b starts, of each cell that they belong to.
    bases: &'p [usize],
    /// Contracted cores of the lines, for each of these cells, whose first ones are so far apart.
    numbers: &'p [Padded],
    apart: usize,
}

impl WithSimd for Plane<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // SAFETY: the machine has these vectors; the plane lies in the tensor, and this thread alone works on these lines.
        unsafe {
            match S::F32_LANES {
                #[cfg(target_arch = "x86_64")]
                16 => self.add::<S, std::arch::x86_64::__m512>(simd),
                #[cfg(target_arch = "x86_64")]
                8 => self.add::<S, std::arch::x86_64::__m256>(simd),
                _ => self.add::<S, [f32; 4]>(simd),
            }
        }
    }
}

impl Plane<'_> {
    /// # Safety
    /// The machine has vectors `V`, and nobody else refers to the lines of these groups.
    #[inline(always)]
    unsafe fn add<S: Simd, V: Shuffle>(self, simd: S) {
        assert!(V::LANES == self.permuted.lanes);
        let Plane { permuted, groups, present, start, next, step, buffers: Buffers { bases, numbers } } = self;
        let count = present.cells.len() * permuted.leading.node.mixture[permuted.leading.depth];
        let apart = permuted.leading.node.undecomposed[permuted.leading.depth];
        if apart {
            let bases = room(bases, count).iter_mut();
            bases.zip(&present.cells).for_each(|(basis, cell)| *basis = cell * permuted.orders.len());
        }
        for (number, rows) in groups.iter().enumerate() {
            if !apart && number % TOGETHER == 0 {
                let groups = &groups[number..groups.len().min(number + TOGETHER)];
                permuted.contract(simd, groups, present, (&mut *bases, &mut *numbers));
            }
            let ahead = number + AHEAD;
            let plane = if ahead < groups.len() { start } else { next };
            for &row in &groups[ahead % groups.len()] {
                prefetch_from(plane.wrapping_add(row as usize * step), permuted.columns);
            }
            let group = if apart {
                Group { bases: &bases[..count], numbers: &present.cores.0[rows[0] as usize..], apart: permuted.rows }
            } else {
                let at = number % TOGETHER * count;
                Group { bases: &bases[at..at + count], numbers: &numbers[at * LINES..], apart: rows.len() }
            };
            let lines = (start, step);
            // SAFETY: the machine has vectors `V`, as the caller promises, and nobody else has the lines of this
            // plane.
            unsafe {
                match rows.len() {
                    1 => permuted.lines::<V, 1>(lines, rows, &group),
                    2 => permuted.lines::<V, 2>(lines, rows, &group),
                    3 => permuted.lines::<V, 3>(lines, rows, &group),
                    4 => permuted.lines::<V, 4>(lines, rows, &group),
                    5 => permuted.lines::<V, 5>(lines, rows, &group),
                    6 => permuted.lines::<V, 6>(lines, rows, &group),
                    7 => permuted.lines::<V, 7>(lines, rows, &group),
                    _ => permuted.lines::<V, LINES>(lines, rows, &group),
                }
            }
        }
    }
}

impl Permuted<'_> {
    /// Contract the cores of the cells that lines belong to with their rows of mode a; where the bases of these cells are.
    #[inline(always)]
    fn contract<S: Simd>(
        &self,
        simd: S,
        groups: &[Vec<u32>],
        Partial { cells, cores }: &Partial,
        (bases, numbers): (&mut Vec<usize>, &mut Vec<Padded>),
    ) {
        let Permuted { leading: Leading { node, depth: a, .. }, weights, orders, .. } = self;
        let (clusters, mixture, rank) = (node.clusters[*a], node.mixture[*a], node.ranks[*a]);
        let (count, before) = (cells.len() * mixture, node.clusters[..*a].iter().product::<usize>());
        assert!(cores.len() == cells.len() * clusters * rank * PAD && cells.iter().all(|&cell| cell < before));
        assert!(weights.len() == node.sizes[*a] * mixture * before * rank);
        let bases = room(bases, TOGETHER * count).chunks_exact_mut(count);
        let numbers = room(numbers, TOGETHER * count * LINES).chunks_exact_mut(count * LINES);
        for ((rows, bases), numbers) in groups.iter().zip(bases).zip(numbers) {
            let (subset, mut out) = (subsets(node, *a, rows[0]), numbers.iter_mut());
            for ((p, k), basis) in (0..cells.len()).flat_map(|p| (0..mixture).map(move |k| (p, k))).zip(bases) {
                let (cell, c) = (cells[p], usize::from(subset[k]));
                *basis = (cell * clusters + c) * orders.len();
                for (&row, out) in rows.iter().zip(&mut out) {
                    // SAFETY: the numbers of all cells and rows are there, as asserted.
                    unsafe {
                        let core = cores.as_ptr().add((p * clusters + c) * rank * PAD);
                        let weights = weights.as_ptr().add(((row as usize * mixture + k) * before + cell) * rank);
                        let mut sum = simd.mul_f32s(core.cast::<S::f32s>().read_unaligned(), *weights.cast());
                        for r in 1..rank {
                            let core = core.add(r * PAD).cast::<S::f32s>().read_unaligned();
                            sum = simd.mul_add_e_f32s(core, *weights.add(r).cast(), sum);
                        }
                        S::as_mut_simd_f32s(&mut out.0).0[0] = sum;
                    }
                }
            }
        }
    }

    /// Add to the lines of `M` rows of mode a that share their subsets.
    ///
    /// # Safety
    /// The machine has vectors `V`, here and below, and nobody else refers to these lines of the plane.
    #[inline(always)]
    unsafe fn lines<V: Shuffle, const M: usize>(&self, (plane, step): (*mut f32, usize), rows: &[u32], group: &Group) {
        let &Group { bases, numbers, apart } = group;
        assert!(rows.len() == M && numbers.len() >= (bases.len() - 1) * apart + M && self.columns >= V::LANES);
        assert!(bases.iter().all(|from| from + self.orders.len() <= self.basis.len()));
        let mut lines = [plane; M];
        lines.iter_mut().zip(rows).for_each(|(line, &row)| *line = line.wrapping_add(row as usize * step));
        // SAFETY: as the caller promises; bases and numbers are there, as asserted.
        unsafe {
            self.vectors::<V, M>(lines, group);
        }
    }

    /// Vector by vector of their columns.
    ///
    /// # Safety
    /// That of `lines`, which has checked what the group points to.
    #[inline(always)]
    unsafe fn vectors<V: Shuffle, const M: usize>(&self, lines: [*mut f32; M], group: &Group) {
        let mut slot = 0;
        for &first in &self.starts {
            // SAFETY: the caller has the lines, each of a vector of numbers or more from every start; bases and
            // numbers of the group are there.
            unsafe {
                let mut sums = lines.map(|line| V::load(line.add(first)));
                for _ in 0..self.slots {
                    let (order, mut numbers) = (&self.orders[slot], group.numbers.as_ptr());
                    for from in group.bases {
                        let factors = V::load(self.basis.as_ptr().add(from + slot).cast());
                        for (m, sum) in sums.iter_mut().enumerate() {
                            *sum = sum.multiply_add_shuffled(order, numbers.add(m).cast(), factors);
                        }
                        numbers = numbers.wrapping_add(group.apart);
                    }
                    slot += 1;
                }
                lines.into_iter().zip(sums).for_each(|(line, sum)| sum.store(line.add(first)));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::Example;

    #[test]
    fn agrees_with_reconstruction_cell_by_cell() {
        on_all_machines(|| {
            // Overlapping or not, an undecomposed mode leading and as mode a, no leading mode, many groups.
            compare_with_cells(&[3, 21, 37], &[1, 3, 4], &[1, 2, 2], &[3, 1, 1], Some(0));
            compare_with_cells(&[3, 4, 37], &[2, 1, 4], &[2, 1, 2], &[2, 4, 1], Some(1));
            compare_with_cells(&[5, 7, 6, 30], &[2, 3, 2, 2], &[1, 1, 1, 1], &[2, 1, 3, 2], None);
            compare_with_cells(&[3, 40, 16], &[2, 3, 2], &[2, 2, 2], &[2, 3, 1], None);
            compare_with_cells(&[300, 50], &[90, 2], &[1, 1], &[3, 2], None);
        });
        // Shared by threads, which run with the best instruction set: groups, several planes each, and both.
        compare_with_cells(&[4000, 60], &[5, 2], &[1, 1], &[2, 2], None);
        compare_with_cells(&[70, 60, 50], &[2, 3, 4], &[1, 2, 2], &[2, 3, 1], None);
        compare_with_cells(&[30, 140, 50], &[2, 3, 2], &[1, 1, 1], &[2, 3, 2], None);
    }

    fn compare_with_cells(sizes: &[usize], c: &[usize], k: &[usize], ranks: &[usize], undecomposed: Option<usize>) {
        let example = Example::new(sizes, c, k, ranks, undecomposed);
        example.compare(|node, tensor, bases, cores, weight| {
            assert!(node.clusters[node.order() - 1] * node.ranks[node.order() - 1] <= lanes());
            accumulate(node, tensor, bases, cores, weight);
        });
    }

    #[test]
    fn pays_where_a_vector_holds_all_numbers_of_a_line() {
        let pays = |c: [usize; 2], k: [usize; 2], ranks: [usize; 2]| {
            let example = Example::new(&[400, 300], &c, &k, &ranks, None);
            super::pays(&example.node())
        };
        assert_eq!(pays([2, 4], [2, 2], [2, 1]), lanes() >= 8);
        assert!(!pays([2, 4], [1, 1], [2, 1]), "cells that do not overlap are rounded as each alone");
        assert!(!pays([1, 1], [1, 1], [2, 1]), "without clusters matrices are multiplied");
        assert!(!pays([2, 4], [2, 2], [2, 2]) && !pays([2, 17], [2, 2], [2, 1]));
        assert!(!pays([400, 2], [1, 2], [100, 1]), "the numbers would be many beside the tensor's");
    }
}
