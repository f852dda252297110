//! What the unit tests share.

use crate::cells::Node;

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

/// A node of sizes (3, 4, 2) and ranks (2, 3, 2), its last mode undecomposed, whose 4 cells overlap; and its bases.
pub fn overlapping_cells() -> (Node<'static>, Vec<Vec<f32>>) {
    let members: [&[u16]; 3] = [&[0, 1, 1], &[0, 1, 1, 0, 0, 1, 1, 0], &[0, 0]];
    let shape = (vec![3, 4, 2], vec![2, 2, 1], vec![1, 2, 1], vec![2, 3, 2], vec![false, false, true]);
    let node = Node::new(shape, members.to_vec()).unwrap();
    let bases = (0..3).map(|n| numbers(node.basis_size(n), n as u64 + 1)).collect();
    (node, bases)
}
