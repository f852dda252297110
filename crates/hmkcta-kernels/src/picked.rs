//! Sub-tensors of arrays that other threads use meanwhile, who leave the elements of these alone.

use crate::binding::{Floats, check_length, count, slices};
use crate::guard;
use crate::pick::Pick;
use crate::sizes::{has_room, zeros};
use numpy::{IntoPyArray, PyArray1, PyArrayMethods, PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;

/// Where an array's numbers are, as a number that threads may have.
#[derive(Clone, Copy)]
struct Place(usize);

/// A sub-tensor of a contiguous array of the given sizes, and where that array starts.
fn pick_of(tensor: &Bound<PyArray1<f32>>, sizes: &[usize], rows: &[PyReadonlyArray1<u32>]) -> PyResult<(Pick, Place)> {
    let rows = slices(rows)?;
    check_length("the list of rows", rows.len(), sizes.len())?;
    check_length("the tensor", tensor.len(), count(sizes.iter().copied())?)?;
    let ascending = |rows: &[u32], size: usize| {
        rows.windows(2).all(|pair| pair[0] < pair[1]) && rows.last().is_none_or(|&row| (row as usize) < size)
    };
    let usable = tensor.is_contiguous() && tensor.is_aligned();
    if !usable || !rows.iter().zip(sizes).all(|(rows, &size)| ascending(rows, size)) {
        return Err(PyValueError::new_err("a contiguous tensor and ascending rows of its modes are needed"));
    }
    Ok((Pick::new(sizes, &rows), Place(tensor.data() as usize)))
}

/// The sub-tensor of the given rows of each mode, flat. Meanwhile other threads may write to others.
#[pyfunction]
pub fn gather<'py>(
    py: Python<'py>,
    tensor: Bound<'py, PyArray1<f32>>,
    sizes: Vec<usize>,
    rows: Vec<PyReadonlyArray1<'py, u32>>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let (pick, Place(start)) = pick_of(&tensor, &sizes, &rows)?;
    if !has_room::<f32>(pick.len()) {
        return Err(PyMemoryError::new_err(format!("there is no memory for {} numbers", pick.len())));
    }
    let block = guard::run(py, || {
        let mut block = zeros(pick.len());
        // SAFETY: `pick_of` has checked that the array, which lives as long as `tensor`, is aligned and has all elements
        // of the pick; writers leave these alone.
        unsafe { pick.copy_from(start as *const f32, &mut block) };
        block
    })?;
    Ok(block.into_pyarray(py))
}

/// Put a sub-tensor in its place. Meanwhile other threads may read and write others.
#[pyfunction]
pub fn scatter<'py>(
    py: Python<'py>,
    tensor: Bound<'py, PyArray1<f32>>,
    sizes: Vec<usize>,
    rows: Vec<PyReadonlyArray1<'py, u32>>,
    block: Floats<'py>,
) -> PyResult<()> {
    let (pick, Place(start)) = pick_of(&tensor, &sizes, &rows)?;
    let block = block.as_slice()?;
    check_length("the block", block.len(), pick.len())?;
    let (from, bytes) = (block.as_ptr() as usize, size_of::<f32>());
    let apart = from + bytes * block.len() <= start || start + bytes * tensor.len() <= from;
    let writeable: bool = tensor.getattr("flags")?.getattr("writeable")?.extract()?;
    if !writeable || !(apart || block.is_empty()) {
        return Err(PyValueError::new_err("a tensor that may be written to, and a block apart from it are needed"));
    }
    // SAFETY: as in `gather`; the tensor may be written to, and the block is no part of it.
    guard::run(py, || unsafe { pick.put_into(start as *mut f32, block) })
}
