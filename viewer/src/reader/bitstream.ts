/** Whole numbers of few bits one after the other, without gaps (`docs/format.md`, section 3, packed levels). */

/** The numbers of a stream, from its first bit on. */
export class BitStream {
  private at = 0; // byte
  private held = 0; // bits of those before it that belong to later numbers, and how many
  private left = 0;

  constructor(private readonly stream: Uint8Array) {}

  /** The next number in two's complement, of 1 to 16 bits. */
  next(bits: number): number {
    while (this.left < bits) {
      this.held |= this.stream[this.at]! << this.left;
      this.at += 1;
      this.left += 8;
    }
    const whole = (this.held << (32 - bits)) >> (32 - bits);
    this.held >>= bits;
    this.left -= bits;
    return whole;
  }
}
