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
