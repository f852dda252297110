//! Rows of one mode sorted by membership while kernels run, so that the rows of a cell lie in few stretches.

use crate::threads::{for_each, room};

/// Slices of at least this many elements are long enough wherever they lie.
const LONG: usize = 64;
/// Slices sorted by one task.
const TASK: usize = 256 * 1024;

/// How the rows of a mode are sorted within each `[rows, unit]` piece of a tensor.
pub struct Sorting {
    /// The row that stands at each place.
    order: Vec<u32>,
    /// Elements of a row.
    unit: usize,
}

impl Sorting {
    /// A sorting by the subsets `[I_n, K_n]` of rows of `unit` elements; None where it would gain nothing.
    pub fn new(members: &[u16], mixture: usize, unit: usize) -> Option<Sorting> {
        let order = pattern_order(members, mixture);
        let sorted = order.windows(2).all(|pair| pair[0] < pair[1]);
        (unit < LONG && !sorted).then_some(Sorting { order, unit })
    }

    /// Where each row stands.
    pub fn places(&self) -> Vec<u32> {
        let mut places = vec![0; self.order.len()];
        for (place, &row) in self.order.iter().enumerate() {
            places[row as usize] = place as u32;
        }
        places
    }

    /// Sort the rows of a tensor in place.
    pub fn sort(&self, x: &mut [f32], buffer: &mut Vec<f32>) {
        let piece = self.order.len() * self.unit;
        let buffer = room(buffer, piece);
        for x in x.chunks_exact_mut(piece) {
            buffer.copy_from_slice(x);
            self.each(|row, place, length| x[place..place + length].copy_from_slice(&buffer[row..row + length]));
        }
    }

    /// Undo `sort`.
    pub fn restore(&self, x: &mut [f32], buffer: &mut Vec<f32>) {
        let piece = self.order.len() * self.unit;
        let buffer = room(buffer, piece);
        for x in x.chunks_exact_mut(piece) {
            buffer.copy_from_slice(x);
            self.each(|row, place, length| x[row..row + length].copy_from_slice(&buffer[place..place + length]));
        }
    }

    #[inline(always)]
    fn each(&self, mut copy: impl FnMut(usize, usize, usize)) {
        if self.unit == 1 {
            // Known lengths make these plain moves.
            self.order.iter().enumerate().for_each(|(place, &row)| copy(row as usize, place, 1));
        } else {
            self.order
                .iter()
                .enumerate()
                .for_each(|(place, &row)| copy(row as usize * self.unit, place * self.unit, self.unit));
        }
    }

    /// `sort` or `restore` a tensor on several threads.
    pub fn in_parallel(
        &self,
        x: &mut [f32],
        parallel: bool,
        apply: impl Fn(&Sorting, &mut [f32], &mut Vec<f32>) + Sync + Send,
    ) {
        let piece = self.order.len() * self.unit;
        let tasks = x.chunks_mut(piece * (TASK / piece).max(1)).collect();
        for_each(parallel, tasks, |x| apply(self, x, &mut vec![]));
    }
}

/// Rows ordered so that those with the same subsets stand together, next to those they share most subsets with.
fn pattern_order(members: &[u16], mixture: usize) -> Vec<u32> {
    let pattern = |row: u32| &members[row as usize * mixture..][..mixture];
    let mut rows: Vec<u32> = (0..(members.len() / mixture) as u32).collect();
    rows.sort_by_key(|&row| pattern(row));
    let mut groups: Vec<&[u32]> = rows.chunk_by(|&a, &b| pattern(a) == pattern(b)).collect();
    for at in 1..groups.len() {
        let before = pattern(groups[at - 1][0]);
        let shared = |group: &[u32]| pattern(group[0]).iter().filter(|k| before.contains(k)).count();
        let next = (at..groups.len()).rev().max_by_key(|&other| shared(groups[other]));
        groups[at..=next.unwrap_or(at)].rotate_right(1);
    }
    groups.concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::numbers;

    #[test]
    fn neighbours_share_subsets() {
        let members = [1, 2, 0, 1, 0, 2, 1, 2, 0, 1];
        assert_eq!(pattern_order(&members, 2), [1, 4, 2, 0, 3]);
        assert!(Sorting::new(&members, 2, LONG).is_none());
        assert!(Sorting::new(&[0, 0, 1, 2], 1, 1).is_none());
    }

    #[test]
    fn sorting_can_be_undone() {
        for unit in [1, 3] {
            let x = numbers(2 * 5 * unit, 1);
            let sorting = Sorting::new(&[1, 0, 1, 0, 2], 1, unit).unwrap();
            let mut y = x.clone();
            sorting.sort(&mut y, &mut vec![]);
            assert_eq!(sorting.places(), [2, 0, 3, 1, 4]);
            assert_eq!(y[..unit], x[unit..2 * unit]);
            sorting.in_parallel(&mut y, true, Sorting::restore);
            assert_eq!(y, x);
        }
    }
}
