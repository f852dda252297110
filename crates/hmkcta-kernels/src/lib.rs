//! Native kernels of hmkcta. Each has a readable NumPy twin in `hmkcta.backends.reference` or `hmkcta.decode`.

mod apart;
mod binding;
mod block;
mod block_code;
mod bundle;
mod cell_pairs;
mod cell_projection;
mod cells;
mod chain;
mod coding;
mod collect;
mod contexts;
mod contract;
mod cores;
mod cut_short;
mod dense;
mod dictionary;
mod dots;
mod element;
mod elimination;
mod float16;
mod gauss_seidel;
mod gemm;
mod gram;
mod grouped;
mod guard;
mod hooi;
mod kmeans;
mod lanes;
mod layout;
mod leading;
mod lines;
mod machine;
mod magnitudes;
mod masked;
mod mode_order;
mod orthonormal;
mod packed;
mod pair_projection;
mod part;
mod permuted;
mod pick;
mod picked;
mod places;
mod range_coder;
mod rank_boxes;
mod real;
mod reconstruct;
mod run_code;
mod run_columns;
mod run_cores;
mod run_node;
mod run_numbers;
mod scattered;
mod search_kernels;
mod shared;
mod shuffle;
mod sizes;
mod small;
mod sorting;
mod stage;
mod stage_code;
mod stage_whole;
mod steps;
mod subspace;
#[cfg(test)]
mod testing;
mod threads;
mod transpose;
mod tree;
mod tucker;
mod tuple_lanes;
mod widened;

use binding::{
    Arrays, Doubles, Floats, Members, bases_of, check_bases, check_cores, check_decomposed, check_indices,
    check_length, check_mode, check_rounds, check_tensor, cores_of, count, node, pairs_of, room_for, slices, tensor_of,
};
use cells::Shape;
use coding::Search;
use dictionary::Given;
use element::Decode;
use gauss_seidel::Effort;
use numpy::prelude::*;
use numpy::{Element, PyArray1, PyReadonlyArray1, PyReadwriteArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Cluster subsets and coefficients.
type Coded<'py> = (Bound<'py, PyArray1<u16>>, Bound<'py, PyArray1<f32>>);

/// Fit all cells by Gauss-Seidel sweeps in place; `residual` is data minus model on entry and on return.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "what a node is made of, as Python has it")]
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
    let (residual, cores) = (residual.as_slice_mut()?, cores.as_slice_mut()?);
    let mut bases = bases.iter_mut().map(|b| b.as_slice_mut()).collect::<Result<Vec<_>, _>>()?;
    check_tensor(&node, residual.len())?;
    check_bases(&node, &bases)?;
    check_cores(&node, cores.len())?;
    check_rounds("sweeps", sweeps)?;
    check_rounds("iterations", iterations)?;
    guard::run(py, || gauss_seidel::fit(node, residual, &mut bases, cores, Effort { sweeps, iterations }))
}

/// `tensor += weight * model` in place.
#[pyfunction]
fn accumulate(
    py: Python,
    shape: Shape,
    members: Members,
    mut tensor: PyReadwriteArray1<f32>,
    bases: Vec<Floats>,
    cores: Floats,
    weight: f32,
) -> PyResult<()> {
    let node = node(shape, &members)?;
    let tensor = tensor.as_slice_mut()?;
    check_tensor(&node, tensor.len())?;
    let (bases, cores) = (bases_of(&node, &bases)?, cores_of(&node, &cores)?);
    guard::run(py, || reconstruct::accumulate(node, tensor, &bases, cores, weight))
}

/// `Y_n[c]` of all cells and rows, flat.
#[pyfunction]
fn project_cells<'py>(
    py: Python<'py>,
    shape: Shape,
    members: Members,
    tensor: Floats,
    bases: Vec<Floats>,
    mode: usize,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let node = node(shape, &members)?;
    let (tensor, bases) = (tensor_of(&node, &tensor)?, bases_of(&node, &bases)?);
    check_mode(node.order(), mode)?;
    let other_ranks = (0..node.order()).filter(|&n| n != mode).map(|n| node.ranks[n]);
    room_for::<f32>("projections", [node.cells(), node.sizes[mode]].into_iter().chain(other_ranks))?;
    Ok(guard::run(py, || cell_projection::project_cells(node, tensor, &bases, mode))?.into_pyarray(py))
}

/// The tensor projected on the bases of all cells in a pair of modes, flat.
#[pyfunction]
fn project_pair<'py>(
    py: Python<'py>,
    shape: Shape,
    members: Members,
    tensor: Floats,
    bases: Vec<Floats>,
    pair: (usize, usize),
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let node = node(shape, &members)?;
    let (tensor, bases) = (tensor_of(&node, &tensor)?, bases_of(&node, &bases)?);
    let (a, b) = pair;
    [a, b].into_iter().try_for_each(|n| check_decomposed(&node, n))?;
    if a == b {
        return Err(PyValueError::new_err("two modes are needed"));
    }
    let kept = (0..node.order()).filter(|&n| n != a && n != b).map(|n| node.sizes[n]);
    room_for::<f32>("projections", [node.cells(), node.ranks[a], node.ranks[b]].into_iter().chain(kept))?;
    Ok(guard::run(py, || pair_projection::project_pair(&node, tensor, &bases, pair))?.into_pyarray(py))
}

/// `sum_j P[i, j, k, l] W[j, r, l]`, flat.
#[pyfunction]
fn contract_lanes<'py>(
    py: Python<'py>,
    p: Floats,
    w: Floats,
    sizes: [usize; 3],
    rank: usize,
    lanes: usize,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let (p, w) = (p.as_slice()?, w.as_slice()?);
    let [before, size, after] = sizes;
    check_length("p", p.len(), count([before, size, after, lanes])?)?;
    check_length("w", w.len(), count([size, rank, lanes])?)?;
    let length = room_for::<f32>("sums", [before, after, rank, lanes])?;
    if length == 0 {
        return Ok(vec![].into_pyarray(py));
    }
    Ok(guard::run(py, || contract::contract_lanes(p, w, sizes, rank, lanes))?.into_pyarray(py))
}

/// `U_n` of all cells with its zero rows written out, flat.
#[pyfunction]
fn dense_basis<'py>(
    py: Python<'py>,
    shape: Shape,
    members: Members,
    mode: usize,
    basis: Floats,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let node = node(shape, &members)?;
    let basis = basis.as_slice()?;
    check_decomposed(&node, mode)?;
    check_length("the basis", basis.len(), node.basis_size(mode))?;
    room_for::<f32>("bases", [node.cells(), node.sizes[mode], node.ranks[mode]])?;
    Ok(guard::run(py, || node.dense_basis(mode, basis))?.into_pyarray(py))
}

/// `H_n` of all pairs of cells, flat.
#[pyfunction]
fn dictionary_gram<'py>(
    py: Python<'py>,
    ranks: Vec<usize>,
    products: Vec<Doubles>,
    cores: Floats,
    mode: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let products = slices(&products)?;
    let cores = cores.as_slice()?;
    let pairs = pairs_of(&ranks, &products, cores.len())?;
    check_mode(ranks.len(), mode)?;
    room_for::<f64>("inner products", [pairs.cells, ranks[mode], pairs.cells, ranks[mode]])?;
    Ok(guard::run(py, || gram::dictionary_gram(&pairs, cores, mode))?.into_pyarray(py))
}

/// Cores that leave less, in place, by so many steps of conjugate gradients; `b` are projections on all bases.
#[pyfunction]
fn solve_cores(
    py: Python,
    ranks: Vec<usize>,
    products: Vec<Doubles>,
    mut cores: PyReadwriteArray1<f32>,
    b: Doubles,
    steps: usize,
) -> PyResult<()> {
    let products = slices(&products)?;
    let (cores, b) = (cores.as_slice_mut()?, b.as_slice()?);
    let pairs = pairs_of(&ranks, &products, cores.len())?;
    check_length("b", b.len(), cores.len())?;
    check_rounds("steps", steps)?;
    guard::run(py, || cores::solve_cores(&pairs, cores, b, steps))
}

/// Orthonormal bases of a mode, in place, with cores that keep the model.
#[pyfunction]
fn orthonormalise(
    py: Python,
    shape: Shape,
    members: Members,
    mode: usize,
    mut basis: PyReadwriteArray1<f32>,
    mut cores: PyReadwriteArray1<f32>,
) -> PyResult<()> {
    let node = node(shape, &members)?;
    let (basis, cores) = (basis.as_slice_mut()?, cores.as_slice_mut()?);
    check_decomposed(&node, mode)?;
    check_length("the basis", basis.len(), node.basis_size(mode))?;
    check_cores(&node, cores.len())?;
    guard::run(py, || orthonormal::orthonormalise(&node, mode, basis, cores))
}

/// The best cluster subsets of a mode's rows and their coefficients, flat, from H and b.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "two matrices, what their sides stand for, and what is wanted")]
fn code_rows<'py>(
    py: Python<'py>,
    h: PyReadonlyArray1<'py, f64>,
    b: PyReadonlyArray1<'py, f64>,
    clusters: Vec<usize>,
    mode: usize,
    rank: usize,
    kept: Option<PyReadonlyArray1<'py, u16>>,
    mixture: usize,
    search: &str,
) -> PyResult<Coded<'py>> {
    let (h, b) = (h.as_slice()?, b.as_slice()?);
    let kept = kept.as_ref().map(|kept| kept.as_slice()).transpose()?;
    let side = count(clusters.iter().copied().chain([rank]))?;
    let own = clusters.get(mode).copied().unwrap_or(0);
    if side == 0 || mixture == 0 || mixture > own || own > usize::from(u16::MAX) || b.len() < side {
        return Err(PyValueError::new_err(format!(
            "mode {mode} needs 1 <= K <= C and R >= 1, got C={clusters:?} K={mixture} R={rank}"
        )));
    }
    let given = Given { h, b, clusters: &clusters, mode, rank, rows: b.len() / side };
    check_length("H", h.len(), count([side, side])?)?;
    check_length("b", b.len(), given.rows * side)?;
    if u32::try_from(given.rows).is_err() {
        return Err(PyValueError::new_err(format!("{} rows are more than can be counted", given.rows)));
    }
    if let Some(kept) = kept {
        cells::check_members(kept, given.rows, own, mixture).map_err(PyValueError::new_err)?;
    }
    let search = match search {
        "optimal" if coding::is_few(own, mixture) => Search::Optimal,
        "greedy" => Search::Greedy,
        "fixed" if kept.is_some() => Search::Fixed,
        _ => {
            return Err(PyValueError::new_err(format!(
                "no search is called {search:?}, or it needs subsets to keep, or fewer of them to look at"
            )));
        }
    };
    room_for::<f32>("coefficients", [given.rows, mixture, side / own])?;
    let (subsets, x) = guard::run(py, || coding::code_rows(&given, kept, mixture, search))?;
    Ok((subsets.into_pyarray(py), x.into_pyarray(py)))
}

/// Add the values of scattered elements at `coords` `[elements, N]` to `out`.
fn decode_scattered<'py, T: Decode + Element>(
    py: Python<'py>,
    levels: Vec<Arrays<'py>>,
    coords: PyReadonlyArray1<'py, i64>,
    mut out: PyReadwriteArray1<'py, T>,
) -> PyResult<()> {
    let levels = binding::levels(&levels)?;
    let (coords, out) = (coords.as_slice()?, out.as_slice_mut()?);
    check_length("the coordinates", coords.len(), count([out.len(), levels[0].order()])?)?;
    check_indices(coords)?;
    guard::run(py, || scattered::decode(&levels, coords, out))?.map_err(PyValueError::new_err)
}

#[pyfunction]
fn decode_scattered_f32<'py>(
    py: Python<'py>,
    levels: Vec<Arrays<'py>>,
    coords: PyReadonlyArray1<'py, i64>,
    out: PyReadwriteArray1<'py, f32>,
) -> PyResult<()> {
    decode_scattered(py, levels, coords, out)
}

#[pyfunction]
fn decode_scattered_f64<'py>(
    py: Python<'py>,
    levels: Vec<Arrays<'py>>,
    coords: PyReadonlyArray1<'py, i64>,
    out: PyReadwriteArray1<'py, f64>,
) -> PyResult<()> {
    decode_scattered(py, levels, coords, out)
}

/// Add the block of the outer product of `rows` to `out`; the levels before `first`, from 0, add nothing.
#[pyfunction]
fn decode_block<'py>(
    py: Python<'py>,
    levels: Vec<Arrays<'py>>,
    rows: Vec<PyReadonlyArray1<'py, i64>>,
    first: usize,
    mut out: PyReadwriteArray1<'py, f32>,
) -> PyResult<()> {
    let levels = binding::levels(&levels)?;
    let (rows, out) = (slices(&rows)?, out.as_slice_mut()?);
    check_length("the list of rows", rows.len(), levels[0].order())?;
    check_length("out", out.len(), count(rows.iter().map(|rows| rows.len()))?)?;
    rows.iter().try_for_each(|rows| check_indices(rows))?;
    if out.is_empty() {
        return Ok(());
    }
    guard::run(py, || dense::decode(&levels, &rows, first, out))?.map_err(PyValueError::new_err)
}

#[pymodule]
fn _native(module: &Bound<PyModule>) -> PyResult<()> {
    guard::quiet();
    module.add_function(wrap_pyfunction!(fit_cells, module)?)?;
    module.add_function(wrap_pyfunction!(accumulate, module)?)?;
    module.add_function(wrap_pyfunction!(project_cells, module)?)?;
    module.add_function(wrap_pyfunction!(project_pair, module)?)?;
    module.add_function(wrap_pyfunction!(contract_lanes, module)?)?;
    module.add_function(wrap_pyfunction!(dense_basis, module)?)?;
    module.add_function(wrap_pyfunction!(dictionary_gram, module)?)?;
    module.add_function(wrap_pyfunction!(solve_cores, module)?)?;
    module.add_function(wrap_pyfunction!(orthonormalise, module)?)?;
    module.add_function(wrap_pyfunction!(collect::collect, module)?)?;
    module.add_function(wrap_pyfunction!(collect::collect_scaled, module)?)?;
    module.add_function(wrap_pyfunction!(magnitudes::magnitudes, module)?)?;
    module.add_function(wrap_pyfunction!(picked::gather, module)?)?;
    module.add_function(wrap_pyfunction!(picked::scatter, module)?)?;
    module.add_function(wrap_pyfunction!(code_rows, module)?)?;
    module.add_function(wrap_pyfunction!(kmeans::nearest_with_room, module)?)?;
    module.add_function(wrap_pyfunction!(kmeans::cluster_rows, module)?)?;
    module.add_function(wrap_pyfunction!(search_kernels::rank_boxes, module)?)?;
    module.add_function(wrap_pyfunction!(search_kernels::code_blocks, module)?)?;
    module.add_function(wrap_pyfunction!(decode_scattered_f32, module)?)?;
    module.add_function(wrap_pyfunction!(decode_scattered_f64, module)?)?;
    module.add_function(wrap_pyfunction!(decode_block, module)?)?;
    stage_code::register(module)?;
    module.add_function(wrap_pyfunction!(threads::set_threads, module)?)?;
    module.add_class::<cut_short::MapWatch>()?;
    Ok(())
}
