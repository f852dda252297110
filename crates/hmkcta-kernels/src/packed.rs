//! The arrays of one level of a model as the file stores them (`docs/format.md`, section 3).

use crate::sizes::product;

/// Modes a tensor has at most.
pub const MOST_MODES: usize = 8;

/// Choices of clusters of an element, and of those a row may take in a mode: more than any file may ask for.
const MOST_CHOICES: usize = 1 << 24;

/// The row of an element in each mode.
pub type Position = [u32; MOST_MODES];

/// One level; slices indexed by mode are None where the format leaves an array out.
pub struct Level<'a> {
    /// `[S, 3, N]`: C, K, R of each node.
    pub shape: &'a [u32],
    pub child: Option<&'a [u32]>,
    pub row_offset: Vec<&'a [u32]>,
    pub core: Ragged<'a, u16>,
    pub core_scale: Ragged<'a, f32>,
    pub cluster: Vec<Option<Ragged<'a, u16>>>,
    pub basis: Vec<Option<Ragged<'a, u16>>>,
    pub part: Vec<Option<&'a [u16]>>,
    pub local: Vec<Option<&'a [u32]>>,
}

/// An array with the part of node s from `offset[s]` to `offset[s + 1]`.
#[derive(Clone, Copy)]
pub struct Ragged<'a, T> {
    pub data: &'a [T],
    pub offset: &'a [u32],
}

impl<'a, T> Ragged<'a, T> {
    fn part(&self, s: usize, length: usize) -> Option<&'a [T]> {
        let (from, to) = (*self.offset.get(s)? as usize, *self.offset.get(s + 1)? as usize);
        let part = self.data.get(from..to)?;
        (part.len() == length).then_some(part)
    }
}

/// One node that adds something: what an element's value is computed from.
#[derive(Clone, Copy)]
pub struct NodeView<'a> {
    pub order: usize,
    pub clusters: [usize; MOST_MODES],
    pub mixture: [usize; MOST_MODES],
    pub ranks: [usize; MOST_MODES],
    /// Rows m(s, n).
    pub rows: [usize; MOST_MODES],
    /// `[PC, R_1, .., R_N]`
    pub core: &'a [u16],
    /// `[PC]`
    pub scale: &'a [f32],
    /// `[m, K_n]`; empty for an undecomposed mode.
    pub cluster: [&'a [u16]; MOST_MODES],
    /// `[m, K_n, PC_-n, R_n]`; empty for an undecomposed mode.
    pub basis: [&'a [u16]; MOST_MODES],
    pub decomposed: [bool; MOST_MODES],
}

impl NodeView<'_> {
    /// PC.
    pub fn cells(&self) -> usize {
        self.clusters[..self.order].iter().product()
    }

    /// Numbers of one core.
    pub fn core_size(&self) -> usize {
        self.ranks[..self.order].iter().product()
    }

    /// PC_-n.
    pub fn others(&self, n: usize) -> usize {
        self.cells() / self.clusters[n]
    }

    /// Clusters an element belongs to, prod K_n.
    pub fn choices(&self) -> usize {
        self.mixture[..self.order].iter().product()
    }

    /// Modes with bases, ascending.
    pub fn free(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.order).filter(|&n| self.decomposed[n])
    }

    /// Stored numbers.
    pub fn numbers(&self) -> usize {
        self.core.len() + self.basis.iter().map(|basis| basis.len()).sum::<usize>()
    }
}

impl<'a> Level<'a> {
    pub fn order(&self) -> usize {
        self.row_offset.len()
    }

    /// Node `s`, None if it adds nothing; the message of an error names what is broken.
    pub fn node(&self, s: usize) -> Result<Option<NodeView<'a>>, String> {
        let order = self.order();
        let broken = |what: &str| format!("{what} of node {s} does not have the length its shape says");
        let shape =
            self.shape.get(3 * order * s..3 * order * (s + 1)).ok_or_else(|| format!("there is no node {s}"))?;
        if shape[..order].iter().all(|&c| c == 0) {
            return Ok(None);
        }
        let (clusters, mixture) = (&shape[..order], &shape[order..2 * order]);
        let countable = shape.iter().all(|&x| x > 0) && mixture.iter().zip(clusters).all(|(k, c)| k <= c);
        let choices = product(mixture.iter().map(|&k| k as usize)).is_ok_and(|count| count <= MOST_CHOICES);
        let steps = mixture.iter().zip(clusters).all(|(&k, &c)| u64::from(k) * u64::from(c) <= MOST_CHOICES as u64);
        if !countable || !choices || !steps {
            return Err(format!("the shape of node {s} is none: C, K, R are {shape:?}"));
        }
        let mut node = NodeView {
            order,
            clusters: [1; MOST_MODES],
            mixture: [1; MOST_MODES],
            ranks: [1; MOST_MODES],
            rows: [0; MOST_MODES],
            core: &[],
            scale: &[],
            cluster: [&[]; MOST_MODES],
            basis: [&[]; MOST_MODES],
            decomposed: [false; MOST_MODES],
        };
        for n in 0..order {
            node.clusters[n] = shape[n] as usize;
            node.mixture[n] = shape[order + n] as usize;
            node.ranks[n] = shape[2 * order + n] as usize;
            let offset = self.row_offset[n].get(s..s + 2).ok_or_else(|| broken("row_offset"))?;
            node.rows[n] = offset[1].checked_sub(offset[0]).ok_or_else(|| broken("row_offset"))? as usize;
            if node.rows[n] == 0 {
                return Err(format!("node {s} has a shape, and no row in mode {}", n + 1));
            }
        }
        // The stored arrays hold these, so that no product of them or of some of them wraps.
        product(shape[..order].iter().chain(&shape[2 * order..]).map(|&x| x as usize))?;
        node.scale = self.core_scale.part(s, node.cells()).ok_or_else(|| broken("core_scale"))?;
        node.core = self.core.part(s, node.cells() * node.core_size()).ok_or_else(|| broken("core"))?;
        for n in 0..order {
            let (rows, mixture) = (node.rows[n], node.mixture[n]);
            let Some((cluster, basis)) = self.cluster[n].zip(self.basis[n]) else {
                if node.clusters[n] != 1 || mixture != 1 || node.ranks[n] != rows {
                    return Err(format!("mode {} of node {s} has no basis and needs C = K = 1, R = rows", n + 1));
                }
                continue;
            };
            node.decomposed[n] = true;
            node.cluster[n] = cluster.part(s, rows * mixture).ok_or_else(|| broken("cluster"))?;
            let length = product([rows, mixture, node.others(n), node.ranks[n]])?;
            node.basis[n] = basis.part(s, length).ok_or_else(|| broken("basis"))?;
        }
        Ok(Some(node))
    }

    /// The first child of node `s`; None for a leaf.
    pub fn first_child(&self, s: usize) -> Option<usize> {
        let edges = self.child?.get(s..s + 2)?;
        (edges[0] < edges[1]).then_some(edges[0] as usize)
    }

    /// Where the rows of mode `n` of node `s` go.
    pub fn way_down(&self, s: usize, n: usize) -> Result<WayDown<'a>, String> {
        let Some((part, local)) = self.part[n].zip(self.local[n]) else { return Ok(WayDown(None)) };
        let rows = self.row_offset[n].get(s..s + 2).map(|edges| edges[0] as usize..edges[1] as usize);
        let tables = rows.and_then(|rows| part.get(rows.clone()).zip(local.get(rows)));
        let broken = || format!("part and local of node {s} do not have its rows of mode {}", n + 1);
        tables.map(|tables| WayDown(Some(tables))).ok_or_else(broken)
    }
}

/// Parts and positions in them of the rows of one mode of a node; None for an undecomposed mode.
pub struct WayDown<'a>(Option<(&'a [u16], &'a [u32])>);

impl WayDown<'_> {
    /// Part and position in it of a row; an undecomposed mode has part 0 and keeps the position.
    #[inline(always)]
    pub fn of(&self, position: u32) -> Result<(usize, u32), String> {
        let Some((part, local)) = self.0 else { return Ok((0, position)) };
        let found = part.get(position as usize).zip(local.get(position as usize));
        found.map(|(&part, &local)| (usize::from(part), local)).ok_or_else(|| format!("a node has no row {position}"))
    }
}
