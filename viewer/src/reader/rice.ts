/**
 * Bits of the numbers of a packed level (`docs/format.md`, section 3), and the half-precision numbers that they stand for.
 *
 * A width is a byte for each column of a basis: the lower four bits are one less than the bits of the column's numbers,
 * the upper four one less than the most bits of the core numbers that stand for this column. A core number, which stands
 * for a column of each mode, has the least of these.
 */

import { BitStream } from "./bitstream";
import { halfBits } from "./half";
import { fault } from "./reasons";
import type { Find } from "./schema";
import { type Geometry, type Nodes, nameIn } from "./tables";

const MOST_OF_BASIS = 12;
const MOST_OF_CORE = 16;

/** By mode: of each node [R_n]; null of an undecomposed mode. */
type Widths = (Uint8Array | null)[];

function basisBits(width: number): number {
  return (width & 15) + 1;
}

function coreBits(width: number): number {
  return (width >> 4) + 1;
}

function widthsOf(nodes: Nodes, array: Find): Widths {
  return nodes.ranks.map((_, n) => array(nameIn(nodes, `width/${n}`)) as Uint8Array | null);
}

/** Widths, and the lengths of the arrays of which nodes have so many `numbers`, `core` or `basis/<n>`, by their names. */
export function checkPacked(nodes: Nodes, array: Find, numbers: Map<string, (s: number) => number>): void {
  const widths = widthsOf(nodes, array);
  for (const n of nodes.decomposed) {
    checkWidths(nameIn(nodes, `width/${n}`), widths[n]!, nodes.ranks[n]!);
  }
  for (const [name, count] of numbers) {
    const [full, stored] = [nameIn(nodes, name), array(nameIn(nodes, name))!.length];
    let all = 0;
    for (let s = 0; s < nodes.nodes; s += 1) {
      all += count(s);
    }
    if (all > 8 * stored) { // no number has less than a bit: nothing larger is made than that allows
      throw fault("array-shape", full, `[${stored}]`, `the bits of ${all} numbers`);
    }
    const n = Number(name.split("/")[1]);
    const bits = name === "core" ? bitsOfCores(nodes, widths) : bitsOfBases(widths[n]!, nodes.ranks[n]!, count);
    if (stored !== Math.ceil(bits / 8)) {
      throw fault("array-shape", full, `[${stored}]`, `[${Math.ceil(bits / 8)}]`);
    }
  }
}

/** Widths of a mode's columns: as many as the nodes have ranks, of bases of at most 12 bits. */
function checkWidths(name: string, width: Uint8Array, ranks: Uint32Array): void {
  const columns = ranks.reduce((all, each) => all + each, 0);
  if (width.length !== columns) {
    throw fault("array-shape", name, `[${width.length}]`, `[${columns}]`);
  }
  const bad = width.findIndex((each) => basisBits(each) > MOST_OF_BASIS);
  if (bad >= 0) {
    throw fault("width-range", name, `${width[bad]} at ${bad}, ${basisBits(width[bad]!)} bits`,
      `at most ${MOST_OF_BASIS} bits of a basis number`);
  }
}

/** Bits of all basis numbers of a mode, of which nodes have so many. */
function bitsOfBases(width: Uint8Array, ranks: Uint32Array, numbers: (s: number) => number): number {
  let bits = 0;
  for (let s = 0, column = 0; s < ranks.length; s += 1) {
    const rows = numbers(s) / ranks[s]!;
    for (const end = column + ranks[s]!; column < end; column += 1) {
      bits += rows * basisBits(width[column]!);
    }
  }
  return bits;
}

function bitsOfCores(nodes: Nodes, widths: Widths): number {
  let bits = 0;
  eachNode(nodes, widths, (s, own) => {
    bits += nodes.cells[s]! * own.reduce((all, each) => all + each, 0);
  });
  return bits;
}

/** For each node the bits of a cell's core numbers, in their order; they are there until the next node's turn. */
function eachNode(nodes: Nodes, widths: Widths, take: (s: number, bits: Uint8Array) => void): void {
  let most = 0;
  for (let s = 0; s < nodes.nodes; s += 1) {
    most = Math.max(most, nodes.ranks.reduce((all, rank) => all * rank[s]!, 1));
  }
  const bits = new Uint8Array(most);
  const column = new Float64Array(widths.length); // the node's first one, by mode
  for (let s = 0; s < nodes.nodes; s += 1) {
    bits[0] = MOST_OF_CORE;
    let count = 1;
    for (const [n, width] of widths.entries()) {
      const rank = nodes.ranks[n]![s]!;
      spread(bits, count, rank, width, column[n]!);
      count *= rank;
      column[n]! += rank;
    }
    take(s, bits.subarray(0, count));
  }
}

/** The least bits by the indices of one mode more: in the same place, so from the last one on. */
function spread(bits: Uint8Array, count: number, rank: number, width: Uint8Array | null, column: number): void {
  for (let at = count - 1; at >= 0; at -= 1) {
    const least = bits[at]!;
    for (let r = rank - 1; r >= 0; r -= 1) {
      bits[at * rank + r] = width === null ? least : Math.min(least, coreBits(width[column + r]!));
    }
  }
}

let shares: Uint16Array | undefined;

/** The number of every whole one of 16 bits, divided by 2^15: those of fewer bits are multiples of powers of two. */
function sharesOfOne(): Uint16Array {
  shares ??= Uint16Array.from({ length: 65536 }, (_, bits) => halfBits(((bits << 16) >> 16) / 32768));
  return shares;
}

/** Fill a packed level with the numbers that its bits, which `checkPacked` has let through, stand for. */
export function unpackLevel(geometry: Geometry, array: Find): void {
  const { packed, ranks } = geometry;
  const widths = widthsOf(geometry, array);
  const streamOf = (name: string): BitStream => new BitStream(array(nameIn(geometry, name)) as Uint8Array);
  unpackCores(streamOf("core"), geometry, widths, packed.core);
  for (const n of geometry.decomposed) {
    unpackBases(streamOf(`basis/${n}`), widths[n]!, ranks[n]!, packed.basisOffset[n]!, packed.basis[n]!);
  }
}

function unpackCores(stream: BitStream, nodes: Nodes, widths: Widths, into: Uint16Array): void {
  const number = sharesOfOne();
  let at = 0;
  eachNode(nodes, widths, (s, bits) => {
    const up = 16 - bits.reduce((most, each) => Math.max(most, each), 0); // to whole numbers of 16 bits
    for (let cell = 0; cell < nodes.cells[s]!; cell += 1) {
      for (let i = 0; i < bits.length; i += 1, at += 1) {
        into[at] = number[(stream.next(bits[i]!) << up) & 0xffff]!;
      }
    }
  });
}

function unpackBases(
  stream: BitStream, width: Uint8Array, ranks: Uint32Array, offsets: Uint32Array, into: Uint16Array,
): void {
  const number = sharesOfOne();
  for (let s = 0, first = 0; s < ranks.length; s += 1) {
    const end = first + ranks[s]!;
    for (let at = offsets[s]!, column = first; at < offsets[s + 1]!; at += 1) {
      const bits = basisBits(width[column]!);
      into[at] = number[(stream.next(bits) << (16 - bits)) & 0xffff]!;
      column = column + 1 === end ? first : column + 1;
    }
    first = end;
  }
}
