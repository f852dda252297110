//! Vectors whose lanes are filled from neighbours in any order: arrays, and on x86 registers.

use crate::leading::PAD;

/// In an order, this lane is filled; the bits below say from which number.
pub const FILLED: u32 = 1 << 31;

/// Which number each lane is filled from; the others are zero.
pub type Order = [u32; PAD];

/// Some numbers side by side.
pub trait Shuffle: Copy {
    const LANES: usize = size_of::<Self>() / size_of::<f32>();

    /// # Safety
    /// The machine has such vectors, here and below, and `from` points to `LANES` numbers.
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        // SAFETY: as the caller promises.
        unsafe { from.cast::<Self>().read_unaligned() }
    }

    /// # Safety
    /// `to` points to `LANES` numbers.
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        // SAFETY: as the caller promises.
        unsafe { to.cast::<Self>().write_unaligned(self) }
    }

    /// # Safety
    /// `from` points to `LANES` numbers, whatever the order.
    unsafe fn add_shuffled(self, order: &Order, from: *const f32) -> Self;

    /// The same of an order that fills all lanes, whether it says `FILLED` or not, each number times a factor.
    ///
    /// # Safety
    /// `from` points to `LANES` numbers, whatever the order.
    unsafe fn multiply_add_shuffled(self, order: &Order, from: *const f32, factors: Self) -> Self;
}

impl Shuffle for [f32; 4] {
    #[inline(always)]
    unsafe fn add_shuffled(self, order: &Order, from: *const f32) -> Self {
        // SAFETY: as the caller promises.
        let numbers = unsafe { Self::load(from) };
        std::array::from_fn(|l| self[l] + if order[l] < FILLED { 0.0 } else { numbers[order[l] as usize % 4] })
    }

    #[inline(always)]
    unsafe fn multiply_add_shuffled(self, order: &Order, from: *const f32, factors: Self) -> Self {
        // SAFETY: as the caller promises.
        let numbers = unsafe { Self::load(from) };
        std::array::from_fn(|l| self[l] + numbers[order[l] as usize % 4] * factors[l])
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{Order, Shuffle};
    use std::arch::x86_64::*;

    /// AVX2.
    impl Shuffle for __m256 {
        #[inline(always)]
        unsafe fn add_shuffled(self, order: &Order, from: *const f32) -> Self {
            // SAFETY: the machine has these vectors, and `from` a vector of numbers, as the caller promises.
            unsafe {
                let order = _mm256_loadu_si256(order.as_ptr().cast());
                let numbers = _mm256_permutevar8x32_ps(Self::load(from), order);
                _mm256_add_ps(self, _mm256_and_ps(numbers, _mm256_castsi256_ps(_mm256_srai_epi32::<31>(order))))
            }
        }

        #[inline(always)]
        unsafe fn multiply_add_shuffled(self, order: &Order, from: *const f32, factors: Self) -> Self {
            // SAFETY: the machine has these vectors, and `from` a vector of numbers, as the caller promises.
            unsafe {
                let order = _mm256_loadu_si256(order.as_ptr().cast());
                _mm256_fmadd_ps(_mm256_permutevar8x32_ps(Self::load(from), order), factors, self)
            }
        }
    }

    /// AVX-512.
    impl Shuffle for __m512 {
        #[inline(always)]
        unsafe fn add_shuffled(self, order: &Order, from: *const f32) -> Self {
            // SAFETY: the machine has these vectors, and `from` a vector of numbers, as the caller promises.
            unsafe {
                let order = _mm512_loadu_si512(order.as_ptr().cast());
                let filled = _mm512_movepi32_mask(order);
                _mm512_add_ps(self, _mm512_maskz_permutexvar_ps(filled, order, Self::load(from)))
            }
        }

        #[inline(always)]
        unsafe fn multiply_add_shuffled(self, order: &Order, from: *const f32, factors: Self) -> Self {
            // SAFETY: the machine has these vectors, and `from` a vector of numbers, as the caller promises.
            unsafe {
                let order = _mm512_loadu_si512(order.as_ptr().cast());
                _mm512_fmadd_ps(_mm512_permutexvar_ps(order, Self::load(from)), factors, self)
            }
        }
    }
}
