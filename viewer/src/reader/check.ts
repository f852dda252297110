/** Checks of a stage that is read: its largest shapes are those that the header says, its numbers finite and in range. */

import { halfValue } from "./half";
import type { PackedLevel } from "./packed";
import { fault } from "./reasons";
import type { LevelBounds } from "./stages";

export const MAX_F32 = 3.4028234663852886e38;
const HALF_INFINITY = 0x7c00;

/** What shaders and limits rely on. */
export function checkLargest(level: PackedLevel, stage: LevelBounds, where: string): void {
  [stage.clusters, stage.mixture, stage.ranks].forEach((stated, which) => {
    const found = stated.map(() => 0);
    for (let s = 0; s < level.nodes; s += 1) {
      for (let n = 0; n < level.order; n += 1) {
        found[n] = Math.max(found[n]!, level.shape[(3 * s + which) * level.order + n]!);
      }
    }
    if (found.join() !== stated.join()) {
      throw fault("level-bounds", `${where}.largest[${which}]`, `[${stated.join()}]`, `[${found.join()}]`);
    }
  });
}

/** Multiply-adds of one element at most, in any node of a stage. */
export function largestCost({ nodes, order, shape }: PackedLevel): number {
  let largest = 0;
  for (let s = 0; s < nodes; s += 1) {
    let cost = 1;
    for (let n = 0; n < order; n += 1) {
      const k = shape[(3 * s + 1) * order + n]!;
      cost *= k === 0 ? 1 : k * shape[(3 * s + 2) * order + n]!;
    }
    largest = Math.max(largest, cost);
  }
  return largest;
}

/**
 * A bound on all values of a stage, whose numbers must be finite: the largest scale times the largest core number times,
 * for every mode, the largest K R of a node in which it is decomposed times the largest basis number; no factor below 1.
 */
export function levelReach(level: PackedLevel, where: string): number {
  const { order, shape } = level;
  let reach = Math.max(1, largestFinite(level.coreScale, where) * largestHalf(level.core, where));
  for (let n = 0; n < order; n += 1) {
    let [mixture, rank] = [0, 0];
    for (let s = 0; s < level.nodes; s += 1) {
      const k = shape[(3 * s + 1) * order + n]!;
      mixture = Math.max(mixture, k);
      rank = k > 0 ? Math.max(rank, shape[(3 * s + 2) * order + n]!) : rank;
    }
    reach *= Math.max(1, mixture * rank * largestHalf(level.basis[n]!, where));
  }
  return reach;
}

/** The bound summed over the stages up to this one: no float32 decoder overflows. */
export function checkReach(reach: number, where: string): void {
  if (reach > MAX_F32) {
    throw fault("value-range", where, `values up to ${reach.toPrecision(3)}`, `values up to ${MAX_F32.toPrecision(3)}`);
  }
}

/** The largest magnitude of numbers, all of which must be finite. */
export function largestFinite(array: Float32Array | Float64Array, where: string): number {
  let largest = 0;
  for (let at = 0; at < array.length; at += 1) {
    const size = Math.abs(array[at]!);
    if (!Number.isFinite(size)) {
      throw fault("not-finite", where, `${array[at]} at ${at}`, "finite numbers");
    }
    largest = size > largest ? size : largest;
  }
  return largest;
}

/** Likewise of half-precision patterns: without their sign bit they ascend as the integers with the same bits do. */
function largestHalf(bits: Uint16Array, where: string): number {
  let largest = 0;
  for (let at = 0; at < bits.length; at += 1) {
    const size = bits[at]! & 0x7fff;
    largest = size > largest ? size : largest;
  }
  if (largest >= HALF_INFINITY) {
    const at = bits.findIndex((each) => (each & 0x7fff) >= HALF_INFINITY);
    throw fault("not-finite", where, `${halfValue(bits[at]!)} at ${at}`, "finite numbers");
  }
  return halfValue(largest);
}
