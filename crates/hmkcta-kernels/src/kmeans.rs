//! K-means of rows under a cap on cluster size; twin of `kmeans.py`, which adds numbers up in the same order.

use crate::binding::{Doubles, check_rounds};
use crate::guard;
use crate::machine::dispatch;
use crate::threads;
use numpy::{IntoPyArray, PyArray1};
use pulp::{Simd, WithSimd};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Rows whose distances are found side by side.
const LANES: usize = 16;
/// Rows of a task, and products of rows, features and centres from which on threads share the tasks.
const TASK: usize = 64 * LANES;
const PARALLEL: usize = 1 << 20;

/// So many features of `LANES` rows, each feature of all of them in one piece.
type Tile = [[f64; LANES]];
/// Cluster numbers of rows.
type Labels<'py> = Bound<'py, PyArray1<isize>>;

/// The nearest centre of a row, the first of several; its distance, and that of the next.
#[derive(Clone, Copy)]
struct Nearest {
    centre: usize,
    least: f64,
    second: f64,
}

impl Nearest {
    const NONE: Nearest = Nearest { centre: 0, least: f64::INFINITY, second: f64::INFINITY };

    /// Among the centres at these distances.
    fn of(distance: &[f64]) -> Nearest {
        let mut nearest = Nearest::NONE;
        distance.iter().enumerate().for_each(|(k, &distance)| nearest.offer(k, distance));
        nearest
    }

    #[inline(always)]
    fn offer(&mut self, centre: usize, distance: f64) {
        if distance < self.least {
            *self = Nearest { centre, least: distance, second: self.least };
        } else if distance < self.second {
            self.second = distance;
        }
    }

    /// By how much the next is farther; below all others where none is near.
    fn margin(&self) -> f64 {
        let margin = self.second - self.least;
        // Zero comes in two signs, and NaN too, which an order of all numbers would tell apart.
        if margin.is_nan() { -1.0 } else { margin + 0.0 }
    }
}

/// Each row goes to its nearest centre, none of which takes more than `most` of them; widest margins first.
fn with_room(nearest: &[Nearest], clusters: usize, most: usize, distance: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    let mut labels: Vec<usize> = nearest.iter().map(|row| row.centre).collect();
    let mut count = vec![0; clusters];
    labels.iter().for_each(|&k| count[k] += 1);
    if count.iter().all(|&count| count <= most) {
        return labels;
    }
    let mut order: Vec<(f64, usize)> = nearest.iter().map(Nearest::margin).zip(0..).collect();
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut room = vec![most; clusters];
    for (_, i) in order {
        if room[labels[i]] == 0 {
            let nearer = |a: usize, b: usize| if distance(i, b) < distance(i, a) { b } else { a };
            labels[i] = (0..clusters).filter(|&k| room[k] > 0).reduce(nearer).expect("room for all rows");
        }
        room[labels[i]] -= 1;
    }
    labels
}

/// Rows of so many features, `[I, F]`.
#[derive(Clone, Copy)]
struct Rows<'a> {
    numbers: &'a [f64],
    width: usize,
}

impl Rows<'_> {
    fn each(&self) -> impl Iterator<Item = &[f64]> {
        self.numbers.chunks_exact(self.width)
    }

    /// Squared distance of a row to a centre.
    fn distance(&self, row: usize, centre: &[f64]) -> f64 {
        let row = &self.numbers[row * self.width..][..self.width];
        row.iter().zip(centre).fold(0.0, |sum, (x, at)| sum + (x - at) * (x - at))
    }

    /// Tile after tile; beyond the last row are zeros.
    fn tiles(&self) -> Vec<[f64; LANES]> {
        let rows = self.numbers.len() / self.width;
        let mut tiles = vec![[0.0; LANES]; rows.div_ceil(LANES) * self.width];
        for (i, row) in self.each().enumerate() {
            let tile = &mut tiles[i / LANES * self.width..];
            tile.iter_mut().zip(row).for_each(|(feature, &x)| feature[i % LANES] = x);
        }
        tiles
    }
}

/// The nearest of the centres for all rows of some tiles.
struct Find<'a> {
    tiles: &'a Tile,
    centres: Rows<'a>,
    nearest: &'a mut [Nearest],
}

impl WithSimd for Find<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        for (tile, nearest) in self.tiles.chunks_exact(self.centres.width).zip(self.nearest.chunks_mut(LANES)) {
            nearest.fill(Nearest::NONE);
            for (k, centre) in self.centres.each().enumerate() {
                let mut distance = [0.0; LANES];
                for (x, at) in tile.iter().zip(centre) {
                    for lane in 0..LANES {
                        let apart = x[lane] - at;
                        distance[lane] += apart * apart;
                    }
                }
                nearest.iter_mut().zip(distance).for_each(|(row, distance)| row.offer(k, distance));
            }
        }
    }
}

/// The nearest of the centres for all rows.
fn find(tiles: &Tile, centres: Rows, nearest: &mut [Nearest]) {
    let parts = tiles.chunks(TASK / LANES * centres.width).zip(nearest.chunks_mut(TASK));
    let products = tiles.len() * LANES * (centres.numbers.len() / centres.width);
    threads::for_each(products >= PARALLEL, parts.collect(), |(tiles, nearest)| {
        dispatch(Find { tiles, centres, nearest });
    });
}

/// Centres with rows move to their means.
fn move_to_means(rows: Rows, labels: &[usize], centres: &mut [f64]) {
    let mut sums = vec![0.0; centres.len()];
    let mut count = vec![0.0; centres.len() / rows.width];
    for (row, &k) in rows.each().zip(labels) {
        count[k] += 1.0;
        sums[k * rows.width..].iter_mut().zip(row).for_each(|(sum, x)| *sum += x);
    }
    let means = sums.chunks_exact(rows.width).zip(count).zip(centres.chunks_exact_mut(rows.width));
    for ((sum, count), centre) in means.filter(|((_, count), _)| *count > 0.0) {
        centre.iter_mut().zip(sum).for_each(|(at, sum)| *at = sum / count);
    }
}

/// Labels after so many rounds from the given centres, and squared distances to the clusters' means, in sum.
fn rounds_from(mut centres: Vec<f64>, rows: Rows, most: usize, rounds: usize) -> (Vec<usize>, f64) {
    let (width, tiles) = (rows.width, rows.tiles());
    let mut nearest = vec![Nearest::NONE; rows.numbers.len() / width];
    let mut labels = vec![];
    for _ in 0..rounds {
        find(&tiles, Rows { numbers: &centres, width }, &mut nearest);
        let distance = |i, k: usize| rows.distance(i, &centres[k * width..]);
        let now = with_room(&nearest, centres.len() / width, most, distance);
        if now == labels {
            break;
        }
        labels = now;
        move_to_means(rows, &labels, &mut centres);
    }
    let own = labels.iter().flat_map(|&k| &centres[k * width..][..width]);
    let cost = rows.numbers.iter().zip(own).fold(0.0, |sum, (x, at)| sum + (x - at) * (x - at));
    (labels, cost)
}

/// How many rows of so many numbers an array has.
fn count_rows(what: &str, numbers: &[f64], width: usize) -> PyResult<usize> {
    match numbers.len().checked_rem(width) {
        Some(0) => Ok(numbers.len() / width),
        _ => Err(PyValueError::new_err(format!("{what} must be rows of {width} numbers, got {}", numbers.len()))),
    }
}

fn check_room(rows: usize, clusters: usize, most: usize) -> PyResult<()> {
    if clusters.saturating_mul(most) >= rows {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("{clusters} clusters of at most {most} rows have no room for {rows}")))
}

/// In NumPy's type of row numbers.
fn to_python(py: Python<'_>, labels: Vec<usize>) -> Labels<'_> {
    labels.into_iter().map(|k| k as isize).collect::<Vec<_>>().into_pyarray(py)
}

/// The nearest of the centres for all rows, by distances `[I, C]`; none for more than `most` of them.
#[pyfunction]
pub fn nearest_with_room<'py>(
    py: Python<'py>,
    distance: Doubles,
    clusters: usize,
    most: usize,
) -> PyResult<Labels<'py>> {
    let distance = distance.as_slice()?;
    check_room(count_rows("the distances", distance, clusters)?, clusters, most)?;
    let labels = guard::run(py, || {
        let nearest: Vec<_> = distance.chunks_exact(clusters).map(Nearest::of).collect();
        with_room(&nearest, clusters, most, |i, k| distance[i * clusters + k])
    })?;
    Ok(to_python(py, labels))
}

/// Labels of rows `[I, F]` after so many rounds from centres `[C, F]`, and squared distances to their means, in sum.
#[pyfunction]
pub fn cluster_rows<'py>(
    py: Python<'py>,
    features: Doubles,
    centres: Doubles,
    width: usize,
    most: usize,
    rounds: usize,
) -> PyResult<(Labels<'py>, f64)> {
    let (features, centres) = (features.as_slice()?, centres.as_slice()?);
    let clusters = count_rows("the centres", centres, width)?;
    check_room(count_rows("the features", features, width)?, clusters, most)?;
    let rows = Rows { numbers: features, width };
    if rounds == 0 {
        return Err(PyValueError::new_err("k-means needs a round at the least"));
    }
    check_rounds("rounds", rounds)?;
    let (labels, cost) = guard::run(py, || rounds_from(centres.to_vec(), rows, most, rounds))?;
    Ok((to_python(py, labels), cost))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::numbers;

    fn doubles(count: usize, seed: u64) -> Vec<f64> {
        numbers(count, seed).into_iter().map(f64::from).collect()
    }

    #[test]
    fn nearest_centres_are_those_of_the_distances() {
        on_all_machines(compare_with_distances);
    }

    fn compare_with_distances() {
        for (count, clusters, width) in [(1, 1, 1), (LANES, 3, 12), (TASK + 21, 70, 13)] {
            let (features, centres) = (doubles(count * width, 3), doubles(clusters * width, 4));
            let (rows, centres) = (Rows { numbers: &features, width }, Rows { numbers: &centres, width });
            let mut nearest = vec![Nearest::NONE; count];
            find(&rows.tiles(), centres, &mut nearest);
            for (i, found) in nearest.iter().enumerate() {
                let distance: Vec<f64> = centres.each().map(|centre| rows.distance(i, centre)).collect();
                let expected = Nearest::of(&distance);
                assert_eq!((found.centre, found.margin()), (expected.centre, expected.margin()));
                assert_eq!(found.least, distance[found.centre]);
            }
        }
    }

    #[test]
    fn wide_margins_go_first_and_full_centres_send_on_to_the_next() {
        let distance = [[0.0, 9.0, 9.0], [1.0, 3.0, 2.0], [0.0, 1.0, -0.0], [4.0, 4.0, 4.0], [f64::INFINITY; 3]];
        let labels = |most| {
            let nearest: Vec<_> = distance.iter().map(|row| Nearest::of(row)).collect();
            with_room(&nearest, 3, most, |i, k| distance[i][k])
        };
        assert_eq!(labels(5), [0, 0, 0, 0, 0]);
        assert_eq!(labels(2), [0, 0, 2, 1, 1]);
    }

    #[test]
    fn centres_end_at_the_means_of_their_rows() {
        let features: Vec<f64> = (0..40).map(|i| f64::from(i % 2) * 10.0 + f64::from(i) / 100.0).collect();
        let rows = Rows { numbers: &features, width: 1 };
        let (labels, cost) = rounds_from(vec![4.0, 5.0, 99.0], rows, 40, 8);
        assert!(labels.iter().enumerate().all(|(i, &k)| k == i % 2));
        let spread: f64 = (0..20).map(|i| (f64::from(i) - 9.5).powi(2) / 2500.0).sum();
        assert!((cost - 2.0 * spread).abs() < 1e-9);
    }
}
