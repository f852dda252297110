//! Reconstruction of overlapping cells line by line: a line has all columns, the rows of the last mode b.
//!
//! For fixed rows of the leading modes the cores of the cells that meet there are contracted to `[R_a, R_b]` each, a
//! being the mode that makes the least work, and then with the bases of mode b: to panels, which each row of mode a
//! weighs. Lines are products of matrices then, cluster by cluster of mode b, whose columns are put back in their places
//! as lines are added to the tensor.

use crate::bundle::{Buffers, Bundle};
use crate::cells::Node;
use crate::grouped::{Lines, ROWS};
use crate::leading::{Partial, alike};
use crate::machine::dispatch;
use crate::mode_order::Turned;
use crate::threads::{PARALLEL, for_each};

/// What a group of rows and a multiply-add of a panel cost beside one of a line, measured.
const GROUP: f64 = 2.0;
const PANEL: f64 = 4.0;
/// Pieces the tensor is cut into, for threads to share.
const PIECES: usize = 64;

/// The mode whose rows make the least work; None where the last mode or all others have no bases, or what is left would
/// be too few tuples of rows for threads to share.
pub fn mode_of_rows(node: &Node) -> Option<usize> {
    let (b, elements) = (node.order() - 1, node.sizes.iter().product::<usize>());
    let shared = |n: usize| elements < PARALLEL || elements / (node.sizes[n] * node.sizes[b]) >= PIECES / 8;
    let open = |&n: &usize| !node.undecomposed[n] && !node.undecomposed[b] && shared(n);
    let cost = |n: usize| {
        let groups = alike(node, n, ROWS).len() as f64;
        let panels = (node.clusters[n] * node.ranks[b]) as f64 / node.mixture[n] as f64;
        node.ranks[n] as f64 * (1.0 + (GROUP * groups + PANEL * panels) / node.sizes[n] as f64)
    };
    let costs = (0..b).rev().filter(open).map(|n| (cost(n), n));
    costs.min_by(|x, y| x.0.total_cmp(&y.0)).map(|(_, n)| n)
}

/// `tensor += weight * model`, with the rows of this mode.
pub fn accumulate(node: &Node, mode: usize, tensor: &mut [f32], bases: &[&[f32]], cores: &[f32], weight: f32) {
    assert_eq!(tensor.len(), node.sizes.iter().product::<usize>());
    let turned = Turned::new(node, mode, bases, cores);
    let lines = Lines::new(&turned.node, &turned.bases);
    let all = lines.leading.cores(&turned.cores, weight);
    let inner = node.sizes[mode + 1..node.order() - 1].iter().product();
    let target = Target::new(tensor.as_mut_ptr(), node.sizes[mode], lines.columns, inner);
    let (count, parallel) = (lines.leading.count(), tensor.len() >= PARALLEL);
    let piece = if parallel { count.div_ceil(PIECES) } else { count };
    for_each(parallel, (0..count).step_by(piece).collect(), |from| {
        let mut buffers = Buffers::default();
        let range = from..count.min(from + piece);
        lines.leading.each(range, &all, |number, present| add(&lines, number, present, &mut buffers, &target));
    });
}

/// The tensor: a line of `columns` numbers for each row of mode a and each tuple of rows of the leading modes, of which
/// those behind mode a in the tensor have `inner` combinations.
pub struct Target {
    start: *mut f32,
    rows: usize,
    columns: usize,
    inner: usize,
}

// SAFETY: threads work on tuples or rows of mode a of their own, whose lines share no element.
unsafe impl Sync for Target {}

impl Target {
    pub fn new(start: *mut f32, rows: usize, columns: usize, inner: usize) -> Self {
        Target { start, rows, columns, inner }
    }

    /// Where row 0 of a tuple is found.
    pub fn tuple(&self, number: usize) -> *mut f32 {
        let line = number / self.inner * self.rows * self.inner + number % self.inner;
        self.start.wrapping_add(line * self.columns)
    }

    /// From one row of mode a to the next.
    pub fn step(&self) -> usize {
        self.inner * self.columns
    }
}

/// Where the tuples of a bundle start.
fn starts(lines: &Lines, number: usize, target: &Target, starts: &mut Vec<*mut f32>) {
    let (rows, first) = lines.leading.bundle(number);
    starts.clear();
    starts.extend(rows.iter().map(|&row| target.tuple(first + row as usize)));
}

/// Add the model to one bundle.
fn add(lines: &Lines, number: usize, present: &Partial, buffers: &mut Buffers, target: &Target) {
    starts(lines, number, target, &mut buffers.starts);
    starts(lines, number + 1, target, &mut buffers.ahead);
    // SAFETY: the bundle's lines lie in the tensor, and this thread alone works on them.
    dispatch(unsafe { Bundle::new(lines, present, buffers, target.step()) });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::Example;

    #[test]
    fn agrees_with_reconstruction_cell_by_cell() {
        on_all_machines(|| {
            // Few lines of several vectors, lines of one column, no leading mode, bundles of several rows, high ranks.
            compare_with_cells(&[3, 21, 37], &[2, 3, 5], &[2, 2, 3], &[2, 3, 2], None);
            compare_with_cells(&[3, 21, 37], &[1, 3, 5], &[1, 2, 3], &[3, 3, 2], Some(0));
            compare_with_cells(&[3, 4, 180], &[2, 3, 5], &[2, 2, 3], &[2, 3, 2], None);
            compare_with_cells(&[3, 40, 1], &[2, 3, 5], &[2, 2, 3], &[2, 3, 2], None);
            compare_with_cells(&[19, 50], &[2, 3], &[2, 2], &[3, 4], None);
            compare_with_cells(&[9, 4, 20, 13], &[3, 1, 2, 4], &[2, 1, 2, 2], &[2, 4, 3, 1], Some(1));
            compare_with_cells(&[5, 7, 6, 30], &[2, 3, 2, 2], &[1, 2, 2, 2], &[2, 1, 5, 6], None);
        });
    }

    /// With the rows of every mode that has bases.
    fn compare_with_cells(sizes: &[usize], c: &[usize], k: &[usize], ranks: &[usize], undecomposed: Option<usize>) {
        let example = Example::new(sizes, c, k, ranks, undecomposed);
        assert!(mode_of_rows(&example.node()).is_some());
        for mode in (0..sizes.len() - 1).filter(|&n| Some(n) != undecomposed) {
            example.compare(|node, tensor, bases, cores, weight| {
                accumulate(node, mode, tensor, bases, cores, weight);
            });
        }
    }
}
