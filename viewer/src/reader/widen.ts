/** What the whole numbers of a run stand for (`docs/format.md`, widening): half-precision numbers, by their bits. */

import { halfBits } from "./half";

/** The largest k of a column. */
export const FINEST = 63;
const MOST_CORE = 2047; // in magnitude: whole numbers that half precision has

const SMALL = 256;
const tables: Uint16Array[] = [];

/** 2^(-k/2) in float32. */
function stepOf(k: number): number {
  return k % 2 === 0 ? 2 ** (-k / 2) : Math.fround(Math.SQRT1_2) * 2 ** ((1 - k) / 2);
}

/** The basis numbers of a column by their magnitudes. */
export class Column {
  private readonly step: number;
  private readonly small: Uint16Array;

  constructor(k: number) {
    this.step = stepOf(k);
    this.small = tables[k] ??= Uint16Array.from({ length: SMALL }, (_, size) => this.large(size));
  }

  half(size: number): number {
    return size < SMALL ? this.small[size]! : this.large(size);
  }

  private large(size: number): number {
    return halfBits(Math.fround(size * this.step));
  }
}

const columns: Column[] = [];

/** The column of a k. */
export function columnOf(k: number): Column {
  return columns[k] ??= new Column(k);
}

const wholes = Uint16Array.from({ length: MOST_CORE + 1 }, (_, size) => halfBits(size));

/** Write the core of a node, of which whole numbers are given; by how many powers of two its scale is larger than the step. */
export function widenCore(numbers: Int32Array, count: number, into: Uint16Array, start: number): number {
  let largest = 0;
  for (let at = 0; at < count; at += 1) {
    const size = Math.abs(numbers[at]!);
    largest = size > largest ? size : largest;
  }
  let power = 0;
  while (largest > MOST_CORE * 2 ** power) {
    power += 1;
  }
  for (let at = 0; at < count; at += 1) {
    const number = numbers[at]!;
    const size = Math.abs(number);
    into[start + at] = (number < 0 ? 0x8000 : 0) | (power === 0 ? wholes[size]! : halfBits(size / 2 ** power));
  }
  return power;
}
