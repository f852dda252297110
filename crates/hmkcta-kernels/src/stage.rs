//! A stage of a coded model: where its nodes lie, what they hold, and where their children lie.

use crate::contexts::{Checked, Fault};
use crate::run_node::{Place, grid_of, segment_start};
use crate::sizes::expect_room;

/// The rows of each node, and the extents that they are made of.
#[derive(Clone, Copy)]
pub struct Geometry<'a> {
    order: usize,
    rows: &'a [u32],
    extents: &'a [u32],
    ends: &'a [u32],
}

impl<'a> Geometry<'a> {
    /// `rows`: `[S, N]`; `ends`: `[S N + 1]`, where the extents of each node and mode begin.
    pub fn new(order: usize, rows: &'a [u32], extents: &'a [u32], ends: &'a [u32]) -> Result<Self, String> {
        let sound = order > 0
            && rows.len().is_multiple_of(order)
            && ends.len() == rows.len() + 1
            && ends.windows(2).all(|pair| pair[0] < pair[1])
            && (ends[0], ends[rows.len()] as usize) == (0, extents.len());
        let product = |at: usize| {
            let own = &extents[ends[at] as usize..ends[at + 1] as usize];
            own.iter().fold(1_u64, |product, &extent| product.saturating_mul(u64::from(extent)))
        };
        if sound && rows.iter().enumerate().all(|(at, &rows)| product(at) == u64::from(rows)) {
            return Ok(Geometry { order, rows, extents, ends });
        }
        Err("each node needs its rows in each mode, and extents whose product they are".into())
    }

    pub fn order(&self) -> usize {
        self.order
    }

    pub fn nodes(&self) -> usize {
        self.rows.len() / self.order
    }

    pub fn place(&self, s: usize) -> Place<'a> {
        let (from, to) = (s * self.order, (s + 1) * self.order);
        Place::new(&self.rows[from..to], self.extents, &self.ends[from..=to])
    }
}

/// How many numbers a node has: of basis, subsets and columns in each mode.
#[derive(Clone, Default)]
pub struct Sizes {
    pub cells: u64,
    pub core: u64,
    pub modes: Vec<OfMode>,
}

#[derive(Clone, Copy, Default)]
pub struct OfMode {
    pub rows: u64,
    pub basis: u64,
    pub cluster: u64,
    pub column: u64,
}

impl Sizes {
    /// Of the shape `[3, N]`; what is beyond counting is the largest number.
    pub fn new(shape: [&[u32]; 3], rows: &[u32]) -> Sizes {
        let [clusters, mixture, ranks] = shape;
        let product = |of: &mut dyn Iterator<Item = u32>| of.fold(1_u64, |all, one| all.saturating_mul(one.into()));
        let cells = product(&mut clusters.iter().copied());
        let adds = ranks.iter().any(|&rank| rank > 0);
        let of_mode = |n: usize| {
            let rows = u64::from(rows[n]);
            if !adds || mixture[n] == 0 {
                return OfMode { rows, ..OfMode::default() };
            }
            let others = product(&mut clusters.iter().enumerate().filter(|&(m, _)| m != n).map(|(_, &c)| c));
            let rank = u64::from(ranks[n]);
            let cluster = rows.saturating_mul(mixture[n].into());
            let basis = cluster.saturating_mul(others).saturating_mul(rank);
            OfMode { rows, basis, cluster, column: cells.saturating_mul(rank) }
        };
        let core = if adds { cells.saturating_mul(product(&mut ranks.iter().copied())) } else { 0 };
        Sizes { cells: if adds { cells } else { 0 }, core, modes: (0..rows.len()).map(of_mode).collect() }
    }

    pub fn none(order: usize) -> Sizes {
        Sizes { modes: vec![OfMode::default(); order], ..Sizes::default() }
    }

    /// Add a node's; false where numbers are beyond counting.
    pub fn add(&mut self, other: &Sizes) -> bool {
        let mut sound = true;
        let mut sum = |to: &mut u64, by: u64| {
            let (total, over) = to.overflowing_add(by);
            sound &= !over && total < u64::MAX / 2;
            *to = total;
        };
        sum(&mut self.cells, other.cells);
        sum(&mut self.core, other.core);
        for (to, by) in self.modes.iter_mut().zip(&other.modes) {
            sum(&mut to.rows, by.rows);
            sum(&mut to.basis, by.basis);
            sum(&mut to.cluster, by.cluster);
            sum(&mut to.column, by.column);
        }
        sound
    }
}

/// C, K and R of a node in a table `[S, 3, N]`.
pub fn shape_of(shape: &[u32], order: usize, s: usize) -> [&[u32]; 3] {
    std::array::from_fn(|i| &shape[(3 * s + i) * order..(3 * s + i + 1) * order])
}

/// Where the nodes of the next stage lie, and the position of each row of this one among those of its part.
#[derive(Default)]
pub struct Next {
    pub rows: Vec<u32>,
    pub extents: Vec<u32>,
    pub ends: Vec<u32>,
    pub local: Vec<Vec<u32>>,
}

/// What a stage says of the next one.
pub struct Parted<'a> {
    pub geometry: Geometry<'a>,
    pub shape: &'a [u32],
    /// How many children each node has.
    pub children: &'a [u32],
    /// `[rows]` of each mode.
    pub part: Vec<&'a [u16]>,
}

impl Parted<'_> {
    /// Rows of all children in each mode, and how many children there are.
    fn totals(&self) -> Option<(u64, Vec<u64>)> {
        let (mut count, mut rows) = (0_u64, vec![0_u64; self.geometry.order()]);
        for (s, &children) in self.children.iter().enumerate().filter(|(_, children)| **children > 0) {
            count += u64::from(children);
            let [clusters, ..] = shape_of(self.shape, rows.len(), s);
            let parts = clusters.iter().try_fold(1_u32, |all, &c| all.checked_mul(c).filter(|_| c <= u16::MAX.into()));
            if parts != Some(children) {
                return None;
            }
            for (n, total) in rows.iter_mut().enumerate() {
                let parts = u64::from(children) / u64::from(clusters[n].max(1));
                *total = total.checked_add(parts.checked_mul(self.geometry.place(s).rows[n].into())?)?;
            }
        }
        Some((count, rows))
    }

    /// The next stage. `stated`: its nodes and their rows in each mode, which are checked before there is room for them.
    /// `grids`: rules of cuts as they were coded, a length (0: labels) and segments for each mode of each node with
    /// children; without them they are found.
    pub fn next(&self, stated: Option<(u64, &[u64])>, grids: Option<&[u32]>) -> Checked<Next> {
        let (count, rows) = self.totals().ok_or(Fault::RowCount)?;
        if stated.is_some_and(|(nodes, _)| nodes != count) || count > u32::MAX.into() {
            return Err(Fault::ChildCount);
        }
        if stated.is_some_and(|(_, of_modes)| of_modes != rows) || rows.iter().any(|&rows| rows > u32::MAX.into()) {
            return Err(Fault::RowCount);
        }
        let order = rows.len();
        expect_room::<u32>((count as usize).saturating_mul(order));
        let mut next = Next { ends: vec![0], local: vec![vec![]; order], ..Next::default() };
        let (mut starts, mut grids, mut buffer) = (vec![0; order], grids, vec![]);
        for s in 0..self.geometry.nodes() {
            self.of_node(s, &mut starts, &mut grids, &mut buffer, &mut next)?;
        }
        Ok(next)
    }

    fn of_node(
        &self,
        s: usize,
        starts: &mut [usize],
        grids: &mut Option<&[u32]>,
        buffer: &mut Vec<u16>,
        next: &mut Next,
    ) -> Checked<()> {
        let (order, place) = (starts.len(), self.geometry.place(s));
        let [clusters, _, ranks] = shape_of(self.shape, order, s);
        let mut of_modes: Vec<Vec<(u32, Vec<u32>)>> = Vec::with_capacity(order);
        for n in 0..order {
            let count = place.rows[n] as usize;
            let part = self.part[n].get(starts[n]..starts[n] + count).ok_or(Fault::RowCount)?;
            starts[n] += count;
            let local = &mut next.local[n];
            if self.children[s] == 0 {
                local.resize(local.len() + count, 0);
                continue;
            }
            let grid = match grids {
                Some(stream) => stored_grid(stream),
                None if ranks.iter().any(|&rank| rank > 0) => None,
                None => grid_of(part, clusters[n], place.extents(n), buffer),
            };
            let mut owned = vec![0_u32; clusters[n] as usize];
            for &p in part {
                let owned = owned.get_mut(usize::from(p)).ok_or(Fault::PartRange)?;
                local.push(*owned);
                *owned += 1;
            }
            of_modes.push(children_along(&owned, grid.as_deref(), place.extents(n)));
        }
        for flat in 0..self.children[s] as usize {
            let mut stride: usize = of_modes.iter().map(Vec::len).product();
            for along in &of_modes {
                stride /= along.len();
                let (rows, extents) = &along[flat / stride % along.len()];
                next.rows.push(*rows);
                next.extents.extend(extents);
                next.ends.push(u32::try_from(next.extents.len()).map_err(|_| Fault::ChildCount)?);
            }
        }
        Ok(())
    }
}

/// The next rule of a stream; None for labels.
fn stored_grid(stream: &mut &[u32]) -> Option<Vec<u32>> {
    let (&length, rest) = stream.split_first()?;
    let (grid, rest) = rest.split_at_checked(length as usize)?;
    *stream = rest;
    (length > 0).then(|| grid.to_vec())
}

/// Rows and extents of each part of a mode.
fn children_along(owned: &[u32], grid: Option<&[u32]>, extents: &[u32]) -> Vec<(u32, Vec<u32>)> {
    let of_part = |(part, &rows): (usize, &u32)| {
        if owned.len() == 1 {
            return (rows, extents.to_vec());
        }
        let Some(grid) = grid else { return (rows, vec![rows]) };
        let (mut rest, mut own) = (part as u32, vec![0; extents.len()]);
        for ((own, &extent), &segments) in own.iter_mut().zip(extents).zip(grid).rev() {
            let at = rest % segments;
            rest /= segments;
            *own = segment_start(extent, segments, at + 1) - segment_start(extent, segments, at);
        }
        (rows, own)
    };
    owned.iter().enumerate().map(of_part).collect()
}
