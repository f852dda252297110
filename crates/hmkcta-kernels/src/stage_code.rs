//! Stages coded and decoded for Python, run by run on all threads.

use crate::binding::{check_length, slices};
use crate::contexts::Fault;
use crate::guard;
use crate::run_code::{Decoded, Run, Stage, Stated, decode};
use crate::sizes::zeros;
use crate::stage::{Geometry, Next, Parted};
use crate::stage_whole::Widened;
use crate::threads;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

type Array<'py, T> = PyReadonlyArray1<'py, T>;
type OfModes<'py, T> = Vec<Array<'py, T>>;

/// A run does not take many more bytes than this.
const RUN_BYTES: u64 = 256 << 10;

fn refused(fault: Fault) -> PyErr {
    PyValueError::new_err(fault.code())
}

/// The same, with the number of the run in which it was found.
fn refused_in((fault, run): (Fault, Option<usize>)) -> PyErr {
    PyValueError::new_err((fault.code(), run))
}

/// Where nodes lie, flat.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Places<'py> {
    rows: Array<'py, u32>,
    extents: Array<'py, u32>,
    ends: Array<'py, u32>,
}

impl Places<'_> {
    fn geometry(&self, order: usize) -> PyResult<Geometry<'_>> {
        let (rows, extents, ends) = (self.rows.as_slice()?, self.extents.as_slice()?, self.ends.as_slice()?);
        Geometry::new(order, rows, extents, ends).map_err(PyValueError::new_err)
    }
}

/// The arrays of a stage as a dictionary, all flat; `children` counts those of each node.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Arrays<'py> {
    last: bool,
    coded: bool,
    shape: Array<'py, u32>,
    children: Array<'py, u32>,
    cluster: OfModes<'py, u16>,
    part: OfModes<'py, u16>,
    column: OfModes<'py, u8>,
    core: Array<'py, i32>,
    basis: OfModes<'py, i32>,
}

fn check_tables(geometry: &Geometry, shape: &[u32], children: &[u32]) -> PyResult<()> {
    check_length("shape", shape.len(), 3 * geometry.nodes() * geometry.order())?;
    check_length("children", children.len(), geometry.nodes())
}

impl Arrays<'_> {
    fn stage<'a>(&'a self, places: &'a Places) -> PyResult<Stage<'a>> {
        let (order, shape, children) = (self.cluster.len(), self.shape.as_slice()?, self.children.as_slice()?);
        let geometry = places.geometry(order)?;
        check_tables(&geometry, shape, children)?;
        for (name, length) in [("column", self.column.len()), ("basis", self.basis.len()), ("part", self.part.len())] {
            if name == "part" && !self.last || name != "part" && self.coded {
                check_length(name, length, order)?;
            }
        }
        Ok(Stage {
            geometry,
            last: self.last,
            coded: self.coded,
            shape,
            children,
            cluster: slices(&self.cluster)?,
            part: slices(&self.part)?,
            column: slices(&self.column)?,
            core: self.core.as_slice()?,
            basis: slices(&self.basis)?,
        })
    }
}

/// Something done for each run on all threads; the first fault, if there is one.
fn for_runs<I: Send, T: Send>(
    items: Vec<I>,
    work: impl Fn(I) -> Result<T, Fault> + Sync + Send,
) -> Result<Vec<T>, Fault> {
    let mut done: Vec<Result<T, Fault>> = items.iter().map(|_| Err(Fault::RunCount)).collect();
    let tasks: Vec<(I, &mut Result<T, Fault>)> = items.into_iter().zip(&mut done).collect();
    threads::for_each(true, tasks, |(item, done)| *done = work(item));
    done.into_iter().collect()
}

/// Nodes, coded bytes, cells, core numbers and basis numbers of each mode.
fn counts(run: &Run, bytes: usize) -> Vec<u64> {
    let first = [run.nodes.len() as u64, bytes as u64, run.sizes.cells, run.sizes.core];
    first.into_iter().chain(run.sizes.modes.iter().map(|own| own.basis)).collect()
}

/// The runs of a stage: the bytes of each, and its counts as the header has them.
#[pyfunction]
#[pyo3(signature = (arrays, places, run_bytes = RUN_BYTES))]
pub fn encode_stage<'py>(
    py: Python<'py>,
    arrays: Arrays<'py>,
    places: Places<'py>,
    run_bytes: u64,
) -> PyResult<Vec<(Bound<'py, PyBytes>, Vec<u64>)>> {
    let stage = arrays.stage(&places)?;
    let work = || {
        let runs = stage.runs(run_bytes)?;
        let coded = for_runs(runs.iter().collect(), |run| stage.encode(run))?;
        Ok(runs.into_iter().zip(coded).collect::<Vec<_>>())
    };
    let coded = guard::run(py, work)?.map_err(refused)?;
    Ok(coded.into_iter().map(|(run, bytes)| (PyBytes::new(py, &bytes), counts(&run, bytes.len()))).collect())
}

/// How many bytes the runs of a stage take together.
#[pyfunction]
#[pyo3(signature = (arrays, places, run_bytes = RUN_BYTES))]
pub fn count_stage(py: Python, arrays: Arrays, places: Places, run_bytes: u64) -> PyResult<u64> {
    let stage = arrays.stage(&places)?;
    let work = || Ok(for_runs(stage.runs(run_bytes)?, |run| stage.count(&run))?.into_iter().sum());
    guard::run(py, work)?.map_err(refused)
}

/// What the header says of a stage, as a dictionary.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Header<'py> {
    last: bool,
    step: Option<f32>,
    /// Whether float16 numbers follow the code of each run.
    raw: bool,
    /// `[3, N]`
    largest: Array<'py, u32>,
    /// Nodes of the next stage, and their rows of each mode.
    next: (u64, Vec<u64>),
}

type OfRun<'a> = (&'a [u8], Stated<'a>, Decoded<'a>);

/// Cut the first numbers off a slice.
fn split<'a, T>(rest: &mut &'a mut [T], count: u64) -> Option<&'a mut [T]> {
    let count = usize::try_from(count).ok()?;
    let (first, others) = std::mem::take(rest).split_at_mut_checked(count)?;
    *rest = others;
    Some(first)
}

/// Decode a run and the float16 numbers behind its code.
fn decode_run<'a>((bytes, stated, out): OfRun<'a>, coded: usize, raw: bool) -> Result<Decoded<'a>, Fault> {
    let (code, behind) = bytes.split_at_checked(coded).ok_or(Fault::CodeEnd)?;
    let mut out = decode(code, &stated, out)?;
    let mut rest = behind;
    if raw {
        for to in std::iter::once(&mut out.core).chain(&mut out.basis) {
            let own;
            (own, rest) = rest.split_at_checked(2 * to.len()).ok_or(Fault::CodeEnd)?;
            to.iter_mut().zip(own.as_chunks().0).for_each(|(to, &two)| *to = u16::from_le_bytes(two));
        }
        let own;
        (own, rest) = rest.split_at_checked(4 * out.scale.len()).ok_or(Fault::CodeEnd)?;
        out.scale.iter_mut().zip(own.as_chunks().0).for_each(|(to, &four)| *to = f32::from_le_bytes(four));
    }
    if rest.is_empty() { Ok(out) } else { Err(Fault::CodeEnd) }
}

/// Everything a stage decodes to.
struct Whole {
    core: Vec<u16>,
    scale: Vec<f32>,
    basis: Vec<Vec<u16>>,
    shape: Vec<u32>,
    children: Vec<u32>,
    cluster: Vec<Vec<u16>>,
    part: Vec<Vec<u16>>,
    column: Vec<Vec<u8>>,
    next: Next,
}

struct Task<'a> {
    geometry: Geometry<'a>,
    last: bool,
    step: Option<f32>,
    raw: bool,
    largest: &'a [u32],
    next: (u64, &'a [u64]),
}

impl Task<'_> {
    /// `runs`: the bytes of each, and its counts, which the caller has checked to be no more than there is room for.
    fn decode(&self, runs: &[(&[u8], Vec<u64>)]) -> Result<Whole, (Fault, Option<usize>)> {
        let order = self.geometry.order();
        let total = |i: usize| {
            let sum = runs.iter().try_fold(0_u64, |sum, (_, counts)| sum.checked_add(counts[i]));
            sum.and_then(|sum| usize::try_from(sum).ok()).ok_or((Fault::RunCount, None))
        };
        if total(0)? != self.geometry.nodes() {
            return Err((Fault::RunCount, None));
        }
        let (mut core, mut scale) = (zeros(total(3)?), zeros(total(2)?));
        let mut basis = (0..order).map(|n| Ok(zeros(total(4 + n)?))).collect::<Result<Vec<Vec<u16>>, _>>()?;
        let (mut cores, mut scales) = (&mut core[..], &mut scale[..]);
        let mut bases: Vec<&mut [u16]> = basis.iter_mut().map(|basis| &mut basis[..]).collect();
        let (mut tasks, mut first) = (vec![], 0);
        for (bytes, counts) in runs {
            let own: Option<Vec<_>> =
                bases.iter_mut().zip(&counts[4..]).map(|(rest, &count)| split(rest, count)).collect();
            let (Some(core), Some(scale), Some(basis)) =
                (split(&mut cores, counts[3]), split(&mut scales, counts[2]), own)
            else {
                return Err((Fault::RunCount, None));
            };
            let nodes = first..first + counts[0] as usize;
            first = nodes.end;
            let Task { geometry, last, step, largest, next: (children, _), .. } = *self;
            let stated = Stated { geometry, nodes, last, step, largest, children };
            tasks.push(((*bytes, stated, Decoded::new(core, scale, basis)), counts[1] as usize));
        }
        let done = for_runs(tasks.into_iter().enumerate().collect(), |(run, (task, coded))| {
            Ok(decode_run(task, coded, self.raw).map_err(|fault| (fault, Some(run))))
        });
        let decoded = done.map_err(|fault| (fault, None))?.into_iter().collect::<Result<Vec<_>, _>>()?;
        let mut whole = Tables::new(order);
        decoded.into_iter().for_each(|run| whole.append(run));
        let Tables { shape, children, cluster, part, column, grids } = whole;
        let next = if self.last {
            Next::default()
        } else {
            let part = part.iter().map(Vec::as_slice).collect();
            let parted = Parted { geometry: self.geometry, shape: &shape, children: &children, part };
            parted.next(Some(self.next), Some(&grids)).map_err(|fault| (fault, None))?
        };
        Ok(Whole { core, scale, basis, shape, children, cluster, part, column, next })
    }
}

/// Tables of all runs.
struct Tables {
    shape: Vec<u32>,
    children: Vec<u32>,
    cluster: Vec<Vec<u16>>,
    part: Vec<Vec<u16>>,
    column: Vec<Vec<u8>>,
    grids: Vec<u32>,
}

impl Tables {
    fn new(order: usize) -> Self {
        let (cluster, part, column) = (vec![vec![]; order], vec![vec![]; order], vec![vec![]; order]);
        Tables { shape: vec![], children: vec![], cluster, part, column, grids: vec![] }
    }

    fn append(&mut self, run: Decoded) {
        self.shape.extend(run.shape);
        self.children.extend(run.children);
        self.grids.extend(run.grids);
        self.cluster.iter_mut().zip(run.cluster).for_each(|(to, own)| to.extend(own));
        self.part.iter_mut().zip(run.part).for_each(|(to, own)| to.extend(own));
        self.column.iter_mut().zip(run.column).for_each(|(to, own)| to.extend(own));
    }
}

fn arrays<'py, T: numpy::Element>(py: Python<'py>, each: Vec<Vec<T>>) -> Vec<Bound<'py, PyArray1<T>>> {
    each.into_iter().map(|own| own.into_pyarray(py)).collect()
}

fn next_dict<'py>(py: Python<'py>, next: Next) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    out.set_item("rows", next.rows.into_pyarray(py))?;
    out.set_item("extents", next.extents.into_pyarray(py))?;
    out.set_item("ends", next.ends.into_pyarray(py))?;
    out.set_item("local", arrays(py, next.local))?;
    Ok(out)
}

/// The arrays of a stage, flat, float16 as its bits; `next`: where the nodes of the next stage lie.
#[pyfunction]
pub fn decode_stage<'py>(
    py: Python<'py>,
    header: Header<'py>,
    places: Places<'py>,
    runs: Vec<(Array<'py, u8>, Vec<u64>)>,
) -> PyResult<Bound<'py, PyDict>> {
    let largest = header.largest.as_slice()?;
    let order = largest.len() / 3;
    let geometry = places.geometry(order.max(1))?;
    check_length("largest", largest.len(), 3 * geometry.order())?;
    check_length("next", header.next.1.len(), order)?;
    let runs =
        runs.iter().map(|(bytes, counts)| Ok((bytes.as_slice()?, counts.clone()))).collect::<PyResult<Vec<_>>>()?;
    runs.iter().try_for_each(|(_, counts)| check_length("the counts of a run", counts.len(), 4 + order))?;
    let next = (header.next.0, &header.next.1[..]);
    let task = Task { geometry, last: header.last, step: header.step, raw: header.raw, largest, next };
    let whole = guard::run(py, || task.decode(&runs))?.map_err(refused_in)?;
    let out = PyDict::new(py);
    out.set_item("shape", whole.shape.into_pyarray(py))?;
    out.set_item("children", whole.children.into_pyarray(py))?;
    out.set_item("core", whole.core.into_pyarray(py))?;
    out.set_item("core_scale", whole.scale.into_pyarray(py))?;
    out.set_item("basis", arrays(py, whole.basis))?;
    out.set_item("cluster", arrays(py, whole.cluster))?;
    out.set_item("part", arrays(py, whole.part))?;
    out.set_item("column", arrays(py, whole.column))?;
    out.set_item("next", next_dict(py, whole.next)?)?;
    Ok(out)
}

/// Where the children of a stage's nodes lie: grids are found in the parts.
#[pyfunction]
pub fn next_stage<'py>(
    py: Python<'py>,
    shape: Array<'py, u32>,
    children: Array<'py, u32>,
    part: OfModes<'py, u16>,
    places: Places<'py>,
) -> PyResult<Bound<'py, PyDict>> {
    let (shape, children) = (shape.as_slice()?, children.as_slice()?);
    let geometry = places.geometry(part.len())?;
    check_tables(&geometry, shape, children)?;
    let parted = Parted { geometry, shape, children, part: slices(&part)? };
    let next = guard::run(py, || parted.next(None, None))?.map_err(refused)?;
    next_dict(py, next)
}

/// The arrays of a stage with a step, all flat, float16 as its bits.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct WidenedArrays<'py> {
    step: f32,
    shape: Array<'py, u32>,
    cluster: OfModes<'py, u16>,
    column: OfModes<'py, u8>,
    core: Array<'py, u16>,
    core_scale: Array<'py, f32>,
    basis: OfModes<'py, u16>,
}

/// The whole core numbers and basis numbers of a stage, for `encode_stage`.
#[pyfunction]
#[allow(clippy::type_complexity, reason = "two kinds of numbers")]
pub fn whole_stage<'py>(
    py: Python<'py>,
    arrays: WidenedArrays<'py>,
    places: Places<'py>,
) -> PyResult<(Bound<'py, PyArray1<i32>>, Vec<Bound<'py, PyArray1<i32>>>)> {
    let geometry = places.geometry(arrays.cluster.len())?;
    let shape = arrays.shape.as_slice()?;
    check_length("shape", shape.len(), 3 * geometry.nodes() * geometry.order())?;
    check_length("column", arrays.column.len(), geometry.order())?;
    check_length("basis", arrays.basis.len(), geometry.order())?;
    let widened = Widened {
        geometry,
        step: arrays.step,
        shape,
        cluster: slices(&arrays.cluster)?,
        column: slices(&arrays.column)?,
        core: arrays.core.as_slice()?,
        scale: arrays.core_scale.as_slice()?,
        basis: slices(&arrays.basis)?,
    };
    let (core, basis) = guard::run(py, || widened.whole())?.map_err(PyValueError::new_err)?;
    Ok((core.into_pyarray(py), basis.into_iter().map(|own| own.into_pyarray(py)).collect()))
}

/// Give the module what this file has for Python.
pub fn register(module: &Bound<PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(encode_stage, module)?)?;
    module.add_function(wrap_pyfunction!(count_stage, module)?)?;
    module.add_function(wrap_pyfunction!(decode_stage, module)?)?;
    module.add_function(wrap_pyfunction!(whole_stage, module)?)?;
    module.add_function(wrap_pyfunction!(next_stage, module)?)
}
