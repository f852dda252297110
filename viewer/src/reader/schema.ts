/** Which arrays a file holds, their number types and, where the tables do not decide them, their shapes. */

import type { Dtype, Entry } from "./header";
import { type Limits, checkLimit } from "./limits";
import { type ArrayRecord, MAX_COORD_DIMENSIONS, type Parsed } from "./metadata";
import type { PackedLevel } from "./packed";
import { fault } from "./reasons";

const RAGGED = -1;

type Info = { dtype: Dtype; shape: number[] };
export type TypedArray = Float32Array | Float64Array | Uint16Array | Uint32Array;

/** Names (without prefix) and infos of the arrays of a level with S = `nodes`; -1 for a ragged length. */
function levelSchema(order: number, undecomposed: number[], nodes: number, last: boolean): [string, Info][] {
  const offsets: Info = { dtype: "U32", shape: [nodes + 1] };
  const ragged = (dtype: Dtype): Info => ({ dtype, shape: [RAGGED] });
  const result: [string, Info][] = [["shape", { dtype: "U32", shape: [nodes, 3, order] }]];
  if (!last) {
    result.push(["child", offsets]);
  }
  result.push(["core", ragged("F16")], ["core_offset", offsets], ["core_scale", ragged("F32")], ["cell_offset", offsets]);
  for (let n = 0; n < order; n += 1) {
    result.push([`row_offset/${n}`, offsets]);
    if (undecomposed.includes(n)) {
      continue;
    }
    result.push([`cluster/${n}`, ragged("U16")], [`cluster_offset/${n}`, offsets]);
    result.push([`basis/${n}`, ragged("F16")], [`basis_offset/${n}`, offsets]);
    if (!last) {
      result.push([`part/${n}`, ragged("U16")], [`local/${n}`, ragged("U32")]);
    }
  }
  return result;
}

/** The header and the metadata must speak of the same arrays. */
export function checkRecords(records: Map<string, ArrayRecord>, entries: Map<string, Entry>): void {
  for (const [name, record] of records) {
    const entry = entries.get(name);
    if (entry === undefined) {
      throw fault("array-missing", name, "no such array", "an array, as the metadata has a record of it");
    }
    if (entry.dtype !== record.dtype) {
      throw fault("array-dtype", name, entry.dtype, record.dtype);
    }
    if (entry.shape.join() !== record.shape.join()) {
      throw fault("array-shape", name, `[${entry.shape.join()}]`, `[${record.shape.join()}]`);
    }
  }
  for (const name of entries.keys()) {
    if (!records.has(name)) {
      throw fault("array-unexpected", name, "an array", "none without a record in the metadata");
    }
  }
}

/** The arrays must be exactly those that the metadata calls for. */
export function checkSchema(parsed: Parsed, entries: Map<string, Entry>, limits: Limits): void {
  const { metadata, coords } = parsed;
  const expected = new Map<string, Info>();
  const depth = metadata.levels.length;
  let nodes = 0;
  for (let level = 1; level <= depth; level += 1) {
    const name = `level/${level}/shape`;
    const count = required(name, entries).shape[0] ?? 0;
    nodes += count;
    checkLimit("nodes-limit", name, nodes, limits.nodes);
    for (const [part, info] of levelSchema(metadata.modeSizes.length, metadata.undecomposed, count, level === depth)) {
      expected.set(`level/${level}/${part}`, info);
    }
  }
  for (const [name, info] of expected) {
    checkInfo(name, required(name, entries), [info.dtype], info.shape);
  }
  for (const [n, name] of coords) {
    const entry = required(name, entries);
    const width = entry.shape.slice(1, 2);
    checkInfo(name, entry, ["F32", "F64"], [metadata.axes[n]?.size ?? 0, ...width]);
    if (width.some((numbers) => numbers < 1 || numbers > MAX_COORD_DIMENSIONS)) {
      throw fault("array-shape", name, `[${entry.shape.join()}]`, `1 to ${MAX_COORD_DIMENSIONS} numbers an index`);
    }
  }
  const named = new Set(coords.values());
  for (const name of entries.keys()) {
    if (!expected.has(name) && !named.has(name)) {
      throw fault("array-unexpected", name, "an array", "no such array");
    }
  }
}

function required(name: string, entries: Map<string, Entry>): Entry {
  const entry = entries.get(name);
  if (entry === undefined) {
    throw fault("array-missing", name, "no such array", "an array");
  }
  return entry;
}

function checkInfo(name: string, found: Info, dtypes: Dtype[], shape: number[]): void {
  if (!dtypes.includes(found.dtype)) {
    throw fault("array-dtype", name, found.dtype, dtypes.join(" or "));
  }
  const same = found.shape.length === shape.length
    && found.shape.every((size, n) => shape[n] === RAGGED || shape[n] === size);
  if (!same) {
    const shown = shape.map((size) => (size === RAGGED ? "any length" : size));
    throw fault("array-shape", name, `[${found.shape.join()}]`, `[${shown.join()}]`);
  }
}

/** In file order, all tables come before the F16 arrays, which go level by level. */
export function checkOrder(entries: Map<string, Entry>): void {
  let level = 0;
  for (const [name, entry] of entries) {
    if (entry.shape.includes(0)) {
      continue; // an empty array stands nowhere in particular
    }
    const its = entry.dtype === "F16" ? Number(name.split("/")[1]) : 0;
    if (its < level) {
      throw fault("array-order", name, `after an F16 array of level ${level}`,
        "tables first, then F16 arrays level by level");
    }
    level = Math.max(level, its);
  }
}

/** The array of an entry, as a view of the file's bytes. */
export function viewOf(file: Uint8Array<ArrayBuffer>, dataStart: number, entry: Entry): TypedArray {
  const types = { F16: Uint16Array, F32: Float32Array, F64: Float64Array, U16: Uint16Array, U32: Uint32Array };
  const type = types[entry.dtype];
  if (entry.begin === entry.end) {
    return new type(0);
  }
  return new type(file.buffer, file.byteOffset + dataStart + entry.begin,
    (entry.end - entry.begin) / type.BYTES_PER_ELEMENT);
}

/** The packed level made of a file's arrays, which `checkSchema` has let through. */
export function levelOf(array: (name: string) => TypedArray | null, level: number, order: number): PackedLevel {
  const find = <Type extends TypedArray>(name: string): Type | null => array(`level/${level}/${name}`) as Type | null;
  const get = <Type extends TypedArray>(name: string): Type => {
    const found = find<Type>(name);
    if (found === null) {
      throw fault("array-missing", `level/${level}/${name}`, "no such array", "an array");
    }
    return found;
  };
  const modes = Array.from({ length: order }, (_, n) => n);
  const coreOffset = get<Uint32Array>("core_offset");
  return {
    order, coreOffset, nodes: coreOffset.length - 1,
    shape: get("shape"), child: find("child"), rowOffset: modes.map((n) => get(`row_offset/${n}`)),
    core: get("core"), coreScale: get("core_scale"), cellOffset: get("cell_offset"),
    cluster: modes.map((n) => find(`cluster/${n}`)), clusterOffset: modes.map((n) => find(`cluster_offset/${n}`)),
    basis: modes.map((n) => find(`basis/${n}`)), basisOffset: modes.map((n) => find(`basis_offset/${n}`)),
    part: modes.map((n) => find(`part/${n}`)), local: modes.map((n) => find(`local/${n}`)),
  };
}
