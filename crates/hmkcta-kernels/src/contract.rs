//! A further mode summed over, lane by lane, after `pair_projection.rs`.

use crate::machine::dispatch;
use crate::sizes::zeros;
use crate::threads::{PARALLEL, for_each};
use pulp::{Simd, WithSimd};

/// `Y[i, k, r, l] = sum_j P[i, j, k, l] W[j, r, l]`: lane by lane, a further mode is summed over.
///
/// `P` is `[before, J, after, lanes]`, `W` `[J, R, lanes]`, the result `[before, after, R, lanes]`.
pub fn contract_lanes(p: &[f32], w: &[f32], sizes: [usize; 3], rank: usize, lanes: usize) -> Vec<f32> {
    let [before, size, after] = sizes;
    let mut y = zeros(before * after * rank * lanes);
    let tasks = y.chunks_mut(rank * lanes).enumerate().collect();
    for_each(p.len() >= PARALLEL, tasks, |(at, y)| {
        y.fill(0.0); // as pages of fresh zeros are not to be read first
        let from = &p[(at / after * size * after + at % after) * lanes..];
        dispatch(Lanes { from, step: after * lanes, w, y, lanes });
    });
    y
}

/// `y[r, l] = sum_j from[j, l] w[j, r, l]`, `step` from one j to the next.
struct Lanes<'a> {
    from: &'a [f32],
    step: usize,
    w: &'a [f32],
    y: &'a mut [f32],
    lanes: usize,
}

impl WithSimd for Lanes<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Lanes { from, step, w, y, lanes } = self;
        for (j, w) in w.chunks_exact(y.len()).enumerate() {
            let p = &from[j * step..][..lanes];
            for (y, w) in y.chunks_exact_mut(lanes).zip(w.chunks_exact(lanes)) {
                y.iter_mut().zip(p).zip(w).for_each(|((y, &p), &w)| *y += p * w);
            }
        }
    }
}
