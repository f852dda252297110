//! Mode products of small dense tensors in C order, one after the other.
//!
//! A tensor is a slice and its mode sizes. Seen from mode n it is `[before, I_n, after]`. Bases are kept transposed,
//! `[R_n, m_n]`.

use crate::dots::dots_on;
use crate::gemm::{Matrix, multiply_on};
use crate::threads::{PARALLEL, PIECES, for_each, room};

/// Rows of a matrix transposed at a time, and the fewest columns that a thread shall transpose.
const TILE: usize = 32;

/// `x x_n U^T` (project) or `z x_n U` (expand).
struct Step<'a> {
    before: usize,
    rows: usize,
    rank: usize,
    after: usize,
    basis: &'a [f32],
    expand: bool,
}

/// Mode products to be done in a row on tensors of one shape.
pub struct Chain<'a> {
    steps: Vec<Step<'a>>,
    input: usize,
    parallel: bool,
}

impl<'a> Chain<'a> {
    /// Project the listed modes of a tensor of the given sizes on their bases; updates the sizes.
    pub fn project(
        sizes: &mut [usize],
        modes: impl Iterator<Item = usize>,
        bases: &'a [Option<Vec<f32>>],
    ) -> Chain<'a> {
        Chain::new(sizes, modes, bases, false)
    }

    /// Expand the listed modes of a tensor of the given sizes by their bases; updates the sizes.
    pub fn expand(sizes: &mut [usize], modes: impl Iterator<Item = usize>, bases: &'a [Option<Vec<f32>>]) -> Chain<'a> {
        Chain::new(sizes, modes, bases, true)
    }

    /// Modes without a basis, undecomposed ones, stay as they are.
    fn new(
        sizes: &mut [usize],
        modes: impl Iterator<Item = usize>,
        bases: &'a [Option<Vec<f32>>],
        expand: bool,
    ) -> Chain<'a> {
        let input = sizes.iter().product();
        let mut steps = vec![];
        for n in modes {
            let Some(basis) = &bases[n] else { continue };
            let (before, after) = (sizes[..n].iter().product(), sizes[n + 1..].iter().product());
            let size = sizes[n];
            let other = basis.len() / size;
            let (rows, rank) = if expand { (other, size) } else { (size, other) };
            sizes[n] = other;
            steps.push(Step { before, rows, rank, after, basis, expand });
        }
        Chain { steps, input, parallel: false }
    }

    /// The same, each step by several threads if `parallel` and if it is worth it.
    pub fn on(self, parallel: bool) -> Chain<'a> {
        Chain { parallel, ..self }
    }

    /// Whether nothing is to be done.
    pub fn is_identity(&self) -> bool {
        self.steps.is_empty()
    }

    /// Numbers that come out for one tensor that goes in.
    pub fn output(&self) -> usize {
        self.steps.last().map_or(self.input, Step::output)
    }

    /// Apply the steps to as many tensors as lie in `x`, the results one behind the other.
    pub fn run(&self, x: &[f32], out: &mut [f32], scratch: &mut [Vec<f32>; 2]) {
        self.apply(x, out, scratch, false);
    }

    /// The same, or add the results to what `out` holds.
    pub fn apply(&self, x: &[f32], out: &mut [f32], scratch: &mut [Vec<f32>; 2], add: bool) {
        let Some((last, first)) = self.steps.split_last() else {
            return out.iter_mut().zip(x).for_each(|(to, &value)| *to = if add { *to + value } else { value });
        };
        let times = x.len() / self.input.max(1);
        let [ping, pong] = scratch;
        let (mut from, mut to) = (ping, pong);
        for (number, step) in first.iter().enumerate() {
            let input = if number == 0 { x } else { &from[..times * first[number - 1].output()] };
            step.run(times, input, room(to, times * step.output()), false, self.parallel);
            std::mem::swap(&mut from, &mut to);
        }
        last.run(times, first.last().map_or(x, |step| &from[..times * step.output()]), out, add, self.parallel);
    }
}

impl Step<'_> {
    fn output(&self) -> usize {
        self.before * self.after * if self.expand { self.rows } else { self.rank }
    }

    fn run(&self, times: usize, x: &[f32], out: &mut [f32], add: bool, parallel: bool) {
        let &Step { rows, rank, after, basis, expand, .. } = self;
        let basis = Matrix::new(basis, rank, rows);
        match (expand, after) {
            (false, 1) => dots_on(parallel, x, self.basis, rows, add, out),
            (true, 1) => multiply_on(parallel, Matrix::new(x, times * self.before, rank), basis, add, out),
            (false, _) => multiply_on(parallel, basis, Matrix::new(x, rows, after), add, out),
            (true, _) => multiply_on(parallel, basis.transposed(), Matrix::new(x, rank, after), add, out),
        }
    }
}

/// The mode-n unfolding `[I_n, rest]`, rest in C order; by several threads if `parallel` and if it is worth it.
pub fn unfold(parallel: bool, x: &[f32], sizes: &[usize], n: usize, out: &mut [f32]) {
    let (rows, after) = (sizes[n], sizes[n + 1..].iter().product::<usize>());
    let rest = x.len() / rows;
    let parallel = parallel && x.len() >= PARALLEL;
    let some = if parallel { rows.div_ceil(PIECES).max(TILE.div_ceil(after)) } else { rows };
    for_each(parallel, out.chunks_mut(some * rest).enumerate().collect(), |(number, out)| {
        let first = number * some;
        if after == 1 {
            return transpose_columns(x, rows, first, out);
        }
        for (i, row) in (first..).zip(out.chunks_exact_mut(rest)) {
            for (a, piece) in row.chunks_exact_mut(after).enumerate() {
                piece.copy_from_slice(&x[(a * rows + i) * after..][..after]);
            }
        }
    });
}

/// The transpose of a matrix of `columns` columns.
pub fn transpose(x: &[f32], columns: usize, out: &mut [f32]) {
    transpose_columns(x, columns, 0, out);
}

/// As many columns as there is room for, from `first` on.
fn transpose_columns(x: &[f32], columns: usize, first: usize, out: &mut [f32]) {
    let rows = x.len() / columns;
    for top in (0..rows).step_by(TILE) {
        let tile = TILE.min(rows - top);
        for (j, out) in (first..).zip(out.chunks_exact_mut(rows)) {
            let column = x[top * columns + j..].iter().step_by(columns);
            out[top..][..tile].iter_mut().zip(column).for_each(|(to, &value)| *to = value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{close, numbers};

    /// `sum_i U[i, r] x[.., i, ..]` or `sum_r U[i, r] x[.., r, ..]`, term by term.
    fn mode_product(x: &[f32], sizes: &mut [usize], n: usize, basis: &[f32], expand: bool) -> Vec<f32> {
        let (before, after): (usize, usize) = (sizes[..n].iter().product(), sizes[n + 1..].iter().product());
        let (size, other) = (sizes[n], basis.len() / sizes[n]);
        let mut y = vec![0.0; before * other * after];
        for (at, value) in y.iter_mut().enumerate() {
            let (b, o, a) = (at / (other * after), at / after % other, at % after);
            let number = |s: usize| if expand { basis[s * other + o] } else { basis[o * size + s] };
            *value = (0..size).map(|s| number(s) * x[(b * size + s) * after + a]).sum();
        }
        sizes[n] = other;
        y
    }

    #[test]
    fn chains_agree_with_mode_products_one_by_one() {
        for expand in [false, true] {
            let (rows, ranks) = ([5, 3, 4, 9], [2, 3, 4, 3]);
            let bases: Vec<Option<Vec<f32>>> =
                (0..4).map(|n| (n != 2).then(|| numbers(rows[n] * ranks[n], n as u64))).collect();
            let mut sizes = if expand { ranks } else { rows };
            let x = numbers(2 * sizes.iter().product::<usize>(), 9);
            let chain_modes = [3, 1, 2, 0];
            let mut after = sizes;
            let chain = Chain::new(&mut after, chain_modes.into_iter(), &bases, expand);
            let mut out = vec![7.0; 2 * chain.output()];
            chain.run(&x, &mut out, &mut Default::default());
            let mut sum = vec![1.0; out.len()];
            chain.apply(&x, &mut sum, &mut Default::default(), true);
            let mut expected = x;
            let mut twice = [2, sizes[0], sizes[1], sizes[2], sizes[3]];
            for n in chain_modes {
                if let Some(basis) = &bases[n] {
                    expected = mode_product(&expected, &mut twice, n + 1, basis, expand);
                }
            }
            sizes.copy_from_slice(&twice[1..]);
            assert_eq!(after, sizes);
            out.iter().zip(&expected).for_each(|(&value, &expected)| close(value, f64::from(expected)));
            sum.iter().zip(&expected).for_each(|(&value, &expected)| close(value, f64::from(expected) + 1.0));
        }
    }

    #[test]
    fn unfolding_brings_a_mode_to_the_front() {
        let x: Vec<f32> = (0..24).map(|i| i as f32).collect();
        let mut y = vec![0.0; 24];
        unfold(false, &x, &[2, 3, 4], 1, &mut y);
        assert_eq!(y[..10], [0.0, 1.0, 2.0, 3.0, 12.0, 13.0, 14.0, 15.0, 4.0, 5.0]);
        unfold(false, &x, &[2, 3, 4], 2, &mut y);
        assert_eq!(y[..8], [0.0, 4.0, 8.0, 12.0, 16.0, 20.0, 1.0, 5.0]);
    }

    #[test]
    fn threads_unfold_as_one_does() {
        for (sizes, n) in [([1, 450, 450], 2), ([70, 50, 60], 1), ([3, 500, 140], 0)] {
            let x = numbers(sizes.iter().product(), 1);
            let unfolded = |parallel| {
                let mut out = vec![0.0; x.len()];
                unfold(parallel, &x, &sizes, n, &mut out);
                out
            };
            assert_eq!(unfolded(true), unfolded(false));
        }
    }
}
