/** The shared corpus of `.hmk` cases: building each case's bytes, independently of the reader (`tests/corpus/README.md`). */

import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { crc32 } from "node:zlib";

const TESTS = join(import.meta.dirname, "..", "..", "tests");
const ITEM_SIZES: Record<string, number> = { I8: 1, U8: 1, F16: 2, F32: 4, F64: 8, U16: 2, U32: 4 };

interface Edit {
  op: string;
  at?: number;
  hex?: string;
  size?: number;
  path?: (string | number)[];
  value?: unknown;
  remove?: boolean;
  old?: string;
  new?: string;
  pad?: number;
  name?: string;
  values?: number[];
  dtype?: string;
  shape?: number[];
  first?: boolean;
}

export interface Case {
  name: string;
  base: string | null;
  edits?: Edit[];
  limits?: Record<string, number>;
  expect: { kind: string; reason: string; where?: string };
}

/** The fixtures of all versions. */
export const FIXTURES = readdirSync(join(TESTS, "fixtures")).filter((name) => name.endsWith(".hmk"));

/** The bytes of a fixture of the format. */
export function fixture(name: string): Buffer {
  return readFileSync(join(TESTS, "fixtures", name));
}

/** All cases of all files of the corpus. */
export function readCorpus(): Case[] {
  const folder = join(TESTS, "corpus");
  const names = readdirSync(folder).filter((name) => name.endsWith(".json"));
  return names.flatMap((name) => (JSON.parse(readFileSync(join(folder, name), "utf-8")) as { cases: Case[] }).cases);
}

/** The bytes of a case; null if there must be no file at all. */
export function build(each: Case): Uint8Array<ArrayBuffer> | null {
  if (each.base === null) {
    return null;
  }
  const data = (each.edits ?? []).reduce(applyEdit, each.base === "" ? Buffer.alloc(0) : fixture(each.base));
  return new Uint8Array(data); // a copy at the beginning of its own memory, as a browser has it
}

function applyEdit(data: Buffer, edit: Edit): Buffer {
  if (edit.op === "append") {
    return Buffer.concat([data, Buffer.from(edit.hex!, "hex")]);
  }
  if (edit.op === "truncate") {
    return data.subarray(0, edit.size! < 0 ? data.length + edit.size! : edit.size!);
  }
  if (edit.op === "bytes") {
    const copy = Buffer.from(data);
    Buffer.from(edit.hex!, "hex").copy(copy, edit.at! < 0 ? data.length + edit.at! : edit.at!);
    return copy;
  }
  const parts = new Parts(data);
  if (edit.op.startsWith("header")) {
    return parts.editHeader(edit);
  }
  if (edit.op.startsWith("metadata")) {
    parts.editMetadata(edit);
  } else {
    parts.editArray(edit);
  }
  return parts.join();
}

type Tree = { [key: string | number]: Tree };

function setPath(root: unknown, edit: Edit): void {
  const path = [...edit.path!];
  const last = path.pop()!;
  const parent = path.reduce((node, key) => node[key]!, root as Tree);
  if (edit.remove !== true) {
    parent[last] = edit.value as Tree;
  } else if (Array.isArray(parent)) {
    parent.splice(Number(last), 1);
  } else {
    delete parent[last];
  }
}

function replaceOnce(text: string, edit: Edit): string {
  if (!text.includes(edit.old!)) {
    throw new Error(`${edit.old} does not occur`);
  }
  return text.replace(edit.old!, () => edit.new!);
}

/** Node's own JSON never escapes beyond ASCII, except halves of surrogate pairs, which Python writes as such bytes. */
function utf8(text: string): Buffer {
  return Buffer.from(text, "utf-8");
}

/** Padded, unless it is said by how much, up to where `lead` bytes more end at a multiple of 8. */
function frame(text: string, body: Buffer, lead: number, pad?: number): Buffer {
  const raw = utf8(text);
  const spaces = Buffer.alloc(pad ?? (8 - ((raw.length + lead) % 8)) % 8, " ");
  const length = Buffer.alloc(8);
  length.writeBigUInt64LE(BigInt(raw.length + spaces.length));
  return Buffer.concat([length, raw, spaces, body]);
}

/** A well-formed file taken apart. */
class Parts {
  private readonly header: Record<string, { dtype: string; shape: number[]; data_offsets: [number, number] }>;
  private text: string;
  private arrays: Map<string, { dtype: string; shape: number[]; data: Buffer }>;
  private readonly body: Buffer;

  constructor(data: Buffer) {
    const length = Number(data.readBigUInt64LE(0));
    const header = JSON.parse(data.subarray(8, 8 + length).toString("utf-8")) as typeof this.header;
    this.header = header;
    this.text = (header["__metadata__"] as unknown as { hmkcta: string }).hmkcta;
    this.body = data.subarray(8 + length);
    this.arrays = new Map(Object.entries(header).filter(([name]) => name !== "__metadata__")
      .map(([name, { dtype, shape, data_offsets }]) => [name, { dtype, shape, data: this.body.subarray(...data_offsets) }]));
  }

  join(): Buffer {
    const hash = createHash("sha256").update(utf8(this.text)).digest("hex");
    const header: Record<string, unknown> = { __metadata__: { hmkcta: this.text, hmkcta_sha256: hash } };
    let begin = 0;
    for (const [name, { dtype, shape, data }] of this.arrays) {
      header[name] = { dtype, shape, data_offsets: [begin, begin + data.length] };
      begin += data.length;
    }
    return frame(JSON.stringify(header), Buffer.concat([...this.arrays.values()].map(({ data }) => data)), this.lead);
  }

  /** Bytes of the U8 arrays at the beginning. */
  private get lead(): number {
    const arrays = [...this.arrays.values()];
    const first = arrays.findIndex(({ dtype }) => dtype !== "U8");
    return arrays.slice(0, first).reduce((all, { data }) => all + data.length, 0);
  }

  editHeader(edit: Edit): Buffer {
    if (edit.op === "header") {
      setPath(this.header, edit);
      return frame(JSON.stringify(this.header), this.body, this.lead);
    }
    const text = JSON.stringify(this.header);
    return frame(edit.op === "header-text" ? replaceOnce(text, edit) : text, this.body, this.lead, edit.pad);
  }

  editMetadata(edit: Edit): void {
    if (edit.op === "metadata-text") {
      this.text = replaceOnce(this.text, edit);
      return;
    }
    const metadata: unknown = JSON.parse(this.text);
    setPath(metadata, edit);
    this.text = JSON.stringify(metadata);
  }

  editArray(edit: Edit): void {
    const name = edit.name!;
    const old = this.arrays.get(name);
    if (edit.op === "array-drop") {
      this.arrays.delete(name);
    } else if (edit.op === "array-last") {
      this.arrays.delete(name);
      this.arrays.set(name, old!);
    } else if (edit.op === "array-put") {
      const data = Buffer.from(old!.data);
      const numbers = edit.values === undefined ? Buffer.from(edit.hex!, "hex") : pack(edit.values, old!.dtype);
      numbers.copy(data, edit.at! * ITEM_SIZES[old!.dtype]!);
      this.arrays.set(name, { ...old!, data });
    } else {
      const size = edit.shape!.reduce((all, each) => all * each, 1) * ITEM_SIZES[edit.dtype!]!;
      const data = edit.values === undefined ? Buffer.alloc(size) : pack(edit.values, edit.dtype!);
      const array = { dtype: edit.dtype!, shape: edit.shape!, data };
      this.arrays.set(name, array);
      this.arrays = edit.first === true ? new Map([[name, array], ...this.arrays]) : this.arrays;
    }
    this.record(name);
  }

  /** Make the metadata's record of an array anew, or remove it with the array. */
  private record(name: string): void {
    const metadata = JSON.parse(this.text) as { version: string; arrays: Record<string, unknown> };
    const array = this.arrays.get(name);
    if (array === undefined) {
      delete metadata.arrays[name];
    } else {
      const checksum = crc32(array.data);
      metadata.arrays[name] = ["1.2", "1.4"].includes(metadata.version) ? checksum
        : { dtype: array.dtype, shape: array.shape, crc32: checksum };
    }
    this.text = JSON.stringify(metadata);
  }
}

function pack(values: number[], dtype: string): Buffer {
  const type = dtype === "U8" ? Uint8Array : dtype === "U16" ? Uint16Array : Uint32Array;
  return Buffer.from(type.from(values).buffer);
}
