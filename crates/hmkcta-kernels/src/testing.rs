//! What the unit tests share.

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
