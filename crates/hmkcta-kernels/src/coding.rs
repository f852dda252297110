//! Block-sparse coding of slices in the dictionaries of a few clusters each (paper, section 5); twin of `coding.py`.
//!
//! A subset's H is factored cluster by cluster, and b with it: `y = U^-T b`, and the gain is |y|^2. A panel is what the
//! clusters before one leave of its rows of [H | b]; subsets with the same first clusters share the panels of these.

use crate::dictionary::{Dictionary, Given};
use crate::elimination::{
    BLOCK, Rows, backward, eliminate, forward, subtract_gram, subtract_product, subtract_transposed,
};
use crate::sizes::zeros;

/// A subset must be better by so much of the gain, so that ties go to the one seen first.
const TIE: f64 = 1e-9;

/// Subsets of clusters that are looked at one by one, at the most.
const MOST_SUBSETS: usize = 1 << 20;

#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Search {
    /// Among all subsets.
    Optimal,
    /// Subsets in use grow by the best further cluster.
    Greedy,
    /// None: rows keep what they have.
    Fixed,
}

/// A cluster subset, ascending, and the rows that it is offered to.
type Offer = (Vec<u16>, Vec<u32>);

/// The best subset of `mixture` clusters for each row `[I_n, K_n]`, and coefficients `[I_n, K_n, PC_-n R_n]`. Where not
/// all are looked at rows keep the subset they have if none is better.
pub fn code_rows(given: &Given, kept: Option<&[u16]>, mixture: usize, search: Search) -> (Vec<u16>, Vec<f32>) {
    let dictionary = Dictionary::new(given);
    let mut best = Best { gain: vec![-1.0; given.rows], subset: vec![vec![]; given.rows], x: vec![vec![]; given.rows] };
    match search {
        Search::Optimal => best.offer(&dictionary, &combinations(dictionary.clusters, mixture, given.rows), true),
        Search::Greedy => best.grow(&dictionary, mixture),
        Search::Fixed => (),
    }
    if let Some(kept) = kept.filter(|_| search != Search::Optimal) {
        let kept: Vec<_> = kept.chunks_exact(mixture).map(<[u16]>::to_vec).collect();
        best.offer(&dictionary, &patterns(&kept), true);
    }
    (best.subset.concat(), best.x.concat())
}

/// The best that has been found so far for each row.
struct Best {
    gain: Vec<f64>,
    subset: Vec<Vec<u16>>,
    x: Vec<Vec<f32>>,
}

impl Best {
    /// From the best single clusters on every subset in use tries every further cluster.
    fn grow(&mut self, dictionary: &Dictionary, mixture: usize) {
        self.offer(dictionary, &combinations(dictionary.clusters, 1, self.gain.len()), mixture == 1);
        for size in 2..=mixture {
            let mut wider: Vec<Offer> = vec![];
            for (subset, rows) in patterns(&self.subset) {
                for k in (0..dictionary.clusters as u16).filter(|k| !subset.contains(k)) {
                    let mut grown = [&subset[..], &[k]].concat();
                    grown.sort_unstable();
                    wider.push((grown, rows.clone()));
                }
            }
            // Neighbours share panels. To a row subsets are still offered by ascending k.
            wider.sort();
            self.gain.fill(-1.0);
            self.offer(dictionary, &wider, size == mixture);
        }
    }

    /// Give each subset to those of its rows whose gain it raises, with coefficients if these are wanted.
    fn offer(&mut self, dictionary: &Dictionary, offers: &[Offer], solve: bool) {
        let mut panels: Vec<Panel> = vec![];
        for (subset, rows) in offers {
            let Some((&last, first)) = subset.split_last() else { continue };
            let shared = panels.iter().zip(first).take_while(|(panel, k)| panel.cluster == usize::from(**k)).count();
            panels.truncate(shared);
            for &k in &first[shared..] {
                panels.push(Panel::new(dictionary, &panels, usize::from(k)));
            }
            let corner = Panel::last(dictionary, &panels, usize::from(last), rows);
            let better: Vec<usize> = (0..rows.len()).filter(|&at| self.is_better(rows[at], corner.gain[at])).collect();
            let taken: Vec<u32> = better.iter().map(|&at| rows[at]).collect();
            for (&row, &at) in taken.iter().zip(&better) {
                self.gain[row as usize] = corner.gain[at];
                self.subset[row as usize].clone_from(subset);
            }
            if solve && !taken.is_empty() {
                self.solve(dictionary, &panels, &corner, &taken, &better);
            }
        }
    }

    fn is_better(&self, row: u32, gain: f64) -> bool {
        gain > self.gain[row as usize] * (1.0 + TIE)
    }

    /// Coefficients of some rows, at `places` of the corner's, on one subset: `U x = y`.
    fn solve(&mut self, dictionary: &Dictionary, panels: &[Panel], corner: &Panel, rows: &[u32], places: &[usize]) {
        let columns = rows.len().next_multiple_of(BLOCK);
        let places: Vec<u32> = places.iter().map(|&at| at as u32).collect();
        let mut x: Vec<Vec<f64>> = panels.iter().map(|panel| panel.pick(rows)).collect();
        x.push(corner.pick(&places));
        let all: Vec<&Panel> = panels.iter().chain([corner]).collect();
        for (d, panel) in all.iter().enumerate().rev() {
            let (known, solved) = x.split_at_mut(d + 1);
            for (later, x) in all[d + 1..].iter().zip(solved) {
                let x = Rows { numbers: x, step: columns };
                subtract_product(panel.beside(later.cluster, dictionary.padded), x, dictionary.padded, &mut known[d]);
            }
            backward(panel.beside(panel.cluster, dictionary.padded), &mut known[d], columns);
        }
        for (column, &row) in rows.iter().enumerate() {
            let of_row = &mut self.x[row as usize];
            of_row.clear();
            for (panel, x) in all.iter().zip(&x) {
                of_row.extend(
                    dictionary
                        .lengths(panel.cluster)
                        .iter()
                        .zip(x[column..].iter().step_by(columns))
                        .map(|(length, x)| (x / length) as f32),
                );
            }
        }
    }
}

/// One cluster's rows, eliminated: of H, for the clusters from it on, and y.
struct Panel {
    cluster: usize,
    width: usize,
    w: Vec<f64>,
    columns: usize,
    y: Vec<f64>,
    /// Of each column of y, with the clusters before.
    gain: Vec<f64>,
}

impl Panel {
    /// For all rows of the mode, and all clusters that may follow.
    fn new(dictionary: &Dictionary, before: &[Panel], cluster: usize) -> Panel {
        let width = (dictionary.clusters - cluster) * dictionary.padded;
        let gain = before.last().map_or_else(|| vec![0.0; dictionary.columns], |panel| panel.gain.clone());
        let y = dictionary.b(cluster).to_vec();
        let panel = Panel { cluster, width, w: dictionary.h(cluster, width), columns: dictionary.columns, y, gain };
        panel.eliminated(before, &before.iter().map(|panel| &panel.y[..]).collect::<Vec<_>>())
    }

    /// For some rows, with no cluster to follow.
    fn last(dictionary: &Dictionary, before: &[Panel], cluster: usize, rows: &[u32]) -> Panel {
        let columns = rows.len().next_multiple_of(BLOCK);
        let mut gain = vec![0.0; columns];
        if let Some(panel) = before.last() {
            gain.iter_mut().zip(rows).for_each(|(to, &row)| *to = panel.gain[row as usize]);
        }
        let (width, y) = (dictionary.padded, pick(dictionary.b(cluster), dictionary.columns, rows));
        let ys: Vec<Vec<f64>> = before.iter().map(|panel| panel.pick(rows)).collect();
        let panel = Panel { cluster, width, w: dictionary.h(cluster, width), columns, y, gain };
        panel.eliminated(before, &ys.iter().map(Vec::as_slice).collect::<Vec<_>>())
    }

    /// Less what the clusters before explain, whose parts of y are given.
    fn eliminated(mut self, before: &[Panel], ys: &[&[f64]]) -> Panel {
        let padded = self.y.len() / self.columns;
        for (panel, y) in before.iter().zip(ys) {
            let w = panel.beside(self.cluster, padded);
            // As wide as this panel, and rows as far apart as the other's.
            subtract_gram(w, padded, &mut self.w, self.width);
            subtract_transposed(w, Rows { numbers: y, step: self.columns }, padded, &mut self.y, self.columns);
        }
        eliminate(&mut self.w, self.width);
        forward(Rows { numbers: &self.w, step: self.width }, &mut self.y, self.columns);
        for y in self.y.chunks_exact(self.columns) {
            self.gain.iter_mut().zip(y).for_each(|(gain, y)| *gain += y * y);
        }
        self
    }

    /// W from the columns of a cluster on.
    fn beside(&self, cluster: usize, padded: usize) -> Rows<'_> {
        Rows { numbers: &self.w[(cluster - self.cluster) * padded..], step: self.width }
    }

    /// y of some of its columns, filled up to whole blocks.
    fn pick(&self, places: &[u32]) -> Vec<f64> {
        pick(&self.y, self.columns, places)
    }
}

/// Some of the columns, filled up to whole blocks.
fn pick(y: &[f64], columns: usize, places: &[u32]) -> Vec<f64> {
    let width = places.len().next_multiple_of(BLOCK);
    let mut picked = zeros(y.len() / columns * width);
    for (from, to) in y.chunks_exact(columns).zip(picked.chunks_exact_mut(width)) {
        to.iter_mut().zip(places).for_each(|(to, &place)| *to = from[place as usize]);
    }
    picked
}

/// Whether all subsets can be looked at.
pub fn is_few(clusters: usize, mixture: usize) -> bool {
    let few = |subsets: &usize| *subsets <= MOST_SUBSETS;
    let steps = (0..mixture.min(clusters - mixture)).map(|k| (clusters - k, k + 1));
    steps.into_iter().try_fold(1usize, |subsets, (of, by)| Some(subsets * of / by).filter(few)).is_some()
}

/// All subsets of so many clusters, in order, for all rows.
fn combinations(clusters: usize, mixture: usize, rows: usize) -> Vec<Offer> {
    let every: Vec<u32> = (0..rows as u32).collect();
    let mut subsets: Vec<Vec<u16>> = vec![vec![]];
    for _ in 0..mixture {
        let grow = |subset: Vec<u16>| {
            let from = subset.last().map_or(0, |&k| k + 1);
            (from..clusters as u16).map(move |k| [&subset[..], &[k]].concat())
        };
        subsets = subsets.into_iter().flat_map(grow).collect();
    }
    subsets.into_iter().map(|subset| (subset, every.clone())).collect()
}

/// The subsets in use, in order, each with its rows.
fn patterns(subsets: &[Vec<u16>]) -> Vec<Offer> {
    let mut rows: Vec<u32> = (0..subsets.len() as u32).collect();
    rows.sort_by_key(|&row| &subsets[row as usize]);
    let same = |a: &u32, b: &u32| subsets[*a as usize] == subsets[*b as usize];
    rows.chunk_by(same).map(|rows| (subsets[rows[0] as usize].clone(), rows.to_vec())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::tests::on_all_machines;
    use crate::testing::numbers;

    /// 12 columns of 6 cells, 3 x 2 clusters; rank 2; 9 rows of mode 1.
    fn system() -> (Vec<f64>, Vec<f64>) {
        let d: Vec<f64> = numbers(12 * 30, 5).into_iter().map(f64::from).collect();
        let t: Vec<f64> = numbers(9 * 30, 6).into_iter().map(f64::from).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let all = |other: &[f64]| {
            d.chunks(30).flat_map(|a| other.chunks(30).map(|b| dot(a, b)).collect::<Vec<_>>()).collect()
        };
        (all(&d), all(&t))
    }

    #[test]
    fn optimal_gains_are_those_of_the_equations() {
        on_all_machines(compare_with_equations);
    }

    fn compare_with_equations() {
        let (h, b) = system();
        let given = Given { h: &h, b: &b, clusters: &[3, 2], mode: 0, rank: 2, rows: 9 };
        let (subsets, x) = code_rows(&given, None, 2, Search::Optimal);
        for (row, (subset, x)) in subsets.chunks(2).zip(x.chunks(8)).enumerate() {
            // Cluster k's cells are 2k and 2k + 1, so that its columns are 4k to 4k + 3.
            let columns: Vec<usize> = subset.iter().flat_map(|&k| 4 * usize::from(k)..4 * usize::from(k) + 4).collect();
            for &i in &columns {
                let sum: f64 = columns.iter().zip(x).map(|(&j, &x)| h[i * 12 + j] * f64::from(x)).sum();
                assert!((sum - b[i * 9 + row]).abs() < 1e-4, "{sum} instead of {}", b[i * 9 + row]);
            }
            let kept = code_rows(&given, Some(&subsets), 2, Search::Fixed);
            assert_eq!((&kept.0[..], &kept.1[row * 8..row * 8 + 8]), (&subsets[..], x));
        }
        let (greedy, _) = code_rows(&given, Some(&subsets), 2, Search::Greedy);
        assert_eq!(greedy, subsets, "what rows have is kept where it is the best");
    }
}
