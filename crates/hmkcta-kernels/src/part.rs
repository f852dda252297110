//! The requested rows of one node, as the fitting kernels want them or as single elements.

use crate::cells::Node;
use crate::element::Elements;
use crate::machine::dispatch;
use crate::packed::{NodeView, Position};
use crate::real::widen_all;
use crate::reconstruct::accumulate;
use crate::shared::Shared;
use crate::sizes::zeros;
use pulp::{Simd, WithSimd};

/// Elements decoded one by one at a time.
const ELEMENTS: usize = 1 << 16;
// What the two ways cost in nanoseconds, measured on one core of a 2023 server: a choice of clusters of an element, a
// multiply-add of one; a node, a number to be widened, an element of a cell.
const CHOICE: f64 = 4.0;
const MULTIPLY_ADD: f64 = 0.125;
const NODE: f64 = 20_000.0;
const NUMBER: f64 = 2.0;
const VISIT: f64 = 0.2;

/// The requested rows of one mode of a node, and their places in the run.
pub struct Requested {
    pub pos: Vec<u32>,
    pub place: Vec<u32>,
    /// Stretches of rows whose places follow one another: the first place, and how many.
    stretches: Vec<(u32, u32)>,
}

impl Requested {
    pub fn new(pos: Vec<u32>, place: Vec<u32>) -> Requested {
        let together = place.chunk_by(|a, b| a + 1 == *b);
        let stretches = together.map(|places| (places[0], places.len() as u32)).collect();
        Requested { pos, place, stretches }
    }

    /// Add a value to the element of each row behind `start`, which nobody else uses meanwhile.
    #[inline(always)]
    fn add(&self, values: &[f32], start: usize, out: Shared) {
        if 2 * self.stretches.len() > self.place.len() {
            for (&place, &value) in self.place.iter().zip(values) {
                // SAFETY: `within` gives places inside, and the caller has the elements alone.
                unsafe { *out.within(start + place as usize, 1) += value };
            }
            return;
        }
        let mut values = values;
        for &(place, count) in &self.stretches {
            let count = count as usize;
            let (stretch, behind) = values.split_at(count);
            // SAFETY: as above; `within` has looked that all of the stretch is inside.
            let to = unsafe { std::slice::from_raw_parts_mut(out.within(start + place as usize, count), count) };
            add_all(stretch, to);
            values = behind;
        }
    }
}

/// Add some numbers, mostly few.
#[inline(always)]
fn add_all(values: &[f32], to: &mut [f32]) {
    let ((to, rest_to), (values, rest)) = (to.as_chunks_mut::<8>(), values.as_chunks::<8>());
    for (to, values) in to.iter_mut().zip(values) {
        for (to, &value) in to.iter_mut().zip(values) {
            *to += value;
        }
    }
    rest_to.iter_mut().zip(rest).for_each(|(to, &value)| *to += value);
}

pub struct Part<'p> {
    pub node: &'p NodeView<'p>,
    pub requested: &'p [&'p Requested],
}

impl Part<'_> {
    pub fn len(&self) -> usize {
        self.requested.iter().map(|rows| rows.pos.len()).product()
    }

    /// Whether its elements are a whole run of these sizes, in order.
    pub fn covers(&self, sizes: &[usize]) -> bool {
        let in_order = |rows: &Requested| rows.place.iter().enumerate().all(|(at, &place)| at == place as usize);
        self.requested.iter().zip(sizes).all(|(rows, &size)| rows.pos.len() == size && in_order(rows))
    }

    /// Whether decoding element by element is less work.
    pub fn single_elements_pay(&self) -> bool {
        let node = self.node;
        let visits = (self.len() * node.choices()) as f64;
        let multiply_adds: usize = node.free().map(|n| node.ranks[n]).product();
        let rows: usize =
            node.free().map(|n| self.requested[n].pos.len() * node.mixture[n] * node.others(n) * node.ranks[n]).sum();
        let widened = (node.core.len() + rows) as f64;
        visits * (CHOICE + MULTIPLY_ADD * multiply_adds as f64) < NODE + NUMBER * widened + VISIT * visits
    }

    /// Add the elements one by one, which nobody else uses meanwhile.
    pub fn add_elements(&self, sizes: &[usize], out: Shared, elements: &mut Elements<f32>) -> Result<(), String> {
        let total = self.len();
        let mut values = vec![];
        let (mut pos, mut places) = (vec![Position::default(); total.min(ELEMENTS)], vec![0; total.min(ELEMENTS)]);
        for from in (0..total).step_by(ELEMENTS) {
            let count = ELEMENTS.min(total - from);
            for at in 0..count {
                let (mut rest, mut stride) = (from + at, 1);
                places[at] = 0;
                for ((n, rows), size) in self.requested.iter().enumerate().zip(sizes).rev() {
                    let i = rest % rows.pos.len();
                    rest /= rows.pos.len();
                    pos[at][n] = rows.pos[i];
                    places[at] += rows.place[i] as usize * stride;
                    stride *= size;
                }
            }
            values.clear();
            values.resize(count, 0.0);
            elements.add(self.node, &pos[..count], &mut values)?;
            // SAFETY: `place` gives a place inside, and the caller has the elements alone.
            places.iter().zip(&values).for_each(|(&place, &value)| unsafe { *out.within(place, 1) += value });
        }
        Ok(())
    }

    /// Add the model to a tensor of the requested rows.
    pub fn accumulate(&self, tensor: &mut [f32]) -> Result<(), String> {
        let node = self.node;
        let order = node.order;
        let sizes: Vec<usize> = self.requested.iter().map(|rows| rows.pos.len()).collect();
        let ranks = (0..order).map(|n| if node.decomposed[n] { node.ranks[n] } else { sizes[n] }).collect();
        let undecomposed = node.decomposed[..order].iter().map(|&decomposed| !decomposed).collect();
        let shape =
            (sizes.clone(), node.clusters[..order].to_vec(), node.mixture[..order].to_vec(), ranks, undecomposed);
        let mut members = vec![];
        let mut bases = vec![];
        for (n, &size) in sizes.iter().enumerate() {
            if node.decomposed[n] {
                members.push(pick(node.cluster[n], node.mixture[n], &self.requested[n].pos)?);
                let length = node.mixture[n] * node.others(n) * node.ranks[n];
                bases.push(dispatch(Widen(&pick(node.basis[n], length, &self.requested[n].pos)?)));
            } else {
                members.push(vec![0; size]);
                bases.push(vec![]);
            }
        }
        let cores = self.cores()?;
        let members: Vec<&[u16]> = members.iter().map(|m| m.as_slice()).collect();
        let bases: Vec<&[f32]> = bases.iter().map(|b| b.as_slice()).collect();
        accumulate(Node::new(shape, members)?, tensor, &bases, &cores, 1.0);
        Ok(())
    }

    /// The cores times their scales, for the requested rows of undecomposed modes.
    fn cores(&self) -> Result<Vec<f32>, String> {
        let node = self.node;
        let mut stored = node.core.to_vec();
        for n in 0..node.order {
            let after: usize = node.ranks[n + 1..node.order].iter().product();
            if node.decomposed[n] {
                continue;
            }
            let slices = stored.chunks_exact(node.ranks[n] * after);
            stored =
                slices.map(|slice| pick(slice, after, &self.requested[n].pos)).collect::<Result<Vec<_>, _>>()?.concat();
        }
        let mut cores = dispatch(Widen(&stored));
        for (core, &scale) in cores.chunks_exact_mut((stored.len() / node.cells()).max(1)).zip(node.scale) {
            core.iter_mut().for_each(|z| *z *= scale);
        }
        Ok(cores)
    }

    /// Add values of the requested rows to their places in a run of these sizes, which nobody else uses meanwhile.
    pub fn put(&self, values: &[f32], sizes: &[usize], out: Shared) {
        add_lines(self.requested, values, sizes, 0, out);
    }
}

/// Add values of the rows of some modes, `[m_n, .., m_N]`, to their places behind `start` lines.
fn add_lines(requested: &[&Requested], values: &[f32], sizes: &[usize], start: usize, out: Shared) {
    let Some((rows, others)) = requested.split_first() else { return };
    let start = start * sizes[0];
    if others.is_empty() {
        return rows.add(values, start, out);
    }
    let each = (values.len() / rows.place.len()).max(1);
    for (values, &place) in values.chunks_exact(each).zip(&rows.place) {
        add_lines(others, values, &sizes[1..], start + place as usize, out);
    }
}

/// Rows of `length` numbers each.
fn pick(table: &[u16], length: usize, rows: &[u32]) -> Result<Vec<u16>, String> {
    let mut picked = Vec::with_capacity(length * rows.len());
    for &row in rows {
        let from = table.get(row as usize * length..(row as usize + 1) * length);
        picked.extend_from_slice(from.ok_or_else(|| format!("a node has no row {row}"))?);
    }
    Ok(picked)
}

/// Numbers widened with the instructions of this machine.
struct Widen<'w>(&'w [u16]);

impl WithSimd for Widen<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Vec<f32> {
        let mut wide = zeros(self.0.len());
        widen_all(self.0, &mut wide);
        wide
    }
}
