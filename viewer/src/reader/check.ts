/**
 * Structural checks of the arrays of all levels: every index and offset before anything uses it.
 *
 * A shader that follows a bad index reads some other number and shows a wrong picture without a word, so nothing is
 * left to the decoders.
 */

import { checkParts } from "./checkTree";
import { halfValue } from "./half";
import type { LevelBounds, Metadata } from "./metadata";
import type { PackedLevel } from "./packed";
import { fault } from "./reasons";
import { type Geometry, nameIn, offsetSteps, readGeometry } from "./tables";

export const MAX_F32 = 3.4028234663852886e38;
const HALF_INFINITY = 0x7c00;

/** Check the tables of all levels, whose names, types and table shapes `checkSchema` has let through. */
export function checkTables(metadata: Metadata, levels: PackedLevel[]): Geometry[] {
  const geometries = levels.map((packed, l) => readGeometry(packed, l + 1, metadata.undecomposed));
  checkRoot(geometries[0]!, metadata.modeSizes);
  geometries.forEach((geometry, l) => {
    checkBounds(geometry, metadata.levels[l]!);
    checkNodeSizes(geometry);
    checkClusters(geometry);
  });
  for (let l = 1; l < geometries.length; l += 1) {
    checkParts(geometries[l - 1]!, geometries[l]!);
  }
  return geometries;
}

/** Level 1 has one node, which owns all rows. */
function checkRoot(root: Geometry, sizes: number[]): void {
  if (root.packed.nodes !== 1) {
    throw fault("array-shape", nameIn(root, "shape"), `${root.packed.nodes} nodes`, "one node at level 1");
  }
  sizes.forEach((size, n) => {
    if (root.rows[n]![0] !== size) {
      throw fault("row-count", nameIn(root, `row_offset/${n}`), `${root.rows[n]![0]} rows`, `${size}, the mode size`);
    }
  });
}

/** The metadata's C, K and R are the largest of the level: shaders and limits rely on them. */
function checkBounds(geometry: Geometry, bounds: LevelBounds): void {
  const tables = [["C", geometry.clusters, bounds.clusters], ["K", geometry.mixture, bounds.mixture],
    ["R", geometry.ranks, bounds.ranks]] as const;
  for (const [key, table, bound] of tables) {
    const largest = table.map((column) => column.reduce((most, each) => Math.max(most, each), 0));
    if (largest.join() !== bound.join()) {
      throw fault("level-bounds", `hmkcta.levels[${geometry.level - 1}].${key}`, `[${bound.join()}]`,
        `[${largest.join()}]`);
    }
  }
}

/** Ragged arrays: each node owns as many numbers as its C, K, R and row counts need. */
function checkNodeSizes(geometry: Geometry): void {
  const { packed, clusters, mixture, ranks, rows, cells } = geometry;
  checkRagged(geometry, "cell_offset", packed.cellOffset, packed.coreScale.length, (s) => cells[s]!);
  checkRagged(geometry, "core_offset", packed.coreOffset, packed.core.length,
    (s) => ranks.reduce((all, rank) => all * rank[s]!, cells[s]!));
  for (const n of geometry.decomposed) {
    const entries = (s: number): number => rows[n]![s]! * mixture[n]![s]!;
    const others = (s: number): number => clusters.reduce((all, each, m) => (m === n ? all : all * each[s]!), 1);
    checkRagged(geometry, `cluster_offset/${n}`, packed.clusterOffset[n]!, packed.cluster[n]!.length, entries);
    checkRagged(geometry, `basis_offset/${n}`, packed.basisOffset[n]!, packed.basis[n]!.length,
      (s) => entries(s) * others(s) * ranks[n]![s]!);
  }
}

function checkRagged(
  geometry: Geometry, array: string, offsets: Uint32Array, length: number, needed: (s: number) => number,
): void {
  const name = nameIn(geometry, array);
  offsetSteps(offsets, name).forEach((step, s) => {
    if (step !== needed(s)) {
      throw fault("offset-size", name, `${step} numbers of node ${s}`, needed(s));
    }
  });
  const last = offsets[offsets.length - 1];
  if (last !== length) {
    throw fault("offset-end", name, `last offset ${last}`, `${length}, the length of the array`);
  }
}

/** Every row's cluster subsets exist in its node, are distinct and ascend. */
function checkClusters(geometry: Geometry): void {
  for (const n of geometry.decomposed) {
    checkModeClusters(geometry, n, "cluster-range");
    checkModeClusters(geometry, n, "cluster-order");
  }
}

function checkModeClusters(geometry: Geometry, n: number, reason: "cluster-range" | "cluster-order"): void {
  const cluster = geometry.packed.cluster[n]!;
  const name = nameIn(geometry, `cluster/${n}`);
  let at = 0;
  for (let s = 0; s < geometry.packed.nodes; s += 1) {
    const [allowed, mixture] = [geometry.clusters[n]![s]!, geometry.mixture[n]![s]!];
    const end = at + mixture * geometry.rows[n]![s]!;
    for (let k = 0; at < end; at += 1, k = k + 1 === mixture ? 0 : k + 1) {
      if (reason === "cluster-range" && cluster[at]! >= allowed) {
        throw fault(reason, name, `${cluster[at]} at ${at}`, `less than ${allowed}`);
      }
      if (reason === "cluster-order" && k > 0 && cluster[at]! <= cluster[at - 1]!) {
        throw fault(reason, name, `${cluster[at]} after ${cluster[at - 1]} at ${at - 1}`,
          "distinct subsets, ascending within a row");
      }
    }
  }
}

/**
 * A bound on all values of a level, whose numbers must be finite: the largest scale times the largest core number
 * times, for every decomposed mode, K R times the largest basis number, with no factor below 1.
 */
export function levelReach(geometry: Geometry): number {
  const { packed } = geometry;
  const scale = largestFinite(packed.coreScale, nameIn(geometry, "core_scale"));
  let reach = Math.max(1, scale * largestHalf(packed.core, nameIn(geometry, "core")));
  for (const n of geometry.decomposed) {
    const most = (column: Uint32Array): number => column.reduce((largest, each) => Math.max(largest, each), 0);
    const terms = most(geometry.mixture[n]!) * most(geometry.ranks[n]!);
    reach *= Math.max(1, terms * largestHalf(packed.basis[n]!, nameIn(geometry, `basis/${n}`)));
  }
  return reach;
}

/** The bound summed over the levels up to this one: no float32 decoder overflows. */
export function checkReach(reach: number, geometry: Geometry): void {
  if (reach > MAX_F32) {
    throw fault("value-range", nameIn(geometry, "core_scale"), `values up to ${reach.toPrecision(3)}`,
      `values up to ${MAX_F32.toPrecision(3)}`);
  }
}

/** The largest magnitude of numbers, all of which must be finite. */
export function largestFinite(array: Float32Array | Float64Array, name: string): number {
  let largest = 0;
  for (let at = 0; at < array.length; at += 1) {
    const size = Math.abs(array[at]!);
    if (!Number.isFinite(size)) {
      throw fault("not-finite", name, `${array[at]} at ${at}`, "finite numbers");
    }
    largest = size > largest ? size : largest;
  }
  return largest;
}

/** Likewise of half-precision patterns: without their sign bit they ascend as the integers with the same bits do. */
function largestHalf(bits: Uint16Array, name: string): number {
  let largest = 0;
  for (let at = 0; at < bits.length; at += 1) {
    const size = bits[at]! & 0x7fff;
    largest = size > largest ? size : largest;
  }
  if (largest >= HALF_INFINITY) {
    const at = bits.findIndex((each) => (each & 0x7fff) >= HALF_INFINITY);
    throw fault("not-finite", name, `${halfValue(bits[at]!)} at ${at}`, "finite numbers");
  }
  return halfValue(largest);
}
