//! Blocks of nodes of one cell that fit the cache: the core times one basis after the other, the last mode first, so that
//! all but the first product run along whole lines.

use crate::machine::dispatch;
use crate::packed::NodeView;
use crate::part::Requested;
use crate::real::{Real, widen_all};
use crate::threads::room;
use pulp::{Simd, WithSimd};

/// Elements of a block at most: with what is on the way to them they fit a level 2 cache.
const MOST: usize = 1 << 16;
/// Columns of a basis that are multiplied in one turn.
const TURN: usize = 4;

/// Buffers kept from one node to the next.
#[derive(Default)]
pub struct Products {
    halves: Vec<u16>,
    block: Vec<f32>,
    next: Vec<f32>,
    rows: Vec<f32>,
    turned: Vec<f32>,
}

impl Products {
    /// Whether the node is one cell, and its requested elements are few enough.
    pub fn pay(node: &NodeView, elements: usize) -> bool {
        elements <= MOST && node.core.len() <= MOST.max(elements) && node.cells() == 1
    }

    /// The elements of the requested rows, `[m_1, .., m_N]`.
    pub fn block(&mut self, node: &NodeView, requested: &[&Requested]) -> Result<&[f32], String> {
        for (n, rows) in requested.iter().enumerate() {
            if let Some(row) = rows.pos.iter().find(|&&row| row as usize >= node.rows[n]) {
                return Err(format!("a node has no row {row} in mode {}", n + 1));
            }
        }
        dispatch(Task { products: self, node, requested });
        let length = requested.iter().map(|rows| rows.pos.len()).product();
        Ok(&self.block[..length])
    }
}

struct Task<'t> {
    products: &'t mut Products,
    node: &'t NodeView<'t>,
    requested: &'t [&'t Requested],
}

impl WithSimd for Task<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        // As in `element`: machines of more than four lanes fuse, and so does NEON.
        if S::F32_LANES > 4 || cfg!(target_arch = "aarch64") { self.run::<true>() } else { self.run::<false>() }
    }
}

impl Task<'_> {
    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Task { products: Products { halves, block, next, rows, turned }, node, requested } = self;
        let order = node.order;
        halves.clear();
        if node.free().count() == order {
            halves.extend_from_slice(node.core);
        } else {
            pick(node, requested, 0, 0, halves);
        }
        let stored = room(block, halves.len());
        widen_all(halves, stored);
        stored.iter_mut().for_each(|z| *z *= node.scale[0]);
        let mut lead = halves.len();
        let mut trail = 1;
        for n in (0..order).rev() {
            let (rank, positions) = (node.ranks[n], &requested[n].pos);
            if !node.decomposed[n] {
                lead /= positions.len();
                trail *= positions.len();
                continue;
            }
            let rows = room(rows, rank * positions.len());
            for (row, &position) in rows.chunks_exact_mut(rank).zip(positions) {
                widen_all(&node.basis[n][position as usize * rank..][..rank], row);
            }
            lead /= rank;
            let (from, to) = (&block[..lead * rank * trail], room(next, lead * positions.len() * trail));
            if trail == 1 {
                let turned = room(turned, rows.len());
                for (i, row) in rows.chunks_exact(rank).enumerate() {
                    row.iter().enumerate().for_each(|(r, &u)| turned[r * positions.len() + i] = u);
                }
                multiply::<FUSED>(from, turned, to, (lead, rank, positions.len()));
            } else {
                for (from, to) in from.chunks_exact(rank * trail).zip(to.chunks_exact_mut(positions.len() * trail)) {
                    multiply::<FUSED>(rows, from, to, (positions.len(), rank, trail));
                }
            }
            trail *= positions.len();
            std::mem::swap(block, next);
        }
    }
}

/// `y = a b` of matrices `[lines, inner]` and `[inner, columns]`.
#[inline(always)]
fn multiply<const FUSED: bool>(a: &[f32], b: &[f32], y: &mut [f32], (lines, inner, columns): (usize, usize, usize)) {
    for (a, y) in a.chunks_exact(inner).zip(y.chunks_exact_mut(columns)).take(lines) {
        let mut turns = a.chunks_exact(TURN).zip(b.chunks_exact(TURN * columns));
        let rest = inner % TURN;
        let from = inner - rest;
        let mut begun = false;
        for (a, b) in turns.by_ref() {
            let (b0, b) = b.split_at(columns);
            let (b1, b) = b.split_at(columns);
            let (b2, b3) = b.split_at(columns);
            for (t, y) in y.iter_mut().enumerate() {
                let sum = if begun { added::<FUSED>(a[0], b0[t], *y) } else { a[0] * b0[t] };
                let sum = added::<FUSED>(a[1], b1[t], sum);
                *y = added::<FUSED>(a[3], b3[t], added::<FUSED>(a[2], b2[t], sum));
            }
            begun = true;
        }
        for r in from..inner {
            let (a, b) = (a[r], &b[r * columns..][..columns]);
            if begun {
                y.iter_mut().zip(b).for_each(|(y, &b)| *y = added::<FUSED>(a, b, *y));
            } else {
                y.iter_mut().zip(b).for_each(|(y, &b)| *y = a * b);
            }
            begun = true;
        }
    }
}

#[inline(always)]
fn added<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    Real::mul_add::<FUSED>(a, b, c)
}

/// The core at the requested rows of undecomposed modes.
fn pick(node: &NodeView, requested: &[&Requested], n: usize, at: usize, halves: &mut Vec<u16>) {
    let (rank, last) = (node.ranks[n], n + 1 == node.order);
    let stride: usize = node.ranks[n + 1..node.order].iter().product();
    if last && node.decomposed[n] {
        halves.extend_from_slice(&node.core[at..at + rank]);
    } else if last {
        halves.extend(requested[n].pos.iter().map(|&row| node.core[at + row as usize]));
    } else if node.decomposed[n] {
        (0..rank).for_each(|r| pick(node, requested, n + 1, at + r * stride, halves));
    } else {
        requested[n].pos.iter().for_each(|&row| pick(node, requested, n + 1, at + row as usize * stride, halves));
    }
}
