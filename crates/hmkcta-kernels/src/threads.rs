//! The threads kernels run on, and the buffers each of them keeps.

use crate::sizes::expect_room;
use pyo3::pyfunction;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::cell::RefCell;
use std::sync::{Arc, Mutex, PoisonError};

/// Tensors from this size on are worth several threads.
pub const PARALLEL: usize = 200_000;

/// Sums of so many products are worth several threads.
pub const PRODUCTS: usize = 2_000_000;
/// Pieces that large work is cut into, for threads to share; not as many as there are threads, for results not to depend
/// on their number.
pub const PIECES: usize = 64;

/// Threads that may be asked for, of each core and at the least of so many cores.
const OF_A_CORE: usize = 2;
const FEW_CORES: usize = 8;

/// The pool, of which process (threads do not survive a fork), and how many threads were asked for (0: all cores).
struct State {
    pool: Option<(u32, Arc<ThreadPool>)>,
    wanted: usize,
}

static STATE: Mutex<State> = Mutex::new(State { pool: None, wanted: 0 });

/// How many threads large tensors are worked on by; 0 stands for all cores. Results do not depend on it, nor does it help
/// to have more of them than there are cores.
#[pyfunction]
pub fn set_threads(count: usize) {
    let count = count.min(OF_A_CORE * cores().max(FEW_CORES));
    let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
    if state.wanted != count {
        drop(own(state.pool.take()));
        state.wanted = count;
    }
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// The pool, if it is this process's own. One of a parent process must not be dropped: its threads do not exist here.
fn own(pool: Option<(u32, Arc<ThreadPool>)>) -> Option<(u32, Arc<ThreadPool>)> {
    match pool {
        Some((owner, threads)) if owner != std::process::id() => {
            std::mem::forget(threads);
            None
        }
        own => own,
    }
}

/// The pool to run on; None for one thread, or where no thread can be started.
fn pool() -> Option<Arc<ThreadPool>> {
    let mut state = STATE.lock().unwrap_or_else(PoisonError::into_inner);
    state.pool = own(state.pool.take());
    if state.pool.is_none() {
        let threads = if state.wanted == 0 { cores() } else { state.wanted };
        let build = || ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("hmkcta-{i}")).build();
        state.pool = Some((std::process::id(), Arc::new(build().ok()?)));
    }
    state.pool.as_ref().map(|(_, pool)| pool.clone()).filter(|pool| pool.current_num_threads() > 1)
}

/// How many threads share the work.
pub fn count() -> usize {
    pool().map_or(1, |pool| pool.current_num_threads())
}

/// Do all tasks, on all threads where `parallel` says that it pays. What comes out must not depend on their order.
pub fn for_each<T: Send>(parallel: bool, tasks: Vec<T>, work: impl Fn(T) + Sync + Send) {
    let pool = if parallel && tasks.len() > 1 { pool() } else { None };
    match pool {
        Some(pool) => pool.install(|| tasks.into_par_iter().with_max_len(1).for_each(work)),
        None => tasks.into_iter().for_each(work),
    }
}

/// The same with buffers that a thread uses for one task after the other. Tasks are begun in the order they stand in.
pub fn for_each_with<T: Send, B: Default>(parallel: bool, tasks: Vec<T>, work: impl Fn(T, &mut B) + Sync + Send) {
    let threads = if parallel { count().min(tasks.len()) } else { 1 };
    let queue = Mutex::new(tasks.into_iter());
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    for_each(parallel, (0..threads).collect(), |_| {
        let mut buffers = B::default();
        while let Some(task) = next() {
            work(task, &mut buffers);
        }
    });
}

/// Buffers for results between the steps of a chain of mode products, for a slab and what it is made from, for sorted
/// rows, and for each level of a recursion.
#[derive(Default)]
pub struct Scratch {
    pub steps: [Vec<f32>; 2],
    pub slab: Vec<f32>,
    pub head: Vec<f32>,
    pub sorted: Vec<f32>,
    pub levels: Vec<Vec<f32>>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Lend this thread's buffers. `work` must not ask for them again.
pub fn with_scratch<R>(work: impl FnOnce(&mut Scratch) -> R) -> R {
    SCRATCH.with_borrow_mut(work)
}

/// The first `length` numbers of a buffer that grows as needed; what they are is left open.
pub fn room<T: Copy + Default>(buffer: &mut Vec<T>, length: usize) -> &mut [T] {
    if buffer.len() < length {
        expect_room::<T>(length);
        buffer.resize(length, T::default());
    }
    &mut buffer[..length]
}
