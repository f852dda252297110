/** What the viewer makes as Python does: shader heads, images, single elements, uniforms. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { decodeElement, decodeRows, sourceValue, valueRange } from "../src/decode/element";
import { contractable, contractionConstants, coreStarts, fixedRows, foldChannels, parentTable } from "../src/gpu/frameContraction";
import { pixelCost } from "../src/gpu/payingModes";
import { eachCoefficients, layOutImage, packTables } from "../src/gpu/image";
import { pickedPrelude } from "../src/gpu/picked";
import { decoderUniform } from "../src/gpu/prelude";
import { treeOf } from "../src/gpu/tree";
import { UniformLayout } from "../src/gpu/uniform";
import { crc32 } from "../src/reader/digests";
import type { LevelBounds, Metadata, Role } from "../src/reader/metadata";
import type { PackedLevel } from "../src/reader/packed";

const TESTS = join(import.meta.dirname, "..", "..", "tests");

type Numbers = number[] | null;

/** A model, array by array. */
interface Told {
  axes: { name: string; size: number; role: Role }[];
  organisation: string[][];
  sizes: number[];
  bounds: LevelBounds[];
  stages: ({ nodes: number; order: number } & Record<string, number | Numbers | Numbers[]>)[];
  elements: { rows: number[]; values: number[] }[];
}

interface HeadCase {
  model: string;
  pages: number;
  uniform_stages: number[];
  taken: number[];
  rank: number | null; // that all modes are taken to have
  options: { picks: number[] | null; channels: 1 | 3; contracted: number[]; page_shift: number };
  text: string;
  words: number;
  crc32: number;
  rows: number;
  scales: number;
  coefficients: number[];
  uniform: string;
  cost: number | null;
  contraction: { still: number[]; constants: Record<string, number>; starts: number[]; parents: number[]; fixed: number } | null;
}

/** A model of one cell, made of a model's metadata. */
interface SingleCase {
  model: string;
  options: { picks: number[]; channels: 1 | 3; contracted: number[] };
  bounds: LevelBounds;
  kept: number[];
  undecomposed: number[];
  text: string;
  cost: number;
}

const { models: MODELS, heads: HEADS, single: SINGLE } = JSON.parse(
  readFileSync(join(TESTS, "corpus-render", "prelude.json"), "utf-8")) as
  { models: Record<string, Told>; heads: HeadCase[]; single: SingleCase[] };

const ARRAYS = {
  shape: Uint32Array, child: Uint32Array, rowOffset: Uint32Array, core: Uint16Array, coreOffset: Uint32Array,
  coreScale: Float32Array, cellOffset: Uint32Array, cluster: Uint16Array, clusterOffset: Uint32Array, basis: Uint16Array,
  basisOffset: Uint32Array, part: Uint16Array, local: Uint32Array,
};

function stageOf(told: Told["stages"][number]): PackedLevel {
  const made = Object.entries(ARRAYS).map(([name, Kind]) => {
    const one = (given: Numbers): unknown => (given === null ? null : Kind.from(given));
    const given = told[name] as Numbers | Numbers[];
    return [name, Array.isArray(given) && typeof given[0] === "object" ? (given as Numbers[]).map(one) : one(given as Numbers)];
  });
  return { nodes: told["nodes"], order: told["order"], step: null, ...Object.fromEntries(made) as object } as PackedLevel;
}

function model(name: string): { metadata: Metadata; stages: PackedLevel[] } {
  const { axes, organisation, sizes, bounds, stages } = MODELS[name]!;
  const levels = bounds.filter(({ clusters, ranks }) => ranks.some((rank) => rank > 0) || clusters.every((c) => c === 0));
  return {
    metadata: {
      axes: axes.map((axis) => ({ ...axis, coords: null, unit: "" })), organisation, modeSizes: sizes, stages: bounds, levels,
      sourceDtype: "float32", kind: "generic", transform: { name: "identity", scale: 1 }, quality: [], writer: "",
    },
    stages: stages.map(stageOf),
  };
}

describe("shader heads and images", () => {
  it.each(HEADS)("$model $options", (each) => {
    const { metadata, stages } = model(each.model);
    const { picks, channels, contracted, page_shift: pageShift } = each.options;
    const found = treeOf(metadata, stages);
    expect(found.uniform).toEqual(each.uniform_stages);
    const options = { channels, contracted, pageShift, ...(picks === null ? {} : { picks }) };
    const { rank } = each;
    const same = rank === null ? {} : {
      ranks: metadata.modeSizes.map(() => rank),
      metadata: { ...metadata, stages: metadata.stages.map((stage) => ({ ...stage, ranks: stage.ranks.map(() => rank) })) },
    };
    const tree = { ...found, uniform: each.taken, ...same };
    expect(pickedPrelude(tree, each.pages, options)).toBe(each.text);
    expect(picks === null ? null : pixelCost(tree, options)).toBe(each.cost);
    const layout = layOutImage(stages);
    expect([layout.rows[0]?.[0], layout.scales[0], layout.coefficients]).toEqual([each.rows, each.scales, each.coefficients]);
    const words = new Uint32Array(each.words);
    words.set(packTables(stages, layout));
    const halves = new Uint16Array(words.buffer);
    stages.forEach((stage, t) => eachCoefficients(stage, t, layout, (at, part) => halves.set(part, 2 * at)));
    expect(crc32(new Uint8Array(words.buffer))).toBe(each.crc32);
    expect(Buffer.from(decoderUniform(metadata, metadata.levels.length)).toString("hex")).toBe(each.uniform);
  });
});

describe("heads of one cell", () => {
  it.each(SINGLE)("$options $undecomposed", ({ model: name, options, bounds, kept, undecomposed, text, cost }) => {
    const { metadata } = model(name);
    const tree = {
      metadata: { ...metadata, stages: [bounds], levels: [bounds] }, undecomposed, mixed: [], cuts: false, uniform: [0], ranks: kept,
      whole: metadata.modeSizes.map((_, n) => n),
    };
    expect(pickedPrelude(tree, 1, options)).toBe(text);
    expect(pixelCost(tree, options)).toBe(cost);
  });
});

describe("frame contraction", () => {
  it.each(HEADS.filter((each) => each.contraction !== null))("$model $options.contracted", (each) => {
    const { metadata, stages } = model(each.model);
    const { still, constants, starts, parents, fixed } = each.contraction!;
    const { contracted } = each.options;
    const picks = each.options.picks!;
    expect(contractable(metadata, stages, still)).toEqual(contracted);
    expect(contractable(metadata, stages, still.slice(1))).not.toEqual(contracted);
    const options = { picks, contracted, channels: each.options.channels };
    expect(contractionConstants(treeOf(metadata, stages), stages, [each.scales, each.coefficients[0]!], options)).toEqual(constants);
    expect(Array.from(coreStarts(stages, contracted, foldChannels(metadata, options)))).toEqual(starts);
    expect(Array.from(parentTable(stages))).toEqual(parents);
    const stands = new Map(still.map((axis) => {
      const index = Array.from({ length: picks[axis]! }, (_, k) => k);
      return [axis, { index, weight: index.map((k) => 0.5 ** (1 + k)) }];
    }));
    expect(crc32(new Uint8Array(fixedRows(metadata, contracted, stands).buffer))).toBe(fixed);
  });
});

describe("single elements", () => {
  it.each(Object.keys(MODELS))("%s", (name) => {
    const { stages } = model(name);
    for (const { rows, values } of MODELS[name]!.elements) {
      values.forEach((value, t) => expect(decodeRows(stages, rows, t + 1)).toBeCloseTo(value, 5));
    }
  });

  it("reads merged axes by their strides", () => {
    const { metadata, stages } = model("merged");
    const sizes = metadata.axes.map((axis) => axis.size);
    const { low, high, least, most } = valueRange(metadata, stages, stages.length);
    expect(low).toBeLessThan(high);
    expect([least <= low, most >= high]).toEqual([true, true]);
    const rows = metadata.modeSizes.map((size) => size - 1); // the last element by axes is the last by modes
    expect(decodeElement(metadata, stages, sizes.map((size) => size - 1), stages.length))
      .toBe(decodeRows(stages, rows, stages.length));
  });

  it("undoes value transforms", () => {
    expect(sourceValue(Math.log1p(3), { name: "log1p", scale: 0.5 })).toBeCloseTo(1.5, 12);
    expect(sourceValue(Math.asinh(3), { name: "asinh", scale: 2 })).toBeCloseTo(6, 12);
    expect(sourceValue(-1, { name: "sqrt", scale: 1 })).toBe(0);
  });

  it.each(["log1p", "asinh", "sqrt"] as const)("makes no infinity: %s", (name) => {
    const largest = Math.fround(3.4028235e38);
    expect(sourceValue(1e30, { name, scale: 1 })).toBe(largest);
    expect(sourceValue(-1e30, { name, scale: 1 })).toBe({ log1p: -1, asinh: -largest, sqrt: 0 }[name]);
  });
});

describe("uniforms by name", () => {
  const shader = `struct Lamp { place: vec4f, strength: vec4f }
    struct Frame { a: u32, b: f32, /* */
      low: vec3f, iso: f32,   // packs behind the vector
      at: array<vec4u, 2>, lamps: array<Lamp, 2>, }`;

  it("lays out as WGSL does", () => {
    const layout = new UniformLayout(shader, "Frame");
    expect(layout.size).toBe(16 + 16 + 32 + 64);
    const bytes = layout.pack({ a: 7, b: 0.5, low: [1, 2, 3], iso: 4, "at[1]": [9, 8], "lamps[1].strength": [5] });
    const [words, floats] = [new Uint32Array(bytes), new Float32Array(bytes)];
    expect([words[0], floats[1], ...floats.slice(4, 8), words[12], words[13], floats[28]])
      .toEqual([7, 0.5, 1, 2, 3, 4, 9, 8, 5]);
  });

  it("refuses a field that is not there", () => {
    expect(() => new UniformLayout(shader, "Frame").pack({ c: 1 })).toThrow("no field c");
    expect(() => new UniformLayout(shader, "Nothing")).toThrow("no struct Nothing");
  });
});
