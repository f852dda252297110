//! The cells (clusters c = c_1..c_N) of one node: which rows belong to a cell and where its basis rows are stored.

use crate::sizes::{product, zeros};
use crate::sorting::Sorting;
use crate::transpose::{SIDE, turn_over};

/// Modes of a node at most; trees are walked down mode by mode.
pub const MOST_MODES: usize = 64;
/// Clusters of a mode, whose numbers are kept in 16 bits.
const MOST_CLUSTERS: usize = 1 << 16;
/// Rows transposed at a time, so that a cache line is used up before it is dropped.
const TILE: usize = 64;

/// One node's model at one level: shapes, memberships, bases `[I_n, K_n, PC_-n, R_n]`, cores `[PC, R_1, .., R_N]`.
pub struct Node<'a> {
    pub sizes: Vec<usize>,
    pub clusters: Vec<usize>,
    pub mixture: Vec<usize>,
    pub ranks: Vec<usize>,
    /// Undecomposed modes have an identity basis that is not stored.
    pub undecomposed: Vec<bool>,
    /// Distinct cluster subsets S_n(i) of each row, `[I_n, K_n]` for each mode.
    members: Vec<&'a [u16]>,
    /// Rows of each cluster subset of each mode, ascending, and the slot `i K_n + k` of each.
    subsets: Vec<Vec<Subset>>,
}

/// The rows of one cluster subset of one mode.
#[derive(Clone, Default)]
struct Subset {
    rows: Vec<u32>,
    slots: Vec<u32>,
}

/// C, K, R and mode sizes as Python passes them: `(sizes, clusters, mixture, ranks, undecomposed)`.
pub type Shape = (Vec<usize>, Vec<usize>, Vec<usize>, Vec<usize>, Vec<bool>);

/// One cell: its number in C order, its subset of each mode, and flat(c_-n), where its bases lie among the others.
#[derive(Clone)]
pub struct Cell {
    pub number: usize,
    pub subset: Vec<usize>,
    others: Vec<usize>,
}

impl<'a> Node<'a> {
    /// A node of which every promise the kernels rely on has been checked; the message names what is broken.
    pub fn new(shape: Shape, members: Vec<&'a [u16]>) -> Result<Self, String> {
        let (sizes, clusters, mixture, ranks, undecomposed) = shape;
        let order = sizes.len();
        let lengths = [clusters.len(), mixture.len(), ranks.len(), undecomposed.len(), members.len()];
        if order == 0 || order > MOST_MODES || lengths.iter().any(|&length| length != order) {
            return Err(format!(
                "a node of order {order}, of up to {MOST_MODES}, needs as many C, K, R, flags and memberships, \
                 got {lengths:?}"
            ));
        }
        for n in 0..order {
            let (size, c, k, r) = (sizes[n], clusters[n], mixture[n], ranks[n]);
            let mode = n + 1;
            let countable = u32::try_from(size).is_ok() && c <= MOST_CLUSTERS;
            if size == 0 || k == 0 || k > c || r == 0 || !countable {
                return Err(format!(
                    "mode {mode} needs a row, R >= 1 and 1 <= K <= C <= {MOST_CLUSTERS}, got {size} rows, R={r} C={c} K={k}"
                ));
            }
            if undecomposed[n] && (r != size || c != 1) {
                return Err(format!("mode {mode} is undecomposed and needs R = {size} and C = 1, got R={r} C={c}"));
            }
            check_members(members[n], size, c, k).map_err(|what| format!("memberships of mode {mode}: {what}"))?;
        }
        // With these every product that the kernels form of a node can be counted.
        product(sizes.iter().zip(&ranks).map(|(&size, &rank)| size.max(rank)))?;
        product(clusters.iter().chain(&ranks).copied())?;
        for n in 0..order {
            let others = (0..order).filter(|&m| m != n).map(|m| clusters[m]);
            product([members[n].len(), ranks[n]].into_iter().chain(others))?;
        }
        let subsets = (0..order).map(|n| invert(members[n], clusters[n], mixture[n])).collect();
        Ok(Node { sizes, clusters, mixture, ranks, undecomposed, members, subsets })
    }

    pub fn order(&self) -> usize {
        self.sizes.len()
    }

    pub fn cells(&self) -> usize {
        self.clusters.iter().product()
    }

    /// Whether no element belongs to two cells: each row is in one subset of its mode.
    pub fn is_disjoint(&self) -> bool {
        self.mixture.iter().all(|&k| k == 1)
    }

    pub fn core_size(&self) -> usize {
        self.ranks.iter().product()
    }

    /// Numbers stored for the bases of mode `n`.
    pub fn basis_size(&self, n: usize) -> usize {
        if self.undecomposed[n] { 0 } else { self.members[n].len() * self.combinations(n) * self.ranks[n] }
    }

    /// PC_-n, the combinations of the other modes' subsets.
    fn combinations(&self, n: usize) -> usize {
        self.cells() / self.clusters[n]
    }

    /// The cell of the given number.
    pub fn cell(&self, number: usize) -> Cell {
        let order = self.order();
        let mut subset = vec![0; order];
        let mut rest = number;
        for n in (0..order).rev() {
            subset[n] = rest % self.clusters[n];
            rest /= self.clusters[n];
        }
        let flat = |n: usize| (0..order).filter(|&m| m != n).fold(0, |at, m| at * self.clusters[m] + subset[m]);
        let others = (0..order).map(flat).collect();
        Cell { number, subset, others }
    }

    /// Cluster subsets of the rows of mode `n`, `[I_n, K_n]`.
    pub fn members(&self, n: usize) -> &'a [u16] {
        self.members[n]
    }

    /// Rows of mode `n` that belong to cluster subset `k`, ascending.
    pub fn rows(&self, n: usize, k: usize) -> &[u32] {
        &self.subsets[n][k].rows
    }

    /// Rows of the cell in every mode.
    pub fn cell_rows(&self, cell: &Cell) -> Vec<&[u32]> {
        (0..self.order()).map(|n| self.rows(n, cell.subset[n])).collect()
    }

    /// Sort the rows of the last clustered mode from `first` on by their subsets.
    ///
    /// From now on `rows` means places in a tensor sorted like that. Nothing changes where that gains nothing.
    pub fn sort_rows(&mut self, first: usize) -> Option<Sorting> {
        let clustered = |&n: &usize| self.mixture[n] < self.clusters[n];
        let n = (first..self.order()).rev().find(clustered)?;
        let sorting = Sorting::new(self.members[n], self.mixture[n], self.sizes[n + 1..].iter().product())?;
        let places = sorting.places();
        for Subset { rows, slots } in &mut self.subsets[n] {
            let mut sorted: Vec<(u32, u32)> =
                rows.iter().map(|&row| places[row as usize]).zip(slots.iter().copied()).collect();
            sorted.sort_unstable();
            (*rows, *slots) = sorted.into_iter().unzip();
        }
        Some(sorting)
    }

    /// Whether no element belongs to the cell.
    pub fn is_empty(&self, cell: &Cell) -> bool {
        (0..self.order()).any(|n| self.rows(n, cell.subset[n]).is_empty())
    }

    /// Where row `i`'s numbers of the cell's basis of mode `n` start, if the row belongs to the cell.
    pub fn place(&self, cell: &Cell, n: usize, i: usize) -> Option<usize> {
        let mixture = self.mixture[n];
        let subsets = &self.members[n][i * mixture..(i + 1) * mixture];
        let k = subsets.iter().position(|&k| usize::from(k) == cell.subset[n])?;
        Some(self.offset(cell, n, i * mixture + k))
    }

    fn offset(&self, cell: &Cell, n: usize, slot: usize) -> usize {
        (slot * self.combinations(n) + cell.others[n]) * self.ranks[n]
    }

    /// Read the cell's basis of mode `n`, member rows only, transposed: `[R_n, m_n]`.
    pub fn load_basis(&self, cell: &Cell, n: usize, stored: &[f32]) -> Vec<f32> {
        let slots = &self.subsets[n][cell.subset[n]].slots;
        let (rank, rows) = (self.ranks[n], slots.len());
        let numbers = |slot: u32| &stored[self.offset(cell, n, slot as usize)..][..rank];
        let mut basis = zeros(rank * rows);
        let (fours, rest) = slots.as_chunks::<SIDE>();
        for (four, slots) in fours.iter().enumerate() {
            turn_over(slots.map(numbers), &mut basis[four * SIDE..], rows);
        }
        for (row, &slot) in (rows - rest.len()..).zip(rest) {
            basis[row..].iter_mut().step_by(rows).zip(numbers(slot)).for_each(|(to, &value)| *to = value);
        }
        basis
    }

    /// `U_n` of all cells with its zero rows written out: `[PC, I_n, R_n]`.
    pub fn dense_basis(&self, n: usize, stored: &[f32]) -> Vec<f32> {
        let (clusters, mixture, rank) = (self.clusters[n], self.mixture[n], self.ranks[n]);
        let behind: usize = self.clusters[n + 1..].iter().product();
        let step = self.sizes[n] * rank;
        let mut dense = zeros(self.cells() * step);
        let slots = stored.chunks_exact(self.combinations(n) * rank).zip(self.members[n]).enumerate();
        for (at, (numbers, &k)) in slots {
            let row = at / mixture * rank;
            for (before, numbers) in numbers.chunks_exact(behind * rank).enumerate() {
                let first = (before * clusters + usize::from(k)) * behind * step + row;
                for (after, numbers) in numbers.chunks_exact(rank).enumerate() {
                    dense[first + after * step..][..rank].copy_from_slice(numbers);
                }
            }
        }
        dense
    }

    /// Store the cell's basis `[R_n, m_n]` of mode `n`.
    pub fn store_basis(&self, cell: &Cell, n: usize, basis: &[f32], stored: &mut [f32]) {
        let slots = &self.subsets[n][cell.subset[n]].slots;
        let (rank, rows) = (self.ranks[n], slots.len());
        for (tile, slots) in slots.chunks(TILE).enumerate() {
            for r in 0..rank {
                let numbers = basis[r * rows + tile * TILE..].iter().zip(slots);
                numbers.for_each(|(&value, &slot)| stored[self.offset(cell, n, slot as usize) + r] = value);
            }
        }
    }
}

/// K_n distinct subsets below C_n for each of `size` rows.
pub fn check_members(members: &[u16], size: usize, clusters: usize, mixture: usize) -> Result<(), String> {
    if Some(members.len()) != size.checked_mul(mixture) {
        return Err(format!("{size} x {mixture} numbers expected, got {}", members.len()));
    }
    for (i, subsets) in members.chunks_exact(mixture).enumerate() {
        let repeated = (1..mixture).any(|k| subsets[..k].contains(&subsets[k]));
        if repeated || subsets.iter().any(|&k| usize::from(k) >= clusters) {
            return Err(format!("row {i} has {subsets:?}, distinct numbers below {clusters} expected"));
        }
    }
    Ok(())
}

/// From the subsets of each row to the rows of each subset.
fn invert(members: &[u16], clusters: usize, mixture: usize) -> Vec<Subset> {
    let mut subsets = vec![Subset::default(); clusters];
    for (slot, &k) in members.iter().enumerate() {
        let subset = &mut subsets[usize::from(k)];
        subset.rows.push((slot / mixture) as u32);
        subset.slots.push(slot as u32);
    }
    subsets
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape() -> Shape {
        (vec![3, 2], vec![2, 1], vec![1, 1], vec![1, 2], vec![false, true])
    }

    #[test]
    fn basis_survives_storing() {
        let node = Node::new(
            (vec![3, 2], vec![2, 3], vec![2, 1], vec![2, 1], vec![false; 2]),
            vec![&[0, 1, 1, 0, 0, 1], &[0, 2]],
        )
        .unwrap();
        let mut stored = vec![0.0; node.basis_size(0)];
        assert_eq!(stored.len(), 3 * 2 * 3 * 2);
        for number in 0..node.cells() {
            let cell = node.cell(number);
            let basis: Vec<f32> = (0..6).map(|i| (10 * number + i) as f32).collect();
            node.store_basis(&cell, 0, &basis, &mut stored);
            assert_eq!(node.load_basis(&cell, 0, &stored), basis);
        }
        assert!(stored.iter().skip(1).all(|&x| x != 0.0), "every number belongs to one cell");
    }

    #[test]
    fn broken_shapes_are_refused() {
        assert!(Node::new(shape(), vec![&[0, 1, 0], &[0, 0]]).is_ok());
        assert!(Node::new(shape(), vec![&[0, 2, 0], &[0, 0]]).is_err_and(|e| e.contains("row 1")));
        assert!(Node::new(shape(), vec![&[0, 1], &[0, 0]]).is_err());
        let mut wrong = shape();
        wrong.3[1] = 1;
        assert!(Node::new(wrong, vec![&[0, 1, 0], &[0, 0]]).is_err_and(|e| e.contains("undecomposed")));
        let mut endless = shape();
        endless.3[0] = 1 << 63;
        assert!(Node::new(endless, vec![&[0, 1, 0], &[0, 0]]).is_err_and(|e| e.contains("counted")));
    }

    #[test]
    fn cells_without_rows_are_empty() {
        let node = Node::new(shape(), vec![&[1, 1, 1], &[0, 0]]).unwrap();
        assert!(node.is_empty(&node.cell(0)) && !node.is_empty(&node.cell(1)));
        assert_eq!(node.place(&node.cell(1), 0, 2), Some(2));
        assert_eq!(node.place(&node.cell(0), 0, 2), None);
    }
}
