/** Binary arithmetic decoding with adaptive models (`docs/format.md`, codes of a run). */

import { fault } from "./reasons";

/** Models are words: the probability of a 0 in 1/65536, and above it how many bits were seen. */
const FRESH = 32768;
const [LEAST, MOST] = [32, 65504];
const COUNTED = 254;
const RATES = Int32Array.from({ length: COUNTED + 1 }, (_, seen) => Math.floor(65536 / (seen + 2)));
/** Range and code are kept as signed words, which engines need no memory for: with this bit turned they compare as unsigned ones. */
const TURN = -(2 ** 31);

const LONGEST = 31; // digits behind the first one of a whole number
const [FIRST, SECOND] = [LONGEST + 1, 2 * (LONGEST + 1)];
/** Models of a context: of a whole number, of a label, of a magnitude, and of those that are too large for it. */
export const WHOLE = 4 * (LONGEST + 1);
export const LABEL = 256;
export const UNARY = 14;
const LONGEST_ESCAPE = 24;
export const ESCAPE = LONGEST_ESCAPE + 1;
const TREE_BITS = 8;
/** The largest magnitude of a number. */
export const LARGEST = 2 ** 24 - 1;

export class Coder {
  private readonly models: Int32Array;
  private readonly state = new Int32Array(2); // range, code
  private bytes: Uint8Array = new Uint8Array(0);
  private at = 0;
  private end = 0;
  private where = "";

  constructor(models: number) {
    this.models = new Int32Array(models);
  }

  /** Begin with the bytes of a run: all models are fresh. */
  begin(bytes: Uint8Array, where: string): void {
    [this.bytes, this.at, this.end, this.where] = [bytes, 0, bytes.length, where];
    this.models.fill(FRESH);
    this.state[0] = -1; // 2^32 - 1
    let code = 0;
    for (let i = 0; i < 4; i += 1) {
      code = (code << 8) | this.next();
    }
    this.state[1] = code;
  }

  /** Refuse what is left when all is decoded. */
  finish(): void {
    if (this.at < this.end || this.state[1] !== 0) {
      throw fault("code-end", this.where, `${this.end - this.at} bytes more, code ${this.state[1]! >>> 0}`, "the end of the code");
    }
  }

  private next(): number {
    if (this.at >= this.end) {
      throw fault("code-end", this.where, `${this.end} bytes`, "all codes of the run");
    }
    const byte = this.bytes[this.at]!;
    this.at += 1;
    return byte;
  }

  private outside(found: string, allowed: string): Error {
    return fault("code-range", this.where, found, allowed);
  }

  bit(at: number): number {
    const { models, state } = this;
    const model = models[at]!;
    const zero = model & 0xffff;
    const seen = model >>> 16;
    const rate = RATES[seen]!;
    let [range, code] = [state[0]!, state[1]!];
    const bound = Math.imul(range >>> 16, zero);
    const count = (seen < COUNTED ? seen + 1 : seen) << 16;
    let bit: number;
    if ((code ^ TURN) < (bound ^ TURN)) {
      bit = 0;
      range = bound;
      const after = zero + (Math.imul(65536 - zero, rate) >> 16);
      models[at] = (after > MOST ? MOST : after) | count;
    } else {
      bit = 1;
      code = (code - bound) | 0;
      range = (range - bound) | 0;
      const after = zero - (Math.imul(zero, rate) >> 16);
      models[at] = (after < LEAST ? LEAST : after) | count;
    }
    while (range >>> 24 === 0) { // below 2^24
      range <<= 8;
      code = (code << 8) | this.next();
    }
    state[0] = range;
    state[1] = code;
    return bit;
  }

  /** Some bits without a model, the highest first. */
  raw(bits: number): number {
    const { state } = this;
    let [range, code] = [state[0]!, state[1]!];
    let value = 0;
    for (let i = 0; i < bits; i += 1) {
      range >>>= 1;
      value *= 2;
      if ((code ^ TURN) >= (range ^ TURN)) {
        code = (code - range) | 0;
        value += 1;
      }
      while (range >>> 24 === 0) {
        range <<= 8;
        code = (code << 8) | this.next();
      }
    }
    state[0] = range;
    state[1] = code;
    return value;
  }

  /** A whole number from 0 on, of a context of `WHOLE` models. */
  whole(context: number): number {
    let bits = 0;
    while (this.bit(context + bits) === 1) {
      bits += 1;
      if (bits > LONGEST) {
        throw this.outside(`a whole number of more than ${LONGEST + 1} bits`, `at most ${LONGEST + 1}`);
      }
    }
    let value = 1;
    if (bits > 0) {
      const first = this.bit(context + FIRST + bits);
      value = 2 + first;
      if (bits > 1) {
        value = 2 * value + this.bit(context + SECOND + 2 * bits + first);
        value = value * 2 ** (bits - 2) + this.raw(bits - 2);
      }
    }
    return value - 1;
  }

  /** A label below `count`, of a context of `LABEL` models. */
  label(context: number, count: number): number {
    const bits = 32 - Math.clz32(count - 1);
    const known = Math.min(bits, TREE_BITS);
    let node = 1;
    for (let i = 0; i < known; i += 1) {
      node = 2 * node + this.bit(context + node);
    }
    let value = node - 2 ** known;
    if (bits > known) {
      value = value * 2 ** (bits - known) + this.raw(bits - known);
    }
    if (value >= count) {
      throw fault("cluster-range", this.where, value, `less than ${count}`);
    }
    return value;
  }

  /**
   * A number with its sign, of a context of `UNARY` models; `shift` bits of its magnitude have none. `sign`: the model of
   * its sign; below 0: none.
   *
   * Here files are opened fast or slowly: what `bit` does stands here once more, with nothing but locals.
   */
  signed(context: number, escape: number, shift: number, sign: number): number {
    const { models, state } = this;
    let range = state[0]!;
    let code = state[1]!;
    let high = 0;
    for (;;) {
      const model = models[context + high]!;
      const zero = model & 0xffff;
      const seen = model >>> 16;
      const rate = RATES[seen]!;
      const count = seen < COUNTED ? (model & 0xff0000) + 0x10000 : COUNTED << 16;
      const bound = Math.imul(range >>> 16, zero);
      if ((code ^ TURN) < (bound ^ TURN)) {
        range = bound;
        const after = zero + (Math.imul(65536 - zero, rate) >> 16);
        models[context + high] = (after > MOST ? MOST : after) | count;
        while (range >>> 24 === 0) {
          range <<= 8;
          code = (code << 8) | this.next();
        }
        break;
      }
      code = (code - bound) | 0;
      range = (range - bound) | 0;
      const after = zero - (Math.imul(zero, rate) >> 16);
      models[context + high] = (after < LEAST ? LEAST : after) | count;
      while (range >>> 24 === 0) {
        range <<= 8;
        code = (code << 8) | this.next();
      }
      high += 1;
      if (high === UNARY) {
        break;
      }
    }
    state[0] = range;
    state[1] = code;
    if (high === UNARY) {
      high = this.escaped(escape, shift);
    }
    const magnitude = shift === 0 ? high : (high << shift) + this.raw(shift);
    if (magnitude === 0) {
      return 0;
    }
    return (sign < 0 ? this.raw(1) : this.bit(sign)) === 0 ? magnitude : -magnitude;
  }

  /** A magnitude from `UNARY` on, without the bits that it is shifted by. */
  private escaped(context: number, shift: number): number {
    let bits = 0;
    while (this.bit(context + bits) === 1) {
      bits += 1;
      if (bits > LONGEST_ESCAPE) {
        throw this.outside(`a number of more than ${LONGEST_ESCAPE} bits`, `at most ${LONGEST_ESCAPE}`);
      }
    }
    const high = UNARY + (bits === 0 ? 0 : 2 ** (bits - 1) + this.raw(bits - 1));
    if (high > LARGEST >> shift) {
      throw this.outside(`a magnitude of ${high * 2 ** shift}`, `at most ${LARGEST}`);
    }
    return high;
  }
}
