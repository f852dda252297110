/**
 * The image: all tables and float16 coefficients of a model in one flat array of words, as the shaders read it.
 *
 * `hmkcta.render.image` describes the layout. Here it is made in parts, for a file comes in parts: nodes, rows and
 * scales from the tables, which come first; then a level's coefficients, one range of words each.
 */

import { Problem } from "../problem";
import type { PackedLevel } from "../reader/packed";
import { nodeWords } from "./prelude";
import { shapeOf } from "./tree";

const LEAF = 0xffffffff;
const MOST_WORDS = 2 ** 31;

/** Where the sections of an image start, in words; `coefficients` has an entry a level and the end. */
export interface ImageLayout {
  nodes: number[];
  rows: number[][]; // by level and mode
  scales: number[];
  coefficients: number[];
}

/** Words of a row's record in a node: none where all rows go to one part and have no clusters. */
function recordWords(level: PackedLevel, s: number, n: number): number {
  const mixture = shapeOf(level, s, 1, n);
  return shapeOf(level, s, 0, n) > 1 || mixture > 0 ? 2 + mixture : 0;
}

function rowWords(level: PackedLevel, n: number): number {
  let words = 0;
  for (let s = 0; s < level.nodes; s += 1) {
    words += (level.rowOffset[n]![s + 1]! - level.rowOffset[n]![s]!) * recordWords(level, s, n);
  }
  return words;
}

/** A level's float16 arrays in the order of the image. */
function coefficientArrays(level: PackedLevel): Uint16Array[] {
  return [level.core, ...level.basis];
}

function wordsOf(halves: Uint16Array): number {
  return Math.ceil(halves.length / 2);
}

/** Lay out a model whose tables are there. */
export function layOutImage(levels: PackedLevel[]): ImageLayout {
  const order = levels[0]!.order;
  let at = 0;
  const next = (words: number): number => {
    at += words;
    return at - words;
  };
  const nodes = levels.map((level) => next(level.nodes * nodeWords(order)));
  const rows = levels.map((level) => level.rowOffset.map((_, n) => next(rowWords(level, n))));
  const scales = levels.map((level) => next(level.coreScale.length));
  const coefficients = levels.map((level) =>
    next(coefficientArrays(level).reduce((sum, array) => sum + wordsOf(array), 0)));
  if (at >= MOST_WORDS) {
    throw new Problem("The model is too large for the GPU.", `It takes ${at} words there.`,
      "Compress it with a smaller --size.");
  }
  return { nodes, rows, scales, coefficients: [...coefficients, at] };
}

/** Nodes, rows and scales of all levels: the words from 0 to the first coefficient. */
export function packTables(levels: PackedLevel[], layout: ImageLayout): Uint32Array<ArrayBuffer> {
  const words = new Uint32Array(layout.coefficients[0]!);
  levels.forEach((level, l) => {
    const next = layout.nodes[l + 1] ?? 0;
    writeNodes(words, level, l, layout, next);
    level.cluster.forEach((_, n) => writeRows(words, level, n, layout.rows[l]![n]!));
    words.set(new Uint32Array(level.coreScale.buffer, level.coreScale.byteOffset, level.coreScale.length), layout.scales[l]!);
  });
  return words;
}

function writeNodes(words: Uint32Array, level: PackedLevel, l: number, layout: ImageLayout, nextLevel: number): void {
  const { order, child } = level;
  const size = nodeWords(order);
  let start = layout.coefficients[l]!;
  const starts = coefficientArrays(level).map((array) => {
    start += wordsOf(array);
    return start - wordsOf(array);
  });
  const rows = [...layout.rows[l]!];
  for (let s = 0; s < level.nodes; s += 1) {
    let at = layout.nodes[l]! + s * size;
    const inner = child !== null && child[s] !== child[s + 1];
    words[at] = inner ? nextLevel + child[s]! * size : LEAF;
    words[at + 1] = 2 * starts[0]! + level.coreOffset[s]!;
    words[at + 2] = layout.scales[l]! + level.cellOffset[s]!;
    at += 3;
    for (let n = 0; n < order; n += 1, at += 5) {
      for (let which = 0; which < 3; which += 1) {
        words[at + which] = level.shape[(3 * s + which) * order + n]!;
      }
      words[at + 3] = rows[n]!;
      words[at + 4] = 2 * starts[n + 1]! + level.basisOffset[n]![s]!;
      rows[n]! += (level.rowOffset[n]![s + 1]! - level.rowOffset[n]![s]!) * recordWords(level, s, n);
    }
  }
}

function writeRows(words: Uint32Array, level: PackedLevel, n: number, start: number): void {
  const [offsets, cluster, part, local] = [level.rowOffset[n]!, level.cluster[n]!, level.part[n], level.local[n]];
  let at = start;
  let entry = 0;
  for (let s = 0; s < level.nodes; s += 1) {
    const mixture = shapeOf(level, s, 1, n);
    if (recordWords(level, s, n) === 0) {
      continue;
    }
    for (let row = offsets[s]!; row < offsets[s + 1]!; row += 1) {
      words[at] = part?.[row] ?? 0;
      words[at + 1] = local?.[row] ?? 0;
      at += 2;
      for (let k = 0; k < mixture; k += 1, at += 1, entry += 1) {
        words[at] = cluster[entry]!;
      }
    }
  }
}

/** Calls `write` with each piece of a level's coefficients and the word at which it belongs. */
export function eachCoefficients(
  level: PackedLevel, l: number, layout: ImageLayout, write: (at: number, halves: Uint16Array) => void,
): void {
  let at = layout.coefficients[l]!;
  for (const array of coefficientArrays(level)) {
    write(at, array);
    at += wordsOf(array);
  }
}
