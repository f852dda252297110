//! Gauss-Seidel over cells: each cell in turn takes its own part back into the residual and fits itself to the sum
//! by HOOI (paper, section 3.1). The error never rises, whatever the overlap of the cells.

use crate::cells::{Cell, Node};
use crate::tensor::{expand, gather, project, scatter_add, unfold};

/// How hard each cell is fitted when its turn comes.
#[derive(Clone, Copy)]
pub struct Effort {
    /// Rounds over all cells.
    pub sweeps: usize,
    /// Subspace iterations a mode update, started from the present basis.
    pub iterations: usize,
}

/// One cell's bases `[m_n, R_n]` (None for an undecomposed mode) and core.
struct Tucker {
    bases: Vec<Option<Vec<f32>>>,
    core: Vec<f32>,
}

/// Reconstruct: `core x_1 U_1 .. x_N U_N`.
fn reconstruct(part: &Tucker, ranks: &[usize], rows: &[Vec<u32>]) -> Vec<f32> {
    let mut sizes = ranks.to_vec();
    let mut x = part.core.clone();
    for (n, basis) in part.bases.iter().enumerate() {
        if let Some(basis) = basis {
            x = expand(&x, &mut sizes, n, basis, rows[n].len());
        }
    }
    x
}

/// Project every listed mode of `x` on its basis.
fn project_modes(x: Vec<f32>, sizes: &mut [usize], modes: impl Iterator<Item = usize>, part: &Tucker, ranks: &[usize]) -> Vec<f32> {
    modes.fold(x, |x, n| match &part.bases[n] {
        Some(basis) => project(&x, sizes, n, basis, ranks[n]),
        None => x,
    })
}

/// Orthonormalise the columns of `u` `[m, rank]` by Gram-Schmidt done twice; dependent columns become zero and stay so.
pub fn orthonormalise(u: &mut [f32], rank: usize) {
    let rows = u.len() / rank;
    for r in 0..rank {
        let norm_before = column_dot(u, rank, rows, r, r).sqrt();
        for _ in 0..2 {
            for q in 0..r {
                let along = column_dot(u, rank, rows, q, r) as f32;
                for i in 0..rows {
                    u[i * rank + r] -= along * u[i * rank + q];
                }
            }
        }
        let norm = column_dot(u, rank, rows, r, r).sqrt();
        // What is left of a dependent column is rounding noise: 1e-5 of float32's 1e-7 with two digits to spare.
        let scale = if norm > 1e-5 * norm_before && norm > 0.0 { (1.0 / norm) as f32 } else { 0.0 };
        (0..rows).for_each(|i| u[i * rank + r] *= scale);
    }
}

fn column_dot(u: &[f32], rank: usize, rows: usize, q: usize, r: usize) -> f64 {
    (0..rows).map(|i| f64::from(u[i * rank + q]) * f64::from(u[i * rank + r])).sum()
}

/// Leading left subspace of `e` `[m, q]` by subspace iteration from `u` `[m, rank]`: U <- orth(E E^T U).
fn subspace(e: &[f32], u: &mut Vec<f32>, rank: usize, iterations: usize) {
    let rows = u.len() / rank;
    let columns = e.len() / rows;
    for _ in 0..iterations {
        let coefficients = project(e, &mut [rows, columns], 0, u, rank); // [rank, q]
        *u = vec![0.0; rows * rank];
        for i in 0..rows {
            let row = &e[i * columns..(i + 1) * columns];
            for r in 0..rank {
                u[i * rank + r] =
                    row.iter().zip(&coefficients[r * columns..(r + 1) * columns]).map(|(a, b)| a * b).sum();
            }
        }
        orthonormalise(u, rank);
    }
}

/// One HOOI round on `block`: each half of the modes is updated with the other half projected away once.
fn hooi(block: &[f32], rows: &[Vec<u32>], part: &mut Tucker, ranks: &[usize], iterations: usize) {
    let order = ranks.len();
    let half = order.div_ceil(2);
    for modes in [0..half, half..order] {
        let mut sizes: Vec<usize> = rows.iter().map(Vec::len).collect();
        let away = (0..order).filter(|n| !modes.contains(n));
        let pair = project_modes(block.to_vec(), &mut sizes, away, part, ranks);
        for n in modes.clone() {
            let Some(mut basis) = part.bases[n].take() else { continue };
            let mut reduced = sizes.clone();
            let e = project_modes(pair.clone(), &mut reduced, modes.clone().filter(|&m| m != n), part, ranks);
            subspace(&unfold(&e, &reduced, n), &mut basis, ranks[n], iterations);
            part.bases[n] = Some(basis);
        }
        // The core follows from the half updated last; the first half's is overwritten.
        part.core = project_modes(pair, &mut sizes, modes, part, ranks);
    }
}

/// Fit all cells of `node` to `residual + model`, leaving in `residual` what they do not explain.
pub fn sweep(node: &Node, residual: &mut [f32], bases: &mut [&mut [f32]], cores: &mut [f32], effort: Effort) {
    let size = node.core_size();
    let cells: Vec<Cell> = node.each_cell().into_iter().filter(|cell| !cell.is_empty()).collect();
    for _ in 0..effort.sweeps {
        for cell in &cells {
            let core = &mut cores[cell.number * size..(cell.number + 1) * size];
            let mut part = load(node, cell, bases, core);
            let mut block = gather(residual, &node.sizes, &cell.rows);
            let before = reconstruct(&part, &node.ranks, &cell.rows);
            block.iter_mut().zip(&before).for_each(|(to, own)| *to += own);
            hooi(&block, &cell.rows, &mut part, &node.ranks, effort.iterations);
            let mut change = before;
            for (old, new) in change.iter_mut().zip(reconstruct(&part, &node.ranks, &cell.rows)) {
                *old -= new;
            }
            scatter_add(residual, &node.sizes, &cell.rows, &change, 1.0);
            core.copy_from_slice(&part.core);
            for (n, basis) in part.bases.iter().enumerate() {
                if let Some(basis) = basis {
                    cell.store_basis(node, n, basis, bases[n]);
                }
            }
        }
    }
}

/// `tensor += weight * model`, cell by cell.
pub fn accumulate(node: &Node, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    let size = node.core_size();
    for cell in node.each_cell().iter().filter(|cell| !cell.is_empty()) {
        let part = load(node, cell, bases, &cores[cell.number * size..(cell.number + 1) * size]);
        if part.core.iter().any(|&z| z != 0.0) {
            scatter_add(tensor, &node.sizes, &cell.rows, &reconstruct(&part, &node.ranks, &cell.rows), weight);
        }
    }
}

fn load<B: AsRef<[f32]>>(node: &Node, cell: &Cell, bases: &[B], core: &[f32]) -> Tucker {
    let basis = |n: usize| (!node.undecomposed[n]).then(|| cell.basis(node, n, bases[n].as_ref()));
    Tucker { bases: (0..node.order()).map(basis).collect(), core: core.to_vec() }
}
