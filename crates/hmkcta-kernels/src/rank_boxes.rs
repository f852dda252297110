//! Ranks of a block: the box of its HOSVD core of least cost J = error / D^2 + lambda * bits, found by cumulative sums.
//! The twin of `hmkcta.search.rank_boxes`.

/// What numbers of a step D cost; `hmkcta.search.rate_model` says where the constants come from.
#[derive(Clone, Copy)]
pub struct Rate {
    /// Squared error, in units of D^2, that one bit is worth.
    pub lambda: f32,
    /// Bits of any core number.
    pub offset: f32,
    /// Bits of a core number for each octave of 1 + 12 c^2, c in units of D.
    pub slope: f32,
    /// Bits of a basis column besides its numbers.
    pub column: f32,
}

impl Rate {
    /// The square of a core number in units of D^2, and what storing it changes.
    #[inline(always)]
    fn gain(self, square: f32) -> (f32, f32) {
        let bits = self.offset + self.slope * log2(1.0 + 12.0 * square);
        (square, square.min(ROUNDED) - square + self.lambda * bits)
    }
}

/// Numbers worked on together.
const LANES: usize = 16;

/// Mean squared error of a rounded number, in units of its squared step.
const ROUNDED: f32 = 1.0 / 12.0;

/// Modes that a block may have.
pub const MODES: usize = 8;

/// Buffers of one thread.
#[derive(Default)]
pub struct Boxes {
    squares: Vec<f32>,
    gains: Vec<f32>,
    sums: Vec<f64>,
    columns: [Vec<f64>; MODES],
}

/// log2 of x >= 1, to 2e-5: its exponent, and a minimax polynomial in its mantissa.
#[inline(always)]
fn log2(x: f32) -> f32 {
    let bits = x.to_bits();
    let exponent = (bits >> 23) as i32 - 127;
    let y = f32::from_bits((bits & 0x007f_ffff) | 0x3f80_0000) - 1.0;
    let p = 0.045_148_253 * y - 0.193_573_67;
    let p = p * y + 0.415_604_26;
    let p = p * y - 0.709_095_84;
    exponent as f32 + y * (p * y + 1.441_917)
}

impl Boxes {
    /// The least cost of a core `[n_1, .., n_N]` in units of D^2, and its ranks: 0 in every mode where nothing pays,
    /// n_n in an undecomposed mode. `most`: bound on the product of the ranks of decomposed modes.
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "what a block and its costs are made of")]
    pub fn best(
        &mut self,
        core: &[f32],
        sizes: &[usize],
        decomposed: &[bool],
        inverse_step: f32,
        rate: Rate,
        most: f64,
        ranks: &mut [u32],
    ) -> f64 {
        let order = sizes.len();
        let energy = self.gain(core, inverse_step, rate);
        let kept: Vec<usize> = (0..order).map(|n| if decomposed[n] { sizes[n] } else { 1 }).collect();
        self.reduce(sizes, decomposed, &kept);
        self.accumulate(&kept);
        self.price_columns(sizes, decomposed, rate);
        let (least, place) = self.least(&kept, decomposed, most);
        if least >= 0.0 {
            ranks.fill(0);
            return energy;
        }
        let mut rest = place;
        for n in (0..order).rev() {
            ranks[n] = if decomposed[n] { (rest % kept[n]) as u32 + 1 } else { sizes[n] as u32 };
            rest /= kept[n];
        }
        energy + least
    }

    /// Squares of the core in units of D^2, and what storing each number changes; the sum of the squares.
    #[inline(always)]
    fn gain(&mut self, core: &[f32], inverse_step: f32, rate: Rate) -> f64 {
        self.squares.resize(core.len(), 0.0);
        self.gains.resize(core.len(), 0.0);
        let mut lanes = [0f64; LANES];
        let (cores, cores_left) = core.as_chunks::<LANES>();
        let (squares, squares_left) = self.squares.as_chunks_mut::<LANES>();
        let (gains, gains_left) = self.gains.as_chunks_mut::<LANES>();
        for ((cores, squares), gains) in cores.iter().zip(squares).zip(gains) {
            for lane in 0..LANES {
                let c = cores[lane] * inverse_step;
                (squares[lane], gains[lane]) = rate.gain(c * c);
                lanes[lane] += f64::from(squares[lane]);
            }
        }
        let mut energy = lanes.iter().sum();
        for ((&c, square), gain) in cores_left.iter().zip(squares_left).zip(gains_left) {
            let c = c * inverse_step;
            (*square, *gain) = rate.gain(c * c);
            energy += f64::from(*square);
        }
        energy
    }

    /// Sums of the gains over undecomposed modes, `kept`, and of the squares over all modes but one.
    #[inline(always)]
    fn reduce(&mut self, sizes: &[usize], decomposed: &[bool], kept: &[usize]) {
        let (last, order) = (sizes[sizes.len() - 1], sizes.len());
        self.sums.clear();
        self.sums.resize(kept.iter().product(), 0.0);
        for n in 0..order {
            self.columns[n].clear();
            self.columns[n].resize(if decomposed[n] { sizes[n] } else { 0 }, 0.0);
        }
        let mut steps = [0usize; MODES];
        let mut step = 1;
        for n in (0..order).rev() {
            steps[n] = if decomposed[n] { step } else { 0 };
            step *= kept[n];
        }
        let mut index = [0usize; MODES];
        for (squares, gains) in self.squares.chunks_exact(last).zip(self.gains.chunks_exact(last)) {
            let at: usize = (0..order - 1).map(|n| index[n] * steps[n]).sum();
            let total = f64::from(squares.iter().sum::<f32>());
            for n in 0..order - 1 {
                if decomposed[n] {
                    self.columns[n][index[n]] += total;
                }
            }
            if decomposed[order - 1] {
                for (sum, &gain) in self.sums[at..at + last].iter_mut().zip(gains) {
                    *sum += f64::from(gain);
                }
                for (sum, &square) in self.columns[order - 1].iter_mut().zip(squares) {
                    *sum += f64::from(square);
                }
            } else {
                self.sums[at] += gains.iter().map(|&gain| f64::from(gain)).sum::<f64>();
            }
            for n in (0..order - 1).rev() {
                index[n] += 1;
                if index[n] < sizes[n] {
                    break;
                }
                index[n] = 0;
            }
        }
    }

    /// Cumulative sums of `sums` along every mode.
    #[inline(always)]
    fn accumulate(&mut self, kept: &[usize]) {
        let mut inner = 1;
        for &size in kept.iter().rev() {
            if size > 1 {
                for slab in self.sums.chunks_exact_mut(inner * size) {
                    if inner == 1 {
                        let mut sum = 0.0;
                        for number in slab {
                            sum += *number;
                            *number = sum;
                        }
                    } else {
                        for at in 1..size {
                            let (before, rest) = slab.split_at_mut(at * inner);
                            for (number, &sum) in rest[..inner].iter_mut().zip(&before[(at - 1) * inner..]) {
                                *number += sum;
                            }
                        }
                    }
                }
            }
            inner *= size;
        }
    }

    /// Cost of the first r columns of every decomposed mode, in place of the energies of its columns.
    #[inline(always)]
    fn price_columns(&mut self, sizes: &[usize], decomposed: &[bool], rate: Rate) {
        for n in (0..sizes.len()).filter(|&n| decomposed[n]) {
            let rows = sizes[n] as f64;
            let mut sum = 0.0;
            for energy in &mut self.columns[n] {
                let each = *energy / rows;
                let bits = 0.5 * rows * (1.0 + 12.0 * each).log2() + f64::from(rate.column);
                sum += f64::from(rate.lambda) * bits + rows * each.min(f64::from(ROUNDED));
                *energy = sum;
            }
        }
    }

    /// The least cost of a box of at most `most` numbers, and its place in `sums`.
    #[inline(always)]
    fn least(&self, kept: &[usize], decomposed: &[bool], most: f64) -> (f64, usize) {
        let order = kept.len();
        let last = kept[order - 1];
        let mut found = (f64::INFINITY, 0);
        let mut index = [0usize; MODES];
        for (line, sums) in self.sums.chunks_exact(last).enumerate() {
            let (mut cost, mut product) = (0.0, 1.0);
            for n in (0..order - 1).filter(|&n| decomposed[n]) {
                cost += self.columns[n][index[n]];
                product *= (index[n] + 1) as f64;
            }
            let allowed = if decomposed[order - 1] { ((most / product) as usize).min(last) } else { 1 };
            if product <= most {
                for (r, &sum) in sums[..allowed].iter().enumerate() {
                    let own = if decomposed[order - 1] { self.columns[order - 1][r] } else { 0.0 };
                    if sum + cost + own < found.0 {
                        found = (sum + cost + own, line * last + r);
                    }
                }
            }
            for n in (0..order - 1).rev() {
                index[n] += 1;
                if index[n] < kept[n] {
                    break;
                }
                index[n] = 0;
            }
        }
        found
    }
}
