//! Columns sorted by their clusters put back in their places, as lines are added to a tensor.

use crate::cells::Node;
use crate::leading::PAD;
use crate::machine::lanes;
use crate::shuffle::{FILLED, Order, Shuffle};
use pulp::Simd;

/// Where columns are in a line of all clusters' members: a column is found once for each of its clusters. A line may be
/// of several tuples, whose members of a cluster lie side by side.
pub struct Places {
    columns: usize,
    /// Of the vectors that columns are put back by.
    lanes: usize,
    /// How many columns each cluster has.
    pub members: Vec<usize>,
    /// Where those of each cluster start, padded, and where the last ones end: of one tuple, of as many as there may be.
    pub starts: Vec<usize>,
    pub segments: Vec<usize>,
    blocks: Vec<Block>,
}

/// Columns put back at a time: as many as a vector has lanes, or all if they are fewer.
struct Block {
    first: usize,
    /// Of each cluster that has members among them.
    sources: Vec<Source>,
}

/// The members of one cluster among the columns of a block: neighbours in the line.
struct Source {
    start: usize,
    /// From one tuple to the next.
    step: usize,
    /// Which of them each column of the block is.
    order: Order,
}

/// Columns cut into blocks of a vector: where each starts, and from which column on it is new. The last ones that fill no
/// vector go with some before them, and come first, so that where there are several none is read that was just written.
pub fn cut(columns: usize, lanes: usize) -> impl Iterator<Item = (usize, usize)> {
    let whole = columns - columns % lanes;
    let rest = (whole < columns).then_some((columns.saturating_sub(lanes), whole));
    rest.into_iter().chain((0..whole).step_by(lanes).map(|first| (first, first)))
}

impl Places {
    /// Of the columns of mode b, in lines of up to so many tuples.
    pub fn new(node: &Node, b: usize, tuples: usize) -> Places {
        let (columns, lanes) = (node.sizes[b], lanes());
        let members: Vec<usize> = (0..node.clusters[b]).map(|c| node.rows(b, c).len()).collect();
        let ends = |length: &dyn Fn(usize) -> usize| {
            let mut ends = vec![0];
            members.iter().for_each(|&members| ends.push(ends[ends.len() - 1] + length(members)));
            ends
        };
        let starts = ends(&|members| members.next_multiple_of(PAD));
        let segments = ends(&|members| ((tuples - 1) * members + members.next_multiple_of(PAD)).next_multiple_of(PAD));
        let source = |c: usize, first: usize, new: usize| {
            let before = |column: usize| node.rows(b, c).partition_point(|&j| (j as usize) < column);
            let inside = before(new)..before(first + lanes);
            let mut source = Source { start: segments[c] + inside.start, step: members[c], order: Order::default() };
            for (at, &j) in node.rows(b, c)[inside.clone()].iter().enumerate() {
                source.order[j as usize - first] = FILLED | at as u32;
            }
            Some(source).filter(|_| !inside.is_empty())
        };
        let blocks = cut(columns, lanes).map(|(first, new)| Block {
            first,
            sources: (0..members.len()).filter_map(|c| source(c, first, new)).collect(),
        });
        Places { columns, lanes, blocks: blocks.collect(), members, starts, segments }
    }

    /// Numbers of a line.
    pub fn line(&self) -> usize {
        self.segments[self.members.len()]
    }

    /// Add `M` lines of one of the tuples to these rows; `lines` ends with a vector more than the last.
    ///
    /// # Safety
    /// The rows have all columns, and nobody else refers to them.
    #[inline(always)]
    pub unsafe fn add<S: Simd, const M: usize>(&self, _: S, lines: &[f32], tuple: usize, rows: [*mut f32; M]) {
        // SAFETY: as many lanes as the machine has, which is what `Shuffle` needs; the rest the caller promises.
        unsafe {
            match S::F32_LANES {
                #[cfg(target_arch = "x86_64")]
                16 => self.rows::<std::arch::x86_64::__m512, M>(lines, tuple, rows),
                #[cfg(target_arch = "x86_64")]
                8 => self.rows::<std::arch::x86_64::__m256, M>(lines, tuple, rows),
                _ => self.rows::<[f32; 4], M>(lines, tuple, rows),
            }
        }
    }

    /// # Safety
    /// That of `add`; the machine has these vectors.
    #[inline(always)]
    unsafe fn rows<V: Shuffle, const M: usize>(&self, lines: &[f32], tuple: usize, rows: [*mut f32; M]) {
        assert!(V::LANES == self.lanes && M * self.line() + V::LANES <= lines.len());
        if self.columns >= V::LANES {
            // SAFETY: as the caller promises, and as asserted.
            return unsafe { self.blocks::<V, M>(lines, tuple, rows) };
        }
        let mut few = [[0.0; PAD]; M];
        // SAFETY: rows have all columns, and `few` has a vector of numbers for each.
        unsafe {
            few.iter_mut().zip(rows).for_each(|(few, row)| row.copy_to_nonoverlapping(few.as_mut_ptr(), self.columns));
            self.blocks::<V, M>(lines, tuple, few.each_mut().map(|few| few.as_mut_ptr()));
            few.iter().zip(rows).for_each(|(few, row)| row.copy_from_nonoverlapping(few.as_ptr(), self.columns));
        }
    }

    /// # Safety
    /// From each source's start on the lines have a vector of numbers, and so have the rows from each block's.
    #[inline(always)]
    unsafe fn blocks<V: Shuffle, const M: usize>(&self, lines: &[f32], tuple: usize, rows: [*mut f32; M]) {
        for Block { first, sources } in &self.blocks {
            // SAFETY: as the caller promises.
            unsafe {
                let mut sums = rows.map(|row| V::load(row.add(*first)));
                for Source { start, step, order } in sources {
                    let members = lines.as_ptr().add(start + tuple * step);
                    for (m, sum) in sums.iter_mut().enumerate() {
                        *sum = sum.add_shuffled(order, members.add(m * self.line()));
                    }
                }
                rows.into_iter().zip(sums).for_each(|(row, sum)| sum.store(row.add(*first)));
            }
        }
    }
}
