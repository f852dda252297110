//! The two float types decoding computes in, and float16 as the file stores it.

use std::ops::{Add, Mul};

/// float32 or float64.
pub trait Real: Copy + Default + Send + Sync + Add<Output = Self> + Mul<Output = Self> + 'static {
    const ZERO: Self;
    const ONE: Self;

    fn from_f32(x: f32) -> Self;

    /// `self * b + c`, rounded once where `FUSED` says that the machine does so in one step.
    fn mul_add<const FUSED: bool>(self, b: Self, c: Self) -> Self;

    /// The value of a float16, exactly.
    #[inline(always)]
    fn widen(bits: u16) -> Self {
        Self::from_f32(widen(bits))
    }
}

macro_rules! real {
    ($type:ty) => {
        impl Real for $type {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[inline(always)]
            fn from_f32(x: f32) -> Self {
                Self::from(x)
            }

            #[inline(always)]
            fn mul_add<const FUSED: bool>(self, b: Self, c: Self) -> Self {
                if FUSED { <$type>::mul_add(self, b, c) } else { self * b + c }
            }
        }
    };
}

real!(f32);
real!(f64);

/// The value of a float16, without branches, so that the compiler does many at a time on every machine.
#[inline(always)]
fn widen(bits: u16) -> f32 {
    const REBIAS: u32 = (127 - 15) << 23;
    let sign = u32::from(bits & 0x8000) << 16;
    let rest = u32::from(bits & 0x7fff);
    let normal = (rest << 13) + REBIAS;
    // Infinity and NaN keep their largest exponent; subnormal numbers are multiples of 2^-24.
    let special = normal + REBIAS;
    let subnormal = (rest as i32 as f32 * 2f32.powi(-24)).to_bits();
    let magnitude = if rest < 0x400 { subnormal } else { normal };
    f32::from_bits(sign | if rest >= 0x7c00 { special } else { magnitude })
}

/// Widen as many float16 as both slices have.
#[inline(always)]
pub fn widen_all<T: Real>(from: &[u16], to: &mut [T]) {
    for (to, &bits) in to.iter_mut().zip(from) {
        *to = T::widen(bits);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_float16_is_widened_exactly() {
        for bits in 0..=u16::MAX {
            let (sign, exponent, fraction) = (bits >> 15, i32::from(bits >> 10 & 31), f64::from(bits & 1023));
            let size = match exponent {
                0 => fraction * 2f64.powi(-24),
                31 => f64::INFINITY,
                _ => (1024.0 + fraction) * 2f64.powi(exponent - 25),
            };
            let expected = if sign == 1 { -size } else { size };
            if exponent == 31 && fraction > 0.0 {
                assert!(f64::widen(bits).is_nan());
            } else {
                assert_eq!(f64::widen(bits), expected);
                assert_eq!(f32::widen(bits).is_sign_negative(), sign == 1);
            }
        }
    }
}
