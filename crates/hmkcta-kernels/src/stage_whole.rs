//! Whole numbers of a stage, recovered from the float16 numbers that they were widened to (`docs/format.md`, widening).

use crate::contexts::{MOST_K, MOST_MAGNITUDE};
use crate::float16::{half_bits, halved, halvings, units};
use crate::real::Real;
use crate::stage::{Geometry, Sizes, shape_of};

/// A stage with a step; vectors are indexed by mode, float16 are bits.
pub struct Widened<'a> {
    pub geometry: Geometry<'a>,
    pub step: f32,
    pub shape: &'a [u32],
    pub cluster: Vec<&'a [u16]>,
    pub column: Vec<&'a [u8]>,
    pub core: &'a [u16],
    pub scale: &'a [f32],
    pub basis: Vec<&'a [u16]>,
}

/// Whole core numbers, and whole basis numbers of each mode.
pub type Whole = (Vec<i32>, Vec<Vec<i32>>);

/// The nearest whole number that there is a code for.
fn nearest(value: f64) -> i32 {
    let most = f64::from(MOST_MAGNITUDE);
    value.round_ties_even().clamp(-most, most) as i32
}

impl Widened<'_> {
    /// All numbers, if they are what whole ones widen to; else what is not.
    pub fn whole(&self) -> Result<Whole, String> {
        let order = self.geometry.order();
        let mut at = Sizes::none(order);
        let (mut core, mut basis) = (Vec::with_capacity(self.core.len()), vec![vec![]; order]);
        for s in 0..self.geometry.nodes() {
            let shape = shape_of(self.shape, order, s);
            let own = Sizes::new(shape, self.geometry.place(s).rows);
            let begin = at.clone();
            if !at.add(&own) || !self.holds(&at) {
                return Err(format!("arrays that end before node {s} does"));
            }
            if own.cells == 0 {
                continue;
            }
            let cores = &self.core[begin.core as usize..at.core as usize];
            let scales = &self.scale[begin.cells as usize..at.cells as usize];
            whole_core(cores, scales, self.step, &mut core).ok_or_else(|| format!("core numbers of node {s}"))?;
            for n in (0..order).filter(|&n| shape[1][n] > 0) {
                self.whole_basis(shape, n, (&begin, &at), &mut basis[n])
                    .ok_or_else(|| format!("basis numbers of mode {n} of node {s}"))?;
            }
        }
        Ok((core, basis))
    }

    fn holds(&self, at: &Sizes) -> bool {
        let of_mode = |n: usize| {
            let own = at.modes[n];
            own.cluster <= self.cluster[n].len() as u64
                && own.column <= self.column[n].len() as u64
                && own.basis <= self.basis[n].len() as u64
        };
        at.core <= self.core.len() as u64 && at.cells <= self.scale.len() as u64 && (0..at.modes.len()).all(of_mode)
    }

    fn whole_basis(
        &self,
        shape: [&[u32]; 3],
        n: usize,
        (from, to): (&Sizes, &Sizes),
        out: &mut Vec<i32>,
    ) -> Option<()> {
        let (from, to) = (from.modes[n], to.modes[n]);
        let units = units();
        let column = &self.column[n][from.column as usize..to.column as usize];
        let basis = &self.basis[n][from.basis as usize..to.basis as usize];
        let clusters = &self.cluster[n][from.cluster as usize..to.cluster as usize];
        let rank = shape[2][n] as usize;
        let inner: usize = shape[0][n + 1..].iter().map(|&c| c as usize).product();
        let outer: usize = shape[0][..n].iter().map(|&c| c as usize).product();
        let own = shape[0][n] as usize;
        for (&cluster, of_row) in clusters.iter().zip(basis.chunks_exact(outer * inner * rank)) {
            for (other, bits) in of_row.chunks_exact(rank).enumerate() {
                let cell = (other / inner * own + usize::from(cluster)) * inner + other % inner;
                for (&k, &bits) in column.get(cell * rank..(cell + 1) * rank)?.iter().zip(bits) {
                    let unit = units[usize::from(k.min(MOST_K))];
                    let number = f32::widen(bits);
                    let whole = nearest(f64::from(number) / f64::from(unit));
                    let again = f32::widen(half_bits(whole as f32 * unit));
                    if again != number || k > MOST_K {
                        return None;
                    }
                    out.push(whole);
                }
            }
        }
        Some(())
    }
}

fn whole_core(core: &[u16], scales: &[f32], step: f32, out: &mut Vec<i32>) -> Option<()> {
    let start = out.len();
    let numbers = || core.iter().map(|&bits| f32::widen(bits));
    if numbers().all(|number| number == 0.0) {
        out.resize(start + core.len(), 0);
        return Some(());
    }
    let first = *scales.first()?;
    let e = (0..15).find(|&e| step * (1_u32 << e) as f32 == first)?;
    if scales.iter().any(|&scale| scale != first) {
        return None;
    }
    let times = f64::from(1_u32 << e);
    out.extend(numbers().map(|number| nearest(f64::from(number) * times)));
    let again = halvings(out[start..].iter().map(|q| q.unsigned_abs()).max()?);
    let value = |&q: &i32| f64::from(f32::widen(half_bits(q as f32 * halved(again)))) * f64::from(1_u32 << again);
    out[start..].iter().zip(numbers()).all(|(q, number)| value(q) == f64::from(number) * times).then_some(())
}
