//! What all cells that meet at some leading indices add to one plane, tile by tile.

use crate::machine::prefetch;
use crate::planes::{Buffers, COLUMNS, Partial, Planes, ROWS};
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
    fn with_simd<S: Simd>(mut self, simd: S) {
        for number in 0..self.planes.row_tiles.len() {
            self.prefetch(number);
            self.coefficients(simd, number);
            for column in 0..self.planes.column_tiles.len() {
                match COLUMNS / S::F32_LANES {
                    1 => self.tile::<S, 8, 1>(simd, number, column),
                    2 => self.tile::<S, 4, 2>(simd, number, column),
                    _ => self.tile::<S, 2, 4>(simd, number, column),
                }
            }
            self.store(simd, number);
        }
    }
}

impl Plane<'_> {
    /// Contract the cells' `[R_a, R_b]` with the rows of one tile.
    #[inline(always)]
    fn coefficients<S: Simd>(&mut self, _: S, number: usize) {
        let Plane { planes, present, buffers, .. } = self;
        let (a, b) = (planes.depth, planes.depth + 1);
        let (rank_a, rank_b, clusters_b) = (planes.node.ranks[a], planes.node.ranks[b], planes.node.clusters[b]);
        let (tile, start) = (&planes.row_tiles[number], planes.row_starts[number]);
        let length = planes.row_bases.len() / (planes.node.cells() / planes.node.clusters[a]);
        let (cells, numbers) = planes.left(a);
        let coefficients = &mut buffers.coefficients;
        coefficients.resize(present.cells.len() * tile.subsets.len() * clusters_b * rank_b * ROWS, 0.0);
        let mut outs = coefficients.chunks_exact_mut(rank_b * ROWS);
        for (&leading, cores) in present.cells.iter().zip(present.cores.chunks_exact(cells * numbers)) {
            for (subset, &c) in tile.subsets.iter().enumerate() {
                for c_b in 0..clusters_b {
                    let core = &cores[(usize::from(c) * clusters_b + c_b) * numbers..][..numbers];
                    let at = (leading * clusters_b + c_b) * length + start + subset * rank_a * ROWS;
                    let rows = &planes.row_bases[at..][..rank_a * ROWS];
                    let Some(out) = outs.next() else { return };
                    for (r_b, out) in out.chunks_exact_mut(ROWS).enumerate() {
                        let mut sum = [0.0; ROWS];
                        for (r_a, rows) in rows.chunks_exact(ROWS).enumerate() {
                            let z = core[r_a * rank_b + r_b];
                            sum.iter_mut().zip(rows).for_each(|(to, &u)| *to += z * u);
                        }
                        out.copy_from_slice(&sum);
                    }
                }
            }
        }
    }

    /// Sum up one tile, `M` rows by `V` vectors at a time, into `lines`.
    #[inline(always)]
    fn tile<S: Simd, const M: usize, const V: usize>(&mut self, simd: S, number: usize, column: usize) {
        let Plane { planes, present, buffers, .. } = self;
        let (a, b) = (planes.depth, planes.depth + 1);
        let (rank, clusters_a, clusters_b) = (planes.node.ranks[b], planes.node.clusters[a], planes.node.clusters[b]);
        let (rows, columns) = (&planes.row_tiles[number], &planes.column_tiles[column]);
        let length = planes.column_bases.len() / (planes.node.cells() / clusters_b);
        let panel = columns.subsets.len() * rank * COLUMNS;
        let width = planes.column_tiles.len() * COLUMNS;
        for top in (0..ROWS).step_by(M) {
            let mut sums = [[simd.splat_f32s(0.0); V]; M];
            let mut blocks = buffers.coefficients.chunks_exact(clusters_b * rank * ROWS);
            for &leading in &present.cells {
                for &c in &rows.subsets {
                    let Some(block) = blocks.next() else { return };
                    let at = (leading * clusters_a + usize::from(c)) * length + planes.column_starts[column];
                    let mut numbers = planes.column_bases[at..][..panel].as_ptr();
                    for &c_b in &columns.subsets {
                        let mut weights = block[usize::from(c_b) * rank * ROWS + top..].as_ptr();
                        for _ in 0..rank {
                            // SAFETY: a panel has `rank` lines of 16 numbers a subset, a block `rank` lines of 8 a cluster.
                            unsafe {
                                let mut values = [simd.splat_f32s(0.0); V];
                                for (v, value) in values.iter_mut().enumerate() {
                                    *value = numbers.add(v * S::F32_LANES).cast::<S::f32s>().read_unaligned();
                                }
                                for (m, line) in sums.iter_mut().enumerate() {
                                    let weight = simd.splat_f32s(*weights.add(m));
                                    for (sum, &value) in line.iter_mut().zip(&values) {
                                        *sum = simd.mul_add_e_f32s(weight, value, *sum);
                                    }
                                }
                                numbers = numbers.add(COLUMNS);
                                weights = weights.wrapping_add(ROWS);
                            }
                        }
                    }
                }
            }
            for (m, line) in sums.iter().enumerate() {
                let out = &mut buffers.lines[(top + m) * width + column * COLUMNS..][..COLUMNS];
                // SAFETY: V vectors are 16 numbers.
                unsafe {
                    for (v, &sum) in line.iter().enumerate() {
                        out.as_mut_ptr().add(v * S::F32_LANES).cast::<S::f32s>().write_unaligned(sum);
                    }
                }
            }
        }
    }

    /// Ask for the rows of a tile, which `store` will add to, while its sums are still being computed.
    #[inline(always)]
    fn prefetch(&self, number: usize) {
        let columns = self.planes.columns;
        for &row in &self.planes.row_tiles[number].rows {
            prefetch(&self.x[row as usize * columns..][..columns]);
        }
    }

    /// Add the lines to the plane, columns back in their places.
    #[inline(always)]
    fn store<S: Simd>(&mut self, _: S, number: usize) {
        let Plane { planes, buffers, x, .. } = self;
        let width = planes.column_tiles.len() * COLUMNS;
        for (&row, line) in planes.row_tiles[number].rows.iter().zip(buffers.lines.chunks_exact(width)) {
            let x = &mut x[row as usize * planes.columns..][..planes.columns];
            #[cfg(target_arch = "x86_64")]
            if S::F32_LANES == 16 {
                // SAFETY: `Planes::new` made every place one of a line; 16 lanes are AVX-512.
                unsafe { add_picked(x, line, &planes.places) };
                continue;
            }
            for (to, &place) in x.iter_mut().zip(&planes.places) {
                *to += line[place as usize];
            }
        }
    }
}

/// `x[i] += line[places[i]]`
///
/// # Safety
/// The machine has AVX-512, and all places lie in the line.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn add_picked(x: &mut [f32], line: &[f32], places: &[u32]) {
    use std::arch::x86_64::*;
    let mut places = places.chunks_exact(16);
    let mut targets = x.chunks_exact_mut(16);
    for (x, places) in targets.by_ref().zip(places.by_ref()) {
        unsafe {
            let index = _mm512_loadu_si512(places.as_ptr().cast());
            let picked = _mm512_i32gather_ps::<4>(index, line.as_ptr());
            _mm512_storeu_ps(x.as_mut_ptr(), _mm512_add_ps(_mm512_loadu_ps(x.as_ptr()), picked));
        }
    }
    for (x, &place) in targets.into_remainder().iter_mut().zip(places.remainder()) {
        *x += line[place as usize];
    }
}
