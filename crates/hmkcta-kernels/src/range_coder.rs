//! The adaptive binary range coder of stored numbers (`docs/format.md`, the coded run).
//!
//! The syntax of a run is written once, for a `Coder`: an encoder codes the value it is handed and returns it, a decoder
//! ignores that and returns what it has read.

/// Ranges below this one take in another byte.
const LEAST_RANGE: u32 = 1 << 24;
/// Bounds of a model's probability, in 1/65536.
const LEAST: u32 = 32;
const MOST: u32 = 65504;
/// How many decisions a model counts at most.
const MOST_SEEN: u8 = 254;
/// How far a probability moves towards the last decision, in 1/65536, by the decisions seen.
static RATES: [u16; 256] = rates();

const fn rates() -> [u16; 256] {
    let mut rates = [0; 256];
    let mut seen = 0;
    while seen < 256 {
        rates[seen] = (65536 / (seen + 2)) as u16;
        seen += 1;
    }
    rates
}

/// The probability of a 0, adapted to the decisions seen: its upper half, and how many these were, its lower one.
#[derive(Clone, Copy)]
pub struct Model(u32);

impl Default for Model {
    fn default() -> Self {
        Model(1 << 31)
    }
}

impl Model {
    #[inline(always)]
    fn bound(self, range: u32) -> u32 {
        (range >> 16) * (self.0 >> 16)
    }

    #[inline(always)]
    fn learn(&mut self, bit: bool) {
        let (zero, seen) = (self.0 >> 16, self.0 as u8);
        let rate = u32::from(RATES[usize::from(seen)]);
        let moved = if bit { zero - ((zero * rate) >> 16) } else { zero + (((65536 - zero) * rate) >> 16) };
        self.0 = moved.clamp(LEAST, MOST) << 16 | u32::from(seen + u8::from(seen < MOST_SEEN));
    }

    /// The same without a branch.
    #[inline(always)]
    fn learn_evenly(&mut self, bit: bool) {
        let (zero, seen) = (self.0 >> 16, self.0 as u8);
        let rate = u32::from(RATES[usize::from(seen)]);
        let ones = 0_u32.wrapping_sub(u32::from(bit));
        let step = (((zero & ones | (65536 - zero) & !ones) * rate) >> 16 ^ ones).wrapping_sub(ones);
        self.0 = zero.wrapping_add(step).clamp(LEAST, MOST) << 16 | u32::from(seen + u8::from(seen < MOST_SEEN));
    }
}

/// Either end of a code: decisions go in, and come out.
pub trait Coder {
    /// Whether values come from the code.
    const DECODES: bool;

    /// A decision with the probability of its model.
    fn bit(&mut self, model: &mut Model, bit: bool) -> bool;

    /// The same of a decision that cannot be foreseen, without a branch.
    #[inline(always)]
    fn even_bit(&mut self, model: &mut Model, bit: bool) -> bool {
        self.bit(model, bit)
    }

    /// The lowest bits of a value, up to 32, the highest one first, all equally likely.
    fn raw(&mut self, bits: u32, value: u32) -> u32;

    /// Whether more bytes were read than there are.
    fn past_end(&self) -> bool {
        false
    }
}

/// Writes bytes; carries run through those held back.
pub struct Encoder {
    low: u64,
    range: u32,
    held: u8,
    waiting: usize,
    started: bool,
    bytes: Vec<u8>,
}

impl Encoder {
    pub fn new() -> Self {
        Encoder { low: 0, range: u32::MAX, held: 0, waiting: 0, started: false, bytes: Vec::new() }
    }

    #[inline(always)]
    fn shift(&mut self) {
        if (self.low as u32) < 0xFF00_0000 || self.low >> 32 != 0 {
            self.release((self.low >> 32) as u8);
            self.held = (self.low >> 24) as u8;
        } else {
            self.waiting += 1;
        }
        self.low = (self.low & 0x00FF_FFFF) << 8;
    }

    /// Write the byte held back, which there is none of at first, and the 255s after it.
    #[inline(never)]
    fn release(&mut self, carry: u8) {
        if self.started {
            self.bytes.push(self.held.wrapping_add(carry));
        }
        self.started = true;
        self.bytes.extend(std::iter::repeat_n(0xFF_u8.wrapping_add(carry), self.waiting));
        self.waiting = 0;
    }

    #[inline(always)]
    fn renormalise(&mut self) {
        while self.range < LEAST_RANGE {
            self.range <<= 8;
            self.shift();
        }
    }

    /// All bytes; those of `low` itself end them, so that a decoder ends at exactly 0.
    pub fn finish(mut self) -> Vec<u8> {
        for _ in 0..5 {
            self.shift();
        }
        self.bytes
    }
}

impl Coder for Encoder {
    const DECODES: bool = false;

    #[inline(always)]
    fn bit(&mut self, model: &mut Model, bit: bool) -> bool {
        let bound = model.bound(self.range);
        if bit {
            self.low += u64::from(bound);
            self.range -= bound;
        } else {
            self.range = bound;
        }
        model.learn(bit);
        self.renormalise();
        bit
    }

    #[inline(always)]
    fn raw(&mut self, bits: u32, value: u32) -> u32 {
        for at in (0..bits).rev() {
            self.range >>= 1;
            self.low += u64::from(self.range) * u64::from(value >> at & 1);
            self.renormalise();
        }
        value
    }
}

/// Counts the bytes that an encoder would write, exactly: that takes the ranges alone.
pub struct Counter {
    range: u32,
    bytes: u64,
}

impl Counter {
    pub fn new() -> Self {
        Counter { range: u32::MAX, bytes: 4 }
    }

    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    #[inline(always)]
    fn renormalise(&mut self) {
        while self.range < LEAST_RANGE {
            self.range <<= 8;
            self.bytes += 1;
        }
    }
}

impl Coder for Counter {
    const DECODES: bool = false;

    #[inline(always)]
    fn bit(&mut self, model: &mut Model, bit: bool) -> bool {
        let bound = model.bound(self.range);
        self.range = if bit { self.range - bound } else { bound };
        model.learn(bit);
        self.renormalise();
        bit
    }

    #[inline(always)]
    fn raw(&mut self, bits: u32, value: u32) -> u32 {
        for _ in 0..bits {
            self.range >>= 1;
            self.renormalise();
        }
        value
    }
}

/// Reads what an encoder has written. Behind the last byte it reads zeros, and says so.
pub struct Decoder<'a> {
    bytes: &'a [u8],
    next: usize,
    code: u32,
    range: u32,
}

impl<'a> Decoder<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut decoder = Decoder { bytes, next: 0, code: 0, range: u32::MAX };
        for _ in 0..4 {
            decoder.take();
        }
        decoder
    }

    #[inline(always)]
    fn take(&mut self) {
        self.code = self.code << 8 | u32::from(self.bytes.get(self.next).copied().unwrap_or(0));
        self.next += 1;
    }

    #[inline(always)]
    fn renormalise(&mut self) {
        while self.range < LEAST_RANGE {
            self.range <<= 8;
            self.take();
        }
    }

    /// Whether all bytes were read, none beyond them, and they were those of an encoder that ended here.
    pub fn is_at_end(&self) -> bool {
        self.next == self.bytes.len() && self.code == 0
    }
}

impl Coder for Decoder<'_> {
    const DECODES: bool = true;

    #[inline(always)]
    fn bit(&mut self, model: &mut Model, _: bool) -> bool {
        let bound = model.bound(self.range);
        let bit = self.code >= bound;
        if bit {
            self.code -= bound;
            self.range -= bound;
        } else {
            self.range = bound;
        }
        model.learn(bit);
        self.renormalise();
        bit
    }

    #[inline(always)]
    fn even_bit(&mut self, model: &mut Model, _: bool) -> bool {
        let bound = model.bound(self.range);
        let bit = self.code >= bound;
        let ones = 0_u32.wrapping_sub(u32::from(bit));
        self.code -= bound & ones;
        self.range = bound.wrapping_add(self.range.wrapping_sub(bound << 1) & ones);
        model.learn_evenly(bit);
        self.renormalise();
        bit
    }

    #[inline(always)]
    fn raw(&mut self, bits: u32, _: u32) -> u32 {
        let mut value = 0;
        for _ in 0..bits {
            self.range >>= 1;
            let bit = self.code >= self.range;
            self.code -= if bit { self.range } else { 0 };
            value = value << 1 | u32::from(bit);
            self.renormalise();
        }
        value
    }

    fn past_end(&self) -> bool {
        self.next > self.bytes.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code<C: Coder>(coder: &mut C, decisions: &[bool]) -> Vec<bool> {
        let mut models = [Model::default(); 3];
        let mut each = |(i, &bit): (usize, &bool)| match i % 4 {
            0 => coder.bit(&mut models[0], bit),
            1 => coder.even_bit(&mut models[1], bit),
            2 => coder.bit(&mut models[2], bit),
            _ => coder.raw(5, u32::from(bit) * 31) == 31,
        };
        decisions.iter().enumerate().map(&mut each).collect()
    }

    #[test]
    fn decisions_come_back_and_bytes_are_counted() {
        for rare in [-0.6, 0.0, 0.45, 0.6] {
            let decisions: Vec<bool> = crate::testing::numbers(50_000, 3).into_iter().map(|x| x > rare).collect();
            let (mut encoder, mut counter) = (Encoder::new(), Counter::new());
            code(&mut encoder, &decisions);
            code(&mut counter, &decisions);
            let bytes = encoder.finish();
            assert_eq!(bytes.len() as u64, counter.bytes());
            let mut decoder = Decoder::new(&bytes);
            assert_eq!(code(&mut decoder, &decisions.iter().map(|_| false).collect::<Vec<_>>()), decisions);
            assert!(decoder.is_at_end());
        }
    }
}
