//! Columns sorted by their clusters put back in their places, as lines are added to a tensor.

use pulp::Simd;

/// Columns of a line put back at a time.
const BLOCK: usize = 16;

/// Where columns are in a line of all clusters' members: a column is found once for each of its clusters.
pub struct Places {
    columns: usize,
    /// For each block of columns the clusters that have members among them.
    blocks: Vec<Vec<Source>>,
}

/// The members of one cluster among the columns of a block: neighbours in the line.
struct Source {
    start: usize,
    /// Which columns of the block they are, and which of them each such column is.
    mask: u16,
    order: [u32; BLOCK],
}

impl Places {
    /// Of the members of each cluster, ascending, from its start in the line on.
    pub fn new(members: &[&[u32]], starts: &[usize], columns: usize) -> Places {
        let source = |block: usize, c: usize| {
            let before = |column: usize| members[c].partition_point(|&j| (j as usize) < column);
            let (first, last) = (before(block * BLOCK), before((block + 1) * BLOCK));
            let mut source = Source { start: starts[c] + first, mask: 0, order: [0; BLOCK] };
            for (at, &j) in members[c][first..last].iter().enumerate() {
                source.mask |= 1 << (j as usize % BLOCK);
                source.order[j as usize % BLOCK] = at as u32;
            }
            Some(source).filter(|source| source.mask != 0)
        };
        let sources = |block| (0..members.len()).filter_map(|c| source(block, c)).collect();
        Places { columns, blocks: (0..columns.div_ceil(BLOCK)).map(sources).collect() }
    }

    /// Add `M` lines, the first numbers of each `step`, to these rows of `x`; `lines` ends with a block more than the last.
    #[inline(always)]
    pub fn add<S: Simd, const M: usize>(&self, _: S, lines: &[f32], step: usize, rows: &[u32; M], x: &mut [f32]) {
        let last = self.blocks.iter().flatten().map(|source| source.start).max().unwrap_or(0);
        assert!(rows.iter().all(|&row| (row as usize + 1) * self.columns <= x.len()));
        assert!((M - 1) * step + last + BLOCK <= lines.len());
        for (number, sources) in self.blocks.iter().enumerate() {
            let columns = number * BLOCK..self.columns.min((number + 1) * BLOCK);
            let starts = rows.map(|row| row as usize * self.columns + columns.start);
            #[cfg(target_arch = "x86_64")]
            if S::F32_LANES == BLOCK {
                // SAFETY: 16 lanes are AVX-512; all sources lie within the lines and a block behind them, all rows in x.
                unsafe { add_block(sources, lines, step, x, starts, columns.len()) };
                continue;
            }
            for (start, line) in starts.into_iter().zip(lines.chunks(step)) {
                for Source { start: from, mask, order } in sources {
                    let x = x[start..][..columns.len()].iter_mut().zip(order).enumerate();
                    for (_, (x, at)) in x.filter(|(lane, _)| mask >> lane & 1 == 1) {
                        *x += line[from + *at as usize];
                    }
                }
            }
        }
    }
}

/// Add the same block of columns to `M` rows of `x`.
///
/// # Safety
/// The machine has AVX-512, from each source's start on the lines have 16 numbers, and from each start on `x` has `columns`.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn add_block<const M: usize>(
    sources: &[Source],
    lines: &[f32],
    step: usize,
    x: &mut [f32],
    starts: [usize; M],
    columns: usize,
) {
    use std::arch::x86_64::*;
    let inside = u16::MAX >> (BLOCK - columns);
    unsafe {
        let mut sums = starts.map(|start| _mm512_maskz_loadu_ps(inside, x.as_ptr().add(start)));
        for Source { start, mask, order } in sources {
            let order = _mm512_loadu_si512(order.as_ptr().cast());
            for (m, sum) in sums.iter_mut().enumerate() {
                let members = _mm512_loadu_ps(lines.as_ptr().add(m * step + start));
                *sum = _mm512_add_ps(*sum, _mm512_maskz_permutexvar_ps(*mask, order, members));
            }
        }
        for (start, sum) in starts.into_iter().zip(sums) {
            _mm512_mask_storeu_ps(x.as_mut_ptr().add(start), inside, sum);
        }
    }
}
