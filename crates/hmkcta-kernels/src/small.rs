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
/// Numbers of a basis, or of a product on the way, at most.
const ON_THE_WAY: usize = 1 << 18;

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
    /// Whether the node is one cell, and its requested elements, and what is on the way to them, are few enough.
    pub fn pay(node: &NodeView, requested: &[&Requested]) -> bool {
        let free = |n: usize| node.decomposed[n];
        let asked = |n: usize| requested[n].pos.len();
        let modes = || (0..node.order).rev();
        let elements = modes().fold(1_usize, |all, n| all.saturating_mul(asked(n)));
        if node.cells() != 1 || elements > MOST || node.core.len() > MOST.max(elements) {
            return false;
        }
        let mut size =
            modes().fold(1_usize, |all, n| all.saturating_mul(if free(n) { node.ranks[n] } else { asked(n) }));
        let mut most = size;
        for n in modes().filter(|&n| free(n)) {
            size = (size / node.ranks[n]).saturating_mul(asked(n));
            most = most.max(size).max(node.ranks[n].saturating_mul(asked(n)));
        }
        most <= ON_THE_WAY
    }

    /// The elements of the requested rows, `[m_1, .., m_N]`.
    pub fn block(&mut self, node: &NodeView, requested: &[&Requested]) -> Result<&[f32], String> {
        for (n, rows) in requested.iter().enumerate() {
            if let Some(row) = rows.pos.iter().find(|&&row| row as usize >= node.rows[n]) {
                return Err(format!("a node has no row {row} in mode {}", n + 1));
            }
            if node.cluster[n].iter().any(|&cluster| cluster > 0) {
                return Err(format!("mode {} of a node has one cluster, and rows of others", n + 1));
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
        let mut done = stretch::<32, FUSED>(a, b, y, 0);
        done = stretch::<8, FUSED>(a, b, y, done);
        done = stretch::<4, FUSED>(a, b, y, done);
        stretch::<1, FUSED>(a, b, y, done);
    }
}

/// A line of `y` from one column on, as far as `P` columns at a time go.
#[inline(always)]
fn stretch<const P: usize, const FUSED: bool>(a: &[f32], b: &[f32], y: &mut [f32], from: usize) -> usize {
    let columns = y.len();
    let mut at = from;
    while at + P <= columns {
        let mut sums = [0.0; P];
        for (&a, b) in a.iter().zip(b.chunks_exact(columns)) {
            let b: &[f32; P] = b[at..at + P].try_into().expect("P columns");
            for (sum, &b) in sums.iter_mut().zip(b) {
                *sum = added::<FUSED>(a, b, *sum);
            }
        }
        y[at..at + P].copy_from_slice(&sums);
        at += P;
    }
    at
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::packed::MOST_MODES;
    use crate::testing::close;

    #[test]
    fn products_are_those_of_single_elements() {
        on_all_machines(|| {
            for (ranks, rows, decomposed) in [
                ([2, 3, 2], [5, 9, 4], [true, true, true]),
                ([2, 9, 5], [5, 9, 40], [true, false, true]),
                ([6, 3, 4], [6, 3, 4], [false, false, false]),
                ([1, 1, 4], [3, 1, 4], [true, true, false]),
            ] {
                compare(&ranks, &rows, &decomposed);
            }
        });
    }

    fn compare(ranks: &[usize; 3], rows: &[usize; 3], decomposed: &[bool; 3]) {
        // Float16 from 1 to 2.
        let bits = |count: usize, seed: usize| {
            (0..count).map(|i| 0x3c00 + ((i * 37 + seed) % 1024) as u16).collect::<Vec<_>>()
        };
        let core = bits(ranks.iter().product(), 5);
        let bases: Vec<Vec<u16>> = (0..3).map(|n| bits(rows[n] * ranks[n], n)).collect();
        let mut node = NodeView {
            order: 3,
            clusters: [1; MOST_MODES],
            mixture: [1; MOST_MODES],
            ranks: [1; MOST_MODES],
            rows: [0; MOST_MODES],
            core: &core,
            scale: &[0.5],
            cluster: [&[]; MOST_MODES],
            basis: [&[]; MOST_MODES],
            decomposed: [false; MOST_MODES],
        };
        for n in 0..3 {
            (node.ranks[n], node.rows[n], node.decomposed[n]) = (ranks[n], rows[n], decomposed[n]);
            node.basis[n] = if decomposed[n] { &bases[n] } else { &[] };
        }
        let wanted: Vec<Requested> = rows
            .iter()
            .map(|&rows| Requested::new((0..rows as u32).rev().collect(), (0..rows as u32).collect()))
            .collect();
        let mut products = Products::default();
        let requested: Vec<&Requested> = wanted.iter().collect();
        let found = products.block(&node, &requested).unwrap();
        for (at, &value) in found.iter().enumerate() {
            let place = [at / (rows[1] * rows[2]), at / rows[2] % rows[1], at % rows[2]];
            let row: [usize; 3] = std::array::from_fn(|n| rows[n] - 1 - place[n]);
            let weight = |n: usize, r: usize| match decomposed[n] {
                true => f64::widen(bases[n][row[n] * ranks[n] + r]),
                false => f64::from(u8::from(r == row[n])),
            };
            let expected: f64 = (0..core.len())
                .map(|c| {
                    let r = [c / (ranks[1] * ranks[2]), c / ranks[2] % ranks[1], c % ranks[2]];
                    0.5 * f64::widen(core[c]) * (0..3).map(|n| weight(n, r[n])).product::<f64>()
                })
                .sum();
            close(value / expected as f32, 1.0);
        }
        let outside = Requested::new(vec![rows[0] as u32], vec![0]);
        assert!(products.block(&node, &[&outside, &wanted[1], &wanted[2]]).is_err());
    }
}
