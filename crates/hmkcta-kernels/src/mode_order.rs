//! A node whose modes come in another order.

use crate::cells::Node;

/// A node, its bases and cores with one mode moved to the place before the last.
pub struct Turned<'a> {
    pub node: Node<'a>,
    pub bases: Vec<Vec<f32>>,
    pub cores: Vec<f32>,
}

impl<'a> Turned<'a> {
    pub fn new(node: &Node<'a>, mode: usize, bases: &[&[f32]], cores: &[f32]) -> Self {
        let last = node.order() - 1;
        let order: Vec<usize> = (0..last).filter(|&n| n != mode).chain([mode, last]).collect();
        let turn = |of: &[usize]| order.iter().map(|&n| of[n]).collect::<Vec<usize>>();
        let undecomposed = order.iter().map(|&n| node.undecomposed[n]).collect();
        let shape = (turn(&node.sizes), turn(&node.clusters), turn(&node.mixture), turn(&node.ranks), undecomposed);
        let members = order.iter().map(|&n| node.members(n)).collect();
        // Numbers of all combinations of the modes between, of all of those behind.
        let (clusters, ranks) = (&node.clusters, &node.ranks);
        let between = |n: usize| (mode + 1..last).filter(|&m| m != n).map(|m| clusters[m]).product::<usize>();
        let basis = |&n: &usize| {
            if n == mode {
                return bases[n].to_vec();
            }
            let behind = if n == last { 1 } else { clusters[last] };
            swap(bases[n], clusters[mode], between(n), behind * ranks[n])
        };
        let size = node.core_size();
        let cells = swap(cores, clusters[mode], between(mode), clusters[last] * size);
        let between = ranks[mode + 1..last].iter().product();
        let cores = swap(&cells, ranks[mode], between, ranks[last]);
        let bases = order.iter().map(basis).collect();
        Turned { node: Node::new(shape, members).expect("modes of a node that is valid"), bases, cores }
    }
}

/// Numbers `[.., a, b, inner]` as `[.., b, a, inner]`.
fn swap(numbers: &[f32], a: usize, b: usize, inner: usize) -> Vec<f32> {
    if a == 1 || b == 1 {
        return numbers.to_vec();
    }
    let mut turned = Vec::with_capacity(numbers.len());
    for block in numbers.chunks_exact((a * b * inner).max(1)) {
        for j in 0..b {
            for i in 0..a {
                turned.extend_from_slice(&block[(i * b + j) * inner..][..inner]);
            }
        }
    }
    turned
}
