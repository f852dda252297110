/**
 * The small tables of a level, checked and unpacked: C, K, R and row counts of each node.
 *
 * Products of sizes are taken in float64: they cannot wrap, and are exact wherever they can equal a 32-bit offset.
 */

import type { PackedLevel } from "./packed";
import { fault } from "./reasons";

/** The nodes of a level, before anything else is known of it. */
export interface Nodes {
  level: number; // from 1
  nodes: number;
  shape: Uint32Array; // [S, 3, N]
  decomposed: number[]; // mode numbers
  clusters: Uint32Array[]; // by mode: [S]
  mixture: Uint32Array[];
  ranks: Uint32Array[];
  rows: Float64Array[];
  cells: Float64Array; // [S], PC
}

export interface Geometry extends Nodes {
  packed: PackedLevel;
}

/** Full name of an array of the level. */
export function nameIn(nodes: Nodes, array: string): string {
  return `level/${nodes.level}/${array}`;
}

/** Check the shape table and the row offsets of a level and unpack them. */
export function readGeometry(packed: PackedLevel, level: number, undecomposed: number[]): Geometry {
  const rows = packed.rowOffset.map((offsets, n) => offsetSteps(offsets, `level/${level}/row_offset/${n}`));
  return { ...nodesOf(packed.shape, rows, level, undecomposed), packed };
}

/** Check the shape table of a level whose nodes own so many rows, by mode, and unpack it. */
export function nodesOf(shape: Uint32Array, rows: Float64Array[], level: number, undecomposed: number[]): Nodes {
  const order = rows.length;
  const nodes = shape.length / (3 * order);
  const modes = rows.map((_, n) => n);
  const column = (which: number, n: number): Uint32Array =>
    Uint32Array.from({ length: nodes }, (_, s) => shape[(3 * s + which) * order + n]!);
  const clusters = modes.map((n) => column(0, n));
  const found: Nodes = {
    level, nodes, shape, clusters, rows, decomposed: modes.filter((n) => !undecomposed.includes(n)),
    mixture: modes.map((n) => column(1, n)), ranks: modes.map((n) => column(2, n)),
    cells: Float64Array.from({ length: nodes }, (_, s) => clusters.reduce((all, each) => all * each[s]!, 1)),
  };
  checkShapes(found, undecomposed);
  return found;
}

/** What each node owns according to an offset array, which must start at 0 and ascend. */
export function offsetSteps(offsets: Uint32Array, name: string): Float64Array {
  if (offsets[0] !== 0) {
    throw fault("offset-order", name, `first offset ${offsets[0]}`, "0");
  }
  const steps = new Float64Array(offsets.length - 1);
  for (let s = 0; s < steps.length; s += 1) {
    const step = offsets[s + 1]! - offsets[s]!;
    if (step < 0) {
      throw fault("offset-order", name, `${offsets[s + 1]} after ${offsets[s]} at node ${s}`, "ascending offsets");
    }
    steps[s] = step;
  }
  return steps;
}

/** Whether C, K and R of a node are all zero. */
function isZero(shape: Uint32Array, order: number, s: number): boolean {
  const width = 3 * order;
  for (let i = s * width; i < (s + 1) * width; i += 1) {
    if (shape[i] !== 0) {
      return false;
    }
  }
  return true;
}

/** Each node's C, K and R: all zero, or K <= C and all positive, and fixed for an undecomposed mode. */
function checkShapes(found: Nodes, undecomposed: number[]): void {
  const { nodes, shape, clusters, mixture, ranks, rows } = found;
  const name = nameIn(found, "shape");
  const zero = Uint8Array.from({ length: nodes }, (_, s) => Number(isZero(shape, rows.length, s)));
  for (let s = 0; s < nodes; s += 1) {
    for (let n = 0; n < rows.length && zero[s] === 0; n += 1) {
      const [c, k, r] = [clusters[n]![s]!, mixture[n]![s]!, ranks[n]![s]!];
      const fixed = undecomposed.includes(n) && (c !== 1 || r !== rows[n]![s]);
      if (c < 1 || k < 1 || r < 1 || k > c || fixed) {
        throw fault("node-shape", name, `C=${c} K=${k} R=${r} in mode ${n} of node ${s}`,
          "all zero, or 1 <= K <= C and R >= 1 in every mode; C = K = 1 and R = rows if undecomposed");
      }
    }
  }
  for (let s = 0; s < nodes; s += 1) {
    const n = zero[s] === 0 ? rows.findIndex((each) => each[s] === 0) : -1;
    if (n >= 0) {
      throw fault("node-empty", name, `node ${s} without rows in mode ${n} has a shape`, "a shape of zeros");
    }
  }
}
