//! Parts of a tensor taken out and put back, for Python.

use crate::binding::{Floats, check_length, slices};
use crate::pick::Pick;
use numpy::{IntoPyArray, PyArray1, PyArrayMethods, PyReadonlyArray1, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A sub-tensor of a contiguous array of the given sizes, and where that array starts.
fn pick_of(tensor: &Bound<PyArray1<f32>>, sizes: &[usize], rows: &[PyReadonlyArray1<u32>]) -> PyResult<(Pick, usize)> {
    let rows = slices(rows)?;
    check_length("the list of rows", rows.len(), sizes.len())?;
    check_length("the tensor", tensor.len(), sizes.iter().product())?;
    let ascending = |rows: &[u32], size: usize| {
        rows.windows(2).all(|pair| pair[0] < pair[1]) && rows.last().is_none_or(|&row| (row as usize) < size)
    };
    if !tensor.is_contiguous() || !rows.iter().zip(sizes).all(|(rows, &size)| ascending(rows, size)) {
        return Err(PyValueError::new_err("a contiguous tensor and ascending rows of its modes are needed"));
    }
    Ok((Pick::new(sizes, &rows), tensor.data() as usize))
}

/// The sub-tensor of the given rows of each mode, flat. Meanwhile other threads may write to others.
#[pyfunction]
pub fn gather<'py>(
    py: Python<'py>,
    tensor: Bound<'py, PyArray1<f32>>,
    sizes: Vec<usize>,
    rows: Vec<PyReadonlyArray1<'py, u32>>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let (pick, start) = pick_of(&tensor, &sizes, &rows)?;
    let mut block = vec![0.0; pick.len()];
    // SAFETY: `pick_of` has checked the array, which lives as long as `tensor`; writers leave these elements alone.
    py.detach(|| unsafe { pick.copy_from(start as *const f32, &mut block) });
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
    let (pick, start) = pick_of(&tensor, &sizes, &rows)?;
    let block = block.as_slice()?;
    check_length("the block", block.len(), pick.len())?;
    // SAFETY: as in `gather`.
    py.detach(|| unsafe { pick.put_into(start as *mut f32, block) });
    Ok(())
}
