/** Packed bases: their bits against those of an encoder of strings of 0 and 1, and files of bytes that are packed here. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { fromStream } from "../src/reader/bitstream";
import { halfBits } from "../src/reader/half";
import { type Header, parseHeader } from "../src/reader/header";
import { DEFAULT_LIMITS } from "../src/reader/limits";
import { BASIS_NUMBERS } from "../src/reader/narrow";
import { Reading, loads } from "../src/reader/read";
import { HmkError } from "../src/reader/reasons";
import { type Case, build, fixture } from "./corpus";

type Edits = NonNullable<Case["edits"]>;

/** Whole numbers below `most`, the same in every run. */
function draws(seed: number): (most: number) => number {
  let state = seed;
  return (most) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return Math.floor((state / 2 ** 32) * most);
  };
}

/** The upper bits of bytes as the specification has them in a file, the lowest of each first. */
function packed(bytes: number[], bits: number[]): number[] {
  const text = bytes.map((byte, at) => (byte & 255).toString(2).padStart(8, "0").slice(0, bits[at]))
    .map((digits) => [...digits].reverse().join("")).join("");
  return (text.match(/.{1,8}/g) ?? []).map((eight) => parseInt([...eight.padEnd(8, "0")].reverse().join(""), 2));
}

function unpacked(stream: number[], width: number[], ranks: number[], rows: number[]): number[] {
  const offsets = Uint32Array.from([0, ...ranks]);
  ranks.forEach((rank, s) => { offsets[s + 1] = offsets[s]! + rank * rows[s]!; });
  const into = new Uint16Array(offsets.at(-1)!);
  fromStream(Uint8Array.from(stream), { width: Uint8Array.from(width), ranks: Uint32Array.from(ranks), offsets }, BASIS_NUMBERS, into);
  return Array.from(into);
}

describe("numbers of few bits", () => {
  it("are those of the specification's example", () => {
    const text = readFileSync(join(import.meta.dirname, "..", "..", "docs", "format.md"), "utf-8").replaceAll(/\s+/g, " ");
    const found = /columns of (\d) and (\d) bits and the numbers ([-\d., ]+) of two rows.* are the bytes 0x(..) and 0x(..)\./.exec(text)!;
    const numbers = found[3]!.split(",").map((number) => halfBits(Number(number)));
    const stream = [found[4]!, found[5]!].map((byte) => parseInt(byte, 16));
    expect(numbers).toHaveLength(4);
    expect(unpacked(stream, [Number(found[1]), Number(found[2])], [2], [2])).toEqual(numbers);
  });

  it("are those of Python's", () => {
    expect(unpacked([29], [2, 2, 3], [3], [1])).toEqual([0.5, -0.5, 0.25].map(halfBits));
  });

  it("take any bits in any column of any node", () => {
    const draw = draws(1);
    for (let round = 0; round < 300; round += 1) {
      const ranks = Array.from({ length: 1 + draw(5) }, () => draw(5)); // 0: a node of shape zero
      const rows = ranks.map(() => 1 + draw(6));
      const columns = ranks.map((rank) => Array.from({ length: rank }, () => 1 + draw(8)));
      const bits = columns.flatMap((own, s) => Array.from({ length: rows[s]! }, () => own).flat());
      const bytes = bits.map((own) => draw(256) & (0xff << (8 - own)) & 255);
      const expected = bytes.map((byte) => BASIS_NUMBERS[byte]!);
      expect(unpacked(packed(bytes, bits), columns.flat(), ranks, rows)).toEqual(expected);
    }
  });

  it("leave what is left of the last byte aside", () => {
    expect(unpacked([0b11111101], [3], [1], [1])).toEqual(unpacked([0b101], [3], [1], [1]));
  });
});

function file(base: string, edits: Edits): Uint8Array<ArrayBuffer> {
  return build({ name: "", base, edits, expect: { kind: "", reason: "" } })!;
}

function headerOf(data: Uint8Array): Header {
  const length = Number(Buffer.from(data).readBigUInt64LE(0));
  return parseHeader(data.subarray(8, 8 + length), data.length, DEFAULT_LIMITS);
}

/** A file of bytes whose lower bits are made 0, and the same file with packed bases. */
function inBytesAndPacked(name: string, seed: number): { bytes: Edits; packed: Edits } {
  const draw = draws(seed);
  const data = fixture(name);
  const { entries, dataStart } = headerOf(data);
  const edits = { bytes: [] as Edits, packed: [{ op: "metadata", path: ["version"], value: "1.3" }] as Edits };
  loads(new Uint8Array(data)).levels.forEach(({ order, nodes, shape, basisOffset }, l) => {
    for (let n = 0; n < order; n += 1) {
      const entry = entries.get(`level/${l + 1}/basis/${n}`);
      if (entry?.dtype !== "I8") {
        continue;
      }
      const columns = Array.from({ length: nodes }, (_, s) => Array.from({ length: shape[(3 * s + 2) * order + n]! }, () => 1 + draw(8)));
      const bits = columns.flatMap((own, s) =>
        Array.from({ length: basisOffset[n]![s + 1]! - basisOffset[n]![s]! }, (_, at) => own[at % own.length]!));
      const whole = Array.from(data.subarray(dataStart + entry.begin, dataStart + entry.end));
      const masked = whole.map((byte, at) => byte & (0xff << (8 - bits[at]!)) & 255);
      const [values, width] = [packed(masked, bits), columns.flat()];
      edits.bytes.push({ op: "array-put", name: `level/${l + 1}/basis/${n}`, at: 0, hex: Buffer.from(masked).toString("hex") });
      edits.packed.push(
        { op: "array-set", name: `level/${l + 1}/width/${n}`, dtype: "U8", shape: [width.length], values: width, first: true },
        { op: "array-set", name: `level/${l + 1}/basis/${n}`, dtype: "U8", shape: [values.length], values },
      );
    }
  });
  return edits;
}

describe.each(["v1.2-eight.hmk", "v1.2-mixed.hmk", "v1.2-lone.hmk"])("packed: %s", (name) => {
  const edits = inBytesAndPacked(name, 7);
  const whole = file(name, edits.packed);

  it("has the numbers and the tables of the file in bytes", () => {
    expect(edits.packed.length).toBeGreaterThan(2);
    expect(loads(whole).levels).toEqual(loads(file(name, edits.bytes)).levels);
  });

  it("is read in parts", () => {
    const { dataStart } = headerOf(whole);
    const reading = new Reading(whole.subarray(8, dataStart), whole.length);
    const memory = new Uint8Array(whole.length);
    memory.set(whole.subarray(0, reading.tablesEnd));
    reading.readTables(memory);
    loads(whole).levels.forEach((level, l) => {
      memory.set(whole.subarray(0, reading.levelEnd(l + 1)));
      reading.readLevel(l + 1, memory);
      expect(reading.levels[l]).toEqual(level);
    });
    expect(reading.levelEnd(1)).toBeLessThan(whole.length);
  });
});

describe("of a packed file", () => {
  const base = "v1.2-eight.hmk";
  const { packed: edits } = inBytesAndPacked(base, 7);
  const values = (name: string): number[] => edits.find((edit) => edit.name === name)!.values!;
  const [width, basis] = [values("level/1/width/0"), values("level/1/basis/0")];
  const set = (name: string, numbers: number[]): Edits =>
    [{ op: "array-set", name, dtype: "U8", shape: [numbers.length], values: numbers }];
  const refused = (data: Uint8Array<ArrayBuffer>): string => {
    try {
      loads(data);
    } catch (error) {
      if (error instanceof HmkError) {
        return `${error.reason} ${error.where}`;
      }
      throw error;
    }
    return "ok";
  };

  it.each<[string, Edits]>([
    ["ok", []],
    ["width-range level/1/width/0", set("level/1/width/0", width.with(-1, 0))],
    ["width-range level/1/width/0", set("level/1/width/0", width.with(0, 9))],
    ["array-shape level/1/width/0", set("level/1/width/0", [...width, 1])],
    ["array-shape level/1/width/0", set("level/1/width/0", width.slice(1))],
    ["array-dtype level/1/width/0", [
      { op: "array-drop", name: "level/1/width/0" }, { op: "array-set", name: "level/1/width/0", dtype: "I8", shape: [width.length] },
    ]],
    ["array-shape level/1/basis/0", set("level/1/basis/0", [...basis, 0])],
    ["array-shape level/1/basis/0", set("level/1/basis/0", basis.slice(1))],
    ["array-dtype level/1/basis/0", [{ op: "array-drop", name: "level/1/width/0" }]],
    ["array-unexpected level/1/width/9", set("level/1/width/9", width)],
    ["array-missing level/1/basis/0", [{ op: "array-drop", name: "level/1/basis/0" }]],
    ["array-order level/2/width/0", [{ op: "array-last", name: "level/2/width/0" }]],
    ["array-order level/1/basis/0", [{ op: "array-last", name: "level/1/basis/0" }]],
    ["array-dtype level/1/basis/0", [{ op: "metadata", path: ["version"], value: "1.2" }]],
  ])("is refused or not: %s", (reason, more) => {
    expect(refused(file(base, [...edits, ...more]))).toBe(reason);
  });

  it("no more is made than its bits allow", () => {
    const size = { op: "metadata", path: ["axes", 0, "size"], value: 2 ** 32 - 1 }; // rows of numbers that are not there
    const huge = [...edits, size, { op: "metadata", path: ["axes", 0, "coords"], value: null }];
    expect(refused(file(base, huge))).toBe("array-shape level/1/basis/0");
  });
});
