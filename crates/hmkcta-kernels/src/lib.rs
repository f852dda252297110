//! Native kernels of hmkcta. Each has a readable NumPy twin in `hmkcta.backends.reference`.

mod cells;
mod gauss_seidel;
mod gram;
mod tensor;

use cells::Node;
use gauss_seidel::Effort;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1, PyReadwriteArray1};
use pyo3::prelude::*;

type Members<'py> = Vec<PyReadonlyArray1<'py, u16>>;

/// C, K, R and mode sizes as Python passes them: `(sizes, clusters, mixture, ranks, undecomposed)`.
type Shape = (Vec<usize>, Vec<usize>, Vec<usize>, Vec<usize>, Vec<bool>);

fn node<'a>(shape: Shape, members: &'a Members) -> PyResult<Node<'a>> {
    let (sizes, clusters, mixture, ranks, undecomposed) = shape;
    let members = members.iter().map(|m| m.as_slice()).collect::<Result<_, _>>()?;
    Ok(Node { sizes, clusters, mixture, ranks, undecomposed, members })
}

/// Fit all cells by Gauss-Seidel sweeps in place; `residual` is data minus model on entry and on return.
#[pyfunction]
fn fit_cells(
    py: Python,
    shape: Shape,
    members: Members,
    mut residual: PyReadwriteArray1<f32>,
    mut bases: Vec<PyReadwriteArray1<f32>>,
    mut cores: PyReadwriteArray1<f32>,
    sweeps: usize,
    iterations: usize,
) -> PyResult<()> {
    let node = node(shape, &members)?;
    let residual = residual.as_slice_mut()?;
    let mut bases = bases.iter_mut().map(|b| b.as_slice_mut()).collect::<Result<Vec<_>, _>>()?;
    let cores = cores.as_slice_mut()?;
    py.detach(|| gauss_seidel::sweep(&node, residual, &mut bases, cores, Effort { sweeps, iterations }));
    Ok(())
}

/// `tensor += weight * model` in place.
#[pyfunction]
fn accumulate(
    py: Python,
    shape: Shape,
    members: Members,
    mut tensor: PyReadwriteArray1<f32>,
    bases: Vec<PyReadonlyArray1<f32>>,
    cores: PyReadonlyArray1<f32>,
    weight: f32,
) -> PyResult<()> {
    let node = node(shape, &members)?;
    let tensor = tensor.as_slice_mut()?;
    let bases = bases.iter().map(|b| b.as_slice()).collect::<Result<Vec<_>, _>>()?;
    let cores = cores.as_slice()?;
    py.detach(|| gauss_seidel::accumulate(&node, tensor, &bases, cores, weight));
    Ok(())
}

/// `Y_n[c]` of all cells and rows, flat.
#[pyfunction]
fn project_cells<'py>(
    py: Python<'py>,
    shape: Shape,
    members: Members,
    tensor: PyReadonlyArray1<f32>,
    bases: Vec<PyReadonlyArray1<f32>>,
    mode: usize,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let node = node(shape, &members)?;
    let tensor = tensor.as_slice()?;
    let bases = bases.iter().map(|b| b.as_slice()).collect::<Result<Vec<_>, _>>()?;
    Ok(py.detach(|| gram::project_cells(&node, tensor, &bases, mode)).into_pyarray(py))
}

/// `H_n` of all pairs of cells, flat.
#[pyfunction]
fn dictionary_gram<'py>(
    py: Python<'py>,
    shape: Shape,
    members: Members,
    bases: Vec<PyReadonlyArray1<f32>>,
    cores: PyReadonlyArray1<f32>,
    mode: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let node = node(shape, &members)?;
    let bases = bases.iter().map(|b| b.as_slice()).collect::<Result<Vec<_>, _>>()?;
    let cores = cores.as_slice()?;
    Ok(py.detach(|| gram::dictionary_gram(&node, &bases, cores, mode)).into_pyarray(py))
}

#[pymodule]
fn _native(module: &Bound<PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(fit_cells, module)?)?;
    module.add_function(wrap_pyfunction!(accumulate, module)?)?;
    module.add_function(wrap_pyfunction!(project_cells, module)?)?;
    module.add_function(wrap_pyfunction!(dictionary_gram, module)?)?;
    Ok(())
}
