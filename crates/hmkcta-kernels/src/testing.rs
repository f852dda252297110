//! What the unit tests share.

use crate::cells::{Node, Shape};
use crate::reconstruct::by_cells;
use crate::threads::set_threads;
use std::sync::{Mutex, PoisonError};

/// Deterministic numbers in -0.5..0.5.
pub fn numbers(count: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
    };
    (0..count).map(|_| next()).collect()
}

/// Equal up to float32's rounding of sums of some hundred numbers below 1.
#[track_caller]
pub fn close(value: f32, expected: f64) {
    assert!((f64::from(value) - expected).abs() < 2e-5 * (1.0 + expected.abs()), "{value} instead of {expected}");
}

/// What comes out, which must be the same, bit by bit, whatever the number of threads.
pub fn on_any_threads(work: impl Fn() -> Vec<f32>) -> Vec<f32> {
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _guard = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let [first, rest @ ..] = [1, 2, 5].map(|threads| {
        set_threads(threads);
        work()
    });
    set_threads(0);
    rest.iter().for_each(|other| assert!(same_bits(&first, other), "threads change the result"));
    first
}

pub fn same_bits(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
}

/// More than a vector has lanes, and no multiple of them.
pub const CELLS: usize = 19;
/// The last mode is undecomposed.
pub const RANKS: [usize; 3] = [2, 3, 2];
const SIZES: [usize; 2] = [3, 4];

/// Bases of two modes of 3 and 4 rows, of which each cell has some.
pub struct OverlappingCells([Vec<f32>; 2]);

impl OverlappingCells {
    pub fn new() -> Self {
        OverlappingCells([0, 1].map(|m| numbers(CELLS * SIZES[m] * RANKS[m], m as u64 + 1)))
    }

    /// U_{m,c}[i, r], zero where row i is not the cell's.
    pub fn basis(&self, m: usize, c: usize, i: usize, r: usize) -> f64 {
        if (c + i + m).is_multiple_of(3) { 0.0 } else { f64::from(self.0[m][(c * SIZES[m] + i) * RANKS[m] + r]) }
    }

    /// U_{m,c}^T U_{m,c'} of all pairs, `[R_m, PC, R_m, PC]` of each mode.
    pub fn products(&self) -> [Vec<f64>; 3] {
        let of = |m: usize| {
            let columns = || (0..RANKS[m]).flat_map(|r| (0..CELLS).map(move |c| (r, c)));
            let product = |(r, c), (q, d)| (0..SIZES[m]).map(|i| self.basis(m, c, i, r) * self.basis(m, d, i, q)).sum();
            columns().flat_map(|one| columns().map(move |other| product(one, other))).collect()
        };
        [of(0), of(1), Vec::new()]
    }
}

/// A node whose rows belong to clusters in turn, and numbers for it.
pub struct Example {
    shape: Shape,
    members: Vec<Vec<u16>>,
}

impl Example {
    pub fn new(sizes: &[usize], c: &[usize], k: &[usize], ranks: &[usize], undecomposed: Option<usize>) -> Self {
        let of_rows = |n: usize| (0..sizes[n]).flat_map(move |i| (0..k[n]).map(move |k| ((i + k) % c[n]) as u16));
        let flags = (0..sizes.len()).map(|n| Some(n) == undecomposed).collect();
        Example {
            members: (0..sizes.len()).map(|n| of_rows(n).collect()).collect(),
            shape: (sizes.to_vec(), c.to_vec(), k.to_vec(), ranks.to_vec(), flags),
        }
    }

    pub fn node(&self) -> Node<'_> {
        Node::new(self.shape.clone(), self.members.iter().map(|m| m.as_slice()).collect()).unwrap()
    }

    /// Bases and cores.
    pub fn numbers(&self) -> (Vec<Vec<f32>>, Vec<f32>) {
        let node = self.node();
        let bases = (0..node.order()).map(|n| numbers(node.basis_size(n), n as u64)).collect();
        (bases, numbers(node.cells() * node.core_size(), 7))
    }

    /// Compare a reconstruction with that cell by cell.
    pub fn compare(&self, accumulate: impl Fn(&Node, &mut [f32], &[&[f32]], &[f32], f32)) {
        let node = self.node();
        let (bases, cores) = self.numbers();
        let bases: Vec<&[f32]> = bases.iter().map(|b| b.as_slice()).collect();
        let mut found = numbers(node.sizes.iter().product(), 8);
        let mut expected = found.clone();
        by_cells(&node, &mut expected, &bases, &cores, -0.5);
        accumulate(&node, &mut found, &bases, &cores, -0.5);
        found.iter().zip(&expected).for_each(|(&x, &y)| close(x, f64::from(y)));
    }
}
