//! Sub-tensors given by a row list for each mode: copied out of, into and added to a tensor in C order.

use crate::machine::dispatch;
use pulp::{MemMask, Simd, WithSimd};

/// Runs of at least this mean length are copied as runs, shorter ones element by element.
const RUN: usize = 4;

/// Where the elements of a sub-tensor lie, in the order of the sub-tensor.
pub struct Pick {
    /// Where each line starts.
    lines: Vec<usize>,
    /// What is picked from a line: the last modes taken together, as far as all but the first of them are complete.
    pattern: Pattern,
    /// Elements of a line of the sub-tensor.
    length: usize,
    /// One past the last element touched.
    end: usize,
}

enum Pattern {
    /// Contiguous stretches `(start, length)`.
    Runs(Vec<(usize, usize)>),
    /// Single elements.
    Elements(Vec<u32>),
}

impl Pick {
    /// The sub-tensor of the given rows (ascending, one list for each mode) in a tensor of the given sizes.
    pub fn new(sizes: &[usize], rows: &[&[u32]]) -> Pick {
        // Modes of which every row belongs are merged with the mode before them.
        let mut split = sizes.len().saturating_sub(1);
        while split > 0 && rows[split].len() == sizes[split] {
            split -= 1;
        }
        let unit: usize = sizes.get(split + 1..).unwrap_or_default().iter().product();
        let last = rows.get(split).map_or(vec![0], |rows| rows.iter().map(|&i| i as usize * unit).collect());
        let stride = unit * sizes.get(split).unwrap_or(&1);
        let lines = offsets(&sizes[..split.min(sizes.len())], &rows[..split.min(rows.len())], stride);
        let length = last.len() * unit;
        let end = lines.last().zip(last.last()).map_or(0, |(line, start)| line + start + unit);
        Pick { lines, pattern: Pattern::new(&last, unit), length, end }
    }

    /// Elements of the sub-tensor.
    pub fn len(&self) -> usize {
        self.lines.len() * self.length
    }

    /// Elements from the start of the tensor on that it must have.
    pub fn end(&self) -> usize {
        self.end
    }

    /// `block = x[rows]`
    pub fn copy(&self, x: &[f32], block: &mut [f32]) {
        assert!(x.len() >= self.end);
        // SAFETY: `x` holds all elements of the pick.
        unsafe { self.copy_from(x.as_ptr(), block) };
    }

    /// The same from where a tensor starts.
    ///
    /// # Safety
    /// The tensor holds all elements of the pick, and nobody writes to these meanwhile.
    pub unsafe fn copy_from(&self, x: *const f32, block: &mut [f32]) {
        assert_eq!(block.len(), self.len());
        let block = block.as_mut_ptr();
        // SAFETY: `Visit` asks only for places within the pick, which both hold.
        let places = move |tensor, at| unsafe { (x.add(tensor), block.add(at)) };
        dispatch(Visit::<_, false> { pick: self, places });
    }

    /// `x[rows] = block` from where a tensor starts.
    ///
    /// # Safety
    /// The tensor holds all elements of the pick, and nobody else uses these meanwhile.
    pub unsafe fn put_into(&self, x: *mut f32, block: &[f32]) {
        // SAFETY: the caller answers for what `onto` needs.
        unsafe { self.onto::<false>(x, block) };
    }

    /// `x[rows] += block`
    pub fn add_onto(&self, x: &mut [f32], block: &[f32]) {
        assert!(x.len() >= self.end);
        // SAFETY: as in `copy`.
        unsafe { self.add_into(x.as_mut_ptr(), block) };
    }

    /// The same from where a tensor starts.
    ///
    /// # Safety
    /// As for `put_into`.
    pub unsafe fn add_into(&self, x: *mut f32, block: &[f32]) {
        // SAFETY: the caller answers for what `onto` needs.
        unsafe { self.onto::<true>(x, block) };
    }

    /// # Safety
    /// As for `put_into`.
    unsafe fn onto<const ADD: bool>(&self, x: *mut f32, block: &[f32]) {
        assert_eq!(block.len(), self.len());
        let block = block.as_ptr();
        // SAFETY: as in `copy_from`.
        let places = move |tensor, at| unsafe { (block.add(at), x.add(tensor)) };
        dispatch(Visit::<_, ADD> { pick: self, places });
    }
}

/// All elements of a pick copied, or added to what is there; `places(in the tensor, in the block)` tells from where to where.
struct Visit<'a, F, const ADD: bool> {
    pick: &'a Pick,
    places: F,
}

impl<F: Fn(usize, usize) -> (*const f32, *mut f32), const ADD: bool> WithSimd for Visit<'_, F, ADD> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Visit { pick, places } = self;
        let mut at = 0;
        for &line in &pick.lines {
            match &pick.pattern {
                Pattern::Runs(runs) => {
                    for &(start, length) in runs {
                        let (from, to) = places(line + start, at);
                        // SAFETY: the caller has checked that tensor and block hold all elements of the pick.
                        unsafe { stretch::<S, ADD>(simd, from, to, length) };
                        at += length;
                    }
                }
                Pattern::Elements(elements) => {
                    for &element in elements {
                        let (from, to) = places(line + element as usize, at);
                        // SAFETY: as above.
                        unsafe { single::<ADD>(from, to) };
                        at += 1;
                    }
                }
            }
        }
    }
}

/// Copy or add one element.
///
/// # Safety
/// `from` may be read, `to` read and written.
#[inline(always)]
unsafe fn single<const ADD: bool>(from: *const f32, to: *mut f32) {
    // SAFETY: as the caller promises.
    unsafe { *to = if ADD { *to + *from } else { *from } };
}

/// Copy or add `length` contiguous elements.
///
/// # Safety
/// `from` may be read, `to` read and written, of that length; they do not overlap.
#[inline(always)]
unsafe fn stretch<S: Simd, const ADD: bool>(simd: S, from: *const f32, to: *mut f32, length: usize) {
    // SAFETY: as the caller promises: `at` and a vector beyond it are within the stretch.
    let sum = |at: usize| unsafe {
        let read = |from: *const f32| from.add(at).cast::<S::f32s>().read_unaligned();
        if ADD { simd.add_f32s(read(from), read(to)) } else { read(from) }
    };
    // SAFETY: as above; the last vector begins where it ends with the stretch.
    unsafe {
        let Some(last) = length.checked_sub(S::F32_LANES) else {
            return few::<S, ADD>(simd, from, to, length);
        };
        // Summed up before and written after the others, with which it may overlap.
        let end = sum(last);
        for at in (0..last).step_by(S::F32_LANES) {
            to.add(at).cast::<S::f32s>().write_unaligned(sum(at));
        }
        to.add(last).cast::<S::f32s>().write_unaligned(end);
    }
}

/// Fewer than a vector has lanes; AVX-512 alone stores a part of a vector as fast as a whole one.
///
/// # Safety
/// That of `stretch`.
#[inline(always)]
unsafe fn few<S: Simd, const ADD: bool>(simd: S, from: *const f32, to: *mut f32, length: usize) {
    // SAFETY: as the caller promises; the mask enables `length` lanes, of which there are more.
    unsafe {
        if S::F32_LANES == 16 {
            let mask = MemMask::new(simd.mask_between_m32s(0, length as u32).mask());
            let read = |from| simd.mask_load_ptr_f32s(mask, from);
            let value = if ADD { simd.add_f32s(read(from), read(to)) } else { read(from) };
            return simd.mask_store_ptr_f32s(mask, to, value);
        }
        (0..length).for_each(|at| single::<ADD>(from.add(at), to.add(at)));
    }
}

impl Pattern {
    /// `unit` elements from each start on, as the longer of runs or elements demands.
    fn new(starts: &[usize], unit: usize) -> Pattern {
        let mut runs: Vec<(usize, usize)> = vec![];
        for &start in starts {
            match runs.last_mut() {
                Some((first, length)) if *first + *length == start => *length += unit,
                _ => runs.push((start, unit)),
            }
        }
        if starts.len() * unit >= RUN * runs.len() || u32::try_from(starts.last().unwrap_or(&0) + unit).is_err() {
            return Pattern::Runs(runs);
        }
        Pattern::Elements(runs.iter().flat_map(|&(start, length)| start as u32..(start + length) as u32).collect())
    }
}

/// Flat positions of all combinations of rows in a tensor of the given sizes whose elements are `stride` apart.
pub fn offsets(sizes: &[usize], rows: &[&[u32]], stride: usize) -> Vec<usize> {
    let mut starts = vec![0];
    for (size, rows) in sizes.iter().zip(rows) {
        let mut next = Vec::with_capacity(starts.len() * rows.len());
        for start in starts {
            next.extend(rows.iter().map(|&i| start * size + i as usize));
        }
        starts = next;
    }
    starts.iter_mut().for_each(|at| *at *= stride);
    starts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::numbers;

    fn check(sizes: &[usize], rows: &[&[u32]]) {
        let x = numbers(sizes.iter().product(), 3);
        let pick = Pick::new(sizes, rows);
        let places = offsets(sizes, rows, 1);
        assert_eq!(pick.len(), places.len());
        let mut block = vec![0.0; places.len()];
        pick.copy(&x, &mut block);
        assert!(places.iter().zip(&block).all(|(&at, &value)| x[at] == value));
        block.iter_mut().for_each(|value| *value *= 2.0);
        let mut y = x.clone();
        // SAFETY: `y` is as large as `x`, which `copy` has checked.
        unsafe { pick.put_into(y.as_mut_ptr(), &block) };
        pick.add_onto(&mut y, &block);
        for at in 0..x.len() {
            assert_eq!(y[at], if places.contains(&at) { 4.0 * x[at] } else { x[at] });
        }
    }

    #[test]
    fn every_pattern_agrees_with_the_definition() {
        on_all_machines(compare_patterns);
    }

    fn compare_patterns() {
        let all: Vec<u32> = (0..12).collect();
        check(&[12], &[&[1, 5, 7]]);
        check(&[2, 12], &[&[1], &all]);
        check(&[3, 2, 12], &[&[0, 2], &[0, 1], &all]);
        check(&[3, 4, 12], &[&[0, 2], &[1, 3], &[0, 2, 3, 4, 9]]);
        check(&[3, 4, 12], &[&[0, 2], &[1, 3], &all[2..11]]);
        check(&[3, 4, 3], &[&[0, 2], &[1, 3], &all[..3]]);
        // Runs of several vectors, of whole ones, and shorter.
        let long: Vec<u32> = (3..38).chain(40..56).chain(58..63).collect();
        check(&[3, 64], &[&[0, 2], &long]);
        check(&[], &[]);
    }
}
