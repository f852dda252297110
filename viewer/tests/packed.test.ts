/** Files with packed levels, which are made here of files of bytes. */

import { describe, expect, it } from "vitest";
import { type Header, parseHeader } from "../src/reader/header";
import { DEFAULT_LIMITS } from "../src/reader/limits";
import type { PackedLevel } from "../src/reader/packed";
import { Reading, loads } from "../src/reader/read";
import { type Case, build, fixture } from "./corpus";
import { arrayOf, drawn, draws, nearest, refusal } from "./riceCode";

type Edits = NonNullable<Case["edits"]>;

function file(base: string, edits: Edits): Uint8Array<ArrayBuffer> {
  return build({ name: "", base, edits, expect: { kind: "", reason: "" } })!;
}

function headerOf(data: Uint8Array): Header {
  const length = Number(Buffer.from(data).readBigUInt64LE(0));
  return parseHeader(data.subarray(8, 8 + length), data.length, DEFAULT_LIMITS);
}

/** Parameters of a cell's core numbers, by the most of each mode's columns: of every index the least. */
function leastOf(columns: number[][]): number[] {
  return columns.reduce((least, own) => least.flatMap((k) => own.map((each) => Math.min(k, each))), [15]);
}

/** A level of bytes packed, with numbers drawn at random: edits of its file, and the level that is meant. */
function packedLevel(
  level: PackedLevel, name: string, draw: (most: number) => number, rest: string, decomposed: (n: number) => boolean,
): { edits: Edits; level: PackedLevel } {
  const nodes = Array.from({ length: level.nodes }, (_, s) => s);
  const modes = Array.from({ length: level.order }, (_, n) => n);
  const columns = nodes.map((s) => modes.map((n) => Array.from({ length: level.shape[(3 * s + 2) * level.order + n]! },
    () => (decomposed(n) ? draw(256) : 0xf0))));
  const edits: Edits = [];
  const put = (array: string, values: number[], first: boolean): void => {
    edits.push({ op: "array-set", name: name + array, dtype: "U8", shape: [values.length], values, first });
  };
  const stored = (
    array: string, offsets: Uint32Array, parameters: (s: number) => number[], stepsOf: (own: number[]) => number[],
  ): Uint16Array => {
    const ks = nodes.map((s) =>
      Array.from({ length: offsets[s + 1]! - offsets[s]! }, (_, at) => parameters(s)[at % parameters(s).length]!));
    const [numbers, steps] = [ks.flat().map((k) => drawn(draw, k)), ks.flatMap(stepsOf)];
    put(array, arrayOf(numbers, ks.flat(), rest), false);
    return Uint16Array.from(numbers, (number, at) => nearest(number / 2 ** (steps[at]! + 2)));
  };
  modes.filter(decomposed).forEach((n) => put(`rice/${n}`, columns.flatMap((own) => own[n]!), true));
  const ofCell = (s: number): number[] => leastOf(columns[s]!.map((own) => own.map((each) => each >> 4)));
  const core = stored("core", level.coreOffset, ofCell, (own) => own.map(() => Math.max(...own)));
  const ofRow = (n: number) => (s: number): number[] => columns[s]![n]!.map((each) => each & 15);
  const basis = modes.map((n) =>
    (decomposed(n) ? stored(`basis/${n}`, level.basisOffset[n]!, ofRow(n), (own) => own) : null));
  return { edits, level: { ...level, core, basis } };
}

/** A file whose levels of bytes are packed, and its levels. */
function packed(base: string, seed: number, rest = "0"): { edits: Edits; levels: PackedLevel[] } {
  const [draw, data] = [draws(seed), new Uint8Array(fixture(base))];
  const [{ metadata, levels }, { entries }] = [loads(data), headerOf(data)];
  const all = { edits: [{ op: "metadata", path: ["version"], value: "1.4" }] as Edits, levels: [] as PackedLevel[] };
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

  it("has the numbers that its codes stand for and the tables of the file in bytes", () => {
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
  const [rice, core, basis] = ["level/1/rice/0", "level/1/core", "level/1/basis/0"].map(values) as
    [number[], number[], number[]];
  const set = (name: string, numbers: number[], dtype = "U8"): Edits =>
    [{ op: "array-set", name, dtype, shape: [numbers.length], values: numbers }];
  const drop = (name: string): Edits => [{ op: "array-drop", name }];
  const last = (name: string): Edits => [{ op: "array-last", name }];
  const version = (value: string): Edits => [{ op: "metadata", path: ["version"], value }];
  const long = core.map(() => 0).with(-1, 128);
  const badChild: Edits = [{ op: "array-put", name: "level/1/child", at: 0, values: [1] }];
  const read = (more: Edits): string => refusal(() => loads(file(base, [...edits, ...more])));

  it.each<[string, Edits]>([
    ["ok", []],
    ["array-shape level/1/rice/0", set("level/1/rice/0", [...rice, 0])],
    ["array-shape level/1/rice/0", set("level/1/rice/0", rice.slice(1))],
    ["array-dtype level/1/rice/0", [...drop("level/1/rice/0"), ...set("level/1/rice/0", rice, "U16")]],
    ["array-missing level/1/rice/0", drop("level/1/rice/0")],
    ["array-missing level/1/rice/1", [...drop("level/1/rice/1"), ...drop("level/1/basis/0")]],
    ["array-unexpected level/1/rice/2", set("level/1/rice/2", rice)], // of an undecomposed mode
    ["array-unexpected level/1/width/0", set("level/1/width/0", rice)],
    ["array-shape level/1/core", set("level/1/core", [])],
    ["array-shape level/1/core", set("level/1/core", core.map(() => 0))],
    ["code-range level/1/core", set("level/1/core", long)],
    ["array-shape level/1/basis/0", set("level/1/rice/0", rice.map((each) => each ^ 1))],
    ["array-missing level/1/basis/0", drop("level/1/basis/0")],
    ["array-dtype level/1/basis/0", [{ op: "array-set", name: "level/1/basis/0", dtype: "I8", shape: [basis.length] }]],
    ["array-dtype level/1/basis/0", [{ op: "array-set", name: "level/1/core", dtype: "F16", shape: [core.length] }]],
    ["array-dtype level/1/basis/0", [{ op: "array-set", name: "level/1/core", dtype: "I8", shape: [core.length] }]],
    ["array-dtype level/2/core", [{ op: "array-set", name: "level/2/core", dtype: "F16", shape: [1] }]],
    ["array-order level/2/rice/0", last("level/2/rice/0")],
    ["array-order level/1/basis/0", last("level/1/basis/0")],
    ["array-order level/1/core", last("level/1/core")],
    ["array-dtype level/1/core", version("1.2")],
    ["version-unknown hmkcta.version", version("1.3")],
    ["array-dtype level/1/core", [{ op: "metadata", path: ["undecomposed"], value: [0, 1, 2] }]],
    ["array-shape level/1/rice/1", [...set("level/1/rice/1", []), ...set("level/1/core", [])]],
    ["array-shape level/1/core", [...set("level/1/basis/0", []), ...set("level/1/core", [])]],
    ["offset-order level/1/child", badChild],
    ["code-range level/1/core", [...badChild, ...set("level/1/core", long)]],
    ["offset-order level/1/child", [...badChild, ...set("level/2/core", [])]],
  ])("is refused or not: %s", (reason, more) => {
    expect(read(more)).toBe(reason);
  });

  it.each(["level/1/core", "level/1/basis/0", "level/2/basis/1", "level/3/core"])("of no other length: %s", (name) => {
    const whole = values(name);
    for (let size = 0; size < whole.length; size += 1) {
      expect(read(set(name, whole.slice(0, size)))).toBe(`array-shape ${name}`);
    }
    for (const byte of [0, 1, 0x80, 0xff]) {
      expect(read(set(name, [...whole, byte]))).toBe(`array-shape ${name}`);
    }
  });

  it.each(["v1.2-eight.hmk", "v1.0-small.hmk"])("version 1.3 is refused without packed levels too: %s", (name) => {
    expect(refusal(() => loads(file(name, version("1.3"))))).toBe("version-unknown hmkcta.version");
  });

  it.each<[string, Edits]>([
    ["ok", []],
    ["array-shape level/1/core", set("level/1/core", [...core, 0])],
    ["code-range level/1/core", set("level/1/core", long)],
    ["array-shape level/1/basis/0", set("level/1/basis/0", basis.slice(0, -1))],
  ])("codes are looked at when they have come: %s", (reason, more) => {
    const whole = file(base, [...edits, ...more]);
    const reading = new Reading(whole.subarray(8, headerOf(whole).dataStart), whole.length);
    const memory = new Uint8Array(whole.length);
    memory.set(whole.subarray(0, reading.tablesEnd));
    reading.readTables(memory);
    memory.set(whole);
    expect(refusal(() => reading.readLevel(1, memory))).toBe(reason);
  });

  it("what is left of the last bytes may be anything", () => {
    const ones = packed(base, 7, "1");
    expect(ones.edits).not.toEqual(edits);
    expect(loads(file(base, ones.edits)).levels).toEqual(ones.levels);
  });

  it("no more is made than its bytes allow", () => {
    const huge = file(base, [...edits, // rows of numbers that are not there
      { op: "metadata", path: ["axes", 0, "size"], value: 2 ** 32 - 1 },
      { op: "metadata", path: ["axes", 0, "coords"], value: null }]);
    const reading = new Reading(huge.subarray(8, headerOf(huge).dataStart), huge.length);
    expect(refusal(() => reading.readTables(huge))).toBe("array-shape level/1/basis/0");
    expect(refusal(() => loads(huge))).toBe("array-shape level/1/basis/0");
  });
});
