/** Half-precision numbers, which JavaScript engines of today mostly lack: bits to values. */

let table: Float32Array | undefined;

/** The value of every 16-bit pattern. */
export function halfValues(): Float32Array {
  if (table === undefined) {
    table = new Float32Array(65536);
    for (let bits = 0; bits < 65536; bits += 1) {
      table[bits] = halfValue(bits);
    }
  }
  return table;
}

/** The pattern nearest to a number below 2 in magnitude. */
export function halfBits(value: number): number {
  const size = Math.abs(value);
  let exponent = 0;
  while (size < 2 ** exponent && exponent > -14) {
    exponent -= 1;
  }
  const fraction = size * 2 ** (10 - exponent); // up to 2048; from 1024 on, that counts as one more of the exponent
  const rest = fraction % 2;
  const nearest = rest === 0.5 ? fraction - rest : Math.round(fraction); // ties to even
  return (value < 0 ? 0x8000 : 0) + ((exponent + 14) << 10) + nearest;
}

/** The pattern nearest to a whole number below 2^18 in magnitude, divided by a power of two from 2^2 to 2^17. */
export function halfOfSteps(whole: number, power: number): number {
  const size = Math.abs(whole);
  const digits = 32 - Math.clz32(size);
  const exponent = digits + 14 - power; // as it is stored
  let pattern: number;
  if (size === 0 || exponent < 1) {
    pattern = size << (24 - power); // the steps of the smallest numbers are finer than these
  } else if (digits <= 11) {
    pattern = (size << (11 - digits)) + ((exponent - 1) << 10);
  } else {
    const shift = digits - 11;
    const odd = (size >> shift) & 1; // ties to even; what is rounded up to 2048 counts as one more of the exponent
    pattern = ((size + (1 << (shift - 1)) - 1 + odd) >> shift) + ((exponent - 1) << 10);
  }
  return whole < 0 ? pattern | 0x8000 : pattern;
}

/** The value of one 16-bit pattern. */
export function halfValue(bits: number): number {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 0) {
    return sign * fraction * 2 ** -24;
  }
  if (exponent === 31) {
    return fraction === 0 ? sign * Infinity : NaN;
  }
  return sign * (1024 + fraction) * 2 ** (exponent - 25);
}
