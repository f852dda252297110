//! The instruction set kernels run with, chosen at run time: AVX-512, AVX2 with FMA, NEON, or what every machine has.

use pulp::{Arch, Scalar128b, Simd, WithSimd};

/// Run a kernel with the best instruction set of this machine.
#[inline]
pub fn dispatch<Op: WithSimd>(op: Op) -> Op::Output {
    match arch() {
        // Four numbers at a time, as the compiler can do without being told of a processor.
        Arch::Scalar => Simd::vectorize(Scalar128b, op),
        arch => arch.dispatch(op),
    }
}

/// How many float32 numbers its vectors have.
pub fn lanes() -> usize {
    struct Lanes;
    impl WithSimd for Lanes {
        type Output = usize;

        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }
    dispatch(Lanes)
}

/// Have the numbers fetched into the cache.
#[inline(always)]
pub fn prefetch(numbers: &[f32]) {
    prefetch_from(numbers.as_ptr(), numbers.len());
}

/// Have so many numbers fetched into the cache, if there are any: nothing is read.
#[inline(always)]
pub fn prefetch_from(numbers: *const f32, count: usize) {
    #[cfg(target_arch = "x86_64")]
    for at in (0..count).step_by(16) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch changes nothing and fails nowhere, and every x86-64 has it.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(numbers.wrapping_add(at).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (numbers, count);
}

#[cfg(not(test))]
#[inline]
fn arch() -> Arch {
    Arch::new()
}

#[cfg(test)]
fn arch() -> Arch {
    tests::CHOSEN.get().unwrap_or_default()
}

#[cfg(test)]
pub mod tests {
    use pulp::Arch;
    use std::cell::Cell;

    thread_local! {
        /// What kernels called by this thread run with; None: the best.
        pub static CHOSEN: Cell<Option<Arch>> = const { Cell::new(None) };
    }

    /// Run a test with every instruction set that this machine has.
    pub fn on_all_machines(test: impl Fn()) {
        let machines = [Arch::Scalar, Arch::new()].into_iter();
        #[cfg(target_arch = "x86_64")]
        let machines = machines.chain(pulp::x86::V3::try_new().map(Arch::V3));
        for arch in machines {
            CHOSEN.set(Some(arch));
            test();
            CHOSEN.set(None);
        }
    }
}
