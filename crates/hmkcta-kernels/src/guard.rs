//! Kernels run without the interpreter's lock, and a panic of theirs as an exception that `except Exception` catches.

use crate::sizes::NoMemory;
use pyo3::exceptions::{PyMemoryError, PyValueError};
use pyo3::prelude::*;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};

/// Say nothing on the terminal of a panic: `run` hands its message to Python. Of the standard library of this module only.
pub fn quiet() {
    set_hook(Box::new(|_| {}));
}

/// Do the work of a kernel. Arguments have been checked before; what they still contradict is an error, not a panic.
pub fn run<R: Send>(py: Python, work: impl FnOnce() -> R + Send) -> PyResult<R> {
    // Whatever the work has left half done is the caller's array, of which it is told that the call failed.
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).map_err(|panic| exception(&*panic))
}

fn exception(panic: &(dyn Any + Send)) -> PyErr {
    if let Some(NoMemory(message)) = panic.downcast_ref() {
        return PyMemoryError::new_err(message.clone());
    }
    let message = panic.downcast_ref::<&str>().map(|text| text.to_string());
    let message = message.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default();
    PyValueError::new_err(format!("arrays that contradict each other: {message}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_become_exceptions() {
        Python::initialize();
        Python::attach(|py| {
            assert_eq!(run(py, || 3).unwrap(), 3);
            let error = run(py, || [1, 2][std::hint::black_box(2)]).unwrap_err();
            assert!(error.is_instance_of::<PyValueError>(py) && error.to_string().contains("index out of bounds"));
            let error = run(py, || crate::sizes::zeros::<f64>(usize::MAX / 1024)).unwrap_err();
            assert!(error.is_instance_of::<PyMemoryError>(py));
        });
    }
}
