//! Products of sizes that anybody may have handed over: what wraps is refused, and so is what no memory holds.

use std::panic::panic_any;

/// Numbers that an array may have: their bytes can be counted, whatever their type and padding.
const MOST: usize = isize::MAX as usize / 64;
/// Arrays of fewer numbers are made without asking first.
const FEW: usize = 1 << 20;

/// What a kernel panics with where there is no memory, for `guard::run` to tell Python.
pub struct NoMemory(pub String);

/// The product of some sizes; the message of an error has them.
pub fn product<I: IntoIterator<Item = usize, IntoIter: Clone>>(sizes: I) -> Result<usize, String> {
    let sizes = sizes.into_iter();
    let product = sizes.clone().try_fold(1usize, |product, size| product.checked_mul(size)).filter(|&n| n <= MOST);
    let found = || sizes.collect::<Vec<_>>();
    product.ok_or_else(|| format!("sizes {:?} make more numbers than can be counted", found()))
}

/// Whether there is room for so many numbers besides what there is.
pub fn has_room<T>(count: usize) -> bool {
    count < FEW || Vec::<T>::new().try_reserve_exact(count).is_ok()
}

/// Zeros. Where there is no room for them, which would end the process, it is a panic that Python hears of.
pub fn zeros<T: Copy + Default>(count: usize) -> Vec<T> {
    expect_room::<T>(count);
    vec![T::default(); count]
}

/// Panic where there is no room for so many numbers.
pub fn expect_room<T>(count: usize) {
    if !has_room::<T>(count) {
        panic_any(NoMemory(format!("there is no memory for {count} numbers of {} bytes", size_of::<T>())));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_do_not_wrap() {
        assert_eq!(product([3, 4, 5]), Ok(60));
        assert_eq!(product([]), Ok(1));
        assert!(product([1 << 32, 1 << 32]).is_err_and(|e| e.contains("4294967296")));
        assert!(product([1 << 63, 2, 0]).is_err());
        assert!(product([1 << 62]).is_err());
    }

    #[test]
    fn what_no_memory_holds_is_a_panic_with_a_message() {
        assert_eq!(zeros::<f32>(3), [0.0; 3]);
        let panic = std::panic::catch_unwind(|| zeros::<f64>(MOST)).unwrap_err();
        assert!(panic.downcast::<NoMemory>().is_ok_and(|panic| panic.0.contains("no memory")));
    }

    /// `cargo test` must find what a release build lets pass.
    #[test]
    #[allow(clippy::assertions_on_constants, reason = "of the profile the tests are compiled with")]
    fn tests_check_overflow_and_what_unsafe_code_promises() {
        assert!(cfg!(debug_assertions));
        assert!(std::panic::catch_unwind(|| std::hint::black_box(u8::MAX) + std::hint::black_box(1)).is_err());
    }
}
