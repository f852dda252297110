//! The cores of a node's cells in a coded run.

use crate::contexts::{Checked, Fault, Models, Size, sign_of, signed};
use crate::range_coder::{Coder, Model};

/// One index of a core's numbers: a mode with a basis, or an extent of one without.
pub struct Axis {
    pub mode: usize,
    pub size: usize,
    pub decomposed: bool,
}

/// Buffers for one core after the other.
#[derive(Default)]
pub struct Scratch {
    known: Vec<i32>,
    steps: Vec<usize>,
    index: Vec<usize>,
}

/// Axes without a basis, in the order in which signs look for neighbours along them.
fn sign_axes(axes: &[&Axis]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..axes.len()).filter(|&a| !axes[a].decomposed).collect();
    order.sort_by_key(|&a| (axes[a].mode, usize::MAX - a));
    order
}

/// The numbers of one cell's core; `ks`: k of the columns along each axis.
pub fn core_numbers<C: Coder>(
    models: &mut Models,
    coder: &mut C,
    axes: &[Axis],
    base: i32,
    ks: &[&[u8]],
    core: &mut [i32],
    scratch: &mut Scratch,
) -> Checked<()> {
    let whole = axes.iter().any(|axis| !axis.decomposed);
    // Along an axis of one index there are no neighbours.
    let only = axes.iter().zip(ks).filter(|(axis, _)| axis.size == 1);
    let base = base + only.filter_map(|(_, ks)| ks.first()).map(|&k| i32::from(k)).sum::<i32>();
    let (axes, ks): (Vec<&Axis>, Vec<&[u8]>) = axes.iter().zip(ks).filter(|(axis, _)| axis.size > 1).unzip();
    match axes.len() {
        0 => single(models, coder, base, core, whole),
        1 => Core::<1>::new(&axes, &ks, scratch, whole).code(models, coder, base, core),
        2 => Core::<2>::new(&axes, &ks, scratch, whole).code(models, coder, base, core),
        3 => Core::<3>::new(&axes, &ks, scratch, whole).code(models, coder, base, core),
        4 => Core::<4>::new(&axes, &ks, scratch, whole).code(models, coder, base, core),
        _ => Core::<0>::new(&axes, &ks, scratch, whole).code(models, coder, base, core),
    }
}

/// The only number of a core.
fn single<C: Coder>(models: &mut Models, coder: &mut C, t: i32, core: &mut [i32], whole: bool) -> Checked<()> {
    let [number] = core else { return Err(Fault::NodeShape) };
    let magnitude = models.core.code(coder, Size::of_core(t), 0, number.unsigned_abs())?;
    if magnitude > 0 {
        let negative = *number < 0;
        let bit = |coder: &mut C| coder.raw(1, u32::from(negative)) != 0;
        let negative = if whole { coder.even_bit(&mut models.core_sign[4], negative) } else { bit(coder) };
        *number = signed(magnitude as i32, negative);
    }
    Ok(())
}

/// A core of A axes of several indices each. Numbers known are kept between borders of zeros, so that all of them have
/// neighbours. Of many axes (A = 0) borders would take too much room, so there are none.
struct Core<'a, const A: usize> {
    axes: &'a [&'a Axis],
    ks: &'a [&'a [u8]],
    /// How far the neighbour along each axis is.
    steps: &'a [usize],
    known: &'a mut [i32],
    index: &'a mut [usize],
    /// Whether the node has a mode without a basis.
    whole: bool,
}

impl<'a, const A: usize> Core<'a, A> {
    const BORDER: usize = if A > 0 { 1 } else { 0 };

    fn new(axes: &'a [&'a Axis], ks: &'a [&'a [u8]], scratch: &'a mut Scratch, whole: bool) -> Self {
        let Scratch { known, steps, index, .. } = scratch;
        steps.clear();
        let mut step = 1;
        for axis in axes.iter().rev() {
            steps.push(step);
            step *= axis.size + Self::BORDER;
        }
        steps.reverse();
        known.clear();
        known.resize(step, 0);
        index.clear();
        index.resize(axes.len(), 0);
        Core { axes, ks, steps, known, index, whole }
    }

    fn code<C: Coder>(mut self, models: &mut Models, coder: &mut C, base: i32, core: &mut [i32]) -> Checked<()> {
        let outer = self.axes.len() - 1;
        for row in core.chunks_exact_mut(self.axes[outer].size) {
            let at: usize = self.index.iter().zip(self.steps).map(|(i, step)| (i + Self::BORDER) * step).sum();
            let ks = self.ks.iter().zip(&*self.index).take(outer);
            let t = base + ks.map(|(ks, &i)| i32::from(ks.get(i).copied().unwrap_or(0))).sum::<i32>();
            if !self.whole {
                self.row(models, coder, (at, t), row, |coder, _, _, negative| coder.raw(1, u32::from(negative)) != 0)?;
            } else {
                self.signed_row(models, coder, (at, t), row)?;
            }
            for a in (0..outer).rev() {
                self.index[a] += 1;
                if self.index[a] < self.axes[a].size {
                    break;
                }
                self.index[a] = 0;
            }
        }
        Ok(())
    }

    /// A row of a core with neighbours along axes without a basis, whose signs those of its numbers go with.
    fn signed_row<C: Coder>(
        &mut self,
        models: &mut Models,
        coder: &mut C,
        at: (usize, i32),
        row: &mut [i32],
    ) -> Checked<()> {
        let order = sign_axes(self.axes);
        // Along the row's own axis the first number has no neighbour; then the next axis takes its place.
        let there = |first: bool| -> [usize; 2] {
            let last = self.axes.len() - 1;
            let exists = |a: &usize| if *a == last { !first } else { self.index[*a] > 0 };
            let mut found = order.iter().copied().filter(exists).map(|a| self.steps[a]);
            [found.next().unwrap_or(0), found.next().unwrap_or(0)]
        };
        let (first, later, start) = (there(true), there(false), at.0);
        self.row(models, coder, at, row, |coder, (known, model), here, negative| {
            let steps = if here == start { first } else { later };
            let sign = |step: usize| if step == 0 { 1 } else { sign_of(known[here - step]) };
            coder.even_bit(&mut model[(3 * sign(steps[0]) + sign(steps[1])).min(8)], negative)
        })
    }

    /// How far the neighbours of a row along other axes are.
    fn present(&self) -> Vec<usize> {
        let outer = self.index.iter().zip(self.steps).take(self.axes.len() - 1);
        outer.filter(|(index, _)| **index > 0).map(|(_, &step)| step).collect()
    }

    #[inline(always)]
    fn row<C: Coder>(
        &mut self,
        models: &mut Models,
        coder: &mut C,
        (start, t): (usize, i32),
        row: &mut [i32],
        negative: impl Fn(&mut C, (&[i32], &mut [Model; 9]), usize, bool) -> bool,
    ) -> Checked<()> {
        let last = self.axes.len() - 1;
        let present: Vec<usize> = if A == 0 { self.present() } else { vec![] };
        let ks = self.ks[last];
        let common = Size::of_core(t);
        for (j, number) in row.iter_mut().enumerate() {
            let here = start + j;
            let size = ks.get(j).map_or(common, |&k| Size::of_core(t + i32::from(k)));
            let sum =
                |steps: &[usize]| -> u32 { steps.iter().map(|step| self.known[here - step].unsigned_abs()).sum() };
            let around = match A {
                0 => sum(&present) + if j > 0 { sum(&[1]) } else { 0 },
                _ => sum(&self.steps[..A]),
            };
            let magnitude = models.core.code(coder, size, around, number.unsigned_abs())?;
            if magnitude > 0 {
                let known = (&*self.known, &mut models.core_sign);
                *number = signed(magnitude as i32, negative(coder, known, here, *number < 0));
                self.known[here] = *number;
            }
        }
        Ok(())
    }
}
