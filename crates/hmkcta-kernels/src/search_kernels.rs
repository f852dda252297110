//! The kernels of the search, as Python calls them: blocks in a batch, shared by threads.

use crate::block_code::{Block, Code, Coder};
use crate::guard;
use crate::machine::dispatch;
use crate::rank_boxes::{Boxes, MODES, Rate};
use crate::sizes::product;
use crate::threads::for_each;
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pulp::{Simd, WithSimd};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Blocks that one thread works on at a time.
const TOGETHER: usize = 16;

/// Costs of blocks, their ranks one behind the other.
type Boxed<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<u32>>);
/// By mode exponents and whole numbers of bases; whole numbers of cores, squared errors.
type Coded<'py> = (
    Vec<Bound<'py, PyArray1<u8>>>,
    Vec<Bound<'py, PyArray1<i32>>>,
    Bound<'py, PyArray1<i32>>,
    Bound<'py, PyArray1<f64>>,
);

/// Elements of a block of these sizes, if it has 1 to 8 modes and is not empty.
fn elements(sizes: &[usize], decomposed: &[bool]) -> PyResult<usize> {
    match product(sizes.iter().copied()) {
        Ok(size) if (1..=MODES).contains(&sizes.len()) && decomposed.len() == sizes.len() && size > 0 => Ok(size),
        _ => Err(PyValueError::new_err(format!("blocks need 1 to {MODES} modes and elements, got {sizes:?}"))),
    }
}

/// The least cost of each core `[blocks, n_1, .., n_N]` and its ranks; `rate`: lambda, offset, slope, column bits.
#[pyfunction]
pub fn rank_boxes<'py>(
    py: Python<'py>,
    cores: PyReadonlyArray1<f32>,
    sizes: Vec<usize>,
    decomposed: Vec<bool>,
    step: f32,
    rate: (f32, f32, f32, f32),
    decode_cost: f64,
) -> PyResult<Boxed<'py>> {
    let size = elements(&sizes, &decomposed)?;
    let cores = cores.as_slice()?;
    if !cores.len().is_multiple_of(size) || step.is_nan() || step <= 0.0 {
        return Err(PyValueError::new_err(format!("whole cores of {size} numbers and a step above 0 are needed")));
    }
    let rate = Rate { lambda: rate.0, offset: rate.1, slope: rate.2, column: rate.3 };
    let order = sizes.len();
    let blocks = cores.len() / size;
    let (mut costs, mut ranks) = (vec![0f64; blocks], vec![0u32; blocks * order]);
    guard::run(py, || {
        let tasks: Vec<_> = cores
            .chunks(TOGETHER * size)
            .zip(costs.chunks_mut(TOGETHER))
            .zip(ranks.chunks_mut(TOGETHER * order))
            .collect();
        for_each(true, tasks, |((cores, costs), ranks)| {
            dispatch(BestBoxes {
                cores,
                sizes: &sizes,
                decomposed: &decomposed,
                step,
                rate,
                decode_cost,
                costs,
                ranks,
            });
        });
    })?;
    Ok((costs.into_pyarray(py), ranks.into_pyarray(py)))
}

struct BestBoxes<'a> {
    cores: &'a [f32],
    sizes: &'a [usize],
    decomposed: &'a [bool],
    step: f32,
    rate: Rate,
    decode_cost: f64,
    costs: &'a mut [f64],
    ranks: &'a mut [u32],
}

impl WithSimd for BestBoxes<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let size: usize = self.sizes.iter().product();
        let mut boxes = Boxes::default();
        for ((core, cost), ranks) in
            self.cores.chunks_exact(size).zip(self.costs).zip(self.ranks.chunks_exact_mut(self.sizes.len()))
        {
            *cost = boxes.best(core, self.sizes, self.decomposed, 1.0 / self.step, self.rate, self.decode_cost, ranks);
        }
    }
}

/// Whole numbers of blocks `[blocks, n_1, .., n_N]` at a step; all have the same undecomposed modes.
#[pyfunction]
#[allow(clippy::too_many_arguments, reason = "what a block is made of, as Python has it")]
pub fn code_blocks<'py>(
    py: Python<'py>,
    values: PyReadonlyArray1<f32>,
    cores: PyReadonlyArray1<f32>,
    bases: Vec<PyReadonlyArray1<f32>>,
    sizes: Vec<usize>,
    decomposed: Vec<bool>,
    ranks: PyReadonlyArray1<u32>,
    step: f32,
    dead_zone: f32,
) -> PyResult<Coded<'py>> {
    let size = elements(&sizes, &decomposed)?;
    let (values, cores, ranks) = (values.as_slice()?, cores.as_slice()?, ranks.as_slice()?);
    let (order, blocks) = (sizes.len(), values.len() / size);
    let bases = bases.iter().map(|b| b.as_slice()).collect::<Result<Vec<_>, _>>()?;
    let fits = |n: usize| bases[n].len() == if decomposed[n] { blocks * sizes[n] * sizes[n] } else { 0 };
    let ranked = |ranks: &[u32]| {
        ranks.iter().all(|&r| r == 0)
            || (0..order).all(|n| {
                ranks[n] >= 1 && ranks[n] as usize <= sizes[n] && (decomposed[n] || ranks[n] as usize == sizes[n])
            })
    };
    if values.len() != blocks * size
        || cores.len() != values.len()
        || ranks.len() != blocks * order
        || bases.len() != order
        || !(0..order).all(fits)
        || !ranks.chunks_exact(order).all(ranked)
        || step.is_nan()
        || step <= 0.0
    {
        return Err(PyValueError::new_err("values, cores, bases and ranks are not of the same blocks"));
    }
    let mut coded: Vec<Code> = (0..blocks).map(|_| Code::default()).collect();
    guard::run(py, || {
        let tasks: Vec<_> = coded.chunks_mut(TOGETHER).enumerate().collect();
        for_each(true, tasks, |(at, codes)| {
            dispatch(CodeBlocks {
                first: at * TOGETHER,
                codes,
                values,
                cores,
                bases: &bases,
                sizes: &sizes,
                decomposed: &decomposed,
                ranks,
                step,
                dead_zone,
            });
        });
    })?;
    let exponents = (0..order)
        .map(|n| coded.iter().flat_map(|c| c.exponents[n].iter().copied()).collect::<Vec<_>>().into_pyarray(py))
        .collect();
    let whole = (0..order)
        .map(|n| coded.iter().flat_map(|c| c.bases[n].iter().copied()).collect::<Vec<_>>().into_pyarray(py))
        .collect();
    let core: Vec<i32> = coded.iter().flat_map(|c| c.core.iter().copied()).collect();
    let errors: Vec<f64> = coded.iter().map(|c| c.error).collect();
    Ok((exponents, whole, core.into_pyarray(py), errors.into_pyarray(py)))
}

struct CodeBlocks<'a> {
    first: usize,
    codes: &'a mut [Code],
    values: &'a [f32],
    cores: &'a [f32],
    bases: &'a [&'a [f32]],
    sizes: &'a [usize],
    decomposed: &'a [bool],
    ranks: &'a [u32],
    step: f32,
    dead_zone: f32,
}

impl WithSimd for CodeBlocks<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let order = self.sizes.len();
        let size: usize = self.sizes.iter().product();
        let mut coder = Coder::default();
        for (i, code) in self.codes.iter_mut().enumerate() {
            let b = self.first + i;
            let ranks: Vec<usize> = self.ranks[b * order..(b + 1) * order].iter().map(|&r| r as usize).collect();
            let mut bases: [&[f32]; MODES] = [&[]; MODES];
            for n in (0..order).filter(|&n| self.decomposed[n]) {
                let each = self.sizes[n] * self.sizes[n];
                bases[n] = &self.bases[n][b * each..(b + 1) * each];
            }
            let block = Block {
                sizes: self.sizes,
                ranks: &ranks,
                decomposed: self.decomposed,
                values: &self.values[b * size..(b + 1) * size],
                bases,
                core: &self.cores[b * size..(b + 1) * size],
            };
            *code = coder.code(&block, self.step, self.dead_zone);
        }
    }
}
