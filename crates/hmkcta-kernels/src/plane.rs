//! What all cells that meet at some leading indices add to one plane, some lines at a time.

use crate::machine::prefetch_from;
use crate::planes::{Buffers, Group, LINES, PAD, Partial, Planes};
use crate::threads::room;
use pulp::{Simd, WithSimd};

/// One plane.
pub struct Plane<'p> {
    pub planes: &'p Planes<'p>,
    pub present: &'p Partial,
    pub buffers: &'p mut Buffers,
    pub x: &'p mut [f32],
}

impl WithSimd for Plane<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Plane { planes, present, buffers: Buffers { choices, coefficients, lines }, x } = self;
        let node = planes.node;
        let numbers = node.clusters[planes.depth + 1] * node.ranks[planes.depth + 1] * LINES;
        let coefficients = room(coefficients, present.cells.len() * node.mixture[planes.depth] * numbers);
        let lines = room(lines, LINES * planes.line() + PAD);
        for (number, group) in planes.groups.iter().enumerate() {
            choose(planes, present, &group.subsets, choices);
            contract(planes, choices, &present.cores, group, coefficients);
            let ahead = Ahead::of(planes, number + 1, node.clusters[planes.depth + 1], x);
            let mut tiles = Tiles { planes, choices, coefficients, numbers, ahead };
            match group.rows.len() {
                1 => tiles.add::<S, 1>(simd, lines, group, x),
                2 => tiles.add::<S, 2>(simd, lines, group, x),
                3 => tiles.add::<S, 3>(simd, lines, group, x),
                4 => tiles.add::<S, 4>(simd, lines, group, x),
                5 => tiles.add::<S, 5>(simd, lines, group, x),
                6 => tiles.add::<S, 6>(simd, lines, group, x),
                7 => tiles.add::<S, 7>(simd, lines, group, x),
                _ => tiles.add::<S, 8>(simd, lines, group, x),
            }
        }
    }
}

/// The rows of the group that comes next, of this plane or of the one behind it.
struct Ahead<'a> {
    rows: std::slice::Chunks<'a, u32>,
    plane: *const f32,
    columns: usize,
}

impl<'a> Ahead<'a> {
    /// In so many parts.
    fn of(planes: &'a Planes, group: usize, parts: usize, x: &[f32]) -> Self {
        let (at, behind) = if group < planes.groups.len() { (group, 0) } else { (0, x.len()) };
        let rows = &planes.groups[at].rows;
        let rows = rows.chunks(rows.len().div_ceil(parts));
        Ahead { rows, plane: x.as_ptr().wrapping_add(behind), columns: planes.columns }
    }

    /// Have the next part fetched: more at once than a core can wait for beside its work hold it up.
    #[inline(always)]
    fn fetch(&mut self) {
        for &row in self.rows.next().unwrap_or_default() {
            prefetch_from(self.plane.wrapping_add(row as usize * self.columns), self.columns);
        }
    }
}

/// One cell but for its cluster of mode b, of those that lines of a group belong to.
pub struct Choice {
    /// Where its core `[R_a, lanes]` is among those present.
    core: usize,
    /// Where its numbers `[C_b, R_a, LINES]` are in the basis of a group.
    basis: usize,
    /// Where its panels start.
    panel: usize,
}

/// The cells of lines with these subsets of mode a: `[combinations, K_a]`.
fn choose(planes: &Planes, present: &Partial, subsets: &[u16], choices: &mut Vec<Choice>) {
    let (node, a) = (planes.node, planes.depth);
    let (clusters, rank) = (node.clusters[a], node.ranks[a]);
    let (size, numbers) = (rank * planes.lanes, node.clusters[a + 1] * rank * LINES);
    let (leading, panel): (usize, usize) = (node.clusters[..a].iter().product(), planes.panel());
    choices.clear();
    for (combination, &cell) in present.cells.iter().enumerate() {
        for (k, &c) in subsets.iter().enumerate() {
            let c = usize::from(c);
            choices.push(Choice {
                core: (combination * clusters + c) * size,
                basis: (k * leading + cell) * numbers,
                panel: (cell * clusters + c) * panel,
            });
        }
    }
}

/// Contract the cores with the rows of mode a of a group: `[choices, C_b, R_b, LINES]`.
#[inline(always)]
fn contract(planes: &Planes, choices: &[Choice], cores: &[f32], group: &Group, coefficients: &mut [f32]) {
    let ranks = (planes.node.ranks[planes.depth], planes.node.ranks[planes.depth + 1]);
    match ranks {
        (3, 3) => contract_ranks::<3, 3>(planes, choices, cores, group, coefficients),
        (2, 2) => contract_ranks::<2, 2>(planes, choices, cores, group, coefficients),
        (1, 1) => contract_ranks::<1, 1>(planes, choices, cores, group, coefficients),
        _ => contract_ranks::<0, 0>(planes, choices, cores, group, coefficients),
    }
}

/// `A`, `B`: R_a and R_b where they are known, else 0.
#[inline(always)]
fn contract_ranks<const A: usize, const B: usize>(
    planes: &Planes,
    choices: &[Choice],
    cores: &[f32],
    group: &Group,
    coefficients: &mut [f32],
) {
    let (a, b) = (planes.depth, planes.depth + 1);
    let (rank_a, rank_b) = if A > 0 { (A, B) } else { (planes.node.ranks[a], planes.node.ranks[b]) };
    let clusters = planes.node.clusters[b];
    let (lines, _) = coefficients.as_chunks_mut::<LINES>();
    let mut outs = lines.chunks_exact_mut(rank_b);
    for choice in choices {
        let core = &cores[choice.core..][..rank_a * planes.lanes];
        let (basis, _) = group.basis[choice.basis..][..clusters * rank_a * LINES].as_chunks::<LINES>();
        for (c, (basis, outs)) in basis.chunks_exact(rank_a).zip(&mut outs).enumerate() {
            if A > 0 {
                // All sums of a cell stay in registers.
                let mut sums = [[0.0; LINES]; B];
                for (weights, core) in basis[..A].iter().zip(core.chunks_exact(planes.lanes)) {
                    let core: &[f32; B] = core[c * B..][..B].try_into().unwrap();
                    for (sum, z) in sums.iter_mut().zip(core) {
                        sum.iter_mut().zip(weights).for_each(|(sum, u)| *sum += z * u);
                    }
                }
                outs.copy_from_slice(&sums);
                continue;
            }
            for (r, out) in outs.iter_mut().enumerate() {
                let mut sum = [0.0; LINES];
                for (weights, core) in basis.iter().zip(core.chunks_exact(planes.lanes)) {
                    let z = core[c * rank_b + r];
                    sum.iter_mut().zip(weights).for_each(|(sum, u)| *sum += z * u);
                }
                *out = sum;
            }
        }
    }
}

/// Products of some lines' coefficients with the panels of their cells.
struct Tiles<'t> {
    planes: &'t Planes<'t>,
    choices: &'t [Choice],
    /// `[choices, C_b, R_b, LINES]`, so many numbers for each choice.
    coefficients: &'t [f32],
    numbers: usize,
    ahead: Ahead<'t>,
}

impl Tiles<'_> {
    /// Add the `M` lines of a group to its rows of a plane.
    #[inline(always)]
    fn add<S: Simd, const M: usize>(&mut self, simd: S, lines: &mut [f32], group: &Group, x: &mut [f32]) {
        self.all::<S, M>(simd, lines);
        let rows = std::array::from_fn(|m| group.rows[m]);
        self.planes.places.add::<S, M>(simd, lines, self.planes.line(), &rows, x);
    }

    /// `M` lines.
    #[inline(always)]
    fn all<S: Simd, const M: usize>(&mut self, simd: S, lines: &mut [f32]) {
        let b = self.planes.depth + 1;
        // Sums, vectors and a weight stay in registers.
        let wide = ((S::REGISTER_COUNT - 2) / (M + 1)).clamp(1, 3);
        for c in 0..self.planes.node.clusters[b] {
            self.ahead.fetch();
            let vectors = self.planes.node.rows(b, c).len().div_ceil(S::F32_LANES);
            let step = if vectors <= wide { vectors.max(1) } else { vectors.div_ceil(2).min(wide) };
            for first in (0..vectors).step_by(step) {
                // SAFETY: members are padded to whole vectors, and lines are as long as all of them.
                unsafe {
                    match step.min(vectors - first) {
                        1 => self.tile::<S, M, 1>(simd, c, first, lines),
                        2 => self.tile::<S, M, 2>(simd, c, first, lines),
                        _ => self.tile::<S, M, 3>(simd, c, first, lines),
                    }
                }
            }
        }
    }

    /// `M` lines of `V` vectors of the members of one cluster of mode b, which stay in registers.
    #[inline(always)]
    unsafe fn tile<S: Simd, const M: usize, const V: usize>(&self, simd: S, c: usize, first: usize, lines: &mut [f32]) {
        let &Tiles { planes, choices, coefficients, numbers: each, .. } = self;
        let rank = planes.node.ranks[planes.depth + 1];
        let (start, line) = (planes.starts[c], planes.line());
        let width = planes.starts[c + 1] - start;
        let mut sums = [[simd.splat_f32s(0.0); V]; M];
        unsafe {
            let mut weights = coefficients.as_ptr().add(c * rank * LINES);
            for choice in choices {
                let mut numbers = planes.panels.as_ptr().add(choice.panel + start * rank + first * S::F32_LANES);
                for r in 0..rank {
                    let values: [S::f32s; V] =
                        std::array::from_fn(|v| numbers.add(v * S::F32_LANES).cast::<S::f32s>().read_unaligned());
                    for (m, sums) in sums.iter_mut().enumerate() {
                        let weight = simd.splat_f32s(*weights.add(r * LINES + m));
                        for (sum, value) in sums.iter_mut().zip(values) {
                            *sum = simd.mul_add_e_f32s(weight, value, *sum);
                        }
                    }
                    numbers = numbers.wrapping_add(width);
                }
                weights = weights.wrapping_add(each);
            }
            for (m, sums) in sums.into_iter().enumerate() {
                let out = lines.as_mut_ptr().add(m * line + start + first * S::F32_LANES);
                for (v, sum) in sums.into_iter().enumerate() {
                    out.add(v * S::F32_LANES).cast::<S::f32s>().write_unaligned(sum);
                }
            }
        }
    }
}
