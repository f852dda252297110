/** Packed levels: their bits against those of an encoder of strings of 0 and 1, and files of bytes that are packed here. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { crc32 } from "node:zlib";
import { describe, expect, it } from "vitest";
import { BitStream } from "../src/reader/bitstream";
import { halfValues } from "../src/reader/half";
import { type Header, parseHeader } from "../src/reader/header";
import { DEFAULT_LIMITS } from "../src/reader/limits";
import type { PackedLevel } from "../src/reader/packed";
import { Reading, loads } from "../src/reader/read";
import { HmkError } from "../src/reader/reasons";
import type { Geometry } from "../src/reader/tables";
import { unpackLevel } from "../src/reader/widths";
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

/** Numbers as the specification has them in a file, the lowest bit of each first; `rest`: what is left of the last byte. */
function streamOf(numbers: number[], bits: number[], rest = "0"): number[] {
  const text = numbers.map((number, at) => (number & (2 ** bits[at]! - 1)).toString(2).padStart(bits[at]!, "0"))
    .map((digits) => [...digits].reverse().join("")).join("");
  return (text.match(/.{1,8}/g) ?? []).map((eight) => parseInt([...eight.padEnd(8, rest)].reverse().join(""), 2));
}

/** The pattern of the float16 number nearest to one below 2 in magnitude, of two as near the even one. */
function nearest(value: number): number {
  const [values, size] = [halfValues(), Math.abs(value)];
  let [low, high] = [0, 0x4000];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    [low, high] = values[middle]! <= size ? [middle, high] : [low, middle];
  }
  const off = size - values[low]! - (values[low + 1]! - size); // exact, as all are multiples of 2^-24
  return (off > 0 || (off === 0 && low % 2 === 1) ? low + 1 : low) + (value < 0 ? 0x8000 : 0);
}

/** What a packed level of one mode holds whose only node has these columns: numbers cell after cell, and row after row. */
function unpacked(width: number[], core: number[], basis: number[]): { core: number[]; basis: number[] } {
  const rank = width.length;
  const columns = (upper: boolean): number[] => width.map((each) => 1 + (upper ? each >> 4 : each & 15));
  const stored = (numbers: number[], bits: number[]): Uint8Array =>
    Uint8Array.from(streamOf(numbers, numbers.map((_, at) => bits[at % rank]!)));
  const arrays: Record<string, Uint8Array> = {
    "level/1/width/0": Uint8Array.from(width), "level/1/core": stored(core, columns(true)),
    "level/1/basis/0": stored(basis, columns(false)),
  };
  const level = {
    core: new Uint16Array(core.length), basis: [new Uint16Array(basis.length)], basisOffset: [Uint32Array.of(0, basis.length)],
  };
  const geometry = {
    level: 1, nodes: 1, decomposed: [0], ranks: [Uint32Array.of(rank)], cells: Float64Array.of(core.length / rank),
    packed: level as unknown as PackedLevel,
  } as unknown as Geometry;
  unpackLevel(geometry, (name) => arrays[name] ?? null);
  return { core: Array.from(level.core), basis: Array.from(level.basis[0]!) };
}

function wholeNumbers(bits: number): number[] {
  return Array.from({ length: 2 ** bits }, (_, at) => at - 2 ** (bits - 1));
}

describe("numbers of few bits", () => {
  it("are those of the specification's example", () => {
    const text = readFileSync(join(import.meta.dirname, "..", "..", "docs", "format.md"), "utf-8").replaceAll(/\s+/g, " ");
    const found = /columns of (\d and \d) bits and the numbers ([-\d., ]+) of two .*? whole numbers ([-\d, ]+), in .*? bytes (.*?)\./
      .exec(text)!;
    const [bits, numbers, whole, bytes] = found.slice(1).map((list) => list.split(/, | and /)) as
      [string[], string[], string[], string[]];
    const each = [...bits, ...bits].map(Number);
    const stream = new BitStream(Uint8Array.from(bytes.map(Number)));
    expect(each.map((own) => stream.next(own))).toEqual(whole.map(Number));
    expect(streamOf(whole.map(Number), each)).toEqual(bytes.map(Number));
    expect(unpacked(bits.map((own) => Number(own) - 1), [0, 0], whole.map(Number)).basis)
      .toEqual(numbers.map((number) => nearest(Number(number))));
  });

  it("take any bits one after the other", () => {
    const draw = draws(1);
    for (let round = 0; round < 300; round += 1) {
      const bits = Array.from({ length: 1 + draw(40) }, () => 1 + draw(16));
      const numbers = bits.map((own) => draw(2 ** own) - 2 ** (own - 1));
      const stream = new BitStream(Uint8Array.from(streamOf(numbers, bits)));
      expect(bits.map((own) => stream.next(own))).toEqual(numbers);
    }
  });

  it.each(Array.from({ length: 12 }, (_, at) => at + 1))("of a basis are shares of a power of two: %i bits", (bits) => {
    const whole = wholeNumbers(bits);
    const values = unpacked([bits - 1], [0], whole).basis.map((pattern) => halfValues()[pattern]);
    expect(values).toEqual(whole.map((number) => number / 2 ** (bits - 1)));
  });

  it.each(Array.from({ length: 16 }, (_, at) => at + 1))("of a core are the nearest to such shares: at most %i bits", (most) => {
    for (let bits = 1; bits <= most; bits += 1) {
      const whole = wholeNumbers(bits).flatMap((number) => [number, -number - 1]); // one of each column
      const widths = [(bits - 1) << 4, (most - 1) << 4];
      expect(unpacked(widths, whole, [0, 0]).core).toEqual(whole.map((number) => nearest(number / 2 ** (most - 1))));
    }
  });

  it("of 16 bits are those of NumPy", () => {
    const { core } = unpacked([0xf0], wholeNumbers(16), [0]);
    // crc32((np.arange(-32768, 32768) / 32768).astype("<f2").tobytes())
    expect(crc32(new Uint8Array(Uint16Array.from(core).buffer))).toBe(1469579073);
  });
});

function file(base: string, edits: Edits): Uint8Array<ArrayBuffer> {
  return build({ name: "", base, edits, expect: { kind: "", reason: "" } })!;
}

function headerOf(data: Uint8Array): Header {
  const length = Number(Buffer.from(data).readBigUInt64LE(0));
  return parseHeader(data.subarray(8, 8 + length), data.length, DEFAULT_LIMITS);
}

/** Bits of the core numbers of a cell, by those of each mode's columns: for every index the least, the last mode fastest. */
function leastBits(columns: number[][]): number[] {
  return columns.reduce((least, own) => least.flatMap((bits) => own.map((each) => Math.min(bits, each))), [16]);
}

/** A level of bytes packed, with numbers drawn at random: edits of its file, and the level that is meant. */
function packedLevel(
  level: PackedLevel, name: string, draw: (most: number) => number, rest: string, decomposed: (n: number) => boolean,
): { edits: Edits; level: PackedLevel } {
  const nodes = Array.from({ length: level.nodes }, (_, s) => s);
  const modes = Array.from({ length: level.order }, (_, n) => n);
  const columns = nodes.map((s) => modes.map((n) => Array.from({ length: level.shape[(3 * s + 2) * level.order + n]! },
    () => (decomposed(n) ? draw(12) + 16 * draw(16) : 0xf0))));
  const edits: Edits = [];
  const put = (array: string, values: number[], first: boolean): void => {
    edits.push({ op: "array-set", name: name + array, dtype: "U8", shape: [values.length], values, first });
  };
  const drawn = (bits: number[]): number[] => bits.map((own) => draw(2 ** own) - 2 ** (own - 1));
  const stored = (
    array: string, offsets: Uint32Array, bitsOf: (s: number) => number[], ofOne: (own: number[]) => number[],
  ): Uint16Array => {
    const bits = nodes.map((s) =>
      Array.from({ length: offsets[s + 1]! - offsets[s]! }, (_, at) => bitsOf(s)[at % bitsOf(s).length]!));
    const [numbers, ones] = [drawn(bits.flat()), bits.flatMap(ofOne)];
    put(array, streamOf(numbers, bits.flat(), rest), false);
    return Uint16Array.from(numbers, (number, at) => nearest(number / 2 ** (ones[at]! - 1)));
  };
  modes.filter(decomposed).forEach((n) => put(`width/${n}`, columns.flatMap((own) => own[n]!), true));
  const ofCell = (s: number): number[] => leastBits(columns[s]!.map((own) => own.map((each) => 1 + (each >> 4))));
  const core = stored("core", level.coreOffset, ofCell, (own) => own.map(() => Math.max(...own)));
  const ofRow = (n: number) => (s: number): number[] => columns[s]![n]!.map((each) => 1 + (each & 15));
  const basis = modes.map((n) =>
    (decomposed(n) ? stored(`basis/${n}`, level.basisOffset[n]!, ofRow(n), (own) => own) : null));
  return { edits, level: { ...level, core, basis } };
}

/** A file whose levels of bytes are packed, and its levels. */
function packed(base: string, seed: number, rest = "0"): { edits: Edits; levels: PackedLevel[] } {
  const [draw, data] = [draws(seed), new Uint8Array(fixture(base))];
  const [{ metadata, levels }, { entries }] = [loads(data), headerOf(data)];
  const all = { edits: [{ op: "metadata", path: ["version"], value: "1.3" }] as Edits, levels: [] as PackedLevel[] };
  for (const [l, before] of levels.entries()) {
    const name = `level/${l + 1}/`;
    const { edits, level } = entries.get(`${name}core`)!.dtype === "I8"
      ? packedLevel(before, name, draw, rest, (n) => !metadata.undecomposed.includes(n)) : { edits: [], level: before };
    all.edits.push(...edits);
    all.levels.push(level);
  }
  return all;
}

describe.each(["v1.2-eight.hmk", "v1.2-mixed.hmk", "v1.2-lone.hmk"])("packed: %s", (name) => {
  const { edits, levels } = packed(name, 7);
  const whole = file(name, edits);

  it("has the numbers that its bits stand for and the tables of the file in bytes", () => {
    expect(edits.length).toBeGreaterThan(3);
    expect(loads(whole).levels).toEqual(levels);
  });

  it("is read in parts", () => {
    const { dataStart } = headerOf(whole);
    const reading = new Reading(whole.subarray(8, dataStart), whole.length);
    const memory = new Uint8Array(whole.length);
    memory.set(whole.subarray(0, reading.tablesEnd));
    reading.readTables(memory);
    levels.forEach((level, l) => {
      memory.set(whole.subarray(0, reading.levelEnd(l + 1)));
      reading.readLevel(l + 1, memory);
      expect(reading.levels[l]).toEqual(level);
    });
    expect(reading.levelEnd(1)).toBeLessThan(whole.length);
  });
});

describe("of a packed file", () => {
  const base = "v1.2-lone.hmk";
  const { edits } = packed(base, 7);
  const values = (name: string): number[] => edits.find((edit) => edit.name === name)!.values!;
  const [width, core, basis] = ["level/1/width/0", "level/1/core", "level/1/basis/0"].map(values) as
    [number[], number[], number[]];
  const set = (name: string, numbers: number[], dtype = "U8"): Edits =>
    [{ op: "array-set", name, dtype, shape: [numbers.length], values: numbers }];
  const drop = (name: string): Edits => [{ op: "array-drop", name }];
  const last = (name: string): Edits => [{ op: "array-last", name }];
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
    ["width-range level/1/width/0", set("level/1/width/0", width.with(-1, 12))],
    ["width-range level/1/width/0", set("level/1/width/0", width.with(0, 255))],
    ["array-shape level/1/width/0", set("level/1/width/0", [...width, 0])],
    ["array-shape level/1/width/0", set("level/1/width/0", width.slice(1))],
    ["array-dtype level/1/width/0", [...drop("level/1/width/0"), ...set("level/1/width/0", width, "U16")]],
    ["array-missing level/1/width/0", drop("level/1/width/0")],
    ["array-missing level/1/width/1", [...drop("level/1/width/1"), ...drop("level/1/basis/0")]],
    ["array-unexpected level/1/width/2", set("level/1/width/2", width)], // of an undecomposed mode
    ["array-shape level/1/core", set("level/1/core", [...core, 0])],
    ["array-shape level/1/core", set("level/1/core", core.slice(1))],
    ["array-shape level/1/core", set("level/1/core", [])],
    ["array-shape level/1/core", set("level/1/width/0", width.map((each) => each & 15))],
    ["array-shape level/1/basis/0", set("level/1/basis/0", [...basis, 0])],
    ["array-shape level/1/basis/0", set("level/1/basis/0", basis.slice(1))],
    ["array-missing level/1/basis/0", drop("level/1/basis/0")],
    ["array-dtype level/1/basis/0", [{ op: "array-set", name: "level/1/basis/0", dtype: "I8", shape: [basis.length] }]],
    ["array-dtype level/1/basis/0", [{ op: "array-set", name: "level/1/core", dtype: "F16", shape: [core.length] }]],
    ["array-dtype level/1/basis/0", [{ op: "array-set", name: "level/1/core", dtype: "I8", shape: [core.length] }]],
    ["array-dtype level/2/core", [{ op: "array-set", name: "level/2/core", dtype: "F16", shape: [1] }]],
    ["array-order level/2/width/0", last("level/2/width/0")],
    ["array-order level/1/basis/0", last("level/1/basis/0")],
    ["array-order level/1/core", last("level/1/core")],
    ["array-dtype level/1/core", [{ op: "metadata", path: ["version"], value: "1.2" }]],
    ["array-dtype level/1/core", [{ op: "metadata", path: ["undecomposed"], value: [0, 1, 2] }]],
    ["width-range level/1/width/1", [
      ...set("level/1/width/1", values("level/1/width/1").with(-1, 15)), ...set("level/1/core", []),
    ]],
    ["array-shape level/1/core", [...set("level/1/basis/0", []), ...set("level/1/core", [])]],
  ])("is refused or not: %s", (reason, more) => {
    expect(refused(file(base, [...edits, ...more]))).toBe(reason);
  });

  it("what is left of the last byte may be anything", () => {
    const ones = packed(base, 7, "1");
    expect(ones.edits).not.toEqual(edits);
    expect(loads(file(base, ones.edits)).levels).toEqual(ones.levels);
  });

  it("no more is made than its bits allow", () => {
    const size = { op: "metadata", path: ["axes", 0, "size"], value: 2 ** 32 - 1 }; // rows of numbers that are not there
    const huge = [...edits, size, { op: "metadata", path: ["axes", 0, "coords"], value: null }];
    expect(refused(file(base, huge))).toBe("array-shape level/1/basis/0");
  });
});
