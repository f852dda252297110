//! Maps of files that somebody cuts short while they are read: reading beyond the end is noted, and does not end the
//! process. Without this the system sends SIGBUS, which no Python program can handle.

use pyo3::buffer::PyBuffer;
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;

/// Notes whether bytes of a map were read that its file no longer has; such bytes read as zeros from then on.
#[pyclass(frozen)]
pub struct MapWatch {
    slot: &'static handler::Slot,
    /// Keeps the map from being closed, so that nothing else comes to lie at its address.
    _bytes: PyBuffer<u8>,
}

#[pymethods]
impl MapWatch {
    #[new]
    fn new(map: PyBuffer<u8>) -> PyResult<Self> {
        let slot = handler::watch(map.buf_ptr() as usize, map.len_bytes());
        let slot = slot.ok_or_else(|| PyMemoryError::new_err("too many maps are watched at once"))?;
        Ok(Self { slot, _bytes: map })
    }

    /// Whether it happened since the watch began.
    #[getter]
    fn cut(&self) -> bool {
        self.slot.cut()
    }
}

impl Drop for MapWatch {
    fn drop(&mut self) {
        self.slot.free();
    }
}

#[cfg(unix)]
mod handler {
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
    use std::sync::{Mutex, PoisonError};

    /// A watched range of addresses; the handler reads it at any moment. `end` is 0 while it is of nobody.
    pub struct Slot {
        start: AtomicUsize,
        end: AtomicUsize,
        cut: AtomicBool,
    }

    impl Slot {
        const fn empty() -> Self {
            Self { start: AtomicUsize::new(0), end: AtomicUsize::new(0), cut: AtomicBool::new(false) }
        }

        pub fn cut(&self) -> bool {
            self.cut.load(SeqCst)
        }

        pub fn free(&self) {
            self.end.store(0, SeqCst);
        }
    }

    static SLOTS: [Slot; 256] = [const { Slot::empty() }; 256];
    static PAGE: AtomicUsize = AtomicUsize::new(0);
    /// Held by whoever changes what is here.
    static LOCK: Mutex<()> = Mutex::new(());
    /// What handled the signal before. The handler may wait for no lock: it is written before the handler is there.
    static mut FORMER: std::mem::MaybeUninit<libc::sigaction> = std::mem::MaybeUninit::uninit();

    pub fn watch(start: usize, length: usize) -> Option<&'static Slot> {
        let _held = LOCK.lock().unwrap_or_else(PoisonError::into_inner);
        install()?;
        let slot = SLOTS.iter().find(|slot| slot.end.load(SeqCst) == 0)?;
        slot.cut.store(false, SeqCst);
        slot.start.store(start, SeqCst);
        slot.end.store(start + length, SeqCst);
        Some(slot)
    }

    /// Handle the signal from now on, also where somebody has taken it over since it was last asked for.
    fn install() -> Option<()> {
        // SAFETY: asks for a number.
        let page = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
        PAGE.store(usize::try_from(page).ok()?, SeqCst);
        // SAFETY: all bytes zero are a valid `sigaction`: no handler, no flags, no signals.
        let (mut action, mut former): (libc::sigaction, libc::sigaction) = unsafe { std::mem::zeroed() };
        action.sa_sigaction = on_fault as *const () as usize;
        action.sa_flags = libc::SA_SIGINFO | libc::SA_ONSTACK;
        // SAFETY: all pointers are valid. `FORMER` is written while another handler, or none, is there.
        unsafe {
            if libc::sigaction(libc::SIGBUS, std::ptr::null(), &raw mut former) != 0 {
                return None;
            }
            if former.sa_sigaction == action.sa_sigaction {
                return Some(());
            }
            (&raw mut FORMER).write(std::mem::MaybeUninit::new(former));
            (libc::sigaction(libc::SIGBUS, &raw const action, std::ptr::null_mut()) == 0).then_some(())
        }
    }

    /// Put zeros in the place of what a watched map no longer has; leave any other fault to whoever handled it before.
    ///
    /// Only what is allowed in a handler: atomics, `mmap`, which is a plain call of the system, and `sigaction`.
    extern "C" fn on_fault(signal: libc::c_int, info: *mut libc::siginfo_t, _context: *mut libc::c_void) {
        const NO_SUCH_ADDRESS: libc::c_int = 2; // BUS_ADRERR; failing memory has another code
        // SAFETY: the system gives a valid pointer with SA_SIGINFO.
        let (address, code) = unsafe { ((*info).si_addr() as usize, (*info).si_code) };
        let page = PAGE.load(SeqCst);
        for slot in SLOTS.iter().filter(|_| code == NO_SUCH_ADDRESS) {
            let (start, end) = (slot.start.load(SeqCst), slot.end.load(SeqCst));
            if address < start || address >= end {
                continue;
            }
            let from = address & !(page - 1);
            let length = end.next_multiple_of(page) - from;
            let access = libc::PROT_READ | libc::PROT_WRITE;
            let kind = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED;
            // SAFETY: the pages are those of a map that `MapWatch` keeps open, from the first that cannot be read on.
            let made = unsafe { libc::mmap(from as *mut libc::c_void, length, access, kind, -1, 0) };
            if made != libc::MAP_FAILED {
                slot.cut.store(true, SeqCst);
                return;
            }
        }
        // SAFETY: `FORMER` was written before this handler was there. The read is tried again when it returns.
        unsafe { libc::sigaction(signal, (&raw const FORMER).cast(), std::ptr::null_mut()) };
    }
}

#[cfg(not(unix))]
mod handler {
    /// Where a file that is mapped cannot be cut short there is nothing to note.
    pub struct Slot;

    impl Slot {
        pub fn cut(&self) -> bool {
            false
        }

        pub fn free(&self) {}
    }

    pub fn watch(_start: usize, _length: usize) -> Option<&'static Slot> {
        Some(&Slot)
    }
}
