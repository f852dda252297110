//! The tables of a node in a coded run: what it is, its shape, the subsets of its rows and the parts they go to.

use crate::contexts::{Checked, Fault, Memberships, Models};
use crate::range_coder::Coder;

/// What a node is.
pub const EMPTY: u8 = 0;
pub const CELLS: u8 = 1;
pub const CUT: u8 = 2;

/// A node as it is coded; vectors are indexed by mode, and used for one node after the other.
#[derive(Default)]
pub struct Node {
    pub kind: u8,
    pub parted: bool,
    pub clusters: Vec<u32>,
    pub mixture: Vec<u32>,
    pub ranks: Vec<u32>,
    /// `[m, K_n]`, none where the mode is not decomposed.
    pub members: Vec<Vec<u16>>,
    /// `[m]` of a node with children.
    pub parts: Vec<Vec<u16>>,
    /// Of a cut: segments of each extent, none where rows have labels.
    pub grids: Vec<Vec<u32>>,
    /// `[PC, R_1, .., R_N]`
    pub core: Vec<i32>,
    /// `[PC, R_n]`
    pub columns: Vec<Vec<u8>>,
}

impl Node {
    pub fn new(order: usize) -> Self {
        Node {
            clusters: vec![0; order],
            mixture: vec![0; order],
            ranks: vec![0; order],
            members: vec![vec![]; order],
            parts: vec![vec![]; order],
            grids: vec![vec![]; order],
            columns: vec![vec![]; order],
            ..Node::default()
        }
    }

    pub fn order(&self) -> usize {
        self.clusters.len()
    }

    /// Make it a node that adds nothing, a leaf.
    pub fn clear(&mut self) {
        (self.kind, self.parted) = (EMPTY, false);
        for shape in [&mut self.clusters, &mut self.mixture, &mut self.ranks] {
            shape.fill(0);
        }
        self.core.clear();
        self.columns.iter_mut().for_each(Vec::clear);
        self.members.iter_mut().chain(&mut self.parts).for_each(Vec::clear);
        self.grids.iter_mut().for_each(Vec::clear);
    }

    pub fn decomposed(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.order()).filter(|&n| self.mixture[n] > 0)
    }

    /// PC; whoever asks has made sure that it is no more than can be counted.
    pub fn cells(&self) -> usize {
        self.clusters.iter().map(|&c| c as usize).product()
    }

    pub fn has_children(&self) -> bool {
        self.kind == CUT || self.parted
    }
}

/// Where a node lies: its rows, and the extents they are made of, in each mode.
#[derive(Clone, Copy)]
pub struct Place<'a> {
    pub rows: &'a [u32],
    extents: &'a [u32],
    ends: &'a [u32],
}

impl<'a> Place<'a> {
    /// `ends`: where the extents of each mode begin in `extents`, and where the last ones end.
    pub fn new(rows: &'a [u32], extents: &'a [u32], ends: &'a [u32]) -> Self {
        Place { rows, extents, ends }
    }

    pub fn extents(&self, n: usize) -> &'a [u32] {
        &self.extents[self.ends[n] as usize..self.ends[n + 1] as usize]
    }

    pub fn is_empty(&self) -> bool {
        self.rows.contains(&0)
    }
}

/// Where numbers come from or go to.
pub trait Port {
    /// Take in C, K and R of one mode as far as they are known, before anything else is read.
    fn bound(&self, _: &Node, _: usize) -> Checked<()> {
        Ok(())
    }

    /// Take in the shape of a node, before anything is kept of it.
    fn admit(&mut self, node: &Node, place: Place) -> Checked<()>;

    /// A number of a node's basis.
    fn take(&self, n: usize, at: usize) -> i32;

    fn put(&mut self, n: usize, at: usize, number: i32, k: u8);
}

/// What a run remembers from node to node.
pub struct Walk {
    pub models: Models,
    /// Whether the nodes are of the last stage.
    last: bool,
    kind: usize,
    parted: usize,
    undecomposed: Vec<usize>,
    rank_length: Vec<usize>,
}

impl Walk {
    pub fn new(order: usize, last: bool) -> Self {
        let (undecomposed, rank_length) = (vec![0; order], vec![0; order]);
        Walk { models: Models::new(order), last, kind: 0, parted: 0, undecomposed, rank_length }
    }

    /// All of a node's tables. In a decoder the node is clear, and has rows in all modes.
    pub fn tables<C: Coder>(
        &mut self,
        coder: &mut C,
        node: &mut Node,
        place: Place,
        port: &mut impl Port,
    ) -> Checked<()> {
        self.kind(coder, node);
        match node.kind {
            CELLS => {
                self.shape(coder, node, place, port)?;
                port.admit(node, place)?;
                self.members(coder, node, place)?;
                if node.parted {
                    self.parts(coder, node, place)?;
                }
            }
            CUT => {
                self.rules(coder, node, place, port)?;
                port.admit(node, place)?;
                self.cut_labels(coder, node, place)?;
            }
            _ => port.admit(node, place)?,
        }
        if coder.past_end() { Err(Fault::CodeEnd) } else { Ok(()) }
    }

    fn kind<C: Coder>(&mut self, coder: &mut C, node: &mut Node) {
        let models = &mut self.models.kind[self.kind];
        node.kind = if coder.bit(&mut models[0], node.kind == CELLS) {
            CELLS
        } else if !self.last && coder.bit(&mut models[1], node.kind == CUT) {
            CUT
        } else {
            EMPTY
        };
        self.kind = usize::from(node.kind);
        if node.kind == CELLS && !self.last {
            node.parted = coder.bit(&mut self.models.parted[self.parted], node.parted);
            self.parted = usize::from(node.parted);
        }
    }

    fn shape<C: Coder>(&mut self, coder: &mut C, node: &mut Node, place: Place, port: &mut impl Port) -> Checked<()> {
        for n in 0..node.order() {
            let models = &mut self.models.modes[n];
            let undecomposed = coder.bit(&mut models.undecomposed[self.undecomposed[n]], node.mixture[n] == 0);
            self.undecomposed[n] = usize::from(undecomposed);
            if undecomposed {
                (node.clusters[n], node.mixture[n], node.ranks[n]) = (1, 0, place.rows[n]);
                port.bound(node, n)?;
                continue;
            }
            let less_one = |count: u32| count.saturating_sub(1);
            node.clusters[n] = models.clusters.code(coder, less_one(node.clusters[n]))? + 1;
            port.bound(node, n)?;
            if node.clusters[n] > 1 {
                node.mixture[n] = models.mixture.code(coder, less_one(node.mixture[n]))? + 1;
            } else {
                node.mixture[n] = 1;
            }
            port.bound(node, n)?;
            let of_rank = &mut models.ranks[self.rank_length[n].min(12)];
            node.ranks[n] = of_rank.code(coder, less_one(node.ranks[n]))? + 1;
            port.bound(node, n)?;
            self.rank_length[n] = 32 - node.ranks[n].leading_zeros() as usize;
        }
        Ok(())
    }

    fn members<C: Coder>(&mut self, coder: &mut C, node: &mut Node, place: Place) -> Checked<()> {
        for n in 0..node.order() {
            let mixture = node.mixture[n] as usize;
            node.members[n].resize(place.rows[n] as usize * mixture, 0);
            if mixture > 0 && node.clusters[n] > 1 {
                memberships(coder, &mut self.models.modes[n].members, &mut node.members[n], mixture, node.clusters[n])?;
            }
        }
        Ok(())
    }

    fn parts<C: Coder>(&mut self, coder: &mut C, node: &mut Node, place: Place) -> Checked<()> {
        for n in 0..node.order() {
            let (part, members, mixture) = (&mut node.parts[n], &node.members[n], node.mixture[n] as usize);
            part.resize(place.rows[n] as usize, 0);
            if node.clusters[n] == 1 {
                continue;
            }
            let models = &mut self.models.modes[n];
            let slot = |(part, of_row): (&u16, &[u16])| of_row.iter().position(|c| c == part);
            let slotted = !C::DECODES && part.iter().zip(members.chunks_exact(mixture)).map(slot).all(|s| s.is_some());
            if coder.bit(&mut models.slotted, slotted) {
                for (part, of_row) in part.iter_mut().zip(members.chunks_exact(mixture)) {
                    let at = if C::DECODES { 0 } else { slot((part, of_row)).unwrap_or(0) as u32 };
                    let at = if mixture > 1 { models.slot.code(coder, at, mixture as u32)? } else { 0 };
                    *part = of_row[at as usize];
                }
            } else {
                memberships(coder, &mut models.part, part, 1, node.clusters[n])?;
            }
        }
        Ok(())
    }

    fn rules<C: Coder>(&mut self, coder: &mut C, node: &mut Node, place: Place, port: &mut impl Port) -> Checked<()> {
        for n in 0..node.order() {
            let (models, grid) = (&mut self.models.modes[n], &mut node.grids[n]);
            if coder.bit(&mut models.rule, grid.is_empty()) {
                node.clusters[n] = models.parts.code(coder, node.clusters[n].saturating_sub(1))? + 1;
                port.bound(node, n)?;
                continue;
            }
            grid.resize(place.extents(n).len(), 0);
            let mut product = 1_u32;
            for (segments, &extent) in grid.iter_mut().zip(place.extents(n)) {
                *segments = models.parts.code(coder, segments.saturating_sub(1))? + 1;
                if *segments > extent {
                    return Err(Fault::NodeShape);
                }
                product = product.saturating_mul(*segments);
            }
            node.clusters[n] = product;
            port.bound(node, n)?;
        }
        Ok(())
    }

    fn cut_labels<C: Coder>(&mut self, coder: &mut C, node: &mut Node, place: Place) -> Checked<()> {
        for n in 0..node.order() {
            let part = &mut node.parts[n];
            part.resize(place.rows[n] as usize, 0);
            if !node.grids[n].is_empty() {
                grid_parts(&node.grids[n], place.extents(n), part);
            } else if node.clusters[n] > 1 {
                memberships(coder, &mut self.models.modes[n].cut, part, 1, node.clusters[n])?;
            }
        }
        Ok(())
    }
}

/// Subsets of rows, `places` of each, ascending and below `clusters`.
fn memberships<C: Coder>(
    coder: &mut C,
    models: &mut Memberships,
    subsets: &mut [u16],
    places: usize,
    clusters: u32,
) -> Checked<()> {
    let mut was = 0;
    for row in 0..subsets.len() / places {
        let (before, own) = subsets.split_at_mut(row * places);
        let own = &mut own[..places];
        if let Some(last) = row.checked_sub(1).map(|row| &before[row * places..]) {
            let same = coder.bit(&mut models.same[was], !C::DECODES && own == last);
            was = usize::from(same);
            if same {
                own.copy_from_slice(last);
                continue;
            }
        }
        let mut least = 0;
        for (place, subset) in own.iter_mut().enumerate() {
            let label = models.label(place).code(coder, u32::from(*subset), clusters)?;
            if label < least {
                return Err(Fault::ClusterOrder);
            }
            (*subset, least) = (label as u16, label + 1);
        }
    }
    Ok(())
}

/// First index of a segment of an extent: of `segments` as equal ones as can be.
pub fn segment_start(extent: u32, segments: u32, segment: u32) -> u32 {
    (u64::from(extent) * u64::from(segment) / u64::from(segments)) as u32
}

/// The part of each row by a rule of a grid, of no more segments than indices along any extent.
pub fn grid_parts(grid: &[u32], extents: &[u32], parts: &mut [u16]) {
    let [segments, inner_grid @ ..] = grid else { return parts.fill(0) };
    let [extent, inner_extents @ ..] = extents else { return };
    let inner: usize = inner_extents.iter().map(|&e| e as usize).product();
    let step: u32 = inner_grid.iter().product();
    let inner_end = inner.min(parts.len());
    let (first, rest) = parts.split_at_mut(inner_end);
    grid_parts(inner_grid, inner_extents, first);
    let mut segment = 0;
    for (index, part) in (1..*extent).zip(rest.chunks_exact_mut(inner.max(1))) {
        while segment_start(*extent, *segments, segment + 1) <= index {
            segment += 1;
        }
        part.iter_mut().zip(&*first).for_each(|(to, from)| *to = from + (segment * step) as u16);
    }
}

/// The rule of a grid that rows go to these parts by, if there is one.
pub fn grid_of(parts: &[u16], clusters: u32, extents: &[u32], buffer: &mut Vec<u16>) -> Option<Vec<u32>> {
    let rows: usize = extents.iter().map(|&e| e as usize).product();
    if rows != parts.len() || rows == 0 {
        return None;
    }
    let (mut grid, mut step, mut product) = (vec![0; extents.len()], 1, 1_u32);
    for (segments, &extent) in grid.iter_mut().zip(extents).rev() {
        // The last index of an extent is in its last segment.
        *segments = u32::from(parts[(extent as usize - 1) * step]) / product + 1;
        if *segments > extent {
            return None;
        }
        product = product.checked_mul(*segments)?;
        step *= extent as usize;
    }
    buffer.clear();
    buffer.resize(rows, 0);
    if product != clusters {
        return None;
    }
    grid_parts(&grid, extents, buffer);
    (buffer == parts).then_some(grid)
}
