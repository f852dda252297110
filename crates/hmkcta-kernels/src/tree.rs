//! What reconstruction and projection of all cells at once share: the tensor is walked once, leading index by leading
//! index, down to pieces (leaves) that fit the cache, and each piece meets all cells that have elements in it.

use crate::cells::{Cell, Node};
use crate::pick::Pick;
use crate::sorting::Sorting;
use std::collections::BTreeMap;

/// Elements of a leaf: 1 MiB, half of the level 2 cache of current server cores.
const LEAF: usize = 256 * 1024;
/// Fewer are not worth the way down to them: a leaf has a mode more then, where that is not more than so many elements.
const FEWEST: usize = 1024;
const MOST: usize = 16 * LEAF;

/// The cells that take part, and what they do at a leaf.
pub struct Tree<'a> {
    pub node: Node<'a>,
    pub bases: &'a [&'a [f32]],
    /// Modes from `depth` on make up a leaf.
    pub depth: usize,
    /// A mode whose memberships do not count and whose basis is not applied.
    open: Option<usize>,
    pub members: Vec<Member>,
    picks: Vec<Pick>,
    /// How rows are sorted in a leaf while cells are picked from it.
    pub sorting: Option<Sorting>,
}

/// One cell.
pub struct Member {
    pub cell: Cell,
    /// Bases `[R_n, m_n]` of the modes of a leaf; None for other modes, undecomposed ones and the open one.
    pub bases: Vec<Option<Vec<f32>>>,
    /// Which elements of a leaf belong to the cell; equal for all cells with the same subsets there.
    pub pick: usize,
}

/// Leading modes that are walked, of a tensor of these sizes.
fn depth(sizes: &[usize]) -> usize {
    let (last, leaf) = (sizes.len() - 1, |depth: usize| sizes[depth..].iter().product::<usize>());
    let depth = (0..last).find(|&depth| leaf(depth) <= LEAF).unwrap_or(last);
    if depth > 0 && leaf(depth) < FEWEST && leaf(depth - 1) <= MOST { depth - 1 } else { depth }
}

impl<'a> Tree<'a> {
    /// All cells that `wanted` and that have elements, those with the same elements in a leaf next to each other.
    pub fn new(
        mut node: Node<'a>,
        bases: &'a [&'a [f32]],
        open: Option<usize>,
        wanted: impl Fn(&Cell) -> bool,
    ) -> Self {
        let order = node.order();
        let depth = depth(&node.sizes);
        let sorting = if open.is_none() { node.sort_rows(depth) } else { None };
        let tree = Tree { node, bases, depth, open, members: vec![], picks: vec![], sorting };
        let (node, mut keys, mut members, mut picks) = (&tree.node, BTreeMap::new(), vec![], vec![]);
        let every: Vec<Vec<u32>> = node.sizes.iter().map(|&size| (0..size as u32).collect()).collect();
        for cell in (0..node.cells()).map(|number| node.cell(number)).filter(wanted) {
            let mut rows = node.cell_rows(&cell);
            let mut key = cell.subset[depth..].to_vec();
            if let Some(n) = open {
                rows[n] = &every[n];
                if n >= depth {
                    key[n - depth] = 0;
                }
            }
            if rows.iter().any(|rows| rows.is_empty()) {
                continue;
            }
            let pick = *keys.entry(key).or_insert_with(|| {
                picks.push(Pick::new(&node.sizes[depth..], &rows[depth..]));
                picks.len() - 1
            });
            let bases = (0..order)
                .map(|n| (n >= depth && tree.applies(n)).then(|| node.load_basis(&cell, n, bases[n])))
                .collect();
            members.push(Member { cell, bases, pick });
        }
        members.sort_by_key(|member: &Member| member.pick);
        Tree { members, picks, ..tree }
    }

    /// Whether mode `n` has bases to be applied.
    pub fn applies(&self, n: usize) -> bool {
        self.open != Some(n) && !self.node.undecomposed[n]
    }

    /// Elements of a leaf.
    pub fn leaf_size(&self) -> usize {
        self.node.sizes[self.depth..].iter().product()
    }

    /// The elements of a leaf that belong to a cell.
    pub fn pick(&self, member: &Member) -> &Pick {
        &self.picks[member.pick]
    }

    /// Row `i` of the cell's basis of mode `n`; None if the row is not the cell's.
    ///
    /// A mode whose bases are not applied has an empty row.
    pub fn row(&self, member: &Member, n: usize, i: usize) -> Option<&[f32]> {
        if !self.applies(n) {
            let inside = self.open == Some(n) || self.node.place(&member.cell, n, i).is_some();
            return inside.then_some(&[]);
        }
        self.node.place(&member.cell, n, i).map(|at| &self.bases[n][at..at + self.node.ranks[n]])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leaf_is_neither_tiny_nor_far_beyond_the_cache() {
        let leaf = |sizes: &[usize]| sizes[depth(sizes)..].to_vec();
        assert_eq!(leaf(&[30, 400, 380, 3]), [380, 3]);
        assert_eq!(leaf(&[58, 152_000, 3]), [152_000, 3]);
        assert_eq!(leaf(&[2, 20_000_000, 3]), [3]);
        assert_eq!(leaf(&[10_092, 456_000]), [456_000]);
        assert_eq!(leaf(&[5, 3]), [5, 3]);
    }
}
