//! What the joint update of one mode's rows needs: projections of the data and inner products of dictionaries.

use crate::cells::{Cell, Node};
use crate::tensor::{gather, project};

/// `Y_n[c] = T x_{m != n} U_{m,c}^T` for all rows of mode `n`: `[PC, I_n, prod_{m != n} R_m]`, zero for empty cells.
pub fn project_cells(node: &Node, tensor: &[f32], bases: &[&[f32]], n: usize) -> Vec<f32> {
    let (order, rows) = (node.order(), node.sizes[n]);
    let columns = node.core_size() / node.ranks[n];
    let mut all = vec![0.0f32; node.cells() * rows * columns];
    for cell in node.each_cell() {
        let mut lists = cell.rows.clone();
        lists[n] = (0..rows as u32).collect();
        if lists.iter().any(Vec::is_empty) {
            continue;
        }
        let mut sizes: Vec<usize> = lists.iter().map(Vec::len).collect();
        let mut y = gather(tensor, &node.sizes, &lists);
        for m in (0..order).filter(|&m| m != n && !node.undecomposed[m]) {
            y = project(&y, &mut sizes, m, &cell.basis(node, m, bases[m]), node.ranks[m]);
        }
        let y = crate::tensor::unfold(&y, &sizes, n);
        all[cell.number * rows * columns..(cell.number + 1) * rows * columns].copy_from_slice(&y);
    }
    all
}

/// `M_m(c, c') = U_{m,c}^T U_{m,c'}` over the rows both cells share, `[R_m, R_m]`; None if they share none.
fn basis_gram(a: &Cell, b: &Cell, bases: (&[f64], &[f64]), m: usize, rank: usize) -> Option<Vec<f64>> {
    let mut gram = vec![0.0f64; rank * rank];
    let (mut i, mut j, mut shared) = (0, 0, false);
    while i < a.rows[m].len() && j < b.rows[m].len() {
        let (left, right) = (a.rows[m][i], b.rows[m][j]);
        if left == right {
            shared = true;
            for r in 0..rank {
                for q in 0..rank {
                    gram[r * rank + q] += bases.0[i * rank + r] * bases.1[j * rank + q];
                }
            }
        }
        i += usize::from(left <= right);
        j += usize::from(right <= left);
    }
    shared.then_some(gram)
}

/// `z x_m M` in float64 for a core seen as `[before, R_m, after]` and `M` `[R_m, R_m]`.
fn mode_product(z: &[f64], ranks: &[usize], m: usize, gram: &[f64]) -> Vec<f64> {
    let after: usize = ranks[m + 1..].iter().product();
    let rank = ranks[m];
    let mut y = vec![0.0f64; z.len()];
    for (from, to) in z.chunks_exact(rank * after).zip(y.chunks_exact_mut(rank * after)) {
        for r in 0..rank {
            for q in 0..rank {
                let weight = gram[r * rank + q];
                for (t, s) in to[q * after..(q + 1) * after].iter_mut().zip(&from[r * after..(r + 1) * after]) {
                    *t += weight * s;
                }
            }
        }
    }
    y
}

/// `unf_n(x) unf_n(z)^T`, `[R_n, R_n]`.
fn contract_all_but(x: &[f64], z: &[f64], ranks: &[usize], n: usize) -> Vec<f64> {
    let after: usize = ranks[n + 1..].iter().product();
    let rank = ranks[n];
    let mut h = vec![0.0f64; rank * rank];
    for (a, b) in x.chunks_exact(rank * after).zip(z.chunks_exact(rank * after)) {
        for r in 0..rank {
            for q in 0..rank {
                let (left, right) = (&a[r * after..(r + 1) * after], &b[q * after..(q + 1) * after]);
                h[r * rank + q] += left.iter().zip(right).map(|(s, t)| s * t).sum::<f64>();
            }
        }
    }
    h
}

/// `H_n[c,c'] = unf_n(Z_c) (kron_{m != n} M_m(c,c')) unf_n(Z_c')^T` for all pairs: `[PC R_n, PC R_n]`, symmetric.
///
/// Rows share a dictionary whatever their own memberships, so mode `n` itself puts no condition on a pair.
pub fn dictionary_gram(node: &Node, bases: &[&[f32]], cores: &[f32], n: usize) -> Vec<f64> {
    let (order, size, rank) = (node.order(), node.core_size(), node.ranks[n]);
    let cells = node.each_cell();
    let side = cells.len() * rank;
    let wide = |x: &[f32]| x.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();
    let cores = wide(cores);
    let decomposed: Vec<usize> = (0..order).filter(|&m| m != n && !node.undecomposed[m]).collect();
    let cell_bases: Vec<Vec<Vec<f64>>> = cells
        .iter()
        .map(|cell| decomposed.iter().map(|&m| wide(&cell.basis(node, m, bases[m]))).collect())
        .collect();
    let mut h = vec![0.0f64; side * side];
    for (c, cell) in cells.iter().enumerate() {
        for (d, other) in cells.iter().enumerate().skip(c) {
            let mut x = Some(cores[c * size..(c + 1) * size].to_vec());
            for (at, &m) in decomposed.iter().enumerate() {
                let gram = basis_gram(cell, other, (&cell_bases[c][at], &cell_bases[d][at]), m, node.ranks[m]);
                x = x.zip(gram).map(|(x, gram)| mode_product(&x, &node.ranks, m, &gram));
            }
            let Some(x) = x else { continue };
            let pair = contract_all_but(&x, &cores[d * size..(d + 1) * size], &node.ranks, n);
            for r in 0..rank {
                for q in 0..rank {
                    h[(c * rank + r) * side + d * rank + q] = pair[r * rank + q];
                    h[(d * rank + q) * side + c * rank + r] = pair[r * rank + q];
                }
            }
        }
    }
    h
}
