//! The columns of a cell's bases in a coded run.

use crate::contexts::{Checked, Models, Size, sign_of, signed};
use crate::range_coder::Coder;
use crate::run_node::Port;

/// Twice the logarithm of a length, rounded.
pub fn length_log(length: usize) -> i32 {
    let square = (length as u128).pow(2);
    let below = square.ilog2();
    (below + u32::from(square * square >= 1 << (2 * below + 1))) as i32
}

/// Columns of a cell's basis.
pub struct Column<'a> {
    pub n: usize,
    pub places: &'a [u32],
    /// PC_-n and where the cell is among these.
    pub others: (usize, usize),
    pub ranks: usize,
    pub extent: Option<usize>,
}

impl Column<'_> {
    pub fn code<C: Coder>(
        &self,
        models: &mut Models,
        coder: &mut C,
        r: usize,
        k: u8,
        port: &mut impl Port,
        known: &mut Vec<i32>,
    ) -> Checked<()> {
        let size = Size::of_basis(i32::from(k) - length_log(self.places.len()));
        match self.extent {
            None => self.along::<C>(models, coder, size, (r, k), port),
            Some(extent) => self.across(models, coder, size, (r, k), port, known, extent),
        }
    }

    #[inline(always)]
    fn address(&self, place: u32, r: usize) -> usize {
        (place as usize * self.others.0 + self.others.1) * self.ranks + r
    }

    /// Rows one after the other.
    fn along<C: Coder>(
        &self,
        models: &mut Models,
        coder: &mut C,
        size: Size,
        (r, k): (usize, u8),
        port: &mut impl Port,
    ) -> Checked<()> {
        let (mut around, mut last, mut signs) = (0, None, 4);
        for &place in self.places {
            let at = self.address(place, r);
            let given = if C::DECODES { 0 } else { port.take(self.n, at) };
            let number = basis_number(models, coder, size, (around, signs), given)?;
            port.put(self.n, at, number, k);
            let magnitude = number.unsigned_abs();
            // Of the second row both neighbours are the first.
            around = magnitude + last.unwrap_or(magnitude);
            last = Some(magnitude);
            signs = 3 * sign_of(number) + signs / 3;
        }
        Ok(())
    }

    /// Rows of several extents, `extent` being the last one.
    #[allow(clippy::too_many_arguments, reason = "as of the other order of rows, and where its neighbours are")]
    fn across<C: Coder>(
        &self,
        models: &mut Models,
        coder: &mut C,
        size: Size,
        (r, k): (usize, u8),
        port: &mut impl Port,
        known: &mut Vec<i32>,
        extent: usize,
    ) -> Checked<()> {
        known.clear();
        known.resize(self.places.len(), 0);
        let mut along = 0;
        for (i, &place) in self.places.iter().enumerate() {
            let at = self.address(place, r);
            let left = (along > 0).then(|| known[i - 1]);
            let above = (i >= extent).then(|| known[i - extent]);
            let (a, b) = (left.or(above).unwrap_or(0), above.or(left).unwrap_or(0));
            let signs = 3 * sign_of(left.unwrap_or(0)) + sign_of(above.unwrap_or(0));
            along = if along + 1 == extent { 0 } else { along + 1 };
            let given = if C::DECODES { 0 } else { port.take(self.n, at) };
            let number = basis_number(models, coder, size, (a.unsigned_abs() + b.unsigned_abs(), signs), given)?;
            port.put(self.n, at, number, k);
            known[i] = number;
        }
        Ok(())
    }
}

/// A number of a basis; the sum of its neighbours' magnitudes, and their signs.
#[inline(always)]
fn basis_number<C: Coder>(
    models: &mut Models,
    coder: &mut C,
    size: Size,
    (around, signs): (u32, usize),
    given: i32,
) -> Checked<i32> {
    let magnitude = models.basis.code(coder, size, around, given.unsigned_abs())? as i32;
    if magnitude == 0 {
        return Ok(0);
    }
    let model = &mut models.basis_sign[signs.min(8)][(size.class.min(63) >> 2) as usize & 15];
    Ok(signed(magnitude, coder.even_bit(model, given < 0)))
}
