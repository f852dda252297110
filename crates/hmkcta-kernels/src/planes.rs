//! Reconstruction of overlapping cells plane by plane: the last two modes make up a plane, `rows` by `columns`.
//!
//! For fixed leading indices the cores of the cells that meet there are contracted to `[R_a, R_b]` each. Eight rows of the
//! plane that share cluster subsets and 16 columns that do are one tile: what all their cells add to it is summed in
//! registers, so the tensor is read and written once whatever the mixture.

use crate::cells::Node;
use crate::machine::dispatch;
use crate::threads::{PARALLEL, for_each};
use crate::tiles::{Tile, tiles};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Rows and columns of a tile.
const ROWS: usize = 8;
const COLUMNS: usize = 16;
/// Pieces the planes are shared out in.
const PIECES: usize = 64;

/// Whether this way is open: two or more modes, of which the last two have bases, and planes enough for threads to share.
pub fn applies(node: &Node) -> bool {
    let order = node.order();
    if order < 2 || node.undecomposed[order - 1] || node.undecomposed[order - 2] {
        return false;
    }
    let planes: usize = node.sizes[..order - 2].iter().product();
    planes >= PIECES / 8 || node.sizes.iter().product::<usize>() < PARALLEL
}

/// `tensor += weight * model`
pub fn accumulate(node: &Node, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    let planes = Planes::new(node, bases);
    let weighted: Vec<f32> = cores.iter().map(|z| weight * z).collect();
    let all = Partial { cells: vec![0], cores: weighted };
    let plane = planes.rows * planes.columns;
    let count = tensor.len() / plane;
    let piece = count.div_ceil(PIECES);
    let parallel = tensor.len() >= PARALLEL;
    for_each(parallel, tensor.chunks_mut(piece * plane).enumerate().collect(), |(number, tensor)| {
        let mut work = Work::new(&planes);
        let from = number * piece;
        planes.descend(0, from..from + tensor.len() / plane, &all, &mut work.levels, &mut work.plane, tensor);
    });
}

/// A node prepared for it.
struct Planes<'a> {
    node: &'a Node<'a>,
    bases: &'a [&'a [f32]],
    /// N - 2, the number of leading modes.
    depth: usize,
    rows: usize,
    columns: usize,
    row_tiles: Vec<Tile>,
    column_tiles: Vec<Tile>,
    /// Of each row tile the first of its `[subsets, R_a, ROWS]` numbers among those of one leading and column subset.
    row_starts: Vec<usize>,
    /// Of each column tile the first of its `[subsets, R_b, COLUMNS]` numbers among those of one leading and row subset.
    column_starts: Vec<usize>,
    /// Basis numbers of the rows, `[leading cells, C_b, row tiles..]`, zero where a row is not the cell's.
    row_bases: Vec<f32>,
    /// Basis numbers of the columns, `[leading cells, C_a, column tiles..]`.
    column_bases: Vec<f32>,
    /// Where each column stands in a line of column tiles.
    places: Vec<u32>,
}

/// Combinations of leading subsets that meet at the present leading indices, and their cores contracted with the rows
/// of these: `[combinations, remaining cells, remaining ranks]`.
#[derive(Clone, Default)]
struct Partial {
    cells: Vec<usize>,
    cores: Vec<f32>,
}

/// Buffers of one task.
struct Work {
    levels: Vec<Partial>,
    plane: Buffers,
}

struct Buffers {
    /// Rows' coefficients of one row tile, `[combinations, subsets, C_b, R_b, ROWS]`.
    coefficients: Vec<f32>,
    /// `[ROWS, column tiles, COLUMNS]`
    lines: Vec<f32>,
}

impl Work {
    fn new(planes: &Planes) -> Work {
        let lines = vec![0.0; ROWS * planes.column_tiles.len() * COLUMNS];
        Work { levels: vec![Partial::default(); planes.depth], plane: Buffers { coefficients: vec![], lines } }
    }
}

impl<'a> Planes<'a> {
    fn new(node: &'a Node<'a>, bases: &'a [&'a [f32]]) -> Self {
        let depth = node.order() - 2;
        let (a, b) = (depth, depth + 1);
        let row_tiles = tiles(node.members(a), node.mixture[a], ROWS);
        let column_tiles = tiles(node.members(b), node.mixture[b], COLUMNS);
        let (row_starts, row_length) = starts(&row_tiles, node.ranks[a] * ROWS);
        let (column_starts, column_length) = starts(&column_tiles, node.ranks[b] * COLUMNS);
        let others = |n: usize| node.cells() / node.clusters[n];
        let mut places = vec![0; node.sizes[b]];
        for (number, tile) in column_tiles.iter().enumerate() {
            for (lane, &column) in tile.rows.iter().enumerate() {
                places[column as usize] = (number * COLUMNS + lane) as u32;
            }
        }
        // flat(c_-a) is the leading cell and c_b; flat(c_-b) the leading cell and c_a.
        Planes {
            row_bases: tiled(node, a, bases[a], &row_tiles, (ROWS, row_length, others(a))),
            column_bases: tiled(node, b, bases[b], &column_tiles, (COLUMNS, column_length, others(b))),
            rows: node.sizes[a],
            columns: node.sizes[b],
            node,
            bases,
            depth,
            row_tiles,
            column_tiles,
            row_starts,
            column_starts,
            places,
        }
    }

    /// Cells and core numbers that are left from mode `n` on.
    fn left(&self, n: usize) -> (usize, usize) {
        (self.node.clusters[n..].iter().product(), self.node.ranks[n..].iter().product())
    }

    /// Add the model to `x`, the planes `range` of those below the present leading indices.
    fn descend(
        &self,
        level: usize,
        range: Range<usize>,
        present: &Partial,
        levels: &mut [Partial],
        buffers: &mut Buffers,
        x: &mut [f32],
    ) {
        let Some((next, levels)) = levels.split_first_mut() else {
            return dispatch(Plane { planes: self, present, buffers, x });
        };
        let span: usize = self.node.sizes[level + 1..self.depth].iter().product();
        let plane = self.rows * self.columns;
        for i in range.start / span..range.end.div_ceil(span) {
            let below = range.start.max(i * span)..range.end.min((i + 1) * span);
            let part = &mut x[(below.start - range.start) * plane..(below.end - range.start) * plane];
            dispatch(Contract { planes: self, level, i, present, next });
            self.descend(level + 1, below.start - i * span..below.end - i * span, next, levels, buffers, part);
        }
    }
}

/// First numbers of the tiles, `unit` a subset, and how many there are.
fn starts(tiles: &[Tile], unit: usize) -> (Vec<usize>, usize) {
    let mut length = 0;
    let first = |tile: &Tile| {
        length += tile.subsets.len() * unit;
        length - tile.subsets.len() * unit
    };
    (tiles.iter().map(first).collect(), length)
}

/// Basis numbers of mode `n` as tiles, for each combination of the other modes' subsets.
fn tiled(
    node: &Node,
    n: usize,
    basis: &[f32],
    tiles: &[Tile],
    (width, length, others): (usize, usize, usize),
) -> Vec<f32> {
    let (mixture, rank) = (node.mixture[n], node.ranks[n]);
    let mut all = vec![0.0; length * others];
    let mut start = 0;
    for tile in tiles {
        for (lane, &row) in tile.rows.iter().enumerate() {
            let row = row as usize;
            for (k, c) in node.members(n)[row * mixture..][..mixture].iter().enumerate() {
                let subset = tile.subsets.iter().position(|s| s == c).unwrap_or(0);
                let from = &basis[(row * mixture + k) * others * rank..][..others * rank];
                for (other, numbers) in from.chunks_exact(rank).enumerate() {
                    let to = other * length + start + subset * rank * width + lane;
                    for (r, &u) in numbers.iter().enumerate() {
                        all[to + r * width] = u;
                    }
                }
            }
        }
        start += tile.subsets.len() * rank * width;
    }
    all
}

/// Keep the combinations that have row `i` of mode `level`, contract their cores with it.
struct Contract<'c> {
    planes: &'c Planes<'c>,
    level: usize,
    i: usize,
    present: &'c Partial,
    next: &'c mut Partial,
}

impl WithSimd for Contract<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Contract { planes, level: n, i, present, next } = self;
        let node = planes.node;
        let (clusters, rank, mixture) = (node.clusters[n], node.ranks[n], node.mixture[n]);
        let (cells, numbers) = planes.left(n + 1);
        next.cells.clear();
        next.cores.clear();
        for (&cell, cores) in present.cells.iter().zip(present.cores.chunks_exact(clusters * cells * rank * numbers)) {
            for (k, &c) in node.members(n)[i * mixture..][..mixture].iter().enumerate() {
                let c = usize::from(c);
                let cores = &cores[c * cells * rank * numbers..][..cells * rank * numbers];
                next.cells.push(cell * clusters + c);
                let start = next.cores.len();
                next.cores.resize(start + cells * numbers, 0.0);
                let outs = next.cores[start..].chunks_exact_mut(numbers).zip(cores.chunks_exact(rank * numbers));
                if node.undecomposed[n] {
                    outs.for_each(|(out, core)| out.copy_from_slice(&core[i * numbers..][..numbers]));
                    continue;
                }
                // flat(c_-n): the subsets of the modes before, then those after.
                let others = node.cells() / clusters;
                let basis = &planes.bases[n][((i * mixture + k) * others + cell * cells) * rank..][..cells * rank];
                for ((out, core), row) in outs.zip(basis.chunks_exact(rank)) {
                    for (&u, line) in row.iter().zip(core.chunks_exact(numbers)) {
                        out.iter_mut().zip(line).for_each(|(to, &z)| *to += u * z);
                    }
                }
            }
        }
    }
}

/// One plane.
struct Plane<'p> {
    planes: &'p Planes<'p>,
    present: &'p Partial,
    buffers: &'p mut Buffers,
    x: &'p mut [f32],
}

impl WithSimd for Plane<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for number in 0..self.planes.row_tiles.len() {
            self.coefficients(simd, number);
            for column in 0..self.planes.column_tiles.len() {
                match COLUMNS / S::F32_LANES {
                    1 => self.tile::<S, 8, 1>(simd, number, column),
                    2 => self.tile::<S, 4, 2>(simd, number, column),
                    _ => self.tile::<S, 2, 4>(simd, number, column),
                }
            }
            self.store(number);
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

    /// Add the lines to the plane, columns back in their places.
    #[inline(always)]
    fn store(&mut self, number: usize) {
        let Plane { planes, buffers, x, .. } = self;
        let width = planes.column_tiles.len() * COLUMNS;
        for (&row, line) in planes.row_tiles[number].rows.iter().zip(buffers.lines.chunks_exact(width)) {
            let x = &mut x[row as usize * planes.columns..][..planes.columns];
            for (to, &place) in x.iter_mut().zip(&planes.places) {
                *to += line[place as usize];
            }
        }
    }
}
