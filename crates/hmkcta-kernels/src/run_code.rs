//! Runs of nodes, coded and decoded (`docs/format.md`, the coded run).

use crate::contexts::{Checked, Fault, MOST_K, MOST_MAGNITUDE};
use crate::float16::{half_bits, halved, halvings, units};
use crate::range_coder::{Coder, Counter, Decoder, Encoder};
use crate::run_node::{CELLS, CUT, Node, Place, Port, Walk, grid_of};
use crate::run_numbers::numbers;
use crate::stage::{Geometry, Sizes, shape_of};

/// A stage to be coded, its arrays in the order of `hmkcta.packed.PackedLevel`; vectors are indexed by mode.
pub struct Stage<'a> {
    pub geometry: Geometry<'a>,
    pub last: bool,
    /// Whether its numbers are coded: they are not as float16, and where there are none.
    pub coded: bool,
    pub shape: &'a [u32],
    pub children: &'a [u32],
    pub cluster: Vec<&'a [u16]>,
    pub part: Vec<&'a [u16]>,
    pub column: Vec<&'a [u8]>,
    pub core: &'a [i32],
    pub basis: Vec<&'a [i32]>,
}

/// Nodes of a run, and where their numbers begin.
#[derive(Clone)]
pub struct Run {
    pub nodes: std::ops::Range<usize>,
    pub starts: Sizes,
    /// Of all of its nodes.
    pub sizes: Sizes,
}

/// Quarters of a bit that a number takes, about: runs end by these, so that their ends depend on the numbers alone.
fn weight(number: i32) -> u64 {
    if number == 0 { 1 } else { 8 + 5 * u64::from(number.unsigned_abs().ilog2()) }
}

/// What a node's tables take, in the same measure.
const NODE_WEIGHT: u64 = 64;
const RAW_WEIGHT: u64 = 64;

impl Stage<'_> {
    fn sizes(&self, s: usize) -> Sizes {
        Sizes::new(shape_of(self.shape, self.geometry.order(), s), self.geometry.place(s).rows)
    }

    /// Runs of about so many bytes, which the arrays are checked to be long enough for.
    pub fn runs(&self, bytes: u64) -> Checked<Vec<Run>> {
        let order = self.geometry.order();
        let mut at = Sizes::none(order);
        let (mut runs, mut first, mut starts, mut sizes) = (vec![], 0, at.clone(), at.clone());
        let mut weighed = 0;
        for s in 0..self.geometry.nodes() {
            let own = self.sizes(s);
            let begin = at.clone();
            if !at.add(&own) || !self.holds(&at) {
                return Err(Fault::RunCount);
            }
            sizes.add(&own);
            weighed += NODE_WEIGHT + self.weigh(&begin, &at);
            if weighed >= bytes * 32 || s + 1 == self.geometry.nodes() {
                runs.push(Run { nodes: first..s + 1, starts, sizes });
                (first, starts, sizes, weighed) = (s + 1, at.clone(), Sizes::none(order), 0);
            }
        }
        Ok(runs)
    }

    fn holds(&self, at: &Sizes) -> bool {
        let within = |end: u64, length: usize| usize::try_from(end).is_ok_and(|end| end <= length);
        let of_mode = |n: usize| {
            let own = at.modes[n];
            within(own.cluster, self.cluster[n].len())
                && (self.last || within(own.rows, self.part[n].len()))
                && (!self.coded || within(own.column, self.column[n].len()) && within(own.basis, self.basis[n].len()))
        };
        (!self.coded || within(at.core, self.core.len())) && (0..self.cluster.len()).all(of_mode)
    }

    fn weigh(&self, from: &Sizes, to: &Sizes) -> u64 {
        if !self.coded {
            let basis: u64 = from.modes.iter().zip(&to.modes).map(|(from, to)| to.basis - from.basis).sum();
            return (to.core - from.core + basis) * RAW_WEIGHT;
        }
        let sum =
            |of: &[i32], from: u64, to: u64| of[from as usize..to as usize].iter().map(|&q| weight(q)).sum::<u64>();
        let bases = self.basis.iter().zip(from.modes.iter().zip(&to.modes));
        sum(self.core, from.core, to.core) + bases.map(|(b, (from, to))| sum(b, from.basis, to.basis)).sum::<u64>()
    }

    /// The bytes of a run.
    pub fn encode(&self, run: &Run) -> Checked<Vec<u8>> {
        let mut encoder = Encoder::new();
        self.code(&mut encoder, run)?;
        Ok(encoder.finish())
    }

    /// How many bytes a run takes.
    pub fn count(&self, run: &Run) -> Checked<u64> {
        let mut counter = Counter::new();
        self.code(&mut counter, run)?;
        Ok(counter.bytes())
    }

    fn code<C: Coder>(&self, coder: &mut C, run: &Run) -> Checked<()> {
        let order = self.geometry.order();
        let (mut walk, mut node) = (Walk::new(order, self.last), Node::new(order));
        let mut at = run.starts.clone();
        let mut buffer = vec![];
        for s in run.nodes.clone() {
            let place = self.geometry.place(s);
            let mut port = Source { stage: self, starts: at.modes.iter().map(|own| own.basis as usize).collect() };
            self.load(s, &at, &mut node, &mut buffer)?;
            if !place.is_empty() {
                walk.tables(coder, &mut node, place, &mut port)?;
                if self.coded && node.kind == CELLS {
                    numbers(&mut walk.models, coder, &mut node, place, &mut port)?;
                }
            } else if node.kind != 0 {
                return Err(Fault::NodeShape);
            }
            at.add(&self.sizes(s));
        }
        Ok(())
    }

    /// Take a node out of the arrays, checked.
    fn load(&self, s: usize, at: &Sizes, node: &mut Node, buffer: &mut Vec<u16>) -> Checked<()> {
        node.clear();
        let (order, place, own) = (self.geometry.order(), self.geometry.place(s), self.sizes(s));
        let [clusters, mixture, ranks] = shape_of(self.shape, order, s);
        let cells = clusters.iter().try_fold(1_u32, |all, &c| all.checked_mul(c)).ok_or(Fault::ChildCount)?;
        node.clusters.copy_from_slice(clusters);
        node.mixture.copy_from_slice(mixture);
        node.ranks.copy_from_slice(ranks);
        node.parted = self.children[s] > 0;
        if node.parted && (self.last || self.children[s] != cells) {
            return Err(Fault::ChildCount);
        }
        if cells == 0 {
            let empty = [clusters, mixture, ranks].concat().iter().all(|&x| x == 0) && !node.parted;
            return if empty { Ok(()) } else { Err(Fault::NodeShape) };
        }
        node.kind = if ranks.iter().any(|&rank| rank > 0) { CELLS } else { CUT };
        (0..order).try_for_each(|n| check_mode(node, place, n))?;
        if node.kind == CUT && (cells < 2 || !node.parted) {
            return Err(Fault::NodeShape);
        }
        for n in 0..order {
            let part_of = |array: &[u16], from: u64, length: u64| array[from as usize..][..length as usize].to_vec();
            node.members[n] = part_of(self.cluster[n], at.modes[n].cluster, own.modes[n].cluster);
            check_members(&node.members[n], mixture[n], clusters[n])?;
            if node.parted {
                node.parts[n] = part_of(self.part[n], at.modes[n].rows, own.modes[n].rows);
                if node.parts[n].iter().any(|&part| u32::from(part) >= clusters[n]) {
                    return Err(Fault::PartRange);
                }
            }
            if node.kind == CUT {
                node.grids[n] = grid_of(&node.parts[n], clusters[n], place.extents(n), buffer).unwrap_or_default();
            }
        }
        if self.coded { self.load_numbers(at, &own, node) } else { Ok(()) }
    }

    fn load_numbers(&self, at: &Sizes, own: &Sizes, node: &mut Node) -> Checked<()> {
        let sound = |numbers: &[i32]| numbers.iter().all(|q| q.unsigned_abs() <= MOST_MAGNITUDE);
        node.core = self.core[at.core as usize..][..own.core as usize].to_vec();
        let mut all_sound = sound(&node.core);
        for n in 0..self.basis.len() {
            let (at, own) = (at.modes[n], own.modes[n]);
            node.columns[n] = self.column[n][at.column as usize..][..own.column as usize].to_vec();
            all_sound &= node.columns[n].iter().all(|&k| k <= MOST_K);
            all_sound &= sound(&self.basis[n][at.basis as usize..][..own.basis as usize]);
        }
        if all_sound { Ok(()) } else { Err(Fault::CodeRange) }
    }
}

/// C, K and R of a mode of a node that is not empty.
fn check_mode(node: &Node, place: Place, n: usize) -> Checked<()> {
    let (clusters, mixture, rank) = (node.clusters[n], node.mixture[n], node.ranks[n]);
    let sound = match (node.kind, mixture) {
        (CUT, _) => mixture == 0,
        (_, 0) => clusters == 1 && rank == place.rows[n],
        _ => mixture <= clusters && rank > 0,
    };
    if sound && clusters <= u16::MAX.into() { Ok(()) } else { Err(Fault::NodeShape) }
}

fn check_members(members: &[u16], mixture: u32, clusters: u32) -> Checked<()> {
    if members.iter().any(|&subset| u32::from(subset) >= clusters) {
        return Err(Fault::ClusterRange);
    }
    let ascending = |row: &[u16]| row.windows(2).all(|pair| pair[0] < pair[1]);
    if members.chunks(mixture.max(1) as usize).all(ascending) { Ok(()) } else { Err(Fault::ClusterOrder) }
}

/// Basis numbers of the node at hand.
struct Source<'a> {
    stage: &'a Stage<'a>,
    starts: Vec<usize>,
}

impl Port for Source<'_> {
    fn admit(&mut self, _: &Node, _: Place) -> Checked<()> {
        Ok(())
    }

    #[inline(always)]
    fn take(&self, n: usize, at: usize) -> i32 {
        self.stage.basis[n][self.starts[n] + at]
    }

    #[inline(always)]
    fn put(&mut self, _: usize, _: usize, _: i32, _: u8) {}
}

/// What a run decodes to; the slices are as long as the file says of it.
pub struct Decoded<'a> {
    pub core: &'a mut [u16],
    pub scale: &'a mut [f32],
    pub basis: Vec<&'a mut [u16]>,
    pub shape: Vec<u32>,
    pub children: Vec<u32>,
    pub cluster: Vec<Vec<u16>>,
    pub part: Vec<Vec<u16>>,
    pub column: Vec<Vec<u8>>,
    /// Rules of cuts, see `stage::Parted::next`.
    pub grids: Vec<u32>,
}

impl<'a> Decoded<'a> {
    pub fn new(core: &'a mut [u16], scale: &'a mut [f32], basis: Vec<&'a mut [u16]>) -> Self {
        let order = basis.len();
        let none = || vec![vec![]; order];
        let (shape, children, grids, column) = (vec![], vec![], vec![], vec![vec![]; order]);
        Decoded { core, scale, basis, shape, children, cluster: none(), part: none(), column, grids }
    }
}

/// What the header says of a stage and its run.
pub struct Stated<'a> {
    pub geometry: Geometry<'a>,
    pub nodes: std::ops::Range<usize>,
    pub last: bool,
    /// D, where numbers are coded.
    pub step: Option<f32>,
    /// `[3, N]`: the largest C, K and R of any node.
    pub largest: &'a [u32],
    /// Nodes of the next stage.
    pub children: u64,
}

struct Sink<'a, 'b> {
    stated: &'b Stated<'a>,
    out: Decoded<'a>,
    /// Where the node at hand begins, and the one after it.
    at: Sizes,
    end: Sizes,
    children: u64,
    units: [f32; MOST_K as usize + 1],
}

impl Port for Sink<'_, '_> {
    fn bound(&self, node: &Node, n: usize) -> Checked<()> {
        let own = [node.clusters[n], node.mixture[n], node.ranks[n]];
        let within = |i: usize| own[i] <= self.stated.largest[i * node.order() + n];
        match ((0..3).all(within), own[1] <= own[0]) {
            (true, true) => Ok(()),
            (false, _) => Err(Fault::LevelBounds),
            _ => Err(Fault::NodeShape),
        }
    }

    fn admit(&mut self, node: &Node, place: Place) -> Checked<()> {
        let shape = [&node.clusters[..], &node.mixture, &node.ranks];
        let cells = node.clusters.iter().fold(1_u64, |all, &c| all.saturating_mul(c.into()));
        if node.kind == CUT && cells < 2 {
            return Err(Fault::NodeShape);
        }
        self.end = self.at.clone();
        let room = |length: usize, end: u64| end <= length as u64;
        let counted = self.end.add(&Sizes::new(shape, place.rows));
        self.children += if node.has_children() { cells } else { 0 };
        let bases = self.out.basis.iter().zip(&self.end.modes).all(|(basis, own)| room(basis.len(), own.basis));
        let sound = room(self.out.scale.len(), self.end.cells) && room(self.out.core.len(), self.end.core) && bases;
        if counted && sound && self.children <= self.stated.children { Ok(()) } else { Err(Fault::RunCount) }
    }

    #[inline(always)]
    fn take(&self, _: usize, _: usize) -> i32 {
        0
    }

    #[inline(always)]
    fn put(&mut self, n: usize, at: usize, number: i32, k: u8) {
        if let Some(to) = self.out.basis[n].get_mut(self.at.modes[n].basis as usize + at) {
            *to = half_bits(number as f32 * self.units[usize::from(k & MOST_K)]);
        }
    }
}

impl Sink<'_, '_> {
    /// Keep a node that has been read.
    fn keep(&mut self, node: &Node, place: Place) {
        let out = &mut self.out;
        for table in [&node.clusters, &node.mixture, &node.ranks] {
            out.shape.extend(table);
        }
        out.children.push(if node.has_children() { node.cells() as u32 } else { 0 });
        for n in 0..node.order() {
            out.cluster[n].extend(&node.members[n]);
            out.column[n].extend(&node.columns[n]);
            if !self.stated.last {
                let rows = out.part[n].len() + place.rows[n] as usize;
                out.part[n].extend(&node.parts[n]);
                out.part[n].resize(rows, 0);
            }
            if node.has_children() {
                out.grids.push(node.grids[n].len() as u32);
                out.grids.extend(&node.grids[n]);
            }
        }
        if let Some(step) = self.stated.step.filter(|_| node.kind == CELLS) {
            self.widen_core(&node.core, step);
        }
        std::mem::swap(&mut self.at, &mut self.end);
    }

    fn widen_core(&mut self, core: &[i32], step: f32) {
        let e = halvings(core.iter().map(|q| q.unsigned_abs()).max().unwrap_or(0));
        let to = &mut self.out.core[self.at.core as usize..self.end.core as usize];
        to.iter_mut().zip(core).for_each(|(to, &q)| *to = half_bits(q as f32 * halved(e)));
        self.out.scale[self.at.cells as usize..self.end.cells as usize].fill(step * (1_u32 << e) as f32);
    }
}

fn read(decoder: &mut Decoder, sink: &mut Sink) -> Checked<()> {
    let stated = sink.stated;
    let order = stated.geometry.order();
    let (mut walk, mut node) = (Walk::new(order, stated.last), Node::new(order));
    for s in stated.nodes.clone() {
        let place = stated.geometry.place(s);
        node.clear();
        if place.is_empty() {
            sink.admit(&node, place)?;
        } else {
            walk.tables(decoder, &mut node, place, sink)?;
            if node.kind == CELLS && stated.step.is_some() {
                make_room(&mut node);
                numbers(&mut walk.models, decoder, &mut node, place, sink)?;
            }
        }
        sink.keep(&node, place);
    }
    Ok(())
}

/// Decode a run.
pub fn decode<'a>(bytes: &[u8], stated: &Stated<'a>, out: Decoded<'a>) -> Checked<Decoded<'a>> {
    let order = stated.geometry.order();
    let mut decoder = Decoder::new(bytes);
    let none = Sizes::none(order);
    let mut sink = Sink { stated, out, at: none.clone(), end: none, children: 0, units: units() };
    // What stands behind the end means nothing, whatever else is wrong with it.
    read(&mut decoder, &mut sink).map_err(|fault| if decoder.past_end() { Fault::CodeEnd } else { fault })?;
    let Sink { out, at, .. } = sink;
    let full = at.cells == out.scale.len() as u64
        && at.core == out.core.len() as u64
        && at.modes.iter().zip(&out.basis).all(|(own, basis)| own.basis == basis.len() as u64);
    match (decoder.is_at_end(), full) {
        (true, true) => Ok(out),
        (true, false) => Err(Fault::RunCount),
        _ => Err(Fault::CodeEnd),
    }
}

/// Zeros for the numbers of a node that has been admitted.
fn make_room(node: &mut Node) {
    let cells = node.cells();
    let ranks: usize = node.ranks.iter().map(|&rank| rank as usize).product();
    node.core.resize(cells * ranks, 0);
    for n in 0..node.order() {
        let columns = if node.mixture[n] > 0 { cells * node.ranks[n] as usize } else { 0 };
        node.columns[n].resize(columns, 0);
    }
}
