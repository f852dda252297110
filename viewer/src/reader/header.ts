/** The safetensors header: eight bytes of length, a JSON object, and which bytes belong to which array. */

import { sha256 } from "./digests";
import { asInteger, asList, asMap, asObject, asOneOf, asText, checkSizes } from "./fields";
import { type Json, parseJson } from "./json";
import type { Limits } from "./limits";
import { fault } from "./reasons";

export const DTYPES = ["I8", "U8", "F16", "F32", "F64", "U16", "U32"] as const;
export type Dtype = (typeof DTYPES)[number];

/** Bytes of one number of each type that a file may hold. */
export const ITEM_SIZES: Record<Dtype, number> = { I8: 1, U8: 1, F16: 2, F32: 4, F64: 8, U16: 2, U32: 4 };

export const LENGTH_BYTES = 8;
const MAX_DIMENSIONS = 3;
const REFETCH = "fetch the file again";

/** An array as the header declares it: number type, shape, and byte range from the end of the header. */
export interface Entry {
  dtype: Dtype;
  shape: number[];
  begin: number;
  end: number;
}

/** A parsed header: the arrays in file order, the metadata text, which has its hash, and where the arrays start. */
export interface Header {
  entries: Map<string, Entry>;
  text: string;
  dataStart: number;
}

/** Bytes of the JSON of a file of `size` bytes, from the file's first eight. */
export function headerLength(start: Uint8Array, size: number, limits: Limits): number {
  if (size < LENGTH_BYTES) {
    throw fault("truncated", "header", `a file of ${size} bytes`, "8 bytes and more",
      "if it was longer where it comes from, fetch it again");
  }
  const exact = new DataView(start.buffer, start.byteOffset, LENGTH_BYTES).getBigUint64(0, true);
  const length = Number(exact);
  if (length > limits.json_bytes) {
    throw fault("header-too-large", "header", `${exact} bytes`, `at most ${limits.json_bytes}`,
      "check that it is an .hmk file");
  }
  if (LENGTH_BYTES + length > size) {
    throw fault("truncated", "header", `a file of ${size} bytes`, `a header up to byte ${LENGTH_BYTES + length}`, REFETCH);
  }
  return length;
}

/** Parse the JSON bytes of the header of a file of `size` bytes and check which bytes it gives to which array. */
export function parseHeader(raw: Uint8Array, size: number, limits: Limits): Header {
  checkBytes(raw);
  if (raw[0] !== 0x7b) {
    throw fault("json-syntax", "header", raw[0] ?? "nothing", "an object that starts with {");
  }
  const parsed = asMap(parseJson(decodeUtf8(raw, "header"), "header"), "header");
  const text = metadataText(parsed.get("__metadata__"), "header.__metadata__");
  parsed.delete("__metadata__");
  checkSizes(parsed, "header", limits);
  const found = Array.from(parsed, ([name, value]): [string, Entry] => [name, parseEntry(value, `header.${name}`)]);
  const entries = new Map(found.sort(([, a], [, b]) => a.begin - b.begin || a.end - b.end));
  const dataStart = LENGTH_BYTES + raw.length;
  checkCoverage(entries, dataStart, size);
  return { entries, text, dataStart };
}

/**
 * A control character is either white space that one flipped bit turns into other white space, or no JSON; of the
 * digits of a \u escape one flipped bit changes the case and nothing else. Both would go unnoticed.
 */
function checkBytes(raw: Uint8Array): void {
  const allowed = "no control characters, lower-case digits in \\u escapes";
  const control = raw.findIndex((byte) => byte < 32);
  if (control >= 0) {
    throw fault("header-bytes", "header", `byte ${raw[control]} at ${LENGTH_BYTES + control}`, allowed);
  }
  const found = /(?<!\\)(?:\\\\)*\\u[0-9a-fA-F]{0,3}[A-F]/.exec(new TextDecoder("latin1").decode(raw));
  if (found !== null) {
    throw fault("header-bytes", "header", `${found[0]} at byte ${LENGTH_BYTES + found.index}`, allowed);
  }
}

function decodeUtf8(raw: Uint8Array, where: string): string {
  try {
    return new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(raw);
  } catch {
    throw fault("json-encoding", where, "other bytes", "UTF-8");
  }
}

/** The metadata text, compared with its hash. */
function metadataText(texts: Json | undefined, where: string): string {
  if (!(texts instanceof Map) || !texts.has("hmkcta")) {
    throw fault("not-hmk", where, "safetensors without hmkcta", "an .hmk file", "compress the data with hmkcta first");
  }
  const found = asObject(texts, where, ["hmkcta", "hmkcta_sha256"]);
  const text = asText(found.hmkcta, `${where}.hmkcta`);
  const hash = asText(found.hmkcta_sha256, `${where}.hmkcta_sha256`);
  if (!text.isWellFormed()) {
    throw fault("json-encoding", `${where}.hmkcta`, "half a surrogate pair", "characters that UTF-8 can hold");
  }
  const digest = sha256(new TextEncoder().encode(text));
  if (digest !== hash) {
    throw fault("metadata-hash", `${where}.hmkcta_sha256`, hash.slice(0, 80), digest, REFETCH);
  }
  return text;
}

function parseEntry(value: Json, where: string): Entry {
  const fields = asObject(value, where, ["dtype", "shape", "data_offsets"]);
  const dtype = asOneOf(fields.dtype, `${where}.dtype`, DTYPES);
  const shape = parseShape(fields.shape, `${where}.shape`);
  const offsets = asList(fields.data_offsets, `${where}.data_offsets`, 2);
  const [begin = 0, end = 0] = offsets.map((item) => asInteger(item, `${where}.data_offsets`));
  const needed = product(shape) * ITEM_SIZES[dtype];
  if (end - begin !== needed) {
    throw fault("array-size", where, `${end - begin} bytes`, `${needed} bytes`);
  }
  return { dtype, shape, begin, end };
}

/** Product of some numbers, 1 for none. */
export function product(numbers: Iterable<number>): number {
  let result = 1;
  for (const number of numbers) {
    result *= number;
  }
  return result;
}

/** The shape of an array; none of the format's has more than three dimensions. */
export function parseShape(value: Json, where: string): number[] {
  const items = asList(value, where);
  if (items.length > MAX_DIMENSIONS) {
    throw fault("field-value", where, `${items.length} dimensions`, `at most ${MAX_DIMENSIONS}`);
  }
  return items.map((item) => asInteger(item, where));
}

/** The arrays, in order, must cover the file from the header to the last byte, each one aligned. */
function checkCoverage(entries: Map<string, Entry>, dataStart: number, size: number): void {
  let position = 0;
  for (const [name, entry] of entries) {
    if (entry.begin !== position) {
      throw fault("array-gap", `header.${name}`, `begin ${entry.begin}`, `begin ${position}`);
    }
    if ((dataStart + entry.begin) % ITEM_SIZES[entry.dtype] !== 0) {
      throw fault("array-alignment", `header.${name}`, `file offset ${dataStart + entry.begin}`,
        `a multiple of ${ITEM_SIZES[entry.dtype]}`);
    }
    position = entry.end;
  }
  if (dataStart + position > size) {
    throw fault("truncated", "data", `a file of ${size} bytes`, `${dataStart + position} bytes`, REFETCH);
  }
  if (dataStart + position < size) {
    throw fault("trailing-bytes", "data", `a file of ${size} bytes`, `${dataStart + position} bytes`);
  }
}
