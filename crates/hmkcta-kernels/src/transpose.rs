//! Rows of numbers turned into columns: what lanes are gathered by, and scattered.

/// Rows turned over at a time.
pub const SIDE: usize = 4;

/// `to[j * step + i] = rows[i][j]`, all numbers of some rows of one length.
#[inline(always)]
pub fn turn_over(rows: [&[f32]; SIDE], to: &mut [f32], step: usize) {
    let length = rows[0].len();
    assert!(rows.iter().all(|row| row.len() == length) && (length == 0 || to.len() >= (length - 1) * step + SIDE));
    let whole = length - length % SIDE;
    for at in (0..whole).step_by(SIDE) {
        // SAFETY: rows have four numbers there, and their places in `to` lie before its end.
        unsafe {
            let columns = turn(rows.map(|row| row.as_ptr().add(at).cast()));
            for (j, column) in columns.into_iter().enumerate() {
                to.as_mut_ptr().add((at + j) * step).cast::<[f32; SIDE]>().write_unaligned(column);
            }
        }
    }
    for at in whole..length {
        to[at * step..][..SIDE].copy_from_slice(&rows.map(|row| row[at]));
    }
}

/// Four rows of four numbers as columns. Of the formula compilers make a move for each number.
///
/// # Safety
/// All pointers point to four numbers.
#[inline(always)]
unsafe fn turn(rows: [*const [f32; SIDE]; SIDE]) -> [[f32; SIDE]; SIDE] {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::*;
        // SAFETY: every x86-64 has these vectors of four numbers.
        unsafe {
            let [a, b, c, d] = rows.map(|row| _mm_loadu_ps(row.cast()));
            let (low, high) =
                ([_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d)], [_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d)]);
            let [low, high] = [low, high].map(|[ab, cd]| [_mm_movelh_ps(ab, cd), _mm_movehl_ps(cd, ab)]);
            std::mem::transmute::<[[__m128; 2]; 2], [[f32; SIDE]; SIDE]>([low, high])
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        let rows = rows.map(|row| unsafe { row.read() });
        std::array::from_fn(|i| rows.map(|row| row[i]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::numbers;

    #[test]
    fn rows_become_columns() {
        for (length, step) in [(0, 4), (1, 4), (4, 4), (11, 7), (16, 30)] {
            let rows: [Vec<f32>; SIDE] = std::array::from_fn(|i| numbers(length, i as u64));
            let mut to = vec![9.0; length * step + SIDE];
            turn_over(rows.each_ref().map(|row| row.as_slice()), &mut to, step);
            for (at, &value) in to.iter().enumerate() {
                let (j, i) = (at / step, at % step);
                assert_eq!(value, if i < SIDE && j < length { rows[i][j] } else { 9.0 });
            }
        }
    }
}
