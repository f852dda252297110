/** Codes of packed levels as strings of 0 and 1, by the text of `docs/format.md` alone, and levels of one mode of these. */

import { halfValues } from "../src/reader/half";
import type { PackedLevel } from "../src/reader/packed";
import { HmkError } from "../src/reader/reasons";
import { checkPacked, unpackLevel } from "../src/reader/rice";
import type { Geometry } from "../src/reader/tables";

/** Whole numbers below `most`, the same in every run. */
export function draws(seed: number): (most: number) => number {
  let state = seed;
  return (most) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * most);
  };
}

/** A number that its parameter suits or, one time in eight, any that there is a code for. */
export function drawn(draw: (most: number) => number, k: number): number {
  const most = draw(8) === 0 ? Math.max(2 ** 15, 6 * 2 ** k) : 2 ** k;
  return draw(2 * most) - most;
}

/** All whole numbers that there are codes for. */
export function wholeNumbers(k: number): number[] {
  const most = Math.max(2 ** 15, 6 * 2 ** k);
  return Array.from({ length: 2 * most }, (_, at) => at - most);
}

/** Digits of a whole number, the lowest first. */
export function digits(number: number, count: number): string {
  return count === 0 ? "" : [...number.toString(2).padStart(count, "0").slice(-count)].reverse().join("");
}

/** Both parts of the code of a number, as the specification has them. */
export function codeOf(q: number, k: number): [string, string] {
  const z = q >= 0 ? 2 * q : -2 * q - 1;
  const u = Math.min(Math.floor(z / 2 ** k), 12);
  return [`${"0".repeat(u)}1`, u < 12 ? digits(z, k) : digits(z, 16)];
}

/** Bytes of bits, the lowest first, the last one filled up. */
export function bytesOf(text: string, rest: string): number[] {
  return (text.match(/.{1,8}/g) ?? []).map((eight) => parseInt([...eight.padEnd(8, rest)].reverse().join(""), 2));
}

/** The bytes of an array of numbers with these parameters; `rest`: what is left of the last byte of both sequences. */
export function arrayOf(numbers: number[], ks: number[], rest = "0"): number[] {
  const codes = numbers.map((number, at) => codeOf(number, ks[at]!));
  return [0, 1].flatMap((part) => bytesOf(codes.map((code) => code[part]!).join(""), rest));
}

/** The pattern of the float16 number nearest to one below 65504 in magnitude, of two as near the even one. */
export function nearest(value: number): number {
  const [values, size] = [halfValues(), Math.abs(value)];
  let [low, high] = [0, 0x7bff];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    [low, high] = values[middle]! <= size ? [middle, high] : [low, middle];
  }
  const off = size - values[low]! - (values[low + 1]! - size); // exact, as all are multiples of 2^-24
  return (off > 0 || (off === 0 && low % 2 === 1) ? low + 1 : low) + (value < 0 ? 0x8000 : 0);
}

/** A packed level of one mode, by the ranks of its nodes, how many cells each has, and how many rows its bases. */
export class Level {
  readonly core: Uint16Array;
  readonly basis: Uint16Array;

  constructor(arrays: Record<string, Uint8Array>, ranks: number[], cells: number[], rows: number[]) {
    const numbers = (times: number[]): number[] => times.map((each, s) => each * ranks[s]!);
    const sums = (all: number[]): Uint32Array => Uint32Array.from([0, ...all.map((_, s) =>
      all.slice(0, s + 1).reduce((one, other) => one + other))]);
    const offsets = sums(numbers(rows));
    this.core = new Uint16Array(sums(numbers(cells)).at(-1)!);
    this.basis = new Uint16Array(offsets.at(-1)!);
    const geometry = {
      level: 1, nodes: ranks.length, decomposed: [0], ranks: [Uint32Array.from(ranks)], cells: Float64Array.from(cells),
      packed: { core: this.core, basis: [this.basis], basisOffset: [offsets] } as unknown as PackedLevel,
    } as unknown as Geometry;
    const counts = new Map([["core", numbers(cells)], ["basis/0", numbers(rows)]]);
    const find = (name: string): Uint8Array | null => arrays[name.replace("level/1/", "")] ?? null;
    checkPacked(geometry, find, new Map([...counts].map(([name, all]) => [name, (s: number) => all[s]!])), true);
    unpackLevel(geometry, find);
  }
}

/** What a packed level of one mode holds whose only node has these columns: numbers cell after cell, row after row. */
export function unpacked(rice: number[], core: number[], basis: number[]): { core: number[]; basis: number[] } {
  const rank = rice.length;
  const stored = (numbers: number[], parameter: (each: number) => number): Uint8Array =>
    Uint8Array.from(arrayOf(numbers, numbers.map((_, at) => parameter(rice[at % rank]!))));
  const arrays = {
    "rice/0": Uint8Array.from(rice),
    core: stored(core, (each) => each >> 4), "basis/0": stored(basis, (each) => each & 15),
  };
  const level = new Level(arrays, [rank], [core.length / rank], [basis.length / rank]);
  return { core: Array.from(level.core), basis: Array.from(level.basis) };
}

/** Why something is refused, and where, or "ok"; what else is thrown is no refusal. */
export function refusal(make: () => unknown): string {
  try {
    make();
  } catch (error) {
    if (error instanceof HmkError) {
      return `${error.reason} ${error.where}`;
    }
    throw error;
  }
  return "ok";
}
