//! Orthonormal bases of one mode, for all cells; what turns them goes into the cores.

use crate::cells::Node;
use crate::subspace::Buffers;

/// `U_n = Q S` for every cell: Q, orthonormal in the order of its columns, takes the place of the basis, and the core
/// becomes `Z x_n S`. Columns that depend on earlier ones become zero, and stay so.
pub fn orthonormalise(node: &Node, n: usize, stored: &mut [f32], cores: &mut [f32]) {
    let (mut buffers, mut mixed) = (Buffers::default(), vec![0.0; node.core_size()]);
    for (number, core) in (0..node.cells()).zip(cores.chunks_exact_mut(node.core_size())) {
        let cell = node.cell(number);
        if node.rows(n, cell.subset[n]).is_empty() {
            continue;
        }
        let before = node.load_basis(&cell, n, stored);
        let mut basis = before.clone();
        buffers.orthonormalise(&mut basis, node.ranks[n], true);
        node.store_basis(&cell, n, &basis, stored);
        let factor = factor(&basis, &before, node.ranks[n]);
        mode_product(core, &factor, node.ranks[n + 1..].iter().product(), &mut mixed);
        core.copy_from_slice(&mixed);
    }
}

/// `S = Q^T U` `[rank, rank]` of bases `[rank, rows]`.
fn factor(basis: &[f32], before: &[f32], rank: usize) -> Vec<f64> {
    let rows = basis.len() / rank;
    let dot = |q: &[f32], u: &[f32]| q.iter().zip(u).map(|(&q, &u)| f64::from(q) * f64::from(u)).sum();
    basis.chunks_exact(rows).flat_map(|q| before.chunks_exact(rows).map(move |u| dot(q, u))).collect()
}

/// `Z x_n S`, where `after` numbers lie between the entries of mode n.
fn mode_product(core: &[f32], factor: &[f64], after: usize, out: &mut [f32]) {
    let rank = factor.len().isqrt();
    for (core, out) in core.chunks_exact(rank * after).zip(out.chunks_exact_mut(rank * after)) {
        for (at, out) in out.iter_mut().enumerate() {
            let from = core[at % after..].iter().step_by(after);
            *out = factor[at / after * rank..].iter().zip(from).map(|(s, &z)| s * f64::from(z)).sum::<f64>() as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reconstruct::accumulate;
    use crate::testing::{close, numbers};

    /// Overlapping cells of a mode with twice the rank that the other allows, and a last, undecomposed one.
    fn node() -> Node<'static> {
        let shape = (vec![5, 4, 2], vec![2, 2, 1], vec![2, 1, 1], vec![2, 3, 2], vec![false, false, true]);
        Node::new(shape, vec![&[0, 1, 1, 0, 0, 1, 1, 0, 0, 1], &[0, 1, 1, 0], &[0, 0]]).unwrap()
    }

    #[test]
    fn the_model_stays_and_bases_become_orthonormal() {
        let sizes = [0, 1, 2].map(|m| node().basis_size(m));
        let mut bases = [0, 1, 2].map(|m| numbers(sizes[m], m as u64 + 3));
        let mut cores = numbers(4 * 12, 7);
        let mut expected = vec![0.0; 40];
        accumulate(node(), &mut expected, &bases.each_ref().map(Vec::as_slice), &cores, 1.0);
        for (n, stored) in bases.iter_mut().enumerate().take(2) {
            orthonormalise(&node(), n, stored, &mut cores);
            for number in 0..4 {
                let basis = node().load_basis(&node().cell(number), n, stored);
                let skew = factor(&basis, &basis, node().ranks[n]);
                // Of two rows, three columns cannot all be independent.
                skew.iter().enumerate().for_each(|(at, &s)| {
                    let one = f64::from(u8::from(at % (node().ranks[n] + 1) == 0 && (n == 0 || at < 8)));
                    close(s as f32, one);
                });
            }
        }
        let mut model = vec![0.0; 40];
        accumulate(node(), &mut model, &bases.each_ref().map(Vec::as_slice), &cores, 1.0);
        model.iter().zip(expected).for_each(|(&value, expected)| close(value, f64::from(expected)));
    }
}
