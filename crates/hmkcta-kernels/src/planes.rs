//! Reconstruction of overlapping cells plane by plane: the last two modes make up a plane, `rows` by `columns`.
//!
//! For fixed leading indices the cores of the cells that meet there are contracted to `[R_a, R_b]` each. Eight rows of the
//! plane that share cluster subsets and 16 columns that do are one tile: what all their cells add to it is summed in
//! registers, so the tensor is read and written once whatever the mixture.

use crate::cells::Node;
use crate::machine::dispatch;
use crate::plane::Plane;
use crate::threads::{PARALLEL, for_each};
use crate::tiles::{Tile, tiles};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Rows and columns of a tile.
pub const ROWS: usize = 8;
pub const COLUMNS: usize = 16;
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
pub struct Planes<'a> {
    pub node: &'a Node<'a>,
    pub bases: &'a [&'a [f32]],
    /// N - 2, the number of leading modes.
    pub depth: usize,
    pub rows: usize,
    pub columns: usize,
    pub row_tiles: Vec<Tile>,
    pub column_tiles: Vec<Tile>,
    /// Of each row tile the first of its `[subsets, R_a, ROWS]` numbers among those of one leading and column subset.
    pub row_starts: Vec<usize>,
    /// Of each column tile the first of its `[subsets, R_b, COLUMNS]` numbers among those of one leading and row subset.
    pub column_starts: Vec<usize>,
    /// Basis numbers of the rows, `[leading cells, C_b, row tiles..]`, zero where a row is not the cell's.
    pub row_bases: Vec<f32>,
    /// Basis numbers of the columns, `[leading cells, C_a, column tiles..]`.
    pub column_bases: Vec<f32>,
    /// Where each column stands in a line of column tiles.
    pub places: Vec<u32>,
}

/// Combinations of leading subsets that meet at the present leading indices, and their cores contracted with the rows
/// of these: `[combinations, remaining cells, remaining ranks]`.
#[derive(Clone, Default)]
pub struct Partial {
    pub cells: Vec<usize>,
    pub cores: Vec<f32>,
}

/// Buffers of one task.
struct Work {
    levels: Vec<Partial>,
    plane: Buffers,
}

pub struct Buffers {
    /// Rows' coefficients of one row tile, `[combinations, subsets, C_b, R_b, ROWS]`.
    pub coefficients: Vec<f32>,
    /// `[ROWS, column tiles, COLUMNS]`
    pub lines: Vec<f32>,
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
    pub fn left(&self, n: usize) -> (usize, usize) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::reconstruct::by_cells;
    use crate::testing::{close, numbers};

    #[test]
    fn agrees_with_reconstruction_cell_by_cell() {
        on_all_machines(compare_with_cells);
    }

    fn compare_with_cells() {
        for undecomposed in [false, true] {
            let (sizes, mixture) = (vec![3, 21, 37], vec![if undecomposed { 1 } else { 2 }, 2, 3]);
            let clusters = vec![if undecomposed { 1 } else { 2 }, 3, 5];
            let ranks = vec![if undecomposed { 3 } else { 2 }, 3, 2];
            let members: Vec<Vec<u16>> = (0..3)
                .map(|n| (0..sizes[n]).flat_map(|i| (0..mixture[n]).map(move |k| (i + k) as u16)).collect::<Vec<u16>>())
                .zip(&clusters)
                .map(|(members, &c)| members.iter().map(|k| k % c as u16).collect())
                .collect();
            let shape = (sizes.clone(), clusters, mixture, ranks, vec![undecomposed, false, false]);
            let node = Node::new(shape, members.iter().map(|m| m.as_slice()).collect()).unwrap();
            assert!(applies(&node));
            let bases: Vec<Vec<f32>> = (0..3).map(|n| numbers(node.basis_size(n), n as u64)).collect();
            let bases: Vec<&[f32]> = bases.iter().map(|b| b.as_slice()).collect();
            let cores = numbers(node.cells() * node.core_size(), 7);
            let mut found = numbers(sizes.iter().product(), 8);
            let mut expected = found.clone();
            accumulate(&node, &mut found, &bases, &cores, -0.5);
            by_cells(&node, &mut expected, &bases, &cores, -0.5);
            found.iter().zip(&expected).for_each(|(&x, &y)| close(x, f64::from(y)));
        }
    }
}
