/**
 * The small tables of a level, checked and unpacked: C, K, R and row counts of each node.
 *
 * Products of sizes are taken in float64: they cannot wrap, and are exact wherever they can equal a 32-bit offset.
 */

import type { PackedLevel } from "./packed";
import { fault } from "./reasons";

export interface Geometry {
  level: number; // from 1
  packed: PackedLevel;
  decomposed: number[]; // mode numbers
  clusters: Uint32Array[]; // by mode: [S]
  mixture: Uint32Array[];
  ranks: Uint32Array[];
  rows: Float64Array[];
  cells: Float64Array; // [S], PC
}

/** Full name of an array of the level. */
export function nameIn(geometry: Geometry, array: string): string {
  return `level/${geometry.level}/${array}`;
}

/** Check the shape table and the row offsets of a level and unpack them. */
export function readGeometry(packed: PackedLevel, level: number, undecomposed: number[]): Geometry {
  const { nodes, order, shape } = packed;
  const modes = Array.from({ length: order }, (_, n) => n);
  const rows = modes.map((n) => offsetSteps(packed.rowOffset[n]!, `level/${level}/row_offset/${n}`));
  const column = (which: number, n: number): Uint32Array =>
    Uint32Array.from({ length: nodes }, (_, s) => shape[(3 * s + which) * order + n]!);
  const clusters = modes.map((n) => column(0, n));
  const geometry: Geometry = {
    level, packed, clusters, rows, decomposed: modes.filter((n) => !undecomposed.includes(n)),
    mixture: modes.map((n) => column(1, n)), ranks: modes.map((n) => column(2, n)),
    cells: Float64Array.from({ length: nodes }, (_, s) => clusters.reduce((all, each) => all * each[s]!, 1)),
  };
  checkShapes(geometry, undecomposed);
  return geometry;
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
export function isZero(packed: PackedLevel, s: number): boolean {
  const width = 3 * packed.order;
  for (let i = s * width; i < (s + 1) * width; i += 1) {
    if (packed.shape[i] !== 0) {
      return false;
    }
  }
  return true;
}

/** Each node's C, K and R: all zero, or K <= C and all positive, and fixed for an undecomposed mode. */
function checkShapes(geometry: Geometry, undecomposed: number[]): void {
  const { packed, clusters, mixture, ranks, rows } = geometry;
  const name = nameIn(geometry, "shape");
  const zero = Uint8Array.from({ length: packed.nodes }, (_, s) => Number(isZero(packed, s)));
  for (let s = 0; s < packed.nodes; s += 1) {
    for (let n = 0; n < packed.order && zero[s] === 0; n += 1) {
      const [c, k, r] = [clusters[n]![s]!, mixture[n]![s]!, ranks[n]![s]!];
      const fixed = undecomposed.includes(n) && (c !== 1 || r !== rows[n]![s]);
      if (c < 1 || k < 1 || r < 1 || k > c || fixed) {
        throw fault("node-shape", name, `C=${c} K=${k} R=${r} in mode ${n} of node ${s}`,
          "all zero, or 1 <= K <= C and R >= 1 in every mode; C = K = 1 and R = rows if undecomposed");
      }
    }
  }
  for (let s = 0; s < packed.nodes; s += 1) {
    const n = zero[s] === 0 ? rows.findIndex((each) => each[s] === 0) : -1;
    if (n >= 0) {
      throw fault("node-empty", name, `node ${s} without rows in mode ${n} has a shape`, "a shape of zeros");
    }
  }
}
