//! A few numbers side by side: arrays that the compiler vectorises, and on x86 with FMA the registers themselves, because
//! it tears arrays of four apart.

use crate::real::Real;

/// `P` numbers that are worked on together.
pub trait Lanes<T, const P: usize>: Copy {
    type Vector: Copy;

    fn splat(self, x: T) -> Self::Vector;

    /// # Safety
    /// `from` points to `P` numbers.
    unsafe fn load(self, from: *const T) -> Self::Vector;

    /// The products of `a[0]`, then of `a[1]`, with each of four numbers, `P` being eight.
    ///
    /// # Safety
    /// `a` points to two numbers, `b` to four.
    unsafe fn products(self, a: *const T, b: *const T) -> Self::Vector;

    /// `a * b + c`
    fn multiply_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;

    fn array(self, a: Self::Vector) -> [T; P];
}

/// Arrays; `FUSED` says that the machine has a fused multiply-add.
#[derive(Clone, Copy)]
pub struct Plain<const FUSED: bool>;

impl<T: Real, const P: usize, const FUSED: bool> Lanes<T, P> for Plain<FUSED> {
    type Vector = [T; P];

    #[inline(always)]
    fn splat(self, x: T) -> [T; P] {
        [x; P]
    }

    #[inline(always)]
    unsafe fn load(self, from: *const T) -> [T; P] {
        // SAFETY: as the caller promises.
        unsafe { from.cast::<[T; P]>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn products(self, a: *const T, b: *const T) -> [T; P] {
        // SAFETY: as the caller promises.
        let (a, b) = unsafe { (a.cast::<[T; 2]>().read_unaligned(), b.cast::<[T; 4]>().read_unaligned()) };
        std::array::from_fn(|l| a[l / 4 % 2] * b[l % 4])
    }

    #[inline(always)]
    fn multiply_add(self, a: [T; P], b: [T; P], c: [T; P]) -> [T; P] {
        let mut sum = c;
        for l in 0..P {
            sum[l] = a[l].mul_add::<FUSED>(b[l], sum[l]);
        }
        sum
    }

    #[inline(always)]
    fn array(self, a: [T; P]) -> [T; P] {
        a
    }
}

#[cfg(target_arch = "x86_64")]
pub use x86::Fused;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::Lanes;
    use pulp::x86::V3;
    use std::arch::x86_64::*;

    /// A machine with AVX2 and FMA; the token proves that it is one, which makes the instructions below safe.
    #[derive(Clone, Copy)]
    pub struct Fused(#[allow(dead_code, reason = "a proof, not a value")] pub V3);

    macro_rules! registers {
        ($count:literal, $vector:ty, $splat:ident, $load:ident, $products:expr, $multiply_add:ident, $store:ident) => {
            impl Lanes<f32, $count> for Fused {
                type Vector = $vector;

                #[inline(always)]
                fn splat(self, x: f32) -> $vector {
                    // SAFETY: the machine has these instructions, here and below.
                    unsafe { $splat(x) }
                }

                #[inline(always)]
                unsafe fn load(self, from: *const f32) -> $vector {
                    // SAFETY: as the caller promises.
                    unsafe { $load(from) }
                }

                #[inline(always)]
                unsafe fn products(self, a: *const f32, b: *const f32) -> $vector {
                    // SAFETY: as the caller promises.
                    unsafe { $products(a, b) }
                }

                #[inline(always)]
                fn multiply_add(self, a: $vector, b: $vector, c: $vector) -> $vector {
                    // SAFETY: as in `splat`.
                    unsafe { $multiply_add(a, b, c) }
                }

                #[inline(always)]
                fn array(self, a: $vector) -> [f32; $count] {
                    let mut array = [0.0; $count];
                    // SAFETY: the array has as many numbers as the vector.
                    unsafe { $store(array.as_mut_ptr(), a) };
                    array
                }
            }
        };
    }

    /// # Safety
    /// None is needed: it is not called.
    #[inline(always)]
    unsafe fn of_eight(_: *const f32, _: *const f32) -> __m128 {
        unreachable!("two times four numbers are eight")
    }

    /// # Safety
    /// The machine has AVX, `a` points to two numbers and `b` to four.
    #[inline(always)]
    unsafe fn two_by_four(a: *const f32, b: *const f32) -> __m256 {
        // SAFETY: as the caller promises; the machine has AVX.
        unsafe {
            let a = _mm256_castpd_ps(_mm256_set1_pd(a.cast::<f64>().read_unaligned()));
            let a = _mm256_permutevar_ps(a, _mm256_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1));
            let b = _mm_loadu_ps(b);
            _mm256_mul_ps(a, _mm256_set_m128(b, b))
        }
    }

    registers!(4, __m128, _mm_set1_ps, _mm_loadu_ps, of_eight, _mm_fmadd_ps, _mm_storeu_ps);
    registers!(8, __m256, _mm256_set1_ps, _mm256_loadu_ps, two_by_four, _mm256_fmadd_ps, _mm256_storeu_ps);
}
