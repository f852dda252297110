//! A mode's dictionary by its inner products, H and b, cluster after cluster and with columns of length one.

use crate::elimination::BLOCK;
use crate::sizes::zeros;

/// Ridge on H relative to its diagonal: keeps collinear dictionaries solvable, costs nothing visible in SNR.
const RIDGE: f64 = 1e-7;

/// H `[PC R_n, PC R_n]` and b `[PC, R_n, I_n]` of a mode, cells in C order.
pub struct Given<'a> {
    pub h: &'a [f64],
    pub b: &'a [f64],
    /// C_1, .., C_N
    pub clusters: &'a [usize],
    pub mode: usize,
    pub rank: usize,
    pub rows: usize,
}

pub struct Dictionary {
    /// C_n
    pub clusters: usize,
    /// Q = PC_-n R_n, the columns of a cluster, and that as whole blocks.
    q: usize,
    pub padded: usize,
    /// I_n as whole blocks.
    pub columns: usize,
    /// `[C_n, padded, C_n, padded]` with the ridge, upper triangle of clusters; the identity where it is padded.
    h: Vec<f64>,
    /// `[C_n, padded, columns]`, zero where it is padded.
    b: Vec<f64>,
    /// `[C_n, Q]`, what columns were divided by.
    length: Vec<f64>,
}

impl Dictionary {
    pub fn new(given: &Given) -> Self {
        let clusters = given.clusters[given.mode];
        let places = places(given);
        let (side, q) = (places.len(), places.len() / clusters);
        let (padded, columns) = (q.next_multiple_of(BLOCK), given.rows.next_multiple_of(BLOCK));
        let diagonal = places.iter().map(|&at| given.h[at * side + at]);
        let length: Vec<f64> = diagonal.map(|square| if square > 0.0 { square.sqrt() } else { 1.0 }).collect();
        let inverse: Vec<f64> = length.iter().map(|length| length.recip()).collect();
        let wide = clusters * padded;
        let (mut h, mut b) = (zeros(wide * wide), zeros(wide * columns));
        for at in 0..wide {
            let (k, i) = (at / padded, at % padded);
            let line = &mut h[at * wide..][..wide];
            line[at] = 1.0;
            if i >= q {
                continue;
            }
            let own = k * q + i;
            let from = &given.h[places[own] * side..][..side];
            for (other, line) in line.chunks_exact_mut(padded).enumerate().skip(k) {
                let others = other * q..(other + 1) * q;
                for ((to, &place), scale) in line.iter_mut().zip(&places[others.clone()]).zip(&inverse[others]) {
                    *to = from[place] * scale * inverse[own];
                }
            }
            line[at] += RIDGE;
            let from = &given.b[places[own] * given.rows..][..given.rows];
            b[at * columns..].iter_mut().zip(from).for_each(|(to, &value)| *to = value * inverse[own]);
        }
        Dictionary { clusters, q, padded, columns, h, b, length }
    }

    /// H of a cluster's columns with its own and those of the clusters after it, up to `width` in all.
    pub fn h(&self, cluster: usize, width: usize) -> Vec<f64> {
        let step = self.clusters * self.padded;
        let lines = self.h[cluster * self.padded * step..].chunks_exact(step).take(self.padded);
        let mut h = Vec::with_capacity(self.padded * width);
        lines.for_each(|line| h.extend_from_slice(&line[cluster * self.padded..][..width]));
        h
    }

    /// b of a cluster, `[padded, columns]`.
    pub fn b(&self, cluster: usize) -> &[f64] {
        &self.b[cluster * self.padded * self.columns..][..self.padded * self.columns]
    }

    /// What a cluster's columns were divided by.
    pub fn lengths(&self, cluster: usize) -> &[f64] {
        &self.length[cluster * self.q..][..self.q]
    }
}

/// Where the columns of H are among those given, cluster by cluster: its cells in C order, each with its columns.
fn places(given: &Given) -> Vec<usize> {
    let &Given { clusters, mode, rank, .. } = given;
    let after: usize = clusters[mode + 1..].iter().product();
    let others = clusters.iter().product::<usize>() / clusters[mode];
    let cell = |k: usize, other: usize| (other / after * clusters[mode] + k) * after + other % after;
    let cells = (0..clusters[mode]).flat_map(|k| (0..others).map(move |other| cell(k, other)));
    cells.flat_map(|cell| cell * rank..(cell + 1) * rank).collect()
}
