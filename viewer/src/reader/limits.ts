/** Limits on what a file may declare, checked before anything of that size is allocated. */

import { type Reason, fault } from "./reasons";

/** The largest values a reader takes (`docs/format.md`, part II). */
export interface Limits {
  order: number; // modes of the tensor
  axes: number; // axes of the source array
  elements: number; // of the source array
  levels: number; // and stages without numbers
  nodes: number; // of all stages together
  clusters: number; // C_n
  mixture: number; // K_n
  rank: number; // R_n of a decomposed mode
  level_cost: number; // product of K_n R_n over the decomposed modes of a node
  widened: number; // bytes of the arrays of all stages, beyond 64 a byte of the file
  json_bytes: number; // the header
  json_depth: number;
  json_string: number; // characters of any string
}

export const DEFAULT_LIMITS: Limits = {
  order: 8, axes: 32, elements: 2 ** 48, levels: 16, nodes: 1_000_000, clusters: 65_535, mixture: 8, rank: 1024,
  level_cost: 2 ** 20, widened: 2 ** 26, json_bytes: 16 * 2 ** 20, json_depth: 16, json_string: 4096,
};

/** Most of `level_cost` that a shader decodes: one that runs for seconds is stopped by the system. */
export const ON_GPU = 2 ** 18;

/** Refuse a number above its limit. */
export function checkLimit(reason: Reason, where: string, found: number, allowed: number): void {
  if (found > allowed) {
    throw fault(reason, where, found, `at most ${allowed}`, "use a file that stays within the limit");
  }
}
