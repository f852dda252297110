//! Reconstruction of cells line by line where the last mode b has so few clusters and ranks that a vector holds a number
//! for each.
//!
//! For fixed rows of the other modes the cores of the cells that meet there are contracted to `[C_b, R_b]` each, one
//! vector. From it each column of the line takes the numbers of its clusters, by a permutation, and multiplies them by
//! its basis row.

use crate::cells::Node;
use crate::leading::{Leading, PAD, Partial, alike, subsets};
use crate::machine::{dispatch, lanes, prefetch_from};
use crate::places::cut;
use crate::shuffle::{Order, Shuffle};
use crate::threads::{PARALLEL, for_each, room};
use pulp::{Simd, WithSimd};

/// Lines worked on at a time, which share what is read of the basis of mode b.
const LINES: usize = 4;
/// How many groups of lines ahead lines are fetched.
const AHEAD: usize = 3;
/// Groups whose cores are contracted before any lines are made: what was just written takes long to read.
const TOGETHER: usize = 32;
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
    let permuted = Permuted::new(node, bases);
    let all = permuted.leading.cores(cores, weight);
    let planes = Planes(tensor.as_mut_ptr());
    let (count, parallel) = (permuted.leading.count(), tensor.len() >= PARALLEL);
    // Few planes are cut, too.
    let (piece, parts) = if parallel { (count.div_ceil(PIECES), PIECES.div_ceil(count)) } else { (count, 1) };
    let part = permuted.groups.len().div_ceil(parts);
    let pieces = (0..count).step_by(piece).flat_map(|from| permuted.groups.chunks(part).map(move |part| (from, part)));
    for_each(parallel, pieces.collect(), |(from, groups)| {
        let mut buffers = Buffers::default();
        permuted.leading.each(from..count.min(from + piece), &all, |number, present| {
            let [start, next] = [number, number + 1].map(|number| planes.start(&permuted, number));
            dispatch(Plane { permuted: &permuted, groups, present, start, next, buffers: &mut buffers });
        });
    });
}

/// The tensor: a plane of modes a and b for each tuple of the leading modes.
struct Planes(*mut f32);

// SAFETY: threads work on planes or groups of rows of their own, which share no element.
unsafe impl Sync for Planes {}

impl Planes {
    fn start(&self, permuted: &Permuted, number: usize) -> *mut f32 {
        let (rows, first) = permuted.leading.bundle(number);
        self.0.wrapping_add((first + rows[0] as usize) * permuted.rows * permuted.columns)
    }
}

/// Numbers of a vector, in one cache line: vectors that lie across two take longer to read, and much longer just after they
/// were written.
#[derive(Clone, Copy, Default)]
#[repr(align(64))]
struct Padded([f32; PAD]);

/// The same numbers so, if they are whole vectors.
fn padded(numbers: &[f32]) -> Vec<Padded> {
    numbers.as_chunks().0.iter().map(|&numbers| Padded(numbers)).collect()
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
    fn new(node: &'a Node<'a>, bases: &[&[f32]]) -> Self {
        let (a, b) = (node.order() - 2, node.order() - 1);
        let leading = Leading::new(node, bases, 1);
        assert!(node.clusters[b] * node.ranks[b] <= lanes());
        let mut permuted = Permuted {
            lanes: lanes(),
            rows: node.sizes[a],
            columns: node.sizes[b],
            weights: if node.undecomposed[a] { vec![] } else { padded(&leading.expand(bases[a], node.ranks[a])) },
            groups: alike(node, a, LINES),
            slots: node.mixture[b] * node.ranks[b],
            starts: vec![],
            orders: vec![],
            basis: vec![],
            leading,
        };
        permuted.cut(bases[b]);
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
    buffers: &'p mut Buffers,
}

/// The cells that the lines of each group belong to.
#[derive(Default)]
struct Buffers {
    /// Where the basis of mode b starts.
    bases: Vec<usize>,
    /// What is contracted of their cores, `[cells, lines]` for each group.
    numbers: Vec<Padded>,
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
        let Plane { permuted, groups, present, start, next, buffers: Buffers { bases, numbers } } = self;
        let count = present.cells.len() * permuted.leading.node.mixture[permuted.leading.depth];
        for (number, rows) in groups.iter().enumerate() {
            if number % TOGETHER == 0 {
                let groups = &groups[number..groups.len().min(number + TOGETHER)];
                permuted.contract(simd, groups, present, (&mut *bases, &mut *numbers));
            }
            let ahead = number + AHEAD;
            let plane = if ahead < groups.len() { start } else { next };
            for &row in &groups[ahead % groups.len()] {
                prefetch_from(plane.wrapping_add(row as usize * permuted.columns), permuted.columns);
            }
            let at = number % TOGETHER * count;
            let (bases, numbers) = (&bases[at..at + count], &numbers[at * LINES..][..rows.len() * count]);
            unsafe {
                match rows.len() {
                    1 => permuted.lines::<V, 1>(start, rows, bases, numbers),
                    2 => permuted.lines::<V, 2>(start, rows, bases, numbers),
                    3 => permuted.lines::<V, 3>(start, rows, bases, numbers),
                    _ => permuted.lines::<V, LINES>(start, rows, bases, numbers),
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
        assert!(node.undecomposed[*a] || weights.len() == node.sizes[*a] * mixture * before * rank);
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
                        if node.undecomposed[*a] {
                            out.0 = core.add(row as usize * PAD).cast::<[f32; PAD]>().read_unaligned();
                            continue;
                        }
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
    unsafe fn lines<V: Shuffle, const M: usize>(
        &self,
        plane: *mut f32,
        rows: &[u32],
        bases: &[usize],
        numbers: &[Padded],
    ) {
        assert!(rows.len() == M && numbers.len() == bases.len() * M && self.columns >= V::LANES);
        assert!(bases.iter().all(|from| from + self.orders.len() <= self.basis.len()));
        let mut lines = [plane; M];
        lines.iter_mut().zip(rows).for_each(|(line, &row)| *line = line.wrapping_add(row as usize * self.columns));
        unsafe {
            self.vectors::<V, M>(lines, bases, numbers);
        }
    }

    /// Vector by vector of their columns.
    #[inline(always)]
    unsafe fn vectors<V: Shuffle, const M: usize>(&self, lines: [*mut f32; M], bases: &[usize], numbers: &[Padded]) {
        let mut slot = 0;
        for &first in &self.starts {
            unsafe {
                let mut sums = lines.map(|line| V::load(line.add(first)));
                for _ in 0..self.slots {
                    let (order, mut numbers) = (&self.orders[slot], numbers.as_ptr());
                    for from in bases {
                        let factors = V::load(self.basis.as_ptr().add(from + slot).cast());
                        for sum in &mut sums {
                            *sum = sum.multiply_add_shuffled(order, numbers.cast(), factors);
                            numbers = numbers.add(1);
                        }
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
        compare_with_cells(&[30, 140, 50], &[2, 3, 4], &[1, 1, 1], &[2, 3, 2], None);
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
