//! Nodes, their arrays and levels of a model as Python hands them over, checked.

use crate::cell_pairs::Pairs;
use crate::cells::{Node, Shape};
use crate::packed::{Level, MOST_MODES, Ragged};
use crate::sizes::{has_room, product};
use numpy::{Element, PyReadonlyArray1};
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;

type Array<'py, T> = PyReadonlyArray1<'py, T>;
type OfModes<'py, T> = Vec<Option<Array<'py, T>>>;
pub type Members<'py> = Vec<PyReadonlyArray1<'py, u16>>;
pub type Floats<'py> = PyReadonlyArray1<'py, f32>;
pub type Doubles<'py> = PyReadonlyArray1<'py, f64>;

/// The arrays of one stage as a dictionary, named as in `hmkcta.packed.PackedLevel`, all flat; float16 as its bits.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Arrays<'py> {
    shape: Array<'py, u32>,
    child: Option<Array<'py, u32>>,
    row_offset: Vec<Array<'py, u32>>,
    core: Array<'py, u16>,
    core_offset: Array<'py, u32>,
    core_scale: Array<'py, f32>,
    cell_offset: Array<'py, u32>,
    cluster: Vec<Array<'py, u16>>,
    cluster_offset: Vec<Array<'py, u32>>,
    basis: Vec<Array<'py, u16>>,
    basis_offset: Vec<Array<'py, u32>>,
    part: OfModes<'py, u16>,
    local: OfModes<'py, u32>,
}

/// Levels that a model has at most: the tree of its nodes is walked down level by level.
const MOST_LEVELS: usize = 1024;
/// Rounds of whatever kind that may be asked for: more would not end in this life.
const MOST_ROUNDS: usize = 1_000_000;

/// The levels, each of as many modes as the others.
pub fn levels<'a>(arrays: &'a [Arrays]) -> PyResult<Vec<Level<'a>>> {
    let levels = arrays.iter().map(Arrays::level).collect::<PyResult<Vec<_>>>()?;
    let order = levels.first().map_or(0, Level::order);
    if levels.len() > MOST_LEVELS {
        return Err(PyValueError::new_err(format!("a model has up to {MOST_LEVELS} levels, got {}", levels.len())));
    }
    if order == 0 || order > MOST_MODES || levels.iter().any(|level| level.order() != order) {
        return Err(PyValueError::new_err(format!("a model has 1 to {MOST_MODES} modes, the same in every level")));
    }
    Ok(levels)
}

impl Arrays<'_> {
    fn level(&self) -> PyResult<Level<'_>> {
        let row_offset = self.row_offset.iter().map(slice).collect::<PyResult<Vec<_>>>()?;
        let order = row_offset.len();
        let cluster = ragged(&self.cluster, &self.cluster_offset)?;
        let basis = ragged(&self.basis, &self.basis_offset)?;
        let part = self.part.iter().map(|part| part.as_ref().map(slice).transpose()).collect::<PyResult<Vec<_>>>()?;
        let local =
            self.local.iter().map(|local| local.as_ref().map(slice).transpose()).collect::<PyResult<Vec<_>>>()?;
        if [cluster.len(), basis.len(), part.len(), local.len()] != [order; 4] {
            return Err(PyValueError::new_err("a level needs cluster, basis, part and local of every mode"));
        }
        Ok(Level {
            shape: slice(&self.shape)?,
            child: self.child.as_ref().map(slice).transpose()?,
            row_offset,
            core: Ragged { data: slice(&self.core)?, offset: slice(&self.core_offset)? },
            core_scale: Ragged { data: slice(&self.core_scale)?, offset: slice(&self.cell_offset)? },
            cluster,
            basis,
            part,
            local,
        })
    }
}

fn slice<'a, T: Element>(array: &'a Array<T>) -> PyResult<&'a [T]> {
    Ok(array.as_slice()?)
}

fn ragged<'a>(data: &'a [Array<u16>], offset: &'a [Array<u32>]) -> PyResult<Vec<Ragged<'a, u16>>> {
    let of_mode =
        |(data, offset): (&'a Array<u16>, &'a Array<u32>)| Ok(Ragged { data: slice(data)?, offset: slice(offset)? });
    data.iter().zip(offset).map(of_mode).collect()
}

pub fn slices<'a, T: Element>(arrays: &'a [Array<T>]) -> PyResult<Vec<&'a [T]>> {
    Ok(arrays.iter().map(|array| array.as_slice()).collect::<Result<_, _>>()?)
}

pub fn node<'a>(shape: Shape, members: &'a Members) -> PyResult<Node<'a>> {
    Node::new(shape, slices(members)?).map_err(PyValueError::new_err)
}

/// Refuse arrays that do not hold what the node's shape says.
pub fn check_length(what: &str, length: usize, expected: usize) -> PyResult<()> {
    if length == expected {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("{what} must hold {expected} numbers, got {length}")))
}

/// The product of sizes as Python gave them.
pub fn count<I: IntoIterator<Item = usize, IntoIter: Clone>>(sizes: I) -> PyResult<usize> {
    product(sizes).map_err(PyValueError::new_err)
}

/// How many numbers come out, if there is room for them.
pub fn room_for<T>(what: &str, sizes: impl IntoIterator<Item = usize, IntoIter: Clone>) -> PyResult<usize> {
    let count = count(sizes)?;
    if has_room::<T>(count) {
        return Ok(count);
    }
    Err(PyMemoryError::new_err(format!("there is no memory for {what} of {count} numbers")))
}

/// Refuse rows that would be taken for others: nodes have as many as 32 bits count.
pub fn check_indices(rows: &[i64]) -> PyResult<()> {
    match rows.iter().find(|&&row| u32::try_from(row).is_err()) {
        Some(row) => Err(PyValueError::new_err(format!("no mode has a row {row}"))),
        None => Ok(()),
    }
}

pub fn check_rounds(what: &str, rounds: usize) -> PyResult<()> {
    if rounds <= MOST_ROUNDS {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("{what} must be up to {MOST_ROUNDS}, got {rounds}")))
}

pub fn check_bases<B: AsRef<[f32]>>(node: &Node, bases: &[B]) -> PyResult<()> {
    check_length("the list of bases", bases.len(), node.order())?;
    bases
        .iter()
        .enumerate()
        .try_for_each(|(n, basis)| check_length(&format!("basis {}", n + 1), basis.as_ref().len(), node.basis_size(n)))
}

pub fn check_tensor(node: &Node, length: usize) -> PyResult<()> {
    check_length("the tensor", length, count(node.sizes.iter().copied())?)
}

pub fn check_cores(node: &Node, length: usize) -> PyResult<()> {
    check_length("the cores", length, node.cells() * node.core_size())
}

pub fn check_mode(order: usize, mode: usize) -> PyResult<()> {
    if mode < order {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("mode must be below {order}, got {mode}")))
}

pub fn check_decomposed(node: &Node, mode: usize) -> PyResult<()> {
    check_mode(node.order(), mode)?;
    if node.undecomposed[mode] {
        return Err(PyValueError::new_err(format!("mode {} is not decomposed", mode + 1)));
    }
    Ok(())
}

pub fn tensor_of<'a>(node: &Node, tensor: &'a Floats) -> PyResult<&'a [f32]> {
    let tensor = tensor.as_slice()?;
    check_tensor(node, tensor.len())?;
    Ok(tensor)
}

pub fn bases_of<'a>(node: &Node, bases: &'a [Floats]) -> PyResult<Vec<&'a [f32]>> {
    let bases = slices(bases)?;
    check_bases(node, &bases)?;
    Ok(bases)
}

pub fn cores_of<'a>(node: &Node, cores: &'a Floats) -> PyResult<&'a [f32]> {
    let cores = cores.as_slice()?;
    check_cores(node, cores.len())?;
    Ok(cores)
}

/// All pairs of as many cells as have so many numbers in their cores.
pub fn pairs_of<'a>(ranks: &'a [usize], products: &'a [&'a [f64]], cores: usize) -> PyResult<Pairs<'a>> {
    check_length("the list of products", products.len(), ranks.len())?;
    if ranks.is_empty() || ranks.len() > crate::cells::MOST_MODES || ranks.contains(&0) {
        return Err(PyValueError::new_err(format!("a core has ranks of 1 and more, got {ranks:?}")));
    }
    let size = count(ranks.iter().copied())?;
    let cells = cores / size;
    let pairs = Pairs { cells, ranks, products };
    check_length("the cores", cores, cells * size)?;
    pairs.modes(None).try_for_each(|m| {
        check_length(&format!("product {}", m + 1), products[m].len(), count([cells, ranks[m], cells, ranks[m]])?)
    })?;
    Ok(pairs)
}
