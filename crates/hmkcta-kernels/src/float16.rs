//! Whole numbers as the float16 numbers that decoders work on (`docs/format.md`, widening).

use crate::contexts::MOST_K;

/// The largest magnitude that float16 holds exactly with all below it, but for one.
const MOST_EXACT: u32 = 2047;

/// The bits of the nearest float16 number; of two as near, the even one.
#[inline(always)]
pub fn half_bits(number: f32) -> u16 {
    let bits = number.to_bits();
    let (sign, rest) = ((bits >> 16 & 0x8000) as u16, bits & 0x7FFF_FFFF);
    if rest >= 0x4780_0000 {
        return sign | 0x7C00;
    }
    if rest < 0x3880_0000 {
        // Subnormal: 2^-24 becomes the last bit of a float32 number, which rounds.
        let rounded = f32::from_bits(rest) + 0.5;
        return sign | (rounded.to_bits() - 0.5_f32.to_bits()) as u16;
    }
    let odd = rest >> 13 & 1;
    sign | ((rest - 0x3800_0000 + 0x0FFF + odd) >> 13) as u16
}

/// What a unit of a column of each k stands for: 2^(-k/2).
pub fn units() -> [f32; MOST_K as usize + 1] {
    std::array::from_fn(|k| {
        let half = if k % 2 == 0 { 1.0 } else { std::f32::consts::FRAC_1_SQRT_2 };
        half * f32::from_bits((127 - k as u32 / 2) << 23)
    })
}

/// e: how many times core numbers are halved, so that float16 holds the largest one nearly as it is.
pub fn halvings(largest: u32) -> u32 {
    let mut e = 0;
    while u64::from(largest) > u64::from(MOST_EXACT) << e {
        e += 1;
    }
    e
}

/// 2^-e.
pub fn halved(e: u32) -> f32 {
    f32::from_bits((127 - e) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::Real;

    #[test]
    fn every_half_comes_back_and_neighbours_round_to_even() {
        for bits in 0..0x7C00_u16 {
            let number = f32::widen(bits);
            assert_eq!((half_bits(number), half_bits(-number)), (bits, bits | 0x8000));
            if bits < 0x7BFF {
                let next = f32::widen(bits + 1);
                let between = (number + next) / 2.0;
                assert_eq!(half_bits(between), bits + (bits & 1));
                assert_eq!(half_bits(f32::from_bits(between.to_bits() + 1)), bits + 1);
                assert_eq!(half_bits(f32::from_bits(between.to_bits() - 1)), bits);
            }
        }
        assert_eq!(half_bits(1e30), 0x7C00);
        assert_eq!(half_bits(65520.0), 0x7C00);
        assert_eq!(half_bits(65519.9), 0x7BFF);
    }

    #[test]
    fn large_cores_are_halved() {
        assert_eq!([0, 2047, 2048, 4094, 4095, (1 << 24) - 1].map(halvings), [0, 0, 1, 1, 2, 14]);
    }
}
