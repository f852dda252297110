//! Columns sorted by their clusters put back in their places, as lines are added to a tensor.

use crate::cells::Node;
use crate::lines::PAD;
use pulp::Simd;

/// Columns of a line put back at a time.
const BLOCK: usize = 16;

/// Where columns are in a line of all clusters' members: a column is found once for each of its clusters. A line may be
/// of several tuples, whose members of a cluster lie side by side.
pub struct Places {
    columns: usize,
    /// How many columns each cluster has.
    pub members: Vec<usize>,
    /// Where those of each cluster start, padded, and where the last ones end: of one tuple, of as many as there may be.
    pub starts: Vec<usize>,
    pub segments: Vec<usize>,
    /// For each block of columns the clusters that have members among them.
    blocks: Vec<Vec<Source>>,
}

/// The members of one cluster among the columns of a block: neighbours in the line.
struct Source {
    start: usize,
    /// From one tuple to the next.
    step: usize,
    /// Which columns of the block they are, and which of them each such column is.
    mask: u16,
    order: [u32; BLOCK],
}

impl Places {
    /// Of the columns of mode b, in lines of up to so many tuples.
    pub fn new(node: &Node, b: usize, tuples: usize) -> Places {
        let members: Vec<usize> = (0..node.clusters[b]).map(|c| node.rows(b, c).len()).collect();
        let ends = |length: &dyn Fn(usize) -> usize| {
            let mut ends = vec![0];
            members.iter().for_each(|&members| ends.push(ends[ends.len() - 1] + length(members)));
            ends
        };
        let starts = ends(&|members| members.next_multiple_of(PAD));
        let segments = ends(&|members| ((tuples - 1) * members + members.next_multiple_of(PAD)).next_multiple_of(PAD));
        let source = |block: usize, c: usize| {
            let before = |column: usize| node.rows(b, c).partition_point(|&j| (j as usize) < column);
            let (first, last) = (before(block * BLOCK), before((block + 1) * BLOCK));
            let mut source = Source { start: segments[c] + first, step: members[c], mask: 0, order: [0; BLOCK] };
            for (at, &j) in node.rows(b, c)[first..last].iter().enumerate() {
                source.mask |= 1 << (j as usize % BLOCK);
                source.order[j as usize % BLOCK] = at as u32;
            }
            Some(source).filter(|source| source.mask != 0)
        };
        let sources = |block| (0..members.len()).filter_map(|c| source(block, c)).collect();
        let blocks = (0..node.sizes[b].div_ceil(BLOCK)).map(sources).collect();
        Places { columns: node.sizes[b], blocks, members, starts, segments }
    }

    /// Numbers of a line.
    pub fn line(&self) -> usize {
        self.segments[self.members.len()]
    }

    /// Add `M` lines of one of the tuples to these rows; `lines` ends with a block more than the last.
    ///
    /// # Safety
    /// The rows have all columns, and nobody else refers to them.
    #[inline(always)]
    pub unsafe fn add<S: Simd, const M: usize>(&self, _: S, lines: &[f32], tuple: usize, rows: [*mut f32; M]) {
        assert!(M * self.line() + BLOCK <= lines.len());
        for (number, sources) in self.blocks.iter().enumerate() {
            let columns = BLOCK.min(self.columns - number * BLOCK);
            let mut blocks = rows;
            blocks.iter_mut().for_each(|block| *block = block.wrapping_add(number * BLOCK));
            #[cfg(target_arch = "x86_64")]
            if S::F32_LANES == BLOCK {
                // SAFETY: 16 lanes are AVX-512; all sources lie within the lines and a block behind them.
                unsafe { add_block(sources, lines, self.line(), tuple, blocks, columns) };
                continue;
            }
            for (block, line) in blocks.into_iter().zip(lines.chunks(self.line())) {
                // SAFETY: as promised by the caller.
                let x = unsafe { std::slice::from_raw_parts_mut(block, columns) };
                for Source { start, step, mask, order } in sources {
                    let line = &line[start + tuple * step..];
                    let x = x.iter_mut().zip(order).enumerate();
                    x.filter(|(lane, _)| mask >> lane & 1 == 1).for_each(|(_, (x, at))| *x += line[*at as usize]);
                }
            }
        }
    }
}

/// Add the same block of columns to `M` rows of `x`.
///
/// # Safety
/// The machine has AVX-512, from each source's start on the lines have 16 numbers, and the rows have `columns`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn add_block<const M: usize>(
    sources: &[Source],
    lines: &[f32],
    length: usize,
    tuple: usize,
    rows: [*mut f32; M],
    columns: usize,
) {
    use std::arch::x86_64::*;
    let inside = u16::MAX >> (BLOCK - columns);
    unsafe {
        let mut sums = [_mm512_setzero_ps(); M];
        for (sum, &x) in sums.iter_mut().zip(&rows) {
            *sum = _mm512_maskz_loadu_ps(inside, x);
        }
        for Source { start, step, mask, order } in sources {
            let start = start + tuple * step;
            let order = _mm512_loadu_si512(order.as_ptr().cast());
            for (m, sum) in sums.iter_mut().enumerate() {
                let members = _mm512_loadu_ps(lines.as_ptr().add(m * length + start));
                *sum = _mm512_add_ps(*sum, _mm512_maskz_permutexvar_ps(*mask, order, members));
            }
        }
        for (x, sum) in rows.into_iter().zip(sums) {
            _mm512_mask_storeu_ps(x, inside, sum);
        }
    }
}
