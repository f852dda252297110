//! The whole numbers of a node in a coded run: cell by cell the columns of its bases, then its core.

use crate::contexts::{Checked, Fault, MOST_K, Models};
use crate::range_coder::Coder;
use crate::run_columns::Column;
use crate::run_cores::{Axis, Scratch, core_numbers};
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
    let (mut scratch, mut known) = (Scratch::default(), vec![]);
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
                column.code(models, coder, r, k, port, &mut known)?;
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
        let mode = n;
        if node.mixture[n] > 0 {
            axes.push(Axis { mode, size: node.ranks[n] as usize, decomposed: true });
        } else {
            let sizes = place.extents(n).iter().map(|&size| size as usize);
            axes.extend(sizes.map(|size| Axis { mode, size, decomposed: false }));
        }
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
