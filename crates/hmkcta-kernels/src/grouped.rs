//! A node prepared to be reconstructed line by line ([`crate::lines`]): rows of mode a in groups, bases of mode b sorted.

use crate::cells::Node;
use crate::leading::{Leading, alike, subsets};
use crate::places::Places;
use crate::sizes::zeros;

/// Rows of mode a worked on at a time.
pub const ROWS: usize = 8;
/// Numbers that the lines of a bundle should have for a row of mode a, all clusters' members; most rows of a bundle.
const BUNDLED: usize = 400;
const MOST_BUNDLED: usize = 8;

/// A node. Modes a and b are the last two.
pub struct Lines<'a> {
    pub leading: Leading<'a>,
    pub node: &'a Node<'a>,
    pub columns: usize,
    /// Rows of mode a with the same subsets, some at a time.
    pub groups: Vec<Group>,
    /// For each cell of the modes but b, and each cluster of b, `[R_b, members]`, these padded.
    pub bases: Vec<f32>,
    /// Where each column is in a line.
    pub places: Places,
}

impl<'a> Lines<'a> {
    pub fn new(node: &'a Node<'a>, bases: &[Vec<f32>]) -> Self {
        let (a, b) = (node.order() - 2, node.order() - 1);
        let most = (BUNDLED / (node.mixture[b] * node.sizes[b])).clamp(1, MOST_BUNDLED);
        let leading = Leading::new(node, bases, most);
        let longest = leading.bundles.iter().map(Vec::len).max().unwrap_or(1);
        let mut lines = Lines {
            columns: node.sizes[b],
            node,
            groups: groups(node, a, &bases[a]),
            leading,
            places: Places::new(node, b, longest),
            bases: vec![],
        };
        lines.bases = lines.sorted(&bases[b]);
        lines
    }

    /// Basis numbers of mode b, which are stored as `[I_b, K_b, cells but b, R_b]`.
    fn sorted(&self, basis: &[f32]) -> Vec<f32> {
        let b = self.node.order() - 1;
        let (rank, clusters, size) = (self.node.ranks[b], self.node.clusters[b], self.basis());
        let cells = self.node.cells() / clusters;
        let mut sorted = zeros(cells * size);
        let mut filled = vec![0; clusters];
        for (&c, numbers) in self.node.members(b).iter().zip(basis.chunks_exact(cells * rank)) {
            let c = usize::from(c);
            let (start, width) = (self.places.starts[c], self.places.starts[c + 1] - self.places.starts[c]);
            let at = start * rank + filled[c];
            filled[c] += 1;
            for (numbers, sorted) in numbers.chunks_exact(rank).zip(sorted.chunks_exact_mut(size)) {
                sorted[at..].iter_mut().step_by(width).zip(numbers).for_each(|(to, &u)| *to = u);
            }
        }
        sorted
    }

    /// Numbers of all clusters of mode b for one cell of the others.
    pub fn basis(&self) -> usize {
        let b = self.node.order() - 1;
        self.node.ranks[b] * self.places.starts[self.node.clusters[b]]
    }
}

/// Up to `ROWS` rows of mode a that share their subsets.
pub struct Group {
    pub subsets: Vec<u16>,
    pub rows: Vec<u32>,
    /// Their basis numbers `[K_a, cells of the other modes, R_a, ROWS]`.
    pub basis: Vec<f32>,
}

/// All rows of mode a, whose basis is stored as `[I_a, K_a, cells of the other modes, R_a]`.
fn groups(node: &Node, a: usize, basis: &[f32]) -> Vec<Group> {
    let length = basis.len() / node.sizes[a];
    let group = |rows: Vec<u32>| {
        let mut numbers = zeros(length * ROWS);
        for (at, &row) in rows.iter().enumerate() {
            let from = &basis[row as usize * length..][..length];
            numbers[at..].iter_mut().step_by(ROWS).zip(from).for_each(|(to, &u)| *to = u);
        }
        Group { subsets: subsets(node, a, rows[0]).to_vec(), rows, basis: numbers }
    };
    alike(node, a, ROWS).into_iter().map(group).collect()
}
