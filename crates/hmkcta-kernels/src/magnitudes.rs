//! How large numbers are: the sum of their squares, the largest magnitude, the smallest but zero.

use crate::guard;
use crate::machine::dispatch;
use numpy::PyReadonlyArray1;
use pulp::{Simd, WithSimd};
use pyo3::prelude::*;

/// Sums side by side, whatever the machine: they come out alike.
const LANES: usize = 32;

/// The sum of squares in float64, which is not finite if a number is not; the largest magnitude, and the smallest but
/// zero, infinite if there is none.
#[pyfunction]
pub fn magnitudes(py: Python, values: PyReadonlyArray1<f32>) -> PyResult<(f64, f32, f32)> {
    let values = values.as_slice()?;
    guard::run(py, || dispatch(Values(values)))
}

struct Values<'a>(&'a [f32]);

impl WithSimd for Values<'_> {
    type Output = (f64, f32, f32);

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let (mut squares, mut largest, mut smallest) = ([0f64; LANES], [0f32; LANES], [f32::INFINITY; LANES]);
        let mut add = |lane: usize, value: f32| {
            let (wide, size) = (f64::from(value), value.abs());
            squares[lane] += wide * wide;
            largest[lane] = if size > largest[lane] { size } else { largest[lane] };
            let size = if size > 0.0 { size } else { f32::INFINITY };
            smallest[lane] = if size < smallest[lane] { size } else { smallest[lane] };
        };
        let (whole, rest) = self.0.as_chunks::<LANES>();
        for chunk in whole {
            for (lane, &value) in chunk.iter().enumerate() {
                add(lane, value);
            }
        }
        for (lane, &value) in rest.iter().enumerate() {
            add(lane, value);
        }
        (
            squares.iter().sum(),
            largest.into_iter().fold(0.0, f32::max),
            smallest.into_iter().fold(f32::INFINITY, f32::min),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;

    #[test]
    fn all_machines_agree_with_the_definition() {
        let values: Vec<f32> = (0..1003).map(|i| ((i * 7919) % 2001 - 1000) as f32 / 8.0).collect();
        let squares: f64 = values.iter().map(|&value| f64::from(value) * f64::from(value)).sum();
        on_all_machines(|| assert_eq!(dispatch(Values(&values)), (squares, 125.0, 0.125)));
        on_all_machines(|| assert_eq!(dispatch(Values(&[0.0; 40])), (0.0, 0.0, f32::INFINITY)));
        on_all_machines(|| assert!(dispatch(Values(&[1.0, f32::NAN, 2.0])).0.is_nan()));
    }
}
