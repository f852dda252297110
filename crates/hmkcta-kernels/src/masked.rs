//! Several vectors side by side, of which the last one may be a part.

use pulp::{MemMask, Simd};

/// `V` vectors of which the last one may be masked.
///
/// # Safety
/// `from` points to these vectors; of the last one, if it is masked, to what the mask enables.
#[inline(always)]
pub unsafe fn load<S: Simd, const V: usize, const MASKED: bool>(
    simd: S,
    from: *const f32,
    last: MemMask<S::m32s>,
) -> [S::f32s; V] {
    // SAFETY: as the caller promises: of the last vector the mask enables what is there.
    std::array::from_fn(|v| unsafe {
        let from = from.add(v * S::F32_LANES);
        if MASKED && v == V - 1 { simd.mask_load_ptr_f32s(last, from) } else { from.cast::<S::f32s>().read_unaligned() }
    })
}

/// The same: masked stores are slow without AVX-512.
///
/// # Safety
/// `to` points to these vectors; of the last one, if it is masked, to what the mask enables.
#[inline(always)]
pub unsafe fn store<S: Simd, const V: usize, const MASKED: bool>(
    simd: S,
    to: *mut f32,
    values: &[S::f32s; V],
    last: MemMask<S::m32s>,
) {
    for (v, &value) in values.iter().enumerate() {
        // SAFETY: as in `load`.
        unsafe {
            let to = to.add(v * S::F32_LANES);
            if MASKED && v == V - 1 {
                simd.mask_store_ptr_f32s(last, to, value);
            } else {
                to.cast::<S::f32s>().write_unaligned(value);
            }
        }
    }
}
