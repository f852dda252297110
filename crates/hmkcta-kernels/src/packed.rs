//! The arrays of one stage of a model: `hmkcta.packed.PackedLevel`.

use crate::sizes::product;

/// Modes a tensor has at most.
pub const MOST_MODES: usize = 8;

/// Choices of clusters of an element, and of those a row may take in a mode: more than any file may ask for.
const MOST_CHOICES: usize = 1 << 24;

/// The row of an element in each mode.
pub type Position = [u32; MOST_MODES];

/// One stage.
pub struct Level<'a> {
    /// `[S, 3, N]`: C, K, R of each node.
    pub shape: &'a [u32],
    pub child: Option<&'a [u32]>,
    pub row_offset: Vec<&'a [u32]>,
    pub core: Ragged<'a, u16>,
    pub core_scale: Ragged<'a, f32>,
    pub cluster: Vec<Ragged<'a, u16>>,
    pub basis: Vec<Ragged<'a, u16>>,
    /// Part and position there of each row; None at the last stage.
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

/// What there is of a node.
#[allow(clippy::large_enum_variant, reason = "of which there is one at a time, on the stack")]
pub enum Node<'a> {
    /// Nothing: it has no children either.
    Empty,
    /// A cut: C of each mode. It adds nothing, and has children.
    Cut([usize; MOST_MODES]),
    Cells(NodeView<'a>),
}

/// One node that adds something: what an element's value is computed from.
#[derive(Clone, Copy)]
pub struct NodeView<'a> {
    pub order: usize,
    pub clusters: [usize; MOST_MODES],
    /// K; 1 of an undecomposed mode.
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

    /// Node `s`; the message of an error names what is broken.
    pub fn node(&self, s: usize) -> Result<Node<'a>, String> {
        let order = self.order();
        let broken = |what: &str| format!("{what} of node {s} does not have the length its shape says");
        let shape =
            self.shape.get(3 * order * s..3 * order * (s + 1)).ok_or_else(|| format!("there is no node {s}"))?;
        let (clusters, rest) = shape.split_at(order);
        let (mixture, ranks) = rest.split_at(order);
        if shape.iter().all(|&number| number == 0) {
            return Ok(Node::Empty);
        }
        if rest.iter().all(|&number| number == 0) && !clusters.contains(&0) {
            return Ok(Node::Cut(std::array::from_fn(|n| clusters.get(n).map_or(1, |&c| c as usize))));
        }
        let sound = |n: usize| {
            clusters[n] > 0 && ranks[n] > 0 && if mixture[n] > 0 { mixture[n] <= clusters[n] } else { clusters[n] == 1 }
        };
        let choices = product(mixture.iter().map(|&k| k.max(1) as usize)).is_ok_and(|count| count <= MOST_CHOICES);
        let steps = mixture.iter().zip(clusters).all(|(&k, &c)| u64::from(k) * u64::from(c) <= MOST_CHOICES as u64);
        if !(0..order).all(sound) || !choices || !steps {
            return Err(format!("C, K and R of node {s} are neither those of cells nor of a cut: {shape:?}"));
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
            node.clusters[n] = clusters[n] as usize;
            node.mixture[n] = mixture[n].max(1) as usize;
            node.ranks[n] = ranks[n] as usize;
            node.decomposed[n] = mixture[n] > 0;
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
            if !node.decomposed[n] {
                if node.ranks[n] != rows {
                    return Err(format!("mode {} of node {s} has no basis and needs R = rows", n + 1));
                }
                continue;
            }
            node.cluster[n] = self.cluster[n].part(s, rows * mixture).ok_or_else(|| broken("cluster"))?;
            let length = product([rows, mixture, node.others(n), node.ranks[n]])?;
            node.basis[n] = self.basis[n].part(s, length).ok_or_else(|| broken("basis"))?;
        }
        Ok(Node::Cells(node))
    }

    /// The first child of node `s`, which is cut into so many parts of each mode; None for a leaf. All of its children are
    /// among the nodes of the next stage, so that there are no more parts than these.
    pub fn first_child(&self, s: usize, clusters: &[usize; MOST_MODES], next: &Level) -> Result<Option<usize>, String> {
        let Some(edges) = self.child.and_then(|child| child.get(s..s + 2)) else { return Ok(None) };
        if edges[0] == edges[1] {
            return Ok(None);
        }
        let nodes = next.shape.len() / (3 * self.order());
        let count = product(clusters[..self.order()].iter().copied())?;
        if edges[1].checked_sub(edges[0]).is_none_or(|own| own as usize != count) || edges[1] as usize > nodes {
            return Err(format!("node {s} is cut into {count} parts, and does not have as many children"));
        }
        Ok(Some(edges[0] as usize))
    }

    /// Where the rows of mode `n` of node `s` go.
    pub fn way_down(&self, s: usize, n: usize) -> Result<WayDown<'a>, String> {
        let rows = self.row_offset[n].get(s..s + 2).map(|edges| edges[0] as usize..edges[1] as usize);
        let part = self.part[n].zip(rows.clone()).and_then(|(part, rows)| part.get(rows));
        let local = self.local[n].zip(rows).and_then(|(local, rows)| local.get(rows));
        part.zip(local).map(WayDown).ok_or_else(|| format!("mode {} of node {s} has no parts of its rows", n + 1))
    }
}

/// Parts and positions in them of the rows of one mode of a node.
pub struct WayDown<'a>((&'a [u16], &'a [u32]));

impl WayDown<'_> {
    /// Part and position in it of a row.
    #[inline(always)]
    pub fn of(&self, position: u32) -> Result<(usize, u32), String> {
        let (part, local) = self.0;
        let found = part.get(position as usize).zip(local.get(position as usize));
        found.map(|(&part, &local)| (usize::from(part), local)).ok_or_else(|| format!("a node has no row {position}"))
    }
}
