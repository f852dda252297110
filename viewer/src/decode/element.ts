/**
 * One element, line by line: for the read-out under the pointer and for tests.
 *
 * The shader `decode.wgsl` does the same for all pixels at once.
 */

import { MAX_F32 } from "../reader/check";
import { halfValues } from "../reader/half";
import { type Metadata, type Transform, levelEnds } from "../reader/metadata";
import type { PackedLevel } from "../reader/packed";

/** The element with these rows of the modes up to so many stages, in the domain of the value transform. */
export function decodeRows(packed: PackedLevel[], rows: number[], stages: number): number {
  const pos = [...rows];
  let s = 0;
  let value = 0;
  for (let t = 0; t < stages; t += 1) {
    const level = packed[t]!;
    if (level.cellOffset[s] !== level.cellOffset[s + 1]) { // else it is empty, or a cut
      value += nodeValue(level, s, pos);
    }
    if (level.child === null || t + 1 === stages || level.child[s] === level.child[s + 1]) {
      break;
    }
    let part = 0;
    for (let n = 0; n < level.order; n += 1) {
      const clusters = clustersOf(level, s, n);
      if (clusters > 1) { // else all rows go to part 0, and keep their places
        const row = level.rowOffset[n]![s]! + pos[n]!;
        part = part * clusters + level.part[n]![row]!;
        pos[n] = level.local[n]![row]!;
      }
    }
    s = level.child[s]! + part;
  }
  return value;
}

function clustersOf(level: PackedLevel, s: number, n: number): number {
  return level.shape[3 * s * level.order + n]!;
}

const MOST_MODES = 32;

/** The node at hand, and its cell at hand, mode by mode: one element is nothing beside thousands, so nothing is made anew. */
const node = {
  clusters: new Int32Array(MOST_MODES), mixture: new Int32Array(MOST_MODES), ranks: new Int32Array(MOST_MODES),
  choice: new Int32Array(MOST_MODES), cell: new Int32Array(MOST_MODES),
  weights: Array.from({ length: MOST_MODES }, () => new Float64Array(0)), // the basis row; none in an undecomposed mode
};

/** What a node adds: the sum over all choices of one cluster subset a mode. */
function nodeValue(level: PackedLevel, s: number, pos: number[]): number {
  const { order, shape } = level;
  const { clusters, mixture, ranks, choice, cell } = node;
  let cells = 1;
  for (let n = 0; n < order; n += 1) {
    const at = 3 * s * order + n;
    clusters[n] = shape[at]!;
    mixture[n] = shape[at + order]!;
    ranks[n] = shape[at + 2 * order]!;
    choice[n] = 0;
    cells *= clusters[n]!;
    if (mixture[n]! > 0 && node.weights[n]!.length < ranks[n]!) {
      node.weights[n] = new Float64Array(ranks[n]!);
    }
  }
  let sum = 0;
  for (;;) {
    for (let n = 0; n < order; n += 1) {
      cell[n] = clusters[n] === 1 ? 0 : level.cluster[n]![level.clusterOffset[n]![s]! + pos[n]! * mixture[n]! + choice[n]!]!;
    }
    sum += cellValue(level, s, pos, cells);
    let n = order - 1;
    while (n >= 0 && (choice[n]! += 1) >= mixture[n]!) {
      choice[n] = 0;
      n -= 1;
    }
    if (n < 0) {
      return sum;
    }
  }
}

/** The number of the cell at hand among those of its node, or among the others' combinations without a mode. */
function flatCell(order: number, without: number): number {
  let flat = 0;
  for (let n = 0; n < order; n += 1) {
    flat = n === without ? flat : flat * node.clusters[n]! + node.cell[n]!;
  }
  return flat;
}

function cellValue(level: PackedLevel, s: number, pos: number[], cells: number): number {
  const { order } = level;
  const half = halfValues();
  let numbers = 1;
  for (let n = 0; n < order; n += 1) {
    const rank = node.ranks[n]!;
    numbers *= rank;
    if (node.mixture[n]! > 0) {
      const basis = level.basis[n]!;
      const row = (pos[n]! * node.mixture[n]! + node.choice[n]!) * (cells / node.clusters[n]!) + flatCell(order, n);
      const first = level.basisOffset[n]![s]! + row * rank;
      for (let r = 0; r < rank; r += 1) {
        node.weights[n]![r] = half[basis[first + r]!]!;
      }
    }
  }
  const flat = flatCell(order, -1);
  return level.coreScale[level.cellOffset[s]! + flat]! * contracted(level, pos, 0, level.coreOffset[s]! + flat * numbers, numbers, half);
}

/** The core at `at`, of which so many numbers belong to modes from n on, times their weights. */
function contracted(level: PackedLevel, pos: number[], n: number, at: number, numbers: number, half: Float32Array): number {
  const rank = node.ranks[n]!;
  const stride = numbers / rank;
  const { core } = level;
  const last = n === level.order - 1;
  if (node.mixture[n] === 0) {
    const place = at + pos[n]! * stride;
    return last ? half[core[place]!]! : contracted(level, pos, n + 1, place, stride, half);
  }
  const weights = node.weights[n]!;
  let sum = 0;
  if (last) {
    for (let r = 0; r < rank; r += 1) {
      sum += weights[r]! * half[core[at + r]!]!;
    }
    return sum;
  }
  for (let r = 0; r < rank; r += 1) {
    sum += weights[r]! * contracted(level, pos, n + 1, at + r * stride, stride, half);
  }
  return sum;
}

/** The source value behind a decoded one; what is too large becomes the largest float32 number. */
export function sourceValue(value: number, transform: Transform): number {
  return Math.max(-MAX_F32, Math.min(inverse(value, transform), MAX_F32));
}

function inverse(value: number, transform: Transform): number {
  switch (transform.name) {
    case "log1p": return transform.scale * Math.expm1(value);
    case "asinh": return transform.scale * Math.sinh(value);
    case "sqrt": return Math.max(value, 0) ** 2;
    default: return value;
  }
}

/** For each source axis its mode, and by how many rows of the mode an index of it counts. */
export function axisPlaces(metadata: Metadata): { mode: number; stride: number }[] {
  const size = new Map(metadata.axes.map((axis) => [axis.name, axis.size]));
  const places = new Map<string, { mode: number; stride: number }>();
  metadata.organisation.forEach((names, mode) => {
    let stride = 1;
    for (const name of [...names].reverse()) {
      places.set(name, { mode, stride });
      stride *= size.get(name) ?? 1;
    }
  });
  return metadata.axes.map((axis) => places.get(axis.name) ?? { mode: 0, stride: 1 });
}

/** The source value at an index of every source axis, from the first `levels` levels. */
export function decodeElement(metadata: Metadata, packed: PackedLevel[], index: number[], levels: number): number {
  const rows = new Array<number>(metadata.modeSizes.length).fill(0);
  axisPlaces(metadata).forEach(({ mode, stride }, axis) => {
    rows[mode]! += index[axis]! * stride;
  });
  return sourceValue(decodeRows(packed, rows, levelEnds(metadata)[levels - 1]!), metadata.transform);
}

export const SAMPLES = 4096;
const HASH = 2654435761;

/** Of some elements spread over a model: the 0.5th and 99.5th percentile, and the extremes. */
export interface ValueRange {
  low: number;
  high: number;
  least: number;
  most: number;
}

/** The range of a model's values; where the percentiles are one value they are the extremes (exact products: i < 2^12, hash < 2^32). */
export function valueRange(metadata: Metadata, packed: PackedLevel[], levels: number, samples = SAMPLES): ValueRange {
  const sizes = metadata.axes.map((axis) => axis.size);
  const total = sizes.reduce((all, each) => all * each, 1);
  const places = axisPlaces(metadata);
  const rows = metadata.modeSizes.map(() => 0);
  const values = new Float64Array(samples);
  const stages = levelEnds(metadata)[levels - 1]!;
  for (let i = 0; i < samples; i += 1) {
    let flat = (i * HASH) % total;
    rows.fill(0);
    for (let n = sizes.length - 1; n >= 0; n -= 1) {
      rows[places[n]!.mode]! += (flat % sizes[n]!) * places[n]!.stride;
      flat = Math.floor(flat / sizes[n]!);
    }
    values[i] = sourceValue(decodeRows(packed, rows, stages), metadata.transform);
  }
  values.sort();
  const [least, most] = [values[0]!, values[samples - 1]!];
  const [low, high] = [values[Math.floor(0.005 * (samples - 1))]!, values[Math.ceil(0.995 * (samples - 1))]!];
  return low < high ? { low, high, least, most } : { low: least, high: most, least, most };
}
