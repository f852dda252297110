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

/// The probability of a 0, adapted to the decisions seen.
#[derive(Clone, Copy)]
pub struct Model {
    zero: u16,
    seen: u8,
}

impl Default for Model {
    fn default() -> Self {
        Model { zero: 1 << 15, seen: 0 }
    }
}

impl Model {
    #[inline(always)]
    fn bound(self, range: u32) -> u32 {
        (range >> 16) * u32::from(self.zero)
    }

    #[inline(always)]
    fn learn(&mut self, bit: bool) {
        let (zero, rate) = (u32::from(self.zero), u32::from(RATES[usize::from(self.seen)]));
        let moved = if bit { zero - (zero * rate >> 16) } else { zero + ((65536 - zero) * rate >> 16) };
        self.zero = moved.clamp(LEAST, MOST) as u16;
        self.seen += u8::from(self.seen < MOST_SEEN);
    }
}

/// Either end of a code: decisions go in, and come out.
pub trait Coder {
    /// Whether values come from the code.
    const DECODES: bool;

    /// A decision with the probability of its model.
    fn bit(&mut self, model: &mut Model, bit: bool) -> bool;

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

    #[test]
    fn decisions_come_back_and_bytes_are_counted() {
        let bits: Vec<bool> = crate::testing::numbers(50_000, 3).into_iter().map(|x| x > 0.45).collect();
        let code = |coder: &mut dyn FnMut(&mut Model, bool, u32)| {
            let mut models = [Model::default(); 2];
            bits.iter().enumerate().for_each(|(i, &bit)| coder(&mut models[i & 1], bit, i as u32 & 31));
        };
        let (mut encoder, mut counter) = (Encoder::new(), Counter::new());
        code(&mut |model, bit, raw| {
            encoder.bit(&mut model.clone(), bit);
            encoder.raw(5, raw);
            counter.bit(model, bit);
            counter.raw(5, raw);
        });
        let bytes = encoder.finish();
        assert!(bytes.len() > 4);
        let mut models = [Model::default(); 2];
        let mut counter_again = Counter::new();
        let mut encoder = Encoder::new();
        for (i, &bit) in bits.iter().enumerate() {
            counter_again.bit(&mut models[i & 1].clone(), bit);
            encoder.bit(&mut models[i & 1], bit);
        }
        let bytes = encoder.finish();
        let (mut decoder, mut models) = (Decoder::new(&bytes), [Model::default(); 2]);
        bits.iter().enumerate().for_each(|(i, &bit)| assert_eq!(decoder.bit(&mut models[i & 1], false), bit));
        assert!(decoder.is_at_end());
    }
}
