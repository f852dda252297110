//! The whole numbers of a node in a coded run: cell by cell the columns of its bases, then its core.

use crate::contexts::{Checked, Fault, MOST_K, Models, Size};
use crate::range_coder::{Coder, Model};
use crate::run_node::{Node, Place, Port};

/// Half an octave.
const ROOT_OF_TWO: f64 = std::f64::consts::SQRT_2;

/// Rows of each cluster of a mode, in order, as places among the subsets of all rows.
struct Members {
    places: Vec<u32>,
    starts: Vec<usize>,
}

impl Members {
    fn new(subsets: &[u16], clusters: usize) -> Self {
        let mut starts = vec![0; clusters + 1];
        subsets.iter().for_each(|&c| starts[usize::from(c) + 1] += 1);
        (0..clusters).for_each(|c| starts[c + 1] += starts[c]);
        let (mut next, mut places) = (starts.clone(), vec![0; subsets.len()]);
        for (place, &c) in subsets.iter().enumerate() {
            places[next[usize::from(c)]] = place as u32;
            next[usize::from(c)] += 1;
        }
        Members { places, starts }
    }

    fn of(&self, cluster: usize) -> &[u32] {
        &self.places[self.starts[cluster]..self.starts[cluster + 1]]
    }
}

/// One index of a core's numbers: a mode with a basis, or an extent of one without.
struct Axis {
    mode: usize,
    size: usize,
    stride: usize,
    decomposed: bool,
}

/// Twice the logarithm of a length, rounded.
pub fn length_log(length: usize) -> i32 {
    let square = (length as u128).pow(2);
    let below = square.ilog2();
    (below + u32::from(square * square >= 1 << (2 * below + 1))) as i32
}

/// All numbers of a node whose tables are known.
pub fn numbers<C: Coder>(
    models: &mut Models,
    coder: &mut C,
    node: &mut Node,
    place: Place,
    port: &mut impl Port,
) -> Checked<()> {
    let decomposed: Vec<usize> = node.decomposed().collect();
    let members: Vec<Members> =
        decomposed.iter().map(|&n| Members::new(&node.members[n], node.clusters[n] as usize)).collect();
    let axes = axes(node, place);
    let (mut core, mut columns) = (std::mem::take(&mut node.core), std::mem::take(&mut node.columns));
    let mut scratch = Scratch::default();
    let cells = node.cells();
    let size = core.len() / cells;
    let mut cell = vec![0; node.order()];
    for flat in 0..cells {
        let mut rest = flat;
        for n in (0..node.order()).rev() {
            (cell[n], rest) = (rest % node.clusters[n] as usize, rest / node.clusters[n] as usize);
        }
        let rows: Vec<&[u32]> = decomposed.iter().zip(&members).map(|(&n, members)| members.of(cell[n])).collect();
        if rows.iter().any(|rows| rows.is_empty()) {
            continue;
        }
        let mut ks = Steps { first: None, last: 0 };
        for (&n, rows) in decomposed.iter().zip(&rows) {
            let ranks = node.ranks[n] as usize;
            let own = &mut columns[n][flat * ranks..(flat + 1) * ranks];
            ks.code(models, coder, n, own)?;
            let others = others(node, n, &cell);
            let column = Column { n, places: rows, others, ranks, extent: inner_extent(node, place, n) };
            for (r, &k) in own.iter().enumerate() {
                column.code(models, coder, r, k, port, &mut scratch.column)?;
            }
        }
        let base = base(node, place, &decomposed, |n, r| columns[n][flat * node.ranks[n] as usize + r]);
        let ks: Vec<&[u8]> = axes
            .iter()
            .map(|axis| {
                let ranks = node.ranks[axis.mode] as usize;
                if axis.decomposed { &columns[axis.mode][flat * ranks..(flat + 1) * ranks] } else { &[][..] }
            })
            .collect();
        core_numbers(models, coder, &axes, base, &ks, &mut core[flat * size..(flat + 1) * size], &mut scratch)?;
        if coder.past_end() {
            return Err(Fault::CodeEnd);
        }
    }
    (node.core, node.columns) = (core, columns);
    Ok(())
}

/// PC_-n and the number of a cell among the other modes' clusters.
fn others(node: &Node, n: usize, cell: &[usize]) -> (usize, usize) {
    let others = (0..node.order()).filter(|&m| m != n);
    others.fold((1, 0), |(count, flat), m| {
        let clusters = node.clusters[m] as usize;
        (count * clusters, flat * clusters + cell[m])
    })
}

/// The last extent of a mode whose rows a cell has all of, where it has several.
fn inner_extent(node: &Node, place: Place, n: usize) -> Option<usize> {
    let extents = place.extents(n);
    (node.clusters[n] == 1 && extents.len() > 1).then(|| extents[extents.len() - 1] as usize)
}

fn axes(node: &Node, place: Place) -> Vec<Axis> {
    let mut axes = vec![];
    for n in 0..node.order() {
        let (mode, stride) = (n, 1);
        if node.mixture[n] > 0 {
            axes.push(Axis { mode, size: node.ranks[n] as usize, stride, decomposed: true });
        } else {
            let sizes = place.extents(n).iter().map(|&size| size as usize);
            axes.extend(sizes.map(|size| Axis { mode, size, stride, decomposed: false }));
        }
    }
    let mut stride = 1;
    for axis in axes.iter_mut().rev() {
        axis.stride = stride;
        stride *= axis.size;
    }
    axes
}

/// What a core number's size is counted from, in half octaves.
fn base(node: &Node, place: Place, decomposed: &[usize], k: impl Fn(usize, usize) -> u8) -> i32 {
    let Some(&first) = decomposed.first() else { return 0 };
    let energy: f64 = (0..node.ranks[first] as usize).map(|r| (1_u64 << k(first, r)) as f64).sum();
    let exponent = ((ROOT_OF_TWO * energy).to_bits() >> 52) as i32 - 1023;
    let whole = (0..node.order()).filter(|&n| node.mixture[n] == 0);
    -(decomposed.len() as i32 - 1) * exponent - whole.map(|n| place.rows[n].ilog2() as i32).sum::<i32>()
}

/// k of the columns of a cell: of the first one, and of the last one told.
struct Steps {
    first: Option<u8>,
    last: u8,
}

impl Steps {
    fn code<C: Coder>(&mut self, models: &mut Models, coder: &mut C, n: usize, own: &mut [u8]) -> Checked<()> {
        for (r, k) in own.iter_mut().enumerate() {
            let told = match self.first {
                None => i64::from(models.first_k.code(coder, u32::from(*k))?),
                Some(first) => {
                    let before = i64::from(if r == 0 { first } else { self.last });
                    let less = before - i64::from(*k);
                    let zigzag = if C::DECODES { 0 } else { (less << 1 ^ less >> 63) as u32 };
                    let zigzag = i64::from(models.modes[n].steps[usize::from(r > 0)].code(coder, zigzag)?);
                    before - (zigzag >> 1 ^ -(zigzag & 1))
                }
            };
            *k = u8::try_from(told).ok().filter(|&k| k <= MOST_K).ok_or(Fault::CodeRange)?;
            self.first.get_or_insert(*k);
            self.last = *k;
        }
        Ok(())
    }
}

#[derive(Default)]
struct Scratch {
    column: Vec<i32>,
    sums: Vec<u32>,
    index: Vec<usize>,
    offsets: Vec<usize>,
}

/// Sign of a number, as 0, 1 or 2.
#[inline(always)]
fn sign_of(number: i32) -> usize {
    (number.signum() + 1) as usize
}

/// Columns of a cell's basis.
struct Column<'a> {
    n: usize,
    places: &'a [u32],
    /// PC_-n and where the cell is among these.
    others: (usize, usize),
    ranks: usize,
    extent: Option<usize>,
}

impl Column<'_> {
    fn code<C: Coder>(
        &self,
        models: &mut Models,
        coder: &mut C,
        r: usize,
        k: u8,
        port: &mut impl Port,
        known: &mut Vec<i32>,
    ) -> Checked<()> {
        let size = Size::of_basis(i32::from(k) - length_log(self.places.len()));
        let of_sign = (size.class.min(63) >> 2) as usize;
        let extent = self.extent.unwrap_or(0);
        known.clear();
        known.resize(if extent > 0 { self.places.len() } else { 0 }, 0);
        let (mut magnitudes, mut signs) = ((0, 0), (1, 1));
        let mut along = 0;
        for (i, &place) in self.places.iter().enumerate() {
            let at = (place as usize * self.others.0 + self.others.1) * self.ranks + r;
            if extent > 0 {
                let left = (along > 0).then(|| known[i - 1]);
                let above = (i >= extent).then(|| known[i - extent]);
                let (a, b) = (left.or(above).unwrap_or(0), above.or(left).unwrap_or(0));
                magnitudes = (a.unsigned_abs(), b.unsigned_abs());
                signs = (sign_of(left.unwrap_or(0)), sign_of(above.unwrap_or(0)));
                along = if along + 1 == extent { 0 } else { along + 1 };
            }
            let given = if C::DECODES { 0 } else { port.take(self.n, at) };
            let around = magnitudes.0 + magnitudes.1;
            let magnitude = models.basis.code(coder, size, around, given.unsigned_abs())?;
            let mut number = magnitude as i32;
            if magnitude > 0 {
                let model = &mut models.basis_sign[(3 * signs.0 + signs.1).min(8)][of_sign & 15];
                number = signed(number, coder.bit(model, given < 0));
            }
            port.put(self.n, at, number, k);
            if extent > 0 {
                known[i] = number;
            } else {
                magnitudes = (magnitude, if i == 0 { magnitude } else { magnitudes.0 });
                signs = (sign_of(number), signs.0);
            }
        }
        Ok(())
    }
}

#[inline(always)]
fn signed(magnitude: i32, negative: bool) -> i32 {
    if negative { -magnitude } else { magnitude }
}

/// Axes without a basis, in the order in which signs look for neighbours along them.
fn sign_axes(axes: &[Axis]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..axes.len()).filter(|&a| !axes[a].decomposed).collect();
    order.sort_by_key(|&a| (axes[a].mode, usize::MAX - a));
    order
}

/// The numbers of one cell's core; `ks`: k of the columns along each axis.
fn core_numbers<C: Coder>(
    models: &mut Models,
    coder: &mut C,
    axes: &[Axis],
    base: i32,
    ks: &[&[u8]],
    core: &mut [i32],
    scratch: &mut Scratch,
) -> Checked<()> {
    let [outer @ .., last] = axes else { return Err(Fault::NodeShape) };
    let last_k = ks[outer.len()];
    let of_signs = sign_axes(axes);
    let Scratch { sums, index, offsets, .. } = scratch;
    index.clear();
    index.resize(axes.len(), 0);
    for start in (0..core.len()).step_by(last.size) {
        let (before, row) = core.split_at_mut(start);
        let row = &mut row[..last.size];
        sums.clear();
        sums.resize(last.size, 0);
        let mut t = base;
        for (a, axis) in outer.iter().enumerate() {
            t += if axis.decomposed { i32::from(ks[a][index[a]]) } else { 0 };
            if index[a] > 0 {
                let neighbours = &before[start - axis.stride..][..last.size];
                sums.iter_mut().zip(neighbours).for_each(|(sum, q)| *sum += q.unsigned_abs());
            }
        }
        offsets.clear();
        let inner_last = !last.decomposed && last.size > 1;
        let reaches = |&&a: &&usize| if a == outer.len() { inner_last } else { index[a] > 0 };
        offsets.extend(of_signs.iter().filter(reaches).map(|&a| axes[a].stride));
        let signs = Signs { offsets, inner: last.stride, inner_last };
        let mut row = Row { before, row, sums, t, size: Size::of_core(t), ks: last_k };
        if of_signs.is_empty() {
            row.code(models, coder, |coder, _, _, _, negative| coder.raw(1, u32::from(negative)) != 0)?;
        } else {
            row.code(models, coder, |coder, model, known, j, negative| {
                coder.bit(&mut model[signs.context(known, j)], negative)
            })?;
        }
        for a in (0..outer.len()).rev() {
            index[a] += 1;
            if index[a] < axes[a].size {
                break;
            }
            index[a] = 0;
        }
    }
    Ok(())
}

/// Where signs of a row of a core find the signs of their neighbours.
struct Signs<'a> {
    /// How far neighbours are, in order; along the row's own axis that is `inner`, where `inner_last`.
    offsets: &'a [usize],
    inner: usize,
    inner_last: bool,
}

/// Numbers before a row, and those of it that are known.
type Known<'a> = (&'a [i32], &'a [i32]);

impl Signs<'_> {
    #[inline(always)]
    fn context(&self, (before, row): Known, j: usize) -> usize {
        let at = before.len() + j;
        let mut signs = [1, 1];
        let along = |offset: &&usize| !(self.inner_last && **offset == self.inner && j == 0);
        for (sign, &offset) in signs.iter_mut().zip(self.offsets.iter().filter(along)) {
            let from = at - offset;
            *sign = sign_of(if from < before.len() { before[from] } else { row[from - before.len()] });
        }
        (3 * signs[0] + signs[1]).min(8)
    }
}

/// Numbers along the last axis of a core.
struct Row<'a> {
    before: &'a [i32],
    row: &'a mut [i32],
    /// Of the neighbours along other axes.
    sums: &'a [u32],
    t: i32,
    size: Size,
    /// Of the columns along the row, none where it has none.
    ks: &'a [u8],
}

impl Row<'_> {
    #[inline(always)]
    fn code<C: Coder>(
        &mut self,
        models: &mut Models,
        coder: &mut C,
        negative: impl Fn(&mut C, &mut [Model; 9], Known, usize, bool) -> bool,
    ) -> Checked<()> {
        let mut last = 0;
        for j in 0..self.row.len() {
            let given = self.row[j];
            let size = if self.ks.is_empty() { self.size } else { Size::of_core(self.t + i32::from(self.ks[j])) };
            let magnitude = models.core.code(coder, size, self.sums[j] + last, given.unsigned_abs())?;
            let mut number = magnitude as i32;
            if magnitude > 0 {
                let known = (self.before, &self.row[..j]);
                number = signed(number, negative(coder, &mut models.core_sign, known, j, given < 0));
            }
            self.row[j] = number;
            last = magnitude;
        }
        Ok(())
    }
}
