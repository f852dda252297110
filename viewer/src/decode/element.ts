/**
 * One element by `docs/format.md`, section 4, line by line: for the read-out under the pointer and for tests.
 *
 * The shader `decode.wgsl` does the same for all pixels at once.
 */

import { halfValues } from "../reader/half";
import type { Metadata, Transform } from "../reader/metadata";
import type { PackedLevel } from "../reader/packed";

/** The element with these rows of the modes up to `levels`, in the domain of the value transform. */
export function decodeRows(packed: PackedLevel[], rows: number[], levels: number): number {
  const pos = [...rows];
  let s = 0;
  let value = 0;
  for (let l = 0; l < levels; l += 1) {
    const level = packed[l]!;
    if (clustersOf(level, s, 0) === 0) {
      break;
    }
    value += nodeValue(level, s, pos);
    if (level.child === null || l + 1 === levels || level.child[s] === level.child[s + 1]) {
      break;
    }
    let part = 0;
    for (let n = 0; n < level.order; n += 1) {
      const [parts, locals] = [level.part[n], level.local[n]];
      part *= clustersOf(level, s, n);
      if (parts != null && locals != null) {
        const row = level.rowOffset[n]![s]! + pos[n]!;
        part += parts[row]!;
        pos[n] = locals[row]!;
      }
    }
    s = level.child[s]! + part;
  }
  return value;
}

function clustersOf(level: PackedLevel, s: number, n: number): number {
  return level.shape[3 * s * level.order + n]!;
}

/** What a node adds: the sum over all choices of one cluster subset a mode. */
function nodeValue(level: PackedLevel, s: number, pos: number[]): number {
  const { order, shape } = level;
  const at = (which: number): number[] =>
    Array.from({ length: order }, (_, n) => shape[(3 * s + which) * order + n]!);
  const [clusters, mixture, ranks] = [at(0), at(1), at(2)];
  const choice = new Array<number>(order).fill(0);
  let sum = 0;
  for (;;) {
    const cell = choice.map((k, n) => {
      const table = level.cluster[n];
      return table == null ? 0 : table[level.clusterOffset[n]![s]! + pos[n]! * mixture[n]! + k]!;
    });
    sum += cellValue(level, s, pos, choice, cell, clusters, mixture, ranks);
    let n = order - 1;
    while (n >= 0 && (choice[n]! += 1) === mixture[n]) {
      choice[n] = 0;
      n -= 1;
    }
    if (n < 0) {
      return sum;
    }
  }
}

function flatten(cell: number[], clusters: number[], without = -1): number {
  return cell.reduce((flat, c, n) => (n === without ? flat : flat * clusters[n]! + c), 0);
}

function cellValue(
  level: PackedLevel, s: number, pos: number[], choice: number[], cell: number[], clusters: number[],
  mixture: number[], ranks: number[],
): number {
  const half = halfValues();
  const flat = flatten(cell, clusters);
  const cells = clusters.reduce((all, each) => all * each, 1);
  const core = level.coreOffset[s]! + flat * ranks.reduce((all, each) => all * each, 1);
  const contract = (n: number, address: number): number => {
    if (n === level.order) {
      return half[level.core[core + address]!]!;
    }
    const rank = ranks[n]!;
    const basis = level.basis[n];
    if (basis == null) {
      return contract(n + 1, address * rank + pos[n]!);
    }
    const row = (pos[n]! * mixture[n]! + choice[n]!) * (cells / clusters[n]!) + flatten(cell, clusters, n);
    const first = level.basisOffset[n]![s]! + row * rank;
    let sum = 0;
    for (let r = 0; r < rank; r += 1) {
      sum += half[basis[first + r]!]! * contract(n + 1, address * rank + r);
    }
    return sum;
  };
  return level.coreScale[level.cellOffset[s]! + flat]! * contract(0, 0);
}

/** The source value behind a decoded one. */
export function sourceValue(value: number, transform: Transform): number {
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
  return sourceValue(decodeRows(packed, rows, levels), metadata.transform);
}

const SAMPLES = 4096;
const HASH = 2654435761;

/** The 0.5th and 99.5th percentile of 4096 elements spread over the model (exact products: i < 2^12, hash < 2^32). */
export function valueRange(metadata: Metadata, packed: PackedLevel[], levels: number): [number, number] {
  const sizes = metadata.axes.map((axis) => axis.size);
  const total = sizes.reduce((all, each) => all * each, 1);
  const values = new Float64Array(SAMPLES);
  for (let i = 0; i < SAMPLES; i += 1) {
    let flat = (i * HASH) % total;
    const index = new Array<number>(sizes.length);
    for (let n = sizes.length - 1; n >= 0; n -= 1) {
      index[n] = flat % sizes[n]!;
      flat = Math.floor(flat / sizes[n]!);
    }
    values[i] = decodeElement(metadata, packed, index, levels);
  }
  values.sort();
  return [values[Math.floor(0.005 * (SAMPLES - 1))]!, values[Math.ceil(0.995 * (SAMPLES - 1))]!];
}
