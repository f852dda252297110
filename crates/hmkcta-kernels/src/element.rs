//! The value a node adds to single elements (`docs/format.md`, section 7).
//!
//! Where many elements of a node are asked for, its numbers are widened from float16 once; else what an element needs is
//! widened for it. Either way the sums are the same, bit by bit.

use crate::lanes::{Lanes, Plain};
use crate::layout::{BESIDE, CORE, INNER, LANES, Layout, MID, OUTER, VECTOR};
use crate::machine::dispatch;
use crate::packed::{NodeView, Position};
use crate::real::Real;
use crate::steps::{Offsets, Steps};
use crate::threads::room;
use crate::widened::{Picked, Source, Tables, Widened};
use pulp::{Simd, WithSimd};

/// Most numbers of a node that are widened at once, which bounds memory.
const MOST_WIDENED: usize = 1 << 24;
/// Elements whose choices are found together, as each is a chain of steps that wait for one another; fewer where they
/// have more choices than this, which the level 1 cache holds.
const TOGETHER: usize = 8;
const CHOICES: usize = 1 << 10;
/// Widening numbers one after the other costs so many times less than picking them.
const IN_BULK: usize = 8;

/// Buffers kept from one node to the next.
#[derive(Default)]
pub struct Elements<T> {
    tables: Tables<T>,
    outer: Vec<T>,
    choices: Vec<u32>,
}

impl<T: Decode> Elements<T> {
    /// Add the node's part to `values` of the elements at row positions `pos`.
    pub fn add(&mut self, node: &NodeView, pos: &[Position], values: &mut [T]) -> Result<(), String> {
        let layout = Layout::new(node);
        let picked = values.len() * node.choices() * (layout.block() + 4 * layout.free.len());
        let numbers = node.numbers();
        let widened = numbers <= MOST_WIDENED && numbers <= IN_BULK * picked;
        dispatch(Task { node, layout: &layout, pos, values, buffers: self, widened })
    }
}

/// The types decoding computes in.
pub trait Decode: Real {
    /// Run a task with the loops for the ranks at hand.
    fn run<S: Simd>(task: Task<Self>, simd: S) -> Result<(), String>;
}

/// One call of `add`, for the instruction set to be chosen.
pub struct Task<'t, T> {
    node: &'t NodeView<'t>,
    layout: &'t Layout,
    pos: &'t [Position],
    values: &'t mut [T],
    buffers: &'t mut Elements<T>,
    widened: bool,
}

impl<T: Decode> WithSimd for Task<'_, T> {
    type Output = Result<(), String>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        T::run(self, simd)
    }
}

impl Decode for f64 {
    #[inline(always)]
    fn run<S: Simd>(task: Task<f64>, _: S) -> Result<(), String> {
        task.plain::<S>()
    }
}

impl Decode for f32 {
    /// The ranks of the paper's configurations have unrolled loops.
    #[inline(always)]
    fn run<S: Simd>(task: Task<f32>, _: S) -> Result<(), String> {
        #[cfg(target_arch = "x86_64")]
        if S::F32_LANES > 4
            && let Some(v3) = pulp::x86::V3::try_new()
        {
            let machine = crate::lanes::Fused(v3);
            return match (task.layout.width, task.layout.beside, task.unrolled()) {
                (8, true, [1, 2, 3]) => task.run::<_, 8, 8, true, 1, 2, 3>(machine),
                (8, true, [1, 2, 2]) => task.run::<_, 8, 8, true, 1, 2, 2>(machine),
                (8, true, _) => task.run::<_, 8, 8, true, 0, 0, 0>(machine),
                (8, false, [4, 4, 6]) => task.run::<_, 8, 8, false, 4, 4, 6>(machine),
                (8, false, _) => task.run::<_, 8, 8, false, 0, 0, 0>(machine),
                (4, _, [1, ..]) => task.run::<_, 4, 8, false, 1, 0, 0>(machine),
                (4, ..) => task.run::<_, 4, 8, false, 0, 0, 0>(machine),
                _ => task.run::<_, LANES, LANES, false, 0, 0, 0>(Plain::<true>),
            };
        }
        task.plain::<S>()
    }
}

impl<T: Real> Task<'_, T> {
    /// The ranks of the loops, where each stands for one mode and the first for none if it is 1; else zeros.
    #[cfg(target_arch = "x86_64")]
    fn unrolled(&self) -> [usize; 3] {
        let Layout { slots, more, ranks, .. } = self.layout;
        if more.is_empty() && slots.contains(&OUTER) == (ranks[0] > 1) { *ranks } else { [0; 3] }
    }

    #[inline(always)]
    fn plain<S: Simd>(self) -> Result<(), String> {
        // All machines of more than four lanes fuse, and so does NEON.
        if S::F32_LANES > 4 || cfg!(target_arch = "aarch64") {
            self.by_width(Plain::<true>)
        } else {
            self.by_width(Plain::<false>)
        }
    }

    #[inline(always)]
    fn by_width<const FUSED: bool>(self, machine: Plain<FUSED>) -> Result<(), String> {
        match (self.layout.width, self.layout.beside) {
            (4, _) => self.run::<_, 4, 8, false, 0, 0, 0>(machine),
            (8, true) => self.run::<_, 8, 8, true, 0, 0, 0>(machine),
            (8, false) => self.run::<_, 8, 8, false, 0, 0, 0>(machine),
            _ => self.run::<_, LANES, LANES, false, 0, 0, 0>(machine),
        }
    }

    /// `P` lanes, `W` slots, `TWO` modes along the lanes or one; `A`, `B`, `C`: the ranks of `unrolled`, or 0.
    #[inline(always)]
    fn run<
        M: Lanes<T, P>,
        const P: usize,
        const W: usize,
        const TWO: bool,
        const A: usize,
        const B: usize,
        const C: usize,
    >(
        self,
        machine: M,
    ) -> Result<(), String> {
        let Task { node, layout, pos, values, buffers, widened } = self;
        let Elements { tables, outer, choices } = buffers;
        let unrolled = [(A, layout.ranks[0]), (B, layout.ranks[1]), (C, layout.ranks[2])];
        assert!(unrolled.iter().all(|&(known, rank)| known == 0 || known == rank));
        assert!(if P < LANES { layout.width == P } else { layout.width.is_multiple_of(P) });
        assert!(
            layout.beside == TWO && (A != 1 || !layout.slots.contains(&OUTER)) && (A == 0 || layout.more.is_empty())
        );
        let ranks = unrolled.map(|(known, rank)| if known > 0 { known } else { rank });
        let width = if P < LANES { P } else { layout.width };
        let together = (CHOICES / node.choices()).clamp(1, TOGETHER);
        let (choices, _) = room(choices, together * node.choices() * W).as_chunks_mut::<W>();
        let sums = Sums { node, layout, pos, values, choices, outer, ranks, width };
        if widened {
            sums.add::<_, M, P, TWO, A>(Widened::new(node, layout, tables), machine)
        } else {
            sums.add::<_, M, P, TWO, A>(Picked::new(node, layout, tables), machine)
        }
    }
}

/// Elements of one node and where their values are summed up.
struct Sums<'t, T, const W: usize> {
    node: &'t NodeView<'t>,
    layout: &'t Layout,
    pos: &'t [Position],
    values: &'t mut [T],
    choices: &'t mut [Offsets<W>],
    outer: &'t mut Vec<T>,
    ranks: [usize; 3],
    width: usize,
}

impl<T: Real, const W: usize> Sums<'_, T, W> {
    #[inline(always)]
    fn add<Q: Source<T>, M: Lanes<T, P>, const P: usize, const TWO: bool, const A: usize>(
        self,
        mut source: Q,
        machine: M,
    ) -> Result<(), String> {
        let Sums { node, layout, pos, values, choices, outer, ranks, width } = self;
        let (steps, more) = (Steps::<W>::new(node, layout, source.addresses()), layout.more.as_slice());
        let together = choices.len() / node.choices();
        for (pos, values) in pos.chunks(together).zip(values.chunks_mut(together)) {
            for (pos, choices) in pos.iter().zip(choices.chunks_exact_mut(node.choices())) {
                steps.choices(pos, choices)?;
            }
            for (value, choices) in values.iter_mut().zip(choices.chunks_exact(node.choices())) {
                let mut lanes = machine.splat(T::ZERO);
                for choice in choices {
                    // SAFETY: `choice` is one of this element's; blocks and rows are as long as `layout` says, which
                    // `ranks` and `width` have been compared with.
                    unsafe {
                        source.choose(choice);
                        let outer = match A {
                            1 => None,
                            0 if !more.is_empty() => Some(products(&source, more, choice, outer)),
                            _ => Some(source.numbers(OUTER, choice)),
                        };
                        let cell = Cell {
                            block: source.numbers(CORE, choice),
                            outer,
                            mid: source.numbers(MID, choice),
                            inner: source.numbers(INNER, choice),
                            beside: if TWO { Some(source.numbers(BESIDE, choice)) } else { None },
                            last: source.numbers(VECTOR, choice),
                            ranks,
                            width,
                        };
                        lanes = cell.add(machine, lanes);
                    }
                }
                *value = *value + total(machine.array(lanes));
            }
        }
        Ok(())
    }
}

/// All products of one number of each row, the last row's fastest; rows are given by slot and length.
///
/// # Safety
/// The choice is one the source has been turned to, and its rows have these lengths.
#[inline(never)]
unsafe fn products<T: Real, const W: usize>(
    source: &impl Source<T>,
    rows: &[(usize, usize)],
    choice: &Offsets<W>,
    all: &mut Vec<T>,
) -> *const T {
    all.clear();
    all.push(T::ONE);
    for &(slot, rank) in rows {
        // SAFETY: as promised by the caller.
        let row = unsafe { std::slice::from_raw_parts(source.numbers(slot, choice), rank) };
        let before = all.len();
        for at in 0..before {
            let weight = all[at];
            all.extend(row.iter().map(|&u| weight * u));
        }
        all.drain(..before);
    }
    all.as_ptr()
}

#[inline(always)]
fn total<T: Real, const P: usize>(mut lanes: [T; P]) -> T {
    let mut half = P / 2;
    while half > 0 {
        for l in 0..half {
            lanes[l] = lanes[l] + lanes[l + half];
        }
        half /= 2;
    }
    lanes[0]
}

/// One cluster's core `[outer, mid, inner, width]`, scaled, and the basis rows of one element.
struct Cell<T> {
    block: *const T,
    outer: Option<*const T>,
    mid: *const T,
    inner: *const T,
    beside: Option<*const T>,
    last: *const T,
    ranks: [usize; 3],
    width: usize,
}

impl<T: Real> Cell<T> {
    /// `lanes + core x_1 u_1 .. x_N u_N`, left to be summed over the lanes.
    ///
    /// # Safety
    /// The pointers are good for as many numbers as `ranks` and `width` say; without an outer row its rank is 1.
    #[inline(always)]
    unsafe fn add<M: Lanes<T, P>, const P: usize>(&self, m: M, mut lanes: M::Vector) -> M::Vector {
        for from in (0..self.width).step_by(P) {
            let mut sum = m.splat(T::ZERO);
            let mut line = from;
            for a in 0..self.ranks[0] {
                let mut of_mid = m.splat(T::ZERO);
                for b in 0..self.ranks[1] {
                    let mut of_inner = m.splat(T::ZERO);
                    for c in 0..self.ranks[2] {
                        // SAFETY: as the caller promises, here and below.
                        let (weight, numbers) = unsafe { (*self.inner.add(c), m.load(self.block.add(line))) };
                        of_inner = m.multiply_add(m.splat(weight), numbers, of_inner);
                        line += self.width;
                    }
                    // SAFETY: as above.
                    of_mid = m.multiply_add(m.splat(unsafe { *self.mid.add(b) }), of_inner, of_mid);
                }
                sum = match self.outer {
                    // SAFETY: as above.
                    Some(outer) => m.multiply_add(m.splat(unsafe { *outer.add(a) }), of_mid, sum),
                    None => of_mid,
                };
            }
            let last = match self.beside {
                // SAFETY: as above.
                Some(beside) => unsafe { m.products(beside, self.last) },
                // SAFETY: as above.
                None => unsafe { m.load(self.last.add(from)) },
            };
            lanes = m.multiply_add(sum, last, lanes);
        }
        lanes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::packed::MOST_MODES;
    use crate::testing::close;

    /// Float16 numbers between 0.25 and 1 of either sign.
    fn bits(count: usize, seed: usize) -> Vec<u16> {
        (0..count)
            .map(|i| 0x3400 + ((i * 7919 + seed * 104_729) % 2048) as u16 + (((i * i + seed) % 2) << 15) as u16)
            .collect()
    }

    #[test]
    fn all_machines_and_both_sources_agree() {
        on_all_machines(compare);
    }

    fn compare() {
        // Ranks with unrolled loops where one mode and where two run along the lanes, without, beyond one vector; and
        // many modes, then so many that offsets take two vectors.
        let unrolled = [vec![4, 4, 6, 6], vec![2, 2, 3, 3], vec![2, 2, 2, 2], vec![1, 4], vec![3, 2]];
        let looped = [vec![3, 5, 2], vec![3, 3, 4], vec![20], vec![2, 2, 1, 2, 3], vec![1, 2, 1, 2, 1, 2, 2]];
        for ranks in unrolled.into_iter().chain(looped) {
            let order = ranks.len();
            let mut node = NodeView {
                order,
                clusters: [1; MOST_MODES],
                mixture: [1; MOST_MODES],
                ranks: [1; MOST_MODES],
                rows: [0; MOST_MODES],
                core: &[],
                scale: &[],
                cluster: [&[]; MOST_MODES],
                basis: [&[]; MOST_MODES],
                decomposed: [false; MOST_MODES],
            };
            for (n, &rank) in ranks.iter().enumerate() {
                (node.clusters[n], node.mixture[n], node.ranks[n]) = (2, 2, rank);
                (node.rows[n], node.decomposed[n]) = (3, true);
            }
            let core = bits(node.cells() * node.core_size(), 1);
            let bases: Vec<Vec<u16>> = (0..order).map(|n| bits(3 * 2 * node.others(n) * ranks[n], n + 2)).collect();
            let scale = vec![0.5; node.cells()];
            (node.core, node.scale) = (&core, &scale);
            for (n, basis) in bases.iter().enumerate() {
                (node.cluster[n], node.basis[n]) = (&[0, 1, 0, 1, 0, 1], basis);
            }
            let pos: Vec<Position> = (0..40).map(|i| std::array::from_fn(|n| (i * order + n) as u32 * 7 % 3)).collect();
            let (mut wide, mut narrow, mut alone) = (vec![0.0f64; 40], vec![0.0f32; 40], vec![0.0f32; 1]);
            Elements::default().add(&node, &pos, &mut wide).unwrap();
            Elements::default().add(&node, &pos, &mut narrow).unwrap();
            Elements::default().add(&node, &pos[..1], &mut alone).unwrap();
            assert_eq!(alone[0], narrow[0]);
            let largest = wide.iter().fold(1.0f64, |most, x| most.max(x.abs()));
            wide.iter().zip(&narrow).for_each(|(&x, &y)| close((f64::from(y) / largest) as f32, x / largest));
            assert!(Elements::default().add(&node, &[[9, 0, 0, 0, 0, 0, 0, 0]], &mut alone).is_err());
        }
    }
}
