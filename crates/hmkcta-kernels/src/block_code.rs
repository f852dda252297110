//! A block's numbers at a step D: bases rounded column by column, the core fitted to the rounded bases and rounded.
//! The twin of `hmkcta.search.block_code`.

use crate::rank_boxes::MODES;

/// Largest exponent k of a column: its numbers are multiples of 2^(-k/2).
pub const MOST_EXPONENT: i32 = 63;
/// Largest magnitude of a whole number.
const MOST_WHOLE: f32 = 16_777_215.0;

/// A block, its orthonormal bases and its core in them.
pub struct Block<'a> {
    /// Rows of each mode.
    pub sizes: &'a [usize],
    /// Columns of each mode that are kept; all rows of an undecomposed mode.
    pub ranks: &'a [usize],
    pub decomposed: &'a [bool],
    /// The values, C order.
    pub values: &'a [f32],
    /// `[n, n]`, a column a line of numbers apart; empty for an undecomposed mode.
    pub bases: [&'a [f32]; MODES],
    /// The core in all columns, C order.
    pub core: &'a [f32],
}

/// Whole numbers of a block.
#[derive(Default)]
pub struct Code {
    /// By mode: the exponents of the columns kept; none in an undecomposed mode.
    pub exponents: [Vec<u8>; MODES],
    /// By mode: `[rows, rank]`.
    pub bases: [Vec<i32>; MODES],
    pub core: Vec<i32>,
    /// Squared error of the values as decoded.
    pub error: f64,
}

/// Buffers of one thread.
#[derive(Default)]
pub struct Coder {
    rounded: [Vec<f32>; MODES],
    inverse: Vec<f32>,
    gram: Vec<f64>,
    tensor: Vec<f32>,
    spare: Vec<f32>,
}

/// Rounded towards zero by `dead_zone` more than to the nearest.
#[inline(always)]
fn whole(x: f32, dead_zone: f32) -> f32 {
    (x.abs() + (0.5 - dead_zone)).floor().min(MOST_WHOLE).copysign(x)
}

impl Coder {
    #[inline(always)]
    pub fn code(&mut self, block: &Block, step: f32, dead_zone: f32) -> Code {
        let mut code = Code::default();
        let order = block.sizes.len();
        if block.ranks[0] == 0 {
            code.error = block.values.iter().map(|&x| f64::from(x) * f64::from(x)).sum();
            return code;
        }
        self.tensor.clear();
        self.tensor.extend_from_slice(block.values);
        let mut shape = block.sizes.to_vec();
        for n in (0..order).filter(|&n| block.decomposed[n]) {
            code.exponents[n] = exponents(block, n, step);
            code.bases[n] = self.round_basis(block, n, &code.exponents[n], dead_zone);
            self.invert(n, block.sizes[n], block.ranks[n]);
            product(&self.inverse, block.ranks[n], &self.tensor, &shape, n, &mut self.spare);
            std::mem::swap(&mut self.tensor, &mut self.spare);
            shape[n] = block.ranks[n];
        }
        code.core = Vec::with_capacity(self.tensor.len());
        for number in &mut self.tensor {
            let q = whole(*number / step, dead_zone);
            code.core.push(q as i32);
            *number = q * step;
        }
        for n in (0..order).filter(|&n| block.decomposed[n]) {
            product(&self.rounded[n], block.sizes[n], &self.tensor, &shape, n, &mut self.spare);
            std::mem::swap(&mut self.tensor, &mut self.spare);
            shape[n] = block.sizes[n];
        }
        code.error = block.values.iter().zip(&self.tensor).map(|(&x, &y)| f64::from(x - y) * f64::from(x - y)).sum();
        code
    }

    /// The whole numbers `[rows, rank]` of a basis; what they stand for is kept in `rounded`.
    #[inline(always)]
    fn round_basis(&mut self, block: &Block, n: usize, exponents: &[u8], dead_zone: f32) -> Vec<i32> {
        let (rows, rank) = (block.sizes[n], block.ranks[n]);
        let scales: Vec<f32> = exponents.iter().map(|&k| (0.5 * f32::from(k)).exp2()).collect();
        let rounded = &mut self.rounded[n];
        rounded.clear();
        let mut all = Vec::with_capacity(rows * rank);
        for row in block.bases[n].chunks_exact(rows) {
            for (&u, &scale) in row[..rank].iter().zip(&scales) {
                let q = whole(u * scale, dead_zone);
                all.push(q as i32);
                rounded.push(q / scale);
            }
        }
        all
    }

    /// The pseudo-inverse `[rank, rows]` of the rounded basis, by Cholesky with a small ridge, in float64.
    #[inline(always)]
    fn invert(&mut self, n: usize, rows: usize, rank: usize) {
        let basis = &self.rounded[n];
        let gram = &mut self.gram;
        gram.clear();
        gram.resize(rank * rank, 0.0);
        for row in basis.chunks_exact(rank) {
            for (i, &a) in row.iter().enumerate() {
                for (sum, &b) in gram[i * rank..i * rank + i + 1].iter_mut().zip(row) {
                    *sum += f64::from(a) * f64::from(b);
                }
            }
        }
        // A ridge of 1e-9 keeps columns that were rounded to zero, or to each other, from dividing by zero.
        for i in 0..rank {
            for j in 0..=i {
                let ahead: f64 = (0..j).map(|l| gram[i * rank + l] * gram[j * rank + l]).sum();
                let rest = gram[i * rank + j] - ahead;
                gram[i * rank + j] = if i == j { (rest + 1e-9).max(1e-12).sqrt() } else { rest / gram[j * rank + j] };
            }
        }
        self.inverse.resize(rank * rows, 0.0);
        let mut solved = vec![0f64; rank];
        for (i, row) in basis.chunks_exact(rank).enumerate() {
            for j in 0..rank {
                let ahead: f64 = (0..j).map(|l| gram[j * rank + l] * solved[l]).sum();
                solved[j] = (f64::from(row[j]) - ahead) / gram[j * rank + j];
            }
            for j in (0..rank).rev() {
                let behind: f64 = (j + 1..rank).map(|l| gram[l * rank + j] * solved[l]).sum();
                solved[j] = (solved[j] - behind) / gram[j * rank + j];
                self.inverse[j * rows + i] = solved[j] as f32;
            }
        }
    }
}

/// Exponent k of each kept column: the multiple of half an octave next to its singular value, in units of the step.
#[inline(always)]
fn exponents(block: &Block, mode: usize, step: f32) -> Vec<u8> {
    let order = block.sizes.len();
    let mut energies = vec![0f64; block.ranks[mode]];
    let mut index = [0usize; MODES];
    let last = block.sizes[order - 1];
    for line in block.core.chunks_exact(last) {
        if (0..order - 1).all(|n| index[n] < block.ranks[n]) {
            let line = &line[..block.ranks[order - 1]];
            if mode == order - 1 {
                for (sum, &c) in energies.iter_mut().zip(line) {
                    *sum += f64::from(c) * f64::from(c);
                }
            } else {
                energies[index[mode]] += line.iter().map(|&c| f64::from(c) * f64::from(c)).sum::<f64>();
            }
        }
        for n in (0..order - 1).rev() {
            index[n] += 1;
            if index[n] < block.sizes[n] {
                break;
            }
            index[n] = 0;
        }
    }
    let unit = f64::from(step) * f64::from(step);
    energies.iter().map(|&e| ((e / unit).max(1.0).log2().round() as i32).clamp(0, MOST_EXPONENT) as u8).collect()
}

/// `tensor` times `matrix` `[rows, n]` along a mode; `shape` is the tensor's.
#[inline(always)]
fn product(matrix: &[f32], rows: usize, tensor: &[f32], shape: &[usize], mode: usize, out: &mut Vec<f32>) {
    let size = shape[mode];
    let inner: usize = shape[mode + 1..].iter().product();
    out.clear();
    out.resize(tensor.len() / size * rows, 0.0);
    for (from, to) in tensor.chunks_exact(size * inner).zip(out.chunks_exact_mut(rows * inner)) {
        if inner == 1 {
            for (number, weights) in to.iter_mut().zip(matrix.chunks_exact(size)) {
                *number = dot(weights, from);
            }
            continue;
        }
        for (line, weights) in to.chunks_exact_mut(inner).zip(matrix.chunks_exact(size)) {
            for (&weight, values) in weights.iter().zip(from.chunks_exact(inner)) {
                for (sum, &value) in line.iter_mut().zip(values) {
                    *sum += weight * value;
                }
            }
        }
    }
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0f32; 16];
    let (a_lanes, a_left) = a.as_chunks::<16>();
    let (b_lanes, b_left) = b.as_chunks::<16>();
    for (a, b) in a_lanes.iter().zip(b_lanes) {
        for i in 0..16 {
            lanes[i] += a[i] * b[i];
        }
    }
    lanes.iter().sum::<f32>() + a_left.iter().zip(b_left).map(|(&a, &b)| a * b).sum::<f32>()
}
