//! Cells of which no two share an element, worked on by several threads.
//!
//! Most such cells are small, and each is work for one thread. Where a few make up most of a node, threads would wait for
//! those who got them: these come first, one after the other, and all threads share the work within each. What comes
//! out of a cell must not depend on how many threads work on it.

use crate::cells::{Cell, Node};
use crate::threads::{PARALLEL, count, for_each_with};
use std::cmp::Reverse;

/// Elements that threads work on together at the most, unless their cells are small: each has copies of its own.
const TOGETHER: usize = 1 << 22;
/// Elements of each cell, on average, from which on cells are shared out: what is kept for each takes memory, too.
const FEWEST: usize = 256;
/// Tasks for each thread, if there are as many cells, so that they end at about the same time.
const TASKS: usize = 2;

/// A cell that has elements, and what the caller keeps for it.
pub struct Turn<T> {
    pub cell: Cell,
    pub item: T,
    /// Whether several threads may share the work within the cell.
    pub shared: bool,
    elements: usize,
}

/// Whether threads shall share the cells of a node.
pub fn pays(node: &Node) -> bool {
    let elements = node.sizes.iter().product::<usize>();
    node.is_disjoint() && node.cells() > 1 && elements >= PARALLEL.max(FEWEST * node.cells()) && count() > 1
}

/// Work on all cells of a node of disjoint cells that have elements, with an item for each cell of the node.
///
/// Each cell has one turn. `work` gets buffers that other cells have used before.
pub fn each_cell<T: Send, B: Default>(node: &Node, items: Vec<T>, work: impl Fn(Turn<T>, &mut B) + Sync + Send) {
    assert!(node.is_disjoint() && items.len() == node.cells());
    let turns: Vec<Turn<T>> = items
        .into_iter()
        .enumerate()
        .map(|(number, item)| {
            let cell = node.cell(number);
            let elements = node.cell_rows(&cell).iter().map(|rows| rows.len()).product();
            Turn { cell, item, shared: false, elements }
        })
        .filter(|turn| turn.elements > 0)
        .collect();
    let threads = count();
    let limit = largest_for_one(turns.iter().map(|turn| turn.elements).collect(), threads);
    let (large, small): (Vec<_>, Vec<_>) = turns.into_iter().partition(|turn| turn.elements > limit);
    let mut buffers = B::default();
    large.into_iter().for_each(|turn| work(Turn { shared: true, ..turn }, &mut buffers));
    drop(buffers);
    for_each_with(true, tasks(node, small, threads), |turns, buffers| {
        turns.into_iter().for_each(|turn| work(turn, buffers));
    });
}

/// How many elements a cell may have to be work for one thread: not much more than a thread's share of all such cells.
fn largest_for_one(mut sizes: Vec<usize>, threads: usize) -> usize {
    sizes.sort_unstable();
    let mut rest: usize = sizes.iter().sum();
    while let Some(largest) = sizes.pop() {
        if largest < PARALLEL || largest * threads <= TOGETHER.min(rest + rest / 2) {
            return largest;
        }
        rest -= largest;
    }
    0
}

/// Cells that one thread shall work on, one after the other, those that take longest first.
///
/// Clusters of the last clustered mode have rows in the same cache lines, for which threads would wait.
fn tasks<T>(node: &Node, turns: Vec<Turn<T>>, threads: usize) -> Vec<Vec<Turn<T>>> {
    let neighbours = node.clusters.iter().rev().copied().find(|&clusters| clusters > 1).unwrap_or(1);
    let parts = (TASKS * threads).div_ceil(node.cells() / neighbours);
    let together = neighbours.div_ceil(parts);
    let place = |turn: &Turn<T>| (turn.cell.number / neighbours, turn.cell.number % neighbours / together);
    let mut tasks: Vec<Vec<Turn<T>>> = vec![];
    for turn in turns {
        match tasks.last_mut() {
            Some(task) if place(&task[0]) == place(&turn) => task.push(turn),
            _ => tasks.push(vec![turn]),
        }
    }
    // Of about the same size they stay in order: their rows lie next to each other.
    tasks.sort_by_key(|task| Reverse(task.iter().map(|turn| turn.elements).sum::<usize>().ilog2()));
    tasks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Example;
    use std::sync::Mutex;

    #[test]
    fn each_cell_with_elements_has_one_turn() {
        // More clusters of mode 1 than rows.
        let example = Example::new(&[3, 400, 200], &[4, 3, 2], &[1; 3], &[1; 3], None);
        let seen = Mutex::new(vec![0; 24]);
        each_cell(&example.node(), (100..124).collect(), |turn: Turn<usize>, buffer: &mut Vec<usize>| {
            assert_eq!(turn.item, turn.cell.number + 100);
            buffer.push(turn.item);
            seen.lock().unwrap()[turn.cell.number] += 1;
        });
        assert_eq!(seen.into_inner().unwrap(), [vec![1; 18], vec![0; 6]].concat());
    }

    #[test]
    fn cells_that_threads_would_wait_for_are_shared() {
        let shared = |sizes: &[usize], threads| {
            let limit = largest_for_one(sizes.iter().map(|size| size * PARALLEL).collect(), threads);
            sizes.iter().filter(|&size| size * PARALLEL > limit).count()
        };
        assert_eq!(shared(&[3], 2), 1);
        assert_eq!(shared(&[3, 2], 2), 0);
        assert_eq!(shared(&[1, 12, 1, 1], 2), 1);
        assert_eq!(shared(&[2; 6], 4), 0);
        assert_eq!(shared(&[2; 6], 16), 6);
        assert_eq!(shared(&[5; 40], 4), 0);
        assert_eq!(shared(&[6; 40], 4), 40);
        assert_eq!(shared(&[], 4), 0);
        assert_eq!(largest_for_one(vec![PARALLEL - 1, 5], 16), PARALLEL - 1);
    }

    #[test]
    fn neighbours_stay_together_as_far_as_there_are_tasks_enough() {
        let example = Example::new(&[4, 8, 12], &[4, 4, 6], &[1; 3], &[1; 3], None);
        let lengths = |threads| {
            let node = example.node();
            let turn = |number| Turn { cell: node.cell(number), item: (), shared: false, elements: 1 };
            let tasks = tasks(&node, (0..96).map(turn).collect(), threads);
            tasks.iter().map(Vec::len).collect::<Vec<_>>()
        };
        assert_eq!(lengths(8), [6; 16]);
        assert_eq!(lengths(12), [3; 32]);
        assert_eq!(lengths(100), [1; 96]);
    }
}
