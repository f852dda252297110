/** What the viewer makes as Python does: shader heads, images, single elements, uniforms. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { decodeElement, decodeRows, sourceValue, valueRange } from "../src/decode/element";
import { contractable, contractionConstants, coreStarts, fixedRows, foldChannels, parentTable } from "../src/gpu/frameContraction";
import { uniformLevels } from "../src/gpu/coreSums";
import { pixelCost } from "../src/gpu/payingModes";
import { eachCoefficients, layOutImage, packTables } from "../src/gpu/image";
import { decoderUniform, prelude } from "../src/gpu/prelude";
import { UniformLayout } from "../src/gpu/uniform";
import { crc32 } from "../src/reader/digests";
import { loads } from "../src/reader/read";
import { FIXTURES, fixture } from "./corpus";

const TESTS = join(import.meta.dirname, "..", "..", "tests");

interface HeadCase {
  file: string;
  pages: number;
  uniform_levels: number[];
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

/** A model of one cell, made of a file's metadata. */
interface SingleCase {
  file: string;
  options: { picks: number[]; channels: 1 | 3; contracted: number[] };
  ranks: number[];
  undecomposed: number[];
  text: string;
  cost: number;
}

const { models: HEADS, single: SINGLE } = JSON.parse(readFileSync(join(TESTS, "corpus-render", "prelude.json"), "utf-8")) as
  { models: HeadCase[]; single: SingleCase[] };

function model(name: string): ReturnType<typeof loads> {
  return loads(new Uint8Array(fixture(name)));
}

describe("shader heads and images", () => {
  it.each(HEADS)("$file $options", (each) => {
    const { metadata, levels } = model(each.file);
    const { picks, channels, contracted, page_shift: pageShift } = each.options;
    expect(uniformLevels(metadata, levels)).toEqual(each.uniform_levels);
    const options = { channels, contracted, pageShift, uniform: each.taken, ...(picks === null ? {} : { picks }) };
    const { rank } = each;
    const shown = rank === null ? metadata : { ...metadata, levels: metadata.levels.map((level) => ({ ...level, ranks: level.ranks.map(() => rank) })) };
    expect(prelude(shown, each.pages, options)).toBe(each.text);
    expect(picks === null ? null : pixelCost(shown, options)).toBe(each.cost);
    const layout = layOutImage(levels);
    expect([layout.rows[0]?.[0], layout.scales[0], layout.coefficients]).toEqual([each.rows, each.scales, each.coefficients]);
    const words = new Uint32Array(each.words);
    words.set(packTables(levels, layout));
    const halves = new Uint16Array(words.buffer);
    levels.forEach((level, l) => eachCoefficients(level, l, layout, (at, part) => halves.set(part, 2 * at)));
    expect(crc32(new Uint8Array(words.buffer))).toBe(each.crc32);
    expect(Buffer.from(decoderUniform(metadata, levels.length)).toString("hex")).toBe(each.uniform);
  });
});

describe("heads of one cell", () => {
  it.each(SINGLE)("$options $undecomposed", ({ file, options, ranks, undecomposed, text, cost }) => {
    const { metadata } = model(file);
    const one = ranks.map(() => 1);
    const shown = { ...metadata, levels: [{ ...metadata.levels[0]!, clusters: one, mixture: one, ranks }], undecomposed };
    expect(prelude(shown, 1, { ...options, uniform: [0] })).toBe(text);
    expect(pixelCost(shown, options)).toBe(cost);
  });
});

describe("frame contraction", () => {
  it.each(HEADS.filter((each) => each.contraction !== null))("$file $options.contracted", (each) => {
    const { metadata, levels } = model(each.file);
    const { still, constants, starts, parents, fixed } = each.contraction!;
    const { contracted } = each.options;
    const picks = each.options.picks!;
    expect(contractable(metadata, levels, still)).toEqual(contracted);
    expect(contractable(metadata, levels, still.slice(1))).not.toEqual(contracted);
    const options = { picks, contracted, channels: each.options.channels };
    expect(contractionConstants(metadata, levels, [each.scales, each.coefficients[0]!], options)).toEqual(constants);
    expect(Array.from(coreStarts(levels, contracted, foldChannels(metadata, options)))).toEqual(starts);
    expect(Array.from(parentTable(levels))).toEqual(parents);
    const stands = new Map(still.map((axis) => {
      const index = Array.from({ length: picks[axis]! }, (_, k) => k);
      return [axis, { index, weight: index.map((k) => 0.5 ** (1 + k)) }];
    }));
    expect(crc32(new Uint8Array(fixedRows(metadata, contracted, stands).buffer))).toBe(fixed);
  });
});

describe("single elements", () => {
  it.each(FIXTURES)("%s", (name) => {
    const { levels } = model(name);
    const expected = JSON.parse(fixture(name.replace(".hmk", ".json")).toString("utf-8")) as
      { indices: number[][]; values: number[][] };
    expected.indices.forEach((index, i) => {
      expected.values[i]!.forEach((value, l) => {
        expect(decodeRows(levels, index, l + 1)).toBeCloseTo(value, 9);
      });
    });
  });

  it("reads merged axes by their strides", () => {
    const { metadata, levels } = model("v1.0-merged.hmk");
    const sizes = metadata.axes.map((axis) => axis.size);
    const { low, high, least, most } = valueRange(metadata, levels, levels.length);
    expect(low).toBeLessThan(high);
    expect([least <= low, most >= high]).toEqual([true, true]);
    const rows = metadata.modeSizes.map((size) => size - 1); // the last element by axes is the last by modes
    expect(decodeElement(metadata, levels, sizes.map((size) => size - 1), levels.length))
      .toBe(decodeRows(levels, rows, levels.length));
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
