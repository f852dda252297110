/** Which arrays a file holds, their number types and, where the tables do not decide them, their shapes. */

import type { Dtype, Entry } from "./header";
import { type Limits, checkLimit } from "./limits";
import { type ArrayRecord, MAX_COORD_DIMENSIONS, NUMBER_TYPES, type Parsed, isShort, mayPack } from "./metadata";
import { BASIS_NUMBERS, CORE_NUMBERS, widen } from "./narrow";
import type { PackedLevel } from "./packed";
import { fault } from "./reasons";
import { unpackLevel } from "./rice";
import { type Geometry, nameIn } from "./tables";

const RAGGED = -1;

/** Where tables are short, arrays that may be left out, and the types that may stand for one in memory. */
const OPTIONAL = ["cluster", "part", "local"];
const NARROWER: Partial<Record<Dtype, Dtype[]>> = { U32: ["U8", "U16", "U32"], U16: ["U8", "U16"] };

type Info = { dtype: Dtype; shape: number[] };
export type TypedArray = Float32Array | Float64Array | Int8Array | Uint8Array | Uint16Array | Uint32Array;
/** An array by its name; null if there is none. */
export type Find = (name: string) => TypedArray | null;

/** Whether an array of this name holds core or basis numbers; all others are tables. */
export function isNumbers(name: string): boolean {
  return /^level\/\d+\/(core$|basis\/)/.test(name);
}

/** Names (without prefix) and infos of the arrays of a level with S = `nodes`; -1 for a ragged length. U8: it is packed. */
function levelSchema(
  order: number, undecomposed: number[], nodes: number, last: boolean, numbers: Dtype,
): [string, Info][] {
  const offsets: Info = { dtype: "U32", shape: [nodes + 1] };
  const ragged = (dtype: Dtype): Info => ({ dtype, shape: [RAGGED] });
  const result: [string, Info][] = [["shape", { dtype: "U32", shape: [nodes, 3, order] }]];
  if (!last) {
    result.push(["child", offsets]);
  }
  result.push(["core", ragged(numbers)], ["core_offset", offsets], ["core_scale", ragged("F32")], ["cell_offset", offsets]);
  for (let n = 0; n < order && numbers === "U8"; n += 1) {
    if (!undecomposed.includes(n)) {
      result.push([`rice/${n}`, ragged("U8")]);
    }
  }
  for (let n = 0; n < order; n += 1) {
    result.push([`row_offset/${n}`, offsets]);
    if (undecomposed.includes(n)) {
      continue;
    }
    result.push([`cluster/${n}`, ragged("U16")], [`cluster_offset/${n}`, offsets]);
    result.push([`basis/${n}`, ragged(numbers)], [`basis_offset/${n}`, offsets]);
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
    if (record.info !== null && entry.dtype !== record.info.dtype) {
      throw fault("array-dtype", name, entry.dtype, record.info.dtype);
    }
    if (record.info !== null && entry.shape.join() !== record.info.shape.join()) {
      throw fault("array-shape", name, `[${entry.shape.join()}]`, `[${record.info.shape.join()}]`);
    }
  }
  for (const name of entries.keys()) {
    if (!records.has(name)) {
      throw fault("array-unexpected", name, "an array", "none without a record in the metadata");
    }
  }
}

/**
 * The arrays must be exactly those that the metadata calls for.
 *
 * Where the version has bytes, the type of a level's core is that of its bases; no F16 follows a level of bytes.
 */
export function checkSchema(parsed: Parsed, entries: Map<string, Entry>, limits: Limits): void {
  const short = isShort(parsed.version);
  const expected = expectedArrays(parsed, entries, limits);
  for (const [name, info] of expected) {
    if (!(short && !entries.has(name) && OPTIONAL.includes(name.split("/")[2]!))) {
      checkInfo(name, required(name, entries), (short ? NARROWER[info.dtype] : undefined) ?? [info.dtype], info.shape);
    }
  }
  checkCoords(parsed, entries);
  const named = new Set(parsed.coords.values());
  for (const name of entries.keys()) {
    if (!expected.has(name) && !named.has(name)) {
      throw fault("array-unexpected", name, "an array", "no such array");
    }
  }
}

/** The arrays that the levels have, by their names. */
function expectedArrays({ metadata, version }: Parsed, entries: Map<string, Entry>, limits: Limits): Map<string, Info> {
  const { modeSizes, undecomposed } = metadata;
  const expected = new Map<string, Info>();
  const depth = metadata.levels.length;
  let nodes = 0;
  let bytes = false;
  for (let level = 1; level <= depth; level += 1) {
    const name = `level/${level}/shape`;
    const count = required(name, entries).shape[0] ?? 0;
    nodes += count;
    checkLimit("nodes-limit", name, nodes, limits.nodes);
    const core = entries.get(`level/${level}/core`)?.dtype;
    const packed = core === "U8" && mayPack(version) && undecomposed.length < modeSizes.length;
    bytes ||= packed || (core === "I8" && NUMBER_TYPES[version].includes("I8"));
    const numbers = packed ? "U8" : bytes ? "I8" : "F16";
    for (const [part, info] of levelSchema(modeSizes.length, undecomposed, count, level === depth, numbers)) {
      if (!(isShort(version) && part.includes("_offset"))) {
        expected.set(`level/${level}/${part}`, info);
      }
    }
  }
  return expected;
}

function checkCoords({ metadata, coords }: Parsed, entries: Map<string, Entry>): void {
  for (const [n, name] of coords) {
    const entry = required(name, entries);
    const width = entry.shape.slice(1, 2);
    checkInfo(name, entry, ["F32", "F64"], [metadata.axes[n]?.size ?? 0, ...width]);
    if (width.some((numbers) => numbers < 1 || numbers > MAX_COORD_DIMENSIONS)) {
      throw fault("array-shape", name, `[${entry.shape.join()}]`, `1 to ${MAX_COORD_DIMENSIONS} numbers an index`);
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

/** In file order, all tables come before core and basis numbers, which go level by level. */
export function checkOrder(entries: Map<string, Entry>): void {
  let level = 0;
  for (const [name, entry] of entries) {
    if (entry.shape.includes(0)) {
      continue; // an empty array stands nowhere in particular
    }
    const its = isNumbers(name) ? Number(name.split("/")[1]) : 0;
    if (its < level) {
      throw fault("array-order", name, `after core or basis numbers of level ${level}`,
        "tables first, then core and basis numbers level by level");
    }
    level = Math.max(level, its);
  }
}

/** The array of an entry, as a view of the file's bytes. */
export function viewOf(file: Uint8Array<ArrayBuffer>, dataStart: number, entry: Entry): TypedArray {
  const types = {
    I8: Int8Array, U8: Uint8Array, F16: Uint16Array, F32: Float32Array, F64: Float64Array, U16: Uint16Array, U32: Uint32Array,
  };
  const type = types[entry.dtype];
  if (entry.begin === entry.end) {
    return new type(0);
  }
  return new type(file.buffer, file.byteOffset + dataStart + entry.begin,
    (entry.end - entry.begin) / type.BYTES_PER_ELEMENT);
}

/**
 * The packed level made of a file's arrays, which `checkSchema` has let through.
 *
 * Where its core and basis numbers are bytes, or it is packed, there is room for what they stand for, which `widenLevel`
 * fills.
 */
export function levelOf(array: Find, level: number, order: number): PackedLevel {
  const find = <Type extends TypedArray>(name: string): Type | null => array(`level/${level}/${name}`) as Type | null;
  const get = <Type extends TypedArray>(name: string): Type => {
    const found = find<Type>(name);
    if (found === null) {
      throw fault("array-missing", `level/${level}/${name}`, "no such array", "an array");
    }
    return found;
  };
  const numbers = (stored: Uint16Array | Int8Array | Uint8Array, offsets: string): Uint16Array => {
    if (stored instanceof Uint8Array) { // offsets of short tables, which what the file holds has bounded
      return new Uint16Array(get<Uint32Array>(offsets).at(-1)!);
    }
    return stored instanceof Int8Array ? new Uint16Array(stored.length) : stored;
  };
  const bases = (n: number): Uint16Array | null => {
    const stored = find<Uint16Array | Int8Array | Uint8Array>(`basis/${n}`);
    return stored === null ? null : numbers(stored, `basis_offset/${n}`);
  };
  const modes = Array.from({ length: order }, (_, n) => n);
  const coreOffset = get<Uint32Array>("core_offset");
  return {
    order, coreOffset, nodes: coreOffset.length - 1,
    shape: get("shape"), child: find("child"), rowOffset: modes.map((n) => get(`row_offset/${n}`)),
    core: numbers(get("core"), "core_offset"), coreScale: get("core_scale"), cellOffset: get("cell_offset"),
    cluster: modes.map((n) => find(`cluster/${n}`)), clusterOffset: modes.map((n) => find(`cluster_offset/${n}`)),
    basis: modes.map(bases), basisOffset: modes.map((n) => find(`basis_offset/${n}`)),
    part: modes.map((n) => find(`part/${n}`)), local: modes.map((n) => find(`local/${n}`)),
  };
}

/** Fill a level of bytes, or a packed one, with the numbers that are meant. */
export function widenLevel(geometry: Geometry, array: Find): void {
  const core = array(nameIn(geometry, "core"));
  if (core instanceof Uint8Array) {
    unpackLevel(geometry, array);
  } else if (core instanceof Int8Array) {
    widen(core, CORE_NUMBERS, geometry.packed.core);
    for (const n of geometry.decomposed) {
      widen(array(nameIn(geometry, `basis/${n}`)) as Int8Array, BASIS_NUMBERS, geometry.packed.basis[n]!);
    }
  }
}
