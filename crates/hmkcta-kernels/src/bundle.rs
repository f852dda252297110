//! What all cells that meet at some rows of the leading modes add to the lines there, some lines at a time.
//!
//! These rows are a bundle: they differ in the last leading mode only, and share their subsets there. So they meet the
//! same cells, and the columns of a cluster of mode b, of all tuples of the bundle, fill vectors side by side.

use crate::grouped::{Group, Lines, ROWS};
use crate::leading::{PAD, Partial};
use crate::machine::prefetch_from;
use crate::threads::room;
use pulp::{Simd, WithSimd};

/// Most vectors of columns worked on at a time.
const WIDE: usize = 3;

/// Buffers of one task.
#[derive(Default)]
pub struct Buffers {
    /// Where the tuples of a bundle and of the next one start.
    pub starts: Vec<*mut f32>,
    pub ahead: Vec<*mut f32>,
    /// The cells that lines of a group belong to.
    pub choices: Vec<Choice>,
    /// Cores contracted with the bases of mode b: lines `[combinations, C_a, R_a]`.
    pub panels: Vec<f32>,
    /// Lines of the rows of a group.
    pub lines: Vec<f32>,
}

/// One bundle.
pub struct Bundle<'p> {
    lines: &'p Lines<'p>,
    present: &'p Partial,
    buffers: &'p mut Buffers,
    /// From one row of mode a to the next.
    step: usize,
}

impl<'p> Bundle<'p> {
    /// # Safety
    /// From each of the buffers' starts there are all columns of all rows of mode a, and nobody else refers to them.
    pub unsafe fn new(lines: &'p Lines<'p>, present: &'p Partial, buffers: &'p mut Buffers, step: usize) -> Self {
        Bundle { lines, present, buffers, step }
    }
}

impl WithSimd for Bundle<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Bundle { lines, present, buffers: Buffers { starts, ahead, choices, panels, lines: sums }, step } = self;
        let (node, a) = (lines.node, lines.leading.depth);
        let panels = room(panels, present.cells.len() * node.clusters[a] * node.ranks[a] * lines.places.line());
        match node.ranks[a + 1] {
            1 => expand::<S, 1>(simd, lines, present, starts.len(), panels),
            2 => expand::<S, 2>(simd, lines, present, starts.len(), panels),
            3 => expand::<S, 3>(simd, lines, present, starts.len(), panels),
            4 => expand::<S, 4>(simd, lines, present, starts.len(), panels),
            _ => expand::<S, 0>(simd, lines, present, starts.len(), panels),
        }
        let sums = room(sums, ROWS * lines.places.line() + PAD);
        for (number, group) in lines.groups.iter().enumerate() {
            choose(lines, present, &group.subsets, choices);
            let (next, of) = lines.groups.get(number + 1).map_or((&lines.groups[0], &*ahead), |next| (next, &*starts));
            let ahead = Ahead { rows: &next.rows, starts: of, step, columns: lines.columns, at: 0 };
            let mut tiles = Tiles { lines, choices, group, panels, starts, step, ahead };
            match group.rows.len() {
                1 => tiles.add::<S, 1>(simd, sums),
                2 => tiles.add::<S, 2>(simd, sums),
                3 => tiles.add::<S, 3>(simd, sums),
                4 => tiles.add::<S, 4>(simd, sums),
                5 => tiles.add::<S, 5>(simd, sums),
                6 => tiles.add::<S, 6>(simd, sums),
                7 => tiles.add::<S, 7>(simd, sums),
                _ => tiles.add::<S, 8>(simd, sums),
            }
        }
    }
}

/// Contract the cores of `count` tuples with the bases of mode b: lines `[combinations, C_a, R_a]`; `B`: R_b if it is
/// known, else 0.
#[inline(always)]
fn expand<S: Simd, const B: usize>(simd: S, lines: &Lines, present: &Partial, count: usize, panels: &mut [f32]) {
    let (node, a, places, lanes) = (lines.node, lines.leading.depth, &lines.places, lines.leading.lanes);
    let (clusters, rank, rank_b) = (node.clusters[a], node.ranks[a], node.ranks[a + 1]);
    let (basis, line, tuple) = (lines.basis(), places.line(), present.cores.len() / count);
    for (number, panels) in panels.chunks_exact_mut(rank * line).enumerate() {
        let cell = present.cells[number / clusters] * clusters + number % clusters;
        let bases = &lines.bases[cell * basis..][..basis];
        let cores = &present.cores[number * rank * lanes..];
        for (c, &members) in places.members.iter().enumerate() {
            let basis = &bases[places.starts[c] * rank_b..];
            // What a tuple has too much is the next one's, so each is finished before.
            let together = if members <= WIDE * S::F32_LANES { count } else { 1 };
            for t in (0..count).step_by(together) {
                for first in (0..members).step_by(WIDE * S::F32_LANES) {
                    let part = Part {
                        cores: &cores[t * tuple + c * rank_b..],
                        core_steps: (tuple, lanes),
                        basis: &basis[first..],
                        width: members.next_multiple_of(PAD),
                        out: &mut panels[places.segments[c] + t * members + first..],
                        out_steps: (members, line),
                        sizes: (together, rank, rank_b),
                    };
                    // SAFETY: members are padded to whole vectors, and lines are as long as all of them.
                    unsafe {
                        match (members - first).div_ceil(S::F32_LANES) {
                            1 => part.combine::<S, B, 1>(simd),
                            2 => part.combine::<S, B, 2>(simd),
                            _ => part.combine::<S, B, 3>(simd),
                        }
                    }
                }
            }
        }
    }
}

/// `out[t, i, j] = sum_r cores[t, i, r] basis[r, j]` for some tuples, R_a, R_b and some members of a cluster of mode b.
struct Part<'p> {
    cores: &'p [f32],
    /// From one tuple to the next, from one number of R_a to the next.
    core_steps: (usize, usize),
    basis: &'p [f32],
    /// From one number of R_b to the next.
    width: usize,
    out: &'p mut [f32],
    out_steps: (usize, usize),
    /// Tuples, R_a, R_b.
    sizes: (usize, usize, usize),
}

impl Part<'_> {
    /// `V` vectors of members; `B`: R_b if it is known, else 0.
    ///
    /// # Safety
    /// All these numbers lie within the slices.
    #[inline(always)]
    unsafe fn combine<S: Simd, const B: usize, const V: usize>(self, simd: S) {
        let Part { cores, core_steps, basis, width, out, out_steps, sizes: (tuples, rank, rank_b) } = self;
        // SAFETY: as the caller promises.
        unsafe {
            let row = |r: usize| -> [S::f32s; V] {
                let at = basis.as_ptr().add(r * width).cast::<S::f32s>();
                std::array::from_fn(|v| at.add(v).read_unaligned())
            };
            let known: [[S::f32s; V]; B] = std::array::from_fn(row);
            for t in 0..tuples {
                for i in 0..rank {
                    let core = cores.as_ptr().add(t * core_steps.0 + i * core_steps.1);
                    let mut sums = [simd.splat_f32s(0.0); V];
                    for r in 0..if B > 0 { B } else { rank_b } {
                        let weight = simd.splat_f32s(*core.add(r));
                        let values = if B > 0 { known[r % B.max(1)] } else { row(r) };
                        for (sum, value) in sums.iter_mut().zip(values) {
                            *sum = simd.mul_add_e_f32s(weight, value, *sum);
                        }
                    }
                    let to = out.as_mut_ptr().add(t * out_steps.0 + i * out_steps.1).cast::<S::f32s>();
                    sums.into_iter().enumerate().for_each(|(v, sum)| to.add(v).write_unaligned(sum));
                }
            }
        }
    }
}

/// Lines of the group that comes next, of this bundle or of the next one, which are fetched bit by bit: more at once
/// than a core can wait for beside its work hold it up.
struct Ahead<'a> {
    rows: &'a [u32],
    starts: &'a [*mut f32],
    step: usize,
    columns: usize,
    at: usize,
}

impl Ahead<'_> {
    /// Have the next lines fetched, of `parts` parts one.
    #[inline(always)]
    fn fetch(&mut self, parts: usize) {
        let count = self.rows.len() * self.starts.len();
        let end = count.min(self.at + count.div_ceil(parts));
        for at in self.at..end {
            let row = self.rows[at % self.rows.len()] as usize;
            prefetch_from(self.starts[at / self.rows.len()].wrapping_add(row * self.step), self.columns);
        }
        self.at = end;
    }
}

/// One cell but for its cluster of mode b, of those that lines of a group belong to.
pub struct Choice {
    /// Where its numbers `[C_b, R_a, ROWS]` are in the basis of a group.
    basis: usize,
    /// Where its lines `[R_a]` start.
    panel: usize,
}

/// The cells of lines with these subsets of mode a: `[combinations, K_a]`.
fn choose(lines: &Lines, present: &Partial, subsets: &[u16], choices: &mut Vec<Choice>) {
    let (node, a) = (lines.node, lines.leading.depth);
    let (clusters, rank) = (node.clusters[a], node.ranks[a]);
    let numbers = node.clusters[a + 1] * rank * ROWS;
    let leading: usize = node.clusters[..a].iter().product();
    choices.clear();
    for (combination, &cell) in present.cells.iter().enumerate() {
        for (k, &c) in subsets.iter().enumerate() {
            choices.push(Choice {
                basis: (k * leading + cell) * numbers,
                panel: (combination * clusters + usize::from(c)) * rank * lines.places.line(),
            });
        }
    }
}

/// Products of some rows of mode a with the lines that they weigh.
struct Tiles<'t> {
    lines: &'t Lines<'t>,
    choices: &'t [Choice],
    group: &'t Group,
    panels: &'t [f32],
    /// Where the tuples start, and from one row of mode a to the next.
    starts: &'t [*mut f32],
    step: usize,
    ahead: Ahead<'t>,
}

impl Tiles<'_> {
    /// Add the lines of a group of `M` rows to the tensor.
    #[inline(always)]
    fn add<S: Simd, const M: usize>(&mut self, simd: S, sums: &mut [f32]) {
        self.all::<S, M>(simd, sums);
        for (tuple, start) in self.starts.iter().enumerate() {
            let rows = std::array::from_fn(|m| start.wrapping_add(self.group.rows[m] as usize * self.step));
            // SAFETY: as `Bundle::new` was promised.
            unsafe { self.lines.places.add::<S, M>(simd, sums, tuple, rows) };
        }
    }

    /// Lines of `M` rows, of all tuples.
    #[inline(always)]
    fn all<S: Simd, const M: usize>(&mut self, simd: S, sums: &mut [f32]) {
        // Sums, vectors and a weight stay in registers.
        let wide = ((S::REGISTER_COUNT - 2) / (M + 1)).clamp(1, WIDE);
        let places = &self.lines.places;
        for (c, &members) in places.members.iter().enumerate() {
            self.ahead.fetch(places.members.len());
            let vectors = (members * self.starts.len()).div_ceil(S::F32_LANES);
            let step = vectors.div_ceil(vectors.div_ceil(wide).max(1)).max(1);
            for first in (0..vectors).step_by(step) {
                // SAFETY: members are padded to whole vectors, and lines are as long as all of them.
                unsafe {
                    match step.min(vectors - first) {
                        1 => self.tile::<S, M, 1>(simd, c, first, sums),
                        2 => self.tile::<S, M, 2>(simd, c, first, sums),
                        _ => self.tile::<S, M, 3>(simd, c, first, sums),
                    }
                }
            }
        }
    }

    /// Lines of `M` rows, `V` vectors of the members of one cluster of mode b, which stay in registers.
    ///
    /// # Safety
    /// Lines, padded to whole vectors, have these members, and `out` has `M` lines.
    #[inline(always)]
    unsafe fn tile<S: Simd, const M: usize, const V: usize>(&self, simd: S, c: usize, first: usize, out: &mut [f32]) {
        let &Tiles { lines, choices, group, panels, .. } = self;
        let rank = lines.node.ranks[lines.leading.depth];
        let line = lines.places.line();
        let start = lines.places.segments[c] + first * S::F32_LANES;
        let mut sums = [[simd.splat_f32s(0.0); V]; M];
        // SAFETY: as the caller promises.
        unsafe {
            let (basis, panels) = (group.basis.as_ptr().add(c * rank * ROWS), panels.as_ptr().add(start));
            for choice in choices {
                let (mut weights, mut numbers) = (basis.add(choice.basis), panels.add(choice.panel));
                for _ in 0..rank {
                    let values: [S::f32s; V] =
                        std::array::from_fn(|v| numbers.add(v * S::F32_LANES).cast::<S::f32s>().read_unaligned());
                    for (m, sums) in sums.iter_mut().enumerate() {
                        let weight = simd.splat_f32s(*weights.add(m));
                        for (sum, value) in sums.iter_mut().zip(values) {
                            *sum = simd.mul_add_e_f32s(weight, value, *sum);
                        }
                    }
                    weights = weights.wrapping_add(ROWS);
                    numbers = numbers.wrapping_add(line);
                }
            }
            for (m, sums) in sums.into_iter().enumerate() {
                let out = out.as_mut_ptr().add(m * line + start);
                for (v, sum) in sums.into_iter().enumerate() {
                    out.add(v * S::F32_LANES).cast::<S::f32s>().write_unaligned(sum);
                }
            }
        }
    }
}
