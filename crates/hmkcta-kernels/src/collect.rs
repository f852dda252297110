//! Elements of an array as it was given, of any layout and type, collected into a tensor.
//!
//! A mode may merge axes of the array, and any of its rows may be wanted: where a row lies is told by its offset, and an
//! element lies where the offsets of its rows add up to.

use crate::binding::{check_length, count};
use crate::guard;
use numpy::{Element, PyArrayMethods, PyReadonlyArray1, PyReadonlyArrayDyn, PyReadwriteArray1, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Bytes of a cache line.
const LINE: usize = 64;
/// Numbers of a line of the tensor that are collected before those of its neighbours: their cache lines stay at hand.
const CHUNK: usize = 256;
/// How far apart rows of a mode may lie, in elements: sums over all modes can be counted.
const MOST_OFFSET: u64 = 1 << 56;
/// Elements of a line of the tensor, at the least, if there are as many.
const LONG: usize = 64;

/// The array by the size of its numbers, which are copied as they are, and where they go.
#[derive(FromPyObject)]
pub enum Numbers<'py> {
    Of1(PyReadonlyArrayDyn<'py, u8>, PyReadwriteArray1<'py, u8>),
    Of2(PyReadonlyArrayDyn<'py, u16>, PyReadwriteArray1<'py, u16>),
    Of4(PyReadonlyArrayDyn<'py, u32>, PyReadwriteArray1<'py, u32>),
    Of8(PyReadonlyArrayDyn<'py, u64>, PyReadwriteArray1<'py, u64>),
}

type Offsets<'py> = Vec<PyReadonlyArray1<'py, i64>>;

/// The elements at the sums of one offset of each mode, counted in elements of the array, in C order.
#[pyfunction]
pub fn collect(py: Python, numbers: Numbers, offsets: Offsets) -> PyResult<()> {
    match numbers {
        Numbers::Of1(array, out) => collected(py, &array, out, &offsets, |number| number),
        Numbers::Of2(array, out) => collected(py, &array, out, &offsets, |number| number),
        Numbers::Of4(array, out) => collected(py, &array, out, &offsets, |number| number),
        Numbers::Of8(array, out) => collected(py, &array, out, &offsets, |number| number),
    }
}

/// The same of float32 numbers, times a factor.
#[pyfunction]
pub fn collect_scaled<'py>(
    py: Python<'py>,
    numbers: (PyReadonlyArrayDyn<'py, f32>, PyReadwriteArray1<'py, f32>),
    offsets: Offsets<'py>,
    factor: f32,
) -> PyResult<()> {
    collected(py, &numbers.0, numbers.1, &offsets, |number| number * factor)
}

fn collected<T: Element + Copy>(
    py: Python,
    array: &PyReadonlyArrayDyn<T>,
    mut out: PyReadwriteArray1<T>,
    offsets: &Offsets,
    change: impl Fn(T) -> T + Send,
) -> PyResult<()> {
    let (offsets, out) = (crate::binding::slices(offsets)?, out.as_slice_mut()?);
    check_length("out", out.len(), count(offsets.iter().map(|rows| rows.len()))?)?;
    if out.is_empty() {
        return Ok(());
    }
    check(array, &offsets)?;
    let start = array.data() as usize;
    // SAFETY: every sum of offsets lies between the first and the last element of the array, which is aligned and lives
    // as long; `out` has an element for each of them.
    guard::run(py, || unsafe { Lines::new::<T>(&offsets).copy(start as *const T, out, change) })
}

/// Refuse offsets that lead out of the array, of which every mode has some.
fn check<T: Element>(array: &PyReadonlyArrayDyn<T>, offsets: &[&[i64]]) -> PyResult<()> {
    let size = size_of::<T>() as isize;
    let (mut least, mut most) = (0, 0);
    for (&stride, &length) in array.strides().iter().zip(array.shape()) {
        let last = (length as i128 - 1) * (stride / size) as i128;
        (least, most) = (least + last.min(0), most + last.max(0));
    }
    let ends = |rows: &&[i64]| rows.iter().fold((i64::MAX, i64::MIN), |(a, b), &row| (a.min(row), b.max(row)));
    let add = |(first, last), (a, b): (i64, i64)| (first + i128::from(a), last + i128::from(b));
    let (first, last) = offsets.iter().map(ends).fold((0, 0), add);
    let far = offsets.iter().map(ends).any(|(a, b)| a.unsigned_abs().max(b.unsigned_abs()) > MOST_OFFSET);
    let even = array.is_aligned() && array.strides().iter().all(|stride| stride % size == 0);
    if even && !far && !array.shape().contains(&0) && least <= first && last <= most {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("offsets from {first} to {last} lead out of an array of {least} to {most}")))
}

/// The tensor line by line.
struct Lines<'a> {
    /// Offsets within a line, which goes along the last modes.
    within: Vec<i64>,
    /// How far apart they are, if they all are as far.
    step: Option<isize>,
    /// Offsets of the modes before.
    before: &'a [&'a [i64]],
    /// The mode of these whose neighbouring rows share cache lines, and how many rows go together from each on.
    beside: Option<(usize, Vec<usize>)>,
}

impl<'a> Lines<'a> {
    fn new<T>(offsets: &'a [&'a [i64]]) -> Lines<'a> {
        let (mut before, mut within) = (offsets, vec![0]);
        while let Some((rows, rest)) = before.split_last() {
            if within.len() >= LONG {
                break;
            }
            within = rows.iter().flat_map(|row| within.iter().map(move |offset| row + offset)).collect();
            before = rest;
        }
        let step = |rows: &[i64]| rows.windows(2).map(|pair| pair[0].abs_diff(pair[1])).min().unwrap_or(u64::MAX);
        let line = (LINE / size_of::<T>()) as u64;
        let beside = (0..before.len())
            .min_by_key(|&n| step(before[n]))
            .filter(|&n| step(before[n]) < step(&within).min(line))
            .map(|n| (n, groups(before[n], line)));
        let step = within.get(1).map_or(1, |second| second - within[0]);
        let even = within.windows(2).all(|pair| pair[1] - pair[0] == step);
        Lines { step: even.then_some(step as isize), within, before, beside }
    }

    /// # Safety
    /// From `start` on there are elements at all sums of offsets, of which `to` has room for as many as there are.
    unsafe fn copy<T: Copy>(&self, start: *const T, to: &mut [T], change: impl Fn(T) -> T) {
        let sizes: Vec<usize> = self.before.iter().map(|rows| rows.len()).collect();
        let mut apart = vec![self.within.len(); sizes.len()];
        for n in (1..sizes.len()).rev() {
            apart[n - 1] = apart[n] * sizes[n];
        }
        let mut at = vec![0; sizes.len()];
        loop {
            let place: usize = at.iter().zip(&apart).map(|(row, apart)| row * apart).sum();
            let from: i64 = at.iter().zip(self.before).map(|(&row, offsets)| offsets[row]).sum();
            let (rows, from, apart) = match &self.beside {
                Some((n, groups)) => {
                    let rows = &self.before[*n][at[*n]..at[*n] + groups[at[*n]]];
                    (rows, from - rows[0], apart[*n])
                }
                None => (&[0][..], from, 0),
            };
            // SAFETY: the caller promises elements at all sums of offsets, and these are some.
            unsafe { self.lines(start, from, rows, &mut to[place..], apart, &change) };
            // The next rows, the last mode's first.
            let Some(n) = (0..sizes.len()).rev().find(|&n| at[n] + self.together(n, at[n]) < sizes[n]) else { return };
            at[n] += self.together(n, at[n]);
            at[n + 1..].fill(0);
        }
    }

    /// How many rows of a mode go together from this one on.
    fn together(&self, n: usize, row: usize) -> usize {
        self.beside.as_ref().map_or(1, |(mode, groups)| if *mode == n { groups[row] } else { 1 })
    }

    /// Lines that lie so far from each other in the tensor, from rows that share cache lines.
    ///
    /// # Safety
    /// That of `copy`, for these rows.
    #[inline]
    unsafe fn lines<T: Copy>(
        &self,
        start: *const T,
        from: i64,
        rows: &[i64],
        to: &mut [T],
        apart: usize,
        change: &impl Fn(T) -> T,
    ) {
        for (number, chunk) in self.within.chunks(CHUNK).enumerate() {
            for (beside, row) in rows.iter().enumerate() {
                let line = to[beside * apart + number * CHUNK..][..chunk.len()].iter_mut();
                // SAFETY: as the caller promises.
                unsafe {
                    let from = start.offset((from + row) as isize);
                    match self.step {
                        Some(1) => {
                            let from = from.offset(chunk[0] as isize);
                            line.enumerate().for_each(|(i, to)| *to = change(*from.add(i)));
                        }
                        Some(step) => {
                            let from = from.offset(chunk[0] as isize);
                            line.enumerate().for_each(|(i, to)| *to = change(*from.offset(i as isize * step)));
                        }
                        None => line.zip(chunk).for_each(|(to, &offset)| *to = change(*from.offset(offset as isize))),
                    }
                }
            }
        }
    }
}

/// For each row how many from it on lie within a cache line, where a group begins; rows of a group follow each other.
fn groups(rows: &[i64], line: u64) -> Vec<usize> {
    let (mut found, mut first) = (vec![0; rows.len()], 0);
    for (n, row) in rows.iter().enumerate() {
        if row.abs_diff(rows[first]) >= line {
            first = n;
        }
        found[first] += 1;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn compare(offsets: &[&[i64]]) {
        let numbers: Vec<u32> = (0..100_000).collect();
        let mut sums = vec![0];
        for rows in offsets {
            sums = sums.iter().flat_map(|sum| rows.iter().map(move |row| sum + row)).collect();
        }
        let mut values = vec![0; sums.len()];
        // SAFETY: all sums are below the length, and `values` has a number for each.
        unsafe { Lines::new::<u32>(offsets).copy(numbers.as_ptr(), &mut values, |number| number) };
        assert!(values.iter().zip(&sums).all(|(&value, &sum)| i64::from(value) == sum));
    }

    #[test]
    fn elements_lie_where_offsets_add_up_to() {
        let steps = |count: i64, step: i64| (0..count).map(|i| i * step).collect::<Vec<_>>();
        let rgb: Vec<i64> = [0, 1, 2, 6000, 6002, 12001, 12000, 12002].to_vec();
        compare(&[&rgb, &steps(5, 1200), &steps(400, 3)]); // colours merged into the first mode
        compare(&[&steps(40, 1), &steps(30, 40), &steps(80, 1200)]); // the first axis first
        compare(&[&steps(7, 900), &steps(3, 300), &steps(300, 1)]); // runs
        compare(&[&steps(50, 30), &[7, 3, 9], &[0, 2]]); // short modes at the end
        compare(&[&[5], &[1, 0]]);
        compare(&[&[3]]);
    }
}
