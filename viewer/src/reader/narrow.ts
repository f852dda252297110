/** Core and basis numbers in a byte each (`docs/format.md`, section 3): the half-precision numbers that bytes stand for. */

import { halfBits } from "./half";

/** The number of each byte, by its bits: of a basis, and of a core before its factor. */
export const BASIS_NUMBERS = table((byte) => byte / 128);
export const CORE_NUMBERS = table((byte) => (byte * Math.abs(byte)) / 127 ** 2);

function table(number: (byte: number) => number): Uint16Array {
  return Uint16Array.from({ length: 256 }, (_, bits) => halfBits(number((bits << 24) >> 24)));
}

/** Write the numbers of bytes. */
export function widen(stored: Int8Array, numbers: Uint16Array, into: Uint16Array): void {
  for (let at = 0; at < stored.length; at += 1) {
    into[at] = numbers[stored[at]! & 255]!;
  }
}
