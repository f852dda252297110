//! Mode products of small dense tensors in C order, written so that the innermost loop is contiguous.
//!
//! A tensor is a slice and its mode sizes. Seen from mode n it is `[before, I_n, after]`.

/// Product of the sizes before and after mode `n`.
fn around(sizes: &[usize], n: usize) -> (usize, usize) {
    (sizes[..n].iter().product(), sizes[n + 1..].iter().product())
}

/// Inner product with eight accumulators, so that the compiler may keep them in one vector register.
fn dot(x: &[f32], y: &[f32]) -> f32 {
    let mut sums = [0.0f32; 8];
    let (xs, ys) = (x.chunks_exact(8), y.chunks_exact(8));
    let tail: f32 = xs.remainder().iter().zip(ys.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in xs.zip(ys) {
        for lane in 0..8 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    tail + sums.iter().sum::<f32>()
}

/// y += a x
fn axpy(y: &mut [f32], a: f32, x: &[f32]) {
    for (to, from) in y.iter_mut().zip(x) {
        *to += a * from;
    }
}

/// `x x_n U^T` for `U` of shape `[I_n, rank]`: the mode-n product with the transposed basis. Updates `sizes`.
pub fn project(x: &[f32], sizes: &mut [usize], n: usize, basis: &[f32], rank: usize) -> Vec<f32> {
    let (before, after) = around(sizes, n);
    let rows = sizes[n];
    let mut y = vec![0.0f32; before * rank * after];
    if after == 1 {
        let columns: Vec<f32> = (0..rank).flat_map(|r| (0..rows).map(move |i| basis[i * rank + r])).collect();
        for a in 0..before {
            for r in 0..rank {
                y[a * rank + r] = dot(&x[a * rows..(a + 1) * rows], &columns[r * rows..(r + 1) * rows]);
            }
        }
    } else {
        for a in 0..before {
            let target = &mut y[a * rank * after..(a + 1) * rank * after];
            for i in 0..rows {
                let source = &x[(a * rows + i) * after..(a * rows + i + 1) * after];
                for (r, lane) in target.chunks_exact_mut(after).enumerate() {
                    axpy(lane, basis[i * rank + r], source);
                }
            }
        }
    }
    sizes[n] = rank;
    y
}

/// `z x_n U` for `U` of shape `[rows, R_n]`: the mode-n product with the basis. Updates `sizes`.
pub fn expand(z: &[f32], sizes: &mut [usize], n: usize, basis: &[f32], rows: usize) -> Vec<f32> {
    let (before, after) = around(sizes, n);
    let rank = sizes[n];
    let mut x = vec![0.0f32; before * rows * after];
    for a in 0..before {
        for i in 0..rows {
            let target = &mut x[(a * rows + i) * after..(a * rows + i + 1) * after];
            for r in 0..rank {
                axpy(target, basis[i * rank + r], &z[(a * rank + r) * after..(a * rank + r + 1) * after]);
            }
        }
    }
    sizes[n] = rows;
    x
}

/// The mode-n unfolding `[I_n, rest]` of a small tensor, rest in C order.
pub fn unfold(x: &[f32], sizes: &[usize], n: usize) -> Vec<f32> {
    let (before, after) = around(sizes, n);
    let rows = sizes[n];
    let mut y = Vec::with_capacity(x.len());
    for i in 0..rows {
        for a in 0..before {
            y.extend_from_slice(&x[(a * rows + i) * after..(a * rows + i + 1) * after]);
        }
    }
    y
}

/// Visit the contiguous runs of the sub-tensor with the given row lists: `visit(offset in x, offset in block)`.
///
/// A run covers the last mode, whose rows the caller applies itself.
pub fn for_each_run(sizes: &[usize], rows: &[Vec<u32>], mut visit: impl FnMut(usize, usize)) {
    let order = sizes.len();
    let runs: usize = rows[..order - 1].iter().map(Vec::len).product();
    let length = rows[order - 1].len();
    let mut position = vec![0usize; order - 1];
    for run in 0..runs {
        let mut start = 0;
        for n in 0..order - 1 {
            start = start * sizes[n] + rows[n][position[n]] as usize;
        }
        visit(start * sizes[order - 1], run * length);
        for n in (0..order - 1).rev() {
            position[n] += 1;
            if position[n] < rows[n].len() {
                break;
            }
            position[n] = 0;
        }
    }
}

/// Copy the sub-tensor with the given row lists into one piece.
pub fn gather(x: &[f32], sizes: &[usize], rows: &[Vec<u32>]) -> Vec<f32> {
    let last = &rows[sizes.len() - 1];
    let mut block = vec![0.0f32; rows.iter().map(Vec::len).product()];
    for_each_run(sizes, rows, |start, at| {
        for (to, &i) in block[at..at + last.len()].iter_mut().zip(last) {
            *to = x[start + i as usize];
        }
    });
    block
}

/// `x[rows] += weight * block`
pub fn scatter_add(x: &mut [f32], sizes: &[usize], rows: &[Vec<u32>], block: &[f32], weight: f32) {
    let last = &rows[sizes.len() - 1];
    for_each_run(sizes, rows, |start, at| {
        for (from, &i) in block[at..at + last.len()].iter().zip(last) {
            x[start + i as usize] += weight * from;
        }
    });
}
