//! The cells (clusters c = c_1..c_N) of one node: which rows belong to a cell and where its basis rows are stored.

/// One node's model at one level: shapes, memberships, bases `[I_n, K_n, PC_-n, R_n]`, cores `[PC, R_1, .., R_N]`.
pub struct Node<'a> {
    pub sizes: Vec<usize>,
    pub clusters: Vec<usize>,
    pub mixture: Vec<usize>,
    pub ranks: Vec<usize>,
    /// Undecomposed modes have an identity basis that is not stored.
    pub undecomposed: Vec<bool>,
    /// Distinct cluster subsets of each row, `[I_n, K_n]` for each mode.
    pub members: Vec<&'a [u16]>,
}

/// Rows of one cell in each mode, and the slot `i K_n + k` where the row's basis numbers lie.
pub struct Cell {
    pub number: usize,
    pub rows: Vec<Vec<u32>>,
    slots: Vec<Vec<usize>>,
    /// Position of this cell among the combinations of the other modes' subsets: flat(c_-n).
    others: Vec<usize>,
}

impl Node<'_> {
    pub fn order(&self) -> usize {
        self.sizes.len()
    }

    pub fn cells(&self) -> usize {
        self.clusters.iter().product()
    }

    pub fn core_size(&self) -> usize {
        self.ranks.iter().product()
    }

    /// All cells in C order.
    pub fn each_cell(&self) -> Vec<Cell> {
        (0..self.cells()).map(|number| self.cell(number)).collect()
    }

    fn cell(&self, number: usize) -> Cell {
        let order = self.order();
        let mut subset = vec![0; order];
        let mut rest = number;
        for n in (0..order).rev() {
            subset[n] = rest % self.clusters[n];
            rest /= self.clusters[n];
        }
        let mut cell = Cell { number, rows: vec![vec![]; order], slots: vec![vec![]; order], others: vec![0; order] };
        for n in 0..order {
            for m in (0..order).filter(|&m| m != n) {
                cell.others[n] = cell.others[n] * self.clusters[m] + subset[m];
            }
            for (slot, &member) in self.members[n].iter().enumerate() {
                if member as usize == subset[n] {
                    cell.rows[n].push((slot / self.mixture[n]) as u32);
                    cell.slots[n].push(slot);
                }
            }
        }
        cell
    }
}

impl Cell {
    pub fn is_empty(&self) -> bool {
        self.rows.iter().any(Vec::is_empty)
    }

    /// Where in the stored basis of mode `n` the numbers of the cell's rows start.
    fn places<'a>(&'a self, node: &'a Node, n: usize) -> impl Iterator<Item = usize> + 'a {
        let combinations = node.cells() / node.clusters[n];
        self.slots[n].iter().map(move |slot| (slot * combinations + self.others[n]) * node.ranks[n])
    }

    /// This cell's basis matrix of mode `n`, member rows only: `[m, R_n]`.
    pub fn basis(&self, node: &Node, n: usize, stored: &[f32]) -> Vec<f32> {
        let rank = node.ranks[n];
        self.places(node, n).flat_map(|place| stored[place..place + rank].iter().copied()).collect()
    }

    /// Store the basis matrix `[m, R_n]` of mode `n`.
    pub fn store_basis(&self, node: &Node, n: usize, basis: &[f32], stored: &mut [f32]) {
        let rank = node.ranks[n];
        for (row, place) in basis.chunks_exact(rank).zip(self.places(node, n)) {
            stored[place..place + rank].copy_from_slice(row);
        }
    }
}
