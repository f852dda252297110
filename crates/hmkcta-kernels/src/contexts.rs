//! The models of a run, by what they depend on, and how whole numbers, labels and magnitudes are told by decisions.

use crate::range_coder::{Coder, Model};

/// The largest magnitude of a stored whole number.
pub const MOST_MAGNITUDE: u32 = (1 << 24) - 1;
/// The largest k of a column: a unit of its numbers stands for 2^(-k/2).
pub const MOST_K: u8 = 63;
/// Magnitudes are told by ones and a zero up to this number, by their lengths from it on.
const MOST_ONES: usize = 14;
/// Models of a class of magnitudes, filled up to a power of two.
const PER_CLASS: usize = 16;
/// Classes of neighbours, by their sum in steps.
const NEIGHBOUR: [u8; 12] = [0, 1, 2, 2, 3, 3, 4, 4, 5, 5, 5, 6];
pub const NEIGHBOURS: usize = 7;
/// Numbers of classes of size, and where the class of size 0 lies.
const BASIS_CLASSES: (i32, i32) = (80, 16);
const CORE_CLASSES: (i32, i32) = (96, 40);
/// Room for the models of all classes, a power of two.
const ROOM: usize = 1 << 14;
const MOST_SHIFT: i32 = 20;
/// Subsets of a row from this one on share their models.
const MOST_PLACES: usize = 8;

/// Why a run cannot be decoded, or numbers cannot be coded: the reason's code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    CodeEnd,
    CodeRange,
    ClusterRange,
    ClusterOrder,
    PartRange,
    NodeShape,
    LevelBounds,
    RunCount,
    ChildCount,
    RowCount,
}

impl Fault {
    pub fn code(self) -> &'static str {
        match self {
            Fault::CodeEnd => "code-end",
            Fault::CodeRange => "code-range",
            Fault::ClusterRange => "cluster-range",
            Fault::ClusterOrder => "cluster-order",
            Fault::PartRange => "part-range",
            Fault::NodeShape => "node-shape",
            Fault::LevelBounds => "level-bounds",
            Fault::RunCount => "run-count",
            Fault::ChildCount => "child-count",
            Fault::RowCount => "row-count",
        }
    }
}

pub type Checked<T> = Result<T, Fault>;

/// Models of whole numbers: of their length, and the two highest bits below the leading one.
#[derive(Clone, Copy, Default)]
pub struct Integer {
    length: [Model; 32],
    first: [Model; 32],
    second: [[Model; 2]; 32],
}

impl Integer {
    /// A whole number up to 2^32 - 2.
    pub fn code<C: Coder>(&mut self, coder: &mut C, value: u32) -> Checked<u32> {
        let wide = u64::from(value) + 1;
        let wanted = if C::DECODES { 0 } else { wide.ilog2() as usize };
        let mut length = 0;
        while coder.bit(&mut self.length[length & 31], wanted > length) {
            length += 1;
            if length > 31 {
                return Err(Fault::CodeRange);
            }
        }
        if length == 0 {
            return Ok(0);
        }
        let bit = |at: usize| wide >> at & 1 != 0;
        let first = coder.bit(&mut self.first[length], bit(length - 1));
        let mut known = 2 | u64::from(first);
        if length > 1 {
            let second = coder.bit(&mut self.second[length][usize::from(first)], bit(length - 2));
            let low = (length - 2) as u32;
            let rest = coder.raw(low, (wide & ((1 << low) - 1)) as u32);
            known = (known << 1 | u64::from(second)) << low | u64::from(rest);
        }
        Ok((known - 1) as u32)
    }
}

/// Models of the eight highest bits of a label.
#[derive(Clone, Copy)]
pub struct Label([Model; 256]);

impl Default for Label {
    fn default() -> Self {
        Label([Model::default(); 256])
    }
}

impl Label {
    /// A label below `count`, which is at least 2.
    pub fn code<C: Coder>(&mut self, coder: &mut C, value: u32, count: u32) -> Checked<u32> {
        let bits = (count - 1).ilog2() + 1;
        let (mut node, mut read) = (1, 0);
        let modelled = bits.min(8);
        for at in (bits - modelled..bits).rev() {
            let bit = u32::from(coder.bit(&mut self.0[node & 255], value >> at & 1 != 0));
            node = node << 1 | bit as usize;
            read = read << 1 | bit;
        }
        let low = bits - modelled;
        let label = read << low | coder.raw(low, value & ((1 << low) - 1));
        if label < count { Ok(label) } else { Err(Fault::ClusterRange) }
    }
}

/// Models of magnitudes by size and neighbours.
pub struct Magnitudes {
    ones: Box<[Model; ROOM]>,
    escape: [Model; 25],
}

impl Default for Magnitudes {
    fn default() -> Self {
        let ones = vec![Model::default(); ROOM].into_boxed_slice().try_into().ok();
        Magnitudes { ones: ones.unwrap_or_else(|| Box::new([Model::default(); ROOM])), escape: Default::default() }
    }
}

/// A class of sizes, and how many low bits of its numbers are raw.
#[derive(Clone, Copy)]
pub struct Size {
    pub class: u32,
    pub shift: u32,
}

impl Size {
    #[inline(always)]
    fn of(t: i32, (classes, zero): (i32, i32)) -> Size {
        Size { class: (t + zero).clamp(0, classes - 1) as u32, shift: ((t >> 1) - 3).clamp(0, MOST_SHIFT) as u32 }
    }

    /// Of a basis number of a column of `k`, less the logarithm of its length.
    #[inline(always)]
    pub fn of_basis(t: i32) -> Size {
        Size::of(t, BASIS_CLASSES)
    }

    #[inline(always)]
    pub fn of_core(t: i32) -> Size {
        Size::of(t, CORE_CLASSES)
    }
}

impl Magnitudes {
    /// A magnitude; `around`: the sum of those of its neighbours.
    #[inline(always)]
    pub fn code<C: Coder>(&mut self, coder: &mut C, size: Size, around: u32, value: u32) -> Checked<u32> {
        let class =
            size.class as usize * NEIGHBOURS + usize::from(NEIGHBOUR[((around >> size.shift) as usize).min(11)]);
        let models = &mut self.ones;
        let wanted = (value >> size.shift) as usize;
        let mut ones = 0;
        while coder.bit(&mut models[(class * PER_CLASS + ones) & (ROOM - 1)], wanted > ones) {
            ones += 1;
            if ones == MOST_ONES {
                return self.long(coder, size.shift, value);
            }
        }
        if size.shift == 0 {
            return Ok(ones as u32);
        }
        Ok((ones as u32) << size.shift | coder.raw(size.shift, value & ((1 << size.shift) - 1)))
    }

    /// One of many steps.
    #[cold]
    fn long<C: Coder>(&mut self, coder: &mut C, shift: u32, value: u32) -> Checked<u32> {
        let over = (value >> shift).saturating_sub(MOST_ONES as u32);
        let wanted = 32 - over.leading_zeros() as usize;
        let mut length = 0;
        while coder.bit(&mut self.escape[length], wanted > length) {
            length += 1;
            if length == self.escape.len() {
                return Err(Fault::CodeRange);
            }
        }
        let mut read = 0;
        if length > 0 {
            let low = length as u32 - 1;
            read = 1 << low | coder.raw(low, over & ((1 << low) - 1));
        }
        let steps = MOST_ONES as u32 + read;
        if steps > MOST_MAGNITUDE >> shift {
            return Err(Fault::CodeRange);
        }
        Ok(steps << shift | coder.raw(shift, value & ((1 << shift) - 1)))
    }
}

/// Sign of a number, as 0, 1 or 2.
#[inline(always)]
pub fn sign_of(number: i32) -> usize {
    (number.signum() + 1) as usize
}

/// A magnitude with its sign, without a branch.
#[inline(always)]
pub fn signed(magnitude: i32, negative: bool) -> i32 {
    let ones = -i32::from(negative);
    (magnitude ^ ones) - ones
}

/// Models of rows that repeat the one before, and of the labels of those that do not.
#[derive(Clone, Default)]
pub struct Memberships {
    pub same: [Model; 2],
    labels: Vec<Label>,
}

impl Memberships {
    /// The models of a row's subset at a place.
    pub fn label(&mut self, place: usize) -> &mut Label {
        let place = place.min(MOST_PLACES - 1);
        if self.labels.len() <= place {
            self.labels.resize(place + 1, Label::default());
        }
        &mut self.labels[place]
    }
}

/// Models of what depends on the mode alone.
#[derive(Clone, Default)]
pub struct OfMode {
    pub undecomposed: [Model; 2],
    pub clusters: Integer,
    pub mixture: Integer,
    /// By the length of the rank before.
    pub ranks: [Integer; 13],
    pub parts: Integer,
    pub rule: Model,
    pub slotted: Model,
    pub members: Memberships,
    pub cut: Memberships,
    pub part: Memberships,
    pub slot: Label,
    /// Of the first column of a mode, and of later ones.
    pub steps: [Integer; 2],
}

/// All models of a run, fresh.
pub struct Models {
    pub kind: [[Model; 2]; 3],
    pub parted: [Model; 2],
    pub modes: Vec<OfMode>,
    pub first_k: Integer,
    pub basis: Magnitudes,
    pub core: Magnitudes,
    pub basis_sign: [[Model; 16]; 9],
    pub core_sign: [Model; 9],
}

impl Models {
    pub fn new(order: usize) -> Self {
        Models {
            kind: Default::default(),
            parted: Default::default(),
            modes: vec![OfMode::default(); order],
            first_k: Integer::default(),
            basis: Magnitudes::default(),
            core: Magnitudes::default(),
            basis_sign: Default::default(),
            core_sign: Default::default(),
        }
    }
}
