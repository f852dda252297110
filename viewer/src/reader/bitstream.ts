/** Bits one after the other, the lowest of each byte first (`docs/format.md`, section 3, packed levels). */

/** The bits of a stream, from the first one of a byte on. */
export class BitStream {
  private held = 0; // bits of the bytes before `at` that come next, and how many; at most 31, so that `>>` adds zeros
  private left = 0;

  constructor(private readonly stream: Uint8Array, private at = 0) {}

  /** The byte after the last one of which bits were taken. */
  get end(): number {
    return this.at - (this.left >> 3);
  }

  /** The next number, of 0 to 16 bits, which must be there. */
  next(bits: number): number {
    if (this.left < 16) {
      this.fill();
    }
    const whole = this.held & ((1 << bits) - 1);
    this.held >>= bits;
    this.left -= bits;
    return whole;
  }

  /** Bits of 0 before the next one of 1, which is taken as well; without end if there is none. */
  zeros(): number {
    if (this.left < 16) {
      this.fill();
    }
    const zeros = 31 - Math.clz32(this.held & -this.held); // -1: no bit at hand is 1
    if (zeros < 0) {
      return this.manyZeros();
    }
    this.held >>= zeros + 1;
    this.left -= zeros + 1;
    return zeros;
  }

  private fill(): void {
    for (let bytes = Math.min(2, this.stream.length - this.at); bytes > 0; bytes -= 1) {
      this.held |= this.stream[this.at]! << this.left;
      this.at += 1;
      this.left += 8;
    }
  }

  /** What `zeros` returns where all bits at hand are 0. */
  private manyZeros(): number {
    let zeros = this.left;
    this.left = 0;
    while (this.at < this.stream.length && this.stream[this.at] === 0) {
      this.at += 1;
      zeros += 8;
    }
    return this.at < this.stream.length ? zeros + this.zeros() : Infinity;
  }
}
