/** Half-precision numbers, which JavaScript engines of today mostly lack: bits to values, and values to bits. */

let table: Float32Array | undefined;

/** The value of every 16-bit pattern. */
export function halfValues(): Float32Array {
  table ??= Float32Array.from({ length: 65536 }, (_, bits) => halfValue(bits));
  return table;
}

const word = new Float32Array(1);
const bits = new Uint32Array(word.buffer);

/** The pattern nearest to a float32 number, of two as near the even one; that of infinity from 65520 on. */
export function halfBits(value: number): number {
  word[0] = value;
  const all = bits[0]!;
  const sign = (all >>> 16) & 0x8000;
  const size = all & 0x7fffffff;
  if (size >= 0x477ff000) { // 65520
    return sign | 0x7c00;
  }
  const exponent = size >>> 23;
  if (exponent < 102) { // below half the smallest number
    return sign;
  }
  const shift = exponent < 113 ? 126 - exponent : 13; // numbers below 2^-14 have the steps of the smallest ones
  const fraction = exponent < 113 ? (size & 0x7fffff) | 0x800000 : size - 0x38000000;
  const low = fraction & ((1 << shift) - 1);
  const middle = 1 << (shift - 1);
  const whole = fraction >>> shift;
  return sign | (whole + (low > middle || (low === middle && (whole & 1) === 1) ? 1 : 0));
}

/** The value of one 16-bit pattern. */
export function halfValue(pattern: number): number {
  const sign = pattern & 0x8000 ? -1 : 1;
  const exponent = (pattern >> 10) & 31;
  const fraction = pattern & 1023;
  if (exponent === 0) {
    return sign * fraction * 2 ** -24;
  }
  if (exponent === 31) {
    return fraction === 0 ? sign * Infinity : NaN;
  }
  return sign * (1024 + fraction) * 2 ** (exponent - 25);
}
