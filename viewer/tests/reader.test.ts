/** The reader against what breaks the format, damage, and files that come in parts. */

import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { decodeRows } from "../src/decode/element";
import { asProblem } from "../src/problem";
import { halfBits, halfValues } from "../src/reader/half";
import { DEFAULT_LIMITS, type Limits } from "../src/reader/limits";
import { Reading, loads } from "../src/reader/read";
import { HmkError, REASONS } from "../src/reader/reasons";
import { type Node, encodeRun } from "./encoder";
import { type Content, assemble, encode, fileOf } from "./files";
import { merged, small } from "./models";
import { nearest } from "./trees";

function verdict(read: () => unknown): HmkError | null {
  try {
    read();
  } catch (error) {
    if (error instanceof HmkError) {
      return error;
    }
    throw error;
  }
  return null;
}

type Json = Record<string | number, unknown>;
type Path = (string | number)[];

/** A file of a header with a value changed, or without it. */
function withHeader(content: Content, path: Path, value?: unknown): Uint8Array<ArrayBuffer> {
  const { header, sections } = encode(content);
  return assemble(JSON.stringify(edited(header, path, value)), sections);
}

function edited(header: Record<string, unknown>, path: Path, value?: unknown): Record<string, unknown> {
  const copy = structuredClone(header);
  const last = path.at(-1)!;
  const parent = path.slice(0, -1).reduce<Json>((at, key) => at[key] as Json, copy);
  if (value === undefined) {
    delete parent[last];
  } else {
    parent[last] = value;
  }
  return copy;
}

/** A file of a header's text with a part of it replaced. */
function withText(old: string, other: string | Uint8Array, times = 1): Uint8Array<ArrayBuffer> {
  const { header, sections } = encode(small());
  const text = JSON.stringify(header);
  expect(text).toContain(old);
  const [before, after] = [text.slice(0, text.indexOf(old)), text.slice(text.indexOf(old) + old.length)];
  return assemble(Buffer.concat([Buffer.from(before), ...new Array<Uint8Array>(times).fill(Buffer.from(other)), Buffer.from(after)]), sections);
}

/** A file of one stage with one node of one mode, of so many rows; `change` changes the node that is coded, `path` the header. */
function withNode(change: (node: Node) => void, path: Path = [], value?: unknown, code?: Uint8Array): Uint8Array<ArrayBuffer> {
  const content = { header: {
    axes: [{ name: "x", size: 6 }], organisation: [[0]], dtype: "float32", quality: [{ snr_db: 1, rmse: 1, max_abs_error: 1 }],
  }, coordinates: [], stages: [{ nodes: [node()], runs: [1], step: 0.5, isHalf: false }] };
  const coded = node();
  change(coded);
  const { header, sections } = encode(content);
  const payload = code ?? encodeRun([coded], true, true);
  const own = edited(header, ["stages", 0, "runs", 0, 1], payload.length);
  return assemble(JSON.stringify(path.length > 0 ? edited(own, path, value) : own), [payload, ...sections.slice(1)]);
}

/** Six rows in two clusters each of three. */
function node(): Node {
  return {
    kind: "cells", rows: [6], extents: [[6]], clusters: [3], mixture: [2], ranks: [1], part: [null], grid: [null],
    cluster: [[[0, 1], [1, 2], [0, 2], [0, 1], [0, 1], [1, 2]]], k: [[[4], [4], [4]]], core: [3, -2, 1],
    basis: [[1, 0, -1, 2, 3, 1, 1, 1, 0, 0, 1, 1]],
  };
}

/** A cut of six rows into two parts, and its children. */
function cut(change: (node: Node) => void, path: Path = [], value?: unknown): Uint8Array<ArrayBuffer> {
  const half = (): Node => ({
    ...node(), rows: [3], extents: [[3]], clusters: [1], mixture: [1], cluster: [[[0], [0], [0]]], k: [[[4]]], core: [2], basis: [[1, 1, 0]],
  });
  const root: Node = {
    ...node(), kind: "cut", mixture: [0], ranks: [0], clusters: [2], grid: [null], part: [[0, 0, 1, 1, 0, 1]], cluster: [[]], k: [[]], core: [], basis: [[]],
  };
  const content: Content = { header: {
    axes: [{ name: "x", size: 6 }], organisation: [[0]], dtype: "float32", quality: [{ snr_db: 1, rmse: 1, max_abs_error: 1 }],
  }, coordinates: [], stages: [
    { nodes: [root], runs: [1], step: null, isHalf: false }, { nodes: [half(), half()], runs: [2], step: 1, isHalf: false },
  ] };
  const { header, sections } = encode(content);
  change(root);
  const payload = encodeRun([root], false, false);
  const own = edited(header, ["stages", 0, "runs", 0, 1], payload.length);
  return assemble(JSON.stringify(path.length > 0 ? edited(own, path, value) : own), [payload, ...sections.slice(1)]);
}

/** Bytes changed behind the checksums' back: the last section's first byte. */
function damaged(): Uint8Array<ArrayBuffer> {
  const bytes = fileOf(small());
  bytes[bytes.length - 6]! ^= 1;
  return bytes;
}

const stage = (t: number, ...path: Path): Path => ["stages", t, ...path];
const same = (): void => undefined;
const scaled = (step: number): Uint8Array<ArrayBuffer> => withHeader(small(), stage(0, "step"), step);
const coordinates = (...values: number[]): Uint8Array<ArrayBuffer> => {
  const content = merged();
  return fileOf({ ...content, coordinates: [content.coordinates[0]!, new Uint8Array(Float64Array.from(values).buffer)] });
};

const CASES: [string, string, () => Uint8Array<ArrayBuffer>, Partial<Limits>?][] = [
  ["ok", "small", () => fileOf(small())], ["ok", "merged", () => fileOf(merged())], ["ok", "a node", () => withNode(same)], ["ok", "a cut", () => cut(same)],
  ["truncated", "no bytes", () => new Uint8Array(0)],
  ["truncated", "without the last byte", () => fileOf(small()).slice(0, -1)],
  ["truncated", "a header that is longer than the file", () => fileOf(small()).slice(0, 200)],
  ["foreign-file", "a picture", () => Uint8Array.from([0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10, ...new Array<number>(40).fill(0)])],
  ["foreign-file", "zeros", () => new Uint8Array(40)],
  ["version-unknown", "version 2", () => assemble("{}", [], 2)],
  ["header-too-large", "a limit", () => fileOf(small()), { json_bytes: 100 }],
  ["header-crc", "a bit of the header", () => {
    const bytes = fileOf(small());
    bytes[30]! ^= 1;
    return bytes;
  }],
  ["header-bytes", "a line feed", () => withText(",", "\n,")],
  ["header-bytes", "an upper-case digit", () => withText("tests", "\\u00DF")],
  ["json-encoding", "half a character", () => withText("tests", Uint8Array.of(0xc3))],
  ["json-encoding", "half a surrogate pair", () => withText("tests", "\\ud800")],
  ["json-syntax", "no JSON", () => assemble("{", [])],
  ["json-syntax", "a space", () => withText(",", ", ")],
  ["json-syntax", "something behind it", () => assemble("{}{}", [])],
  ["json-duplicate-key", "two writers", () => withText('"writer":', '"writer":"","writer":')],
  ["json-number", "infinity", () => withText('"seed":7', '"seed":1e999')],
  ["json-number", "a large whole number", () => withText('"seed":7', '"seed":9007199254740992')],
  ["json-depth", "a deep source", () => withText('"hand"', `${"[".repeat(20)}${"]".repeat(20)}`)],
  ["json-string", "a limit", () => fileOf(small()), { json_string: 6 }],
  ["field-missing", "no axes", () => withHeader(small(), ["axes"])],
  ["field-missing", "no runs", () => withHeader(small(), stage(0, "runs"))],
  ["field-unknown", "a field more", () => withHeader(small(), stage(0, "more"), 1)],
  ["field-type", "a fraction of nodes", () => withHeader(small(), stage(0, "nodes"), 1.5)],
  ["field-value", "a size of 0", () => withHeader(small(), ["axes", 1, "size"], 0)],
  ["field-value", "two axes of a name", () => withHeader(small(), ["axes", 1, "name"], "höhe")],
  ["field-value", "a step of 0", () => scaled(0)],
  ["field-value", "a step beyond float32", () => scaled(1e39)],
  ["field-value", "a step and bits", () => withHeader(small(), stage(0, "bits"), 16)],
  ["field-value", "other bits", () => withHeader(merged(), stage(2, "bits"), 8)],
  ["field-value", "a last stage without numbers", () => withHeader(small(), stage(1, "step"))],
  ["field-value", "a cut with a step", () => cut(same, stage(0, "step"), 1)],
  ["field-value", "numbers without a step", () => withHeader(small(), stage(0, "step"))],
  ["field-value", "two roots", () => withHeader(small(), stage(0, "nodes"), 2)],
  ["field-value", "runs of other nodes", () => withHeader(small(), stage(1, "nodes"), 1000)],
  ["field-value", "a quality too few", () => withHeader(small(), ["quality"], [])],
  ["field-value", "an exact level with errors", () => withHeader(small(), ["quality", 0, "snr_db"], null)],
  ["organisation", "an axis twice", () => withHeader(small(), ["organisation"], [[0], [0]])],
  ["transform-unknown", "another transform", () => withHeader(small(), ["transform"], { name: "cube" })],
  ["trailing-bytes", "a byte more", () => Uint8Array.from([...fileOf(small()), 0])],
  ["section-crc", "a bit of the last section", damaged],
  ["code-end", "a byte behind the code", () => withNode(same, [], undefined, Uint8Array.from([...encodeRun([node()], true, true), 0]))],
  ["code-end", "a code cut short", () => withNode(same, [], undefined, encodeRun([node()], true, true).slice(0, -2))],
  ["code-end", "a code of too few bytes", () => withNode(same, [], undefined, Uint8Array.of(0, 0))],
  ["code-range", "a column finer than any", () => withNode((each) => { each.k[0]![0]![0] = 64; })],
  ["code-range", "a number of 25 bits", () => withNode((each) => { each.core[1] = 2 ** 24; })],
  ["node-shape", "more clusters a row than there are", () => withNode((each) => { each.mixture = [4]; }, stage(0, "largest", 1), [4])],
  ["node-shape", "a cut into one part", () => cut((each) => { each.clusters = [1]; })],
  ["level-bounds", "a rank above", () => withNode((each) => { each.ranks = [2]; })],
  ["level-bounds", "a largest that is not there", () => withNode(same, stage(0, "largest", 2), [2])],
  ["run-count", "a cell less", () => withNode(same, stage(0, "runs", 0, 2), 4)],
  ["run-count", "a number more", () => withNode(same, stage(0, "runs", 0, 4), 11)],
  ["run-count", "more children than nodes", () => cut((each) => { each.clusters = [3]; }, stage(0, "largest", 0), [3])],
  ["row-count", "other rows of the root", () => withNode(same, stage(0, "rows"), [7])],
  ["row-count", "other rows of children", () => cut(same, stage(1, "rows"), [7])],
  ["cluster-range", "a label above", () => withNode((each) => { each.cluster[0]![2] = [0, 3]; })],
  ["cluster-order", "clusters that descend", () => withNode((each) => { each.cluster[0]![2] = [2, 0]; })],
  ["not-finite", "a coordinate", () => coordinates(0, NaN)],
  ["not-finite", "a basis number beyond half precision", () => withNode((each) => {
    each.k[0]![0]![0] = 0;
    each.basis[0]![0] = 65520;
  })],
  ["value-range", "a large step", () => withNode(same, stage(0, "step"), 2e38)],
  ["order-limit", "a limit", () => fileOf(small()), { order: 1 }],
  ["axes-limit", "a limit", () => fileOf(small()), { axes: 1 }],
  ["elements-limit", "a limit", () => fileOf(small()), { elements: 11 }],
  ["levels-limit", "a limit", () => fileOf(small()), { levels: 1 }],
  ["nodes-limit", "a limit", () => fileOf(small()), { nodes: 1 }],
  ["clusters-limit", "a limit", () => withNode(same), { clusters: 2 }],
  ["mixture-limit", "a limit", () => withNode(same), { mixture: 1 }],
  ["rank-limit", "an undecomposed mode's", () => withNode(same, stage(0, "largest"), [[1], [0], [7]])],
  ["rank-limit", "a limit", () => withNode(same), { rank: 0 }],
  ["level-cost-limit", "a limit", () => withNode(same), { level_cost: 1 }],
  ["widened-limit", "more numbers than the file is allowed", () => withNode(same, stage(0, "runs", 0, 3), 2 ** 26)],
  ["child-count", "a node more", () => {
    const { header, sections } = encode(small());
    const { nodes, runs } = (header["stages"] as { nodes: number; runs: number[][] }[])[1]!;
    const more = edited(header, stage(1, "nodes"), nodes + 1);
    return assemble(JSON.stringify(edited(more, stage(1, "runs", 0, 0), runs[0]![0]! + 1)), sections);
  }],
];

describe("refusals", () => {
  it("have every reason", () => {
    expect(new Set(CASES.map(([reason]) => reason))).toEqual(new Set([...[...REASONS.keys()].filter((code) => code !== "unreadable"), "ok"]));
  });

  it.each(CASES)("%s: %s", (reason, _, make, limits = {}) => {
    expect(verdict(() => loads(make(), { ...DEFAULT_LIMITS, ...limits }))?.reason ?? "ok").toBe(reason);
  });

  it("come before memory is taken", () => {
    const rows = withHeader(small(), ["axes", 0, "size"], 2 ** 32 - 1);
    expect(verdict(() => loads(rows))).not.toBeNull();
    const huge = withNode(same, stage(0, "runs", 0, 3), 2 ** 32 - 1);
    expect(verdict(() => loads(huge))?.message).toMatch(/found \d+ MiB of memory, allowed at most 64 MiB for a file of \d+ bytes\. Next: .* the limit widened: \d+/);
  });
});

describe.each([["small", small], ["merged", merged]])("damage of %s", (_, make) => {
  const file = fileOf(make());

  it("reports every truncation as such", () => {
    for (let size = 0; size < file.length; size += 1) {
      expect(verdict(() => loads(file.slice(0, size)))?.reason, `cut to ${size}`).toBe("truncated");
    }
  });

  it("reports every flipped bit", () => {
    const unnoticed: number[] = [];
    const data = file.slice();
    for (let bit = 0; bit < 8 * data.length; bit += 1) {
      data[bit >> 3]! ^= 1 << (bit & 7);
      if (verdict(() => loads(data)) === null) {
        unnoticed.push(bit);
      }
      data[bit >> 3]! ^= 1 << (bit & 7);
    }
    expect(unnoticed).toEqual([]);
    expect(verdict(() => loads(data))).toBeNull();
  }, 60_000);
});

describe("codes", () => {
  it("of any bytes are read or refused", () => {
    let state = 5;
    const found = new Set<string>();
    for (let round = 0; round < 300; round += 1) {
      const bytes = Uint8Array.from({ length: 4 + (round % 60) }, () => {
        state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
        return round % 3 === 0 ? state >>> 24 : (state >>> 24) & (state >>> 16);
      });
      found.add(verdict(() => loads(withNode(same, [], undefined, bytes)))?.reason ?? "ok");
    }
    expect(found.size).toBeGreaterThan(2);
    expect(["cluster-order", "cluster-range", "code-end", "code-range", "level-bounds", "node-shape", "run-count", "not-finite"]).toEqual(
      expect.arrayContaining([...found]));
  });
});

describe.each([["small", small], ["merged", merged]])("reading in parts: %s", (_, make) => {
  const file = fileOf(make());
  const whole = loads(file);

  it("needs for a section no byte behind it, and has in each level what the whole file has", () => {
    const part = new Uint8Array(file.length);
    const header = 20 + new DataView(file.buffer).getUint32(12, true);
    part.set(file.subarray(0, header));
    const reading = new Reading(part, file.length);
    const ends: number[] = [];
    while (reading.nextEnd !== null) {
      const { arrived, nextEnd } = reading;
      part.set(file.subarray(0, nextEnd));
      reading.readNext(part);
      if (reading.arrived > arrived) {
        expect(reading.levelEnd(reading.arrived)).toBe(nextEnd);
        ends.push(nextEnd);
      }
    }
    expect(ends).toHaveLength(whole.metadata.levels.length);
    expect(ends.at(-1)).toBe(file.length);
    expect(reading.stages).toEqual(whole.stages);
    expect(reading.metadata).toEqual(whole.metadata);
  });

  it("notices a section that is not there yet", () => {
    const reading = new Reading(file, file.length);
    const part = file.slice();
    part[reading.nextEnd! - 1]! ^= 255;
    const error = verdict(() => reading.readNext(part));
    expect(error?.reason).toBe("section-crc");
    expect(error?.message).toMatch(/bytes whose checksum \(CRC-32\) is 0x[0-9a-f]{8}, allowed 0x[0-9a-f]{8}, as the file says\. Next: fetch the file again\./);
  });
});

describe("fixtures", () => {
  const folder = join(import.meta.dirname, "..", "..", "tests", "fixtures");
  const names = readdirSync(folder).filter((name) => name.endsWith(".hmk"));

  it.each(names)("%s has the elements that were written down beside it", (name) => {
    const { metadata, stages } = loads(new Uint8Array(readFileSync(join(folder, name))));
    const { elements } = JSON.parse(readFileSync(join(folder, name.replace(".hmk", ".json")), "utf-8")) as { elements: number[][] };
    const order = metadata.modeSizes.length;
    expect(elements.length).toBeGreaterThan(9);
    for (const element of elements) {
      expect(element).toHaveLength(order + stages.length);
      stages.forEach((_, t) => {
        const expected = element[order + t]!;
        const off = Math.abs(decodeRows(stages, element.slice(0, order), t + 1) - expected);
        expect(off, `stage ${t} of ${element.slice(0, order).join()}`).toBeLessThan(1e-6 * Math.max(1, Math.abs(expected)));
      });
    }
  });
});

it("says of coordinates what there is", () => {
  const { axes } = loads(fileOf(merged())).metadata;
  expect(axes.map(({ coords }) => coords?.width ?? null)).toEqual([3, null, 0, null]);
  expect(axes[0]!.coords!.values).toHaveLength(15);
  expect(Array.from(axes[2]!.coords!.values)).toEqual([0, 0.04]);
  expect(loads(fileOf(small())).metadata.axes[0]!.coords!.values).toEqual(Float64Array.of(0, 0.5, 1, 2.5));
});

describe("half precision", () => {
  const values = halfValues();

  it("is the inverse of the value of a pattern, with ties to even", () => {
    const wrong: number[] = [];
    for (let bits = 0; bits < 0x7bff; bits += 1) {
      const middle = (values[bits]! + values[bits + 1]!) / 2;
      const found = [values[bits]!, -values[bits]!, middle].map(halfBits);
      if (found.join() !== [bits, bits + 0x8000, bits + (bits & 1)].join()) {
        wrong.push(bits);
      }
    }
    expect(wrong).toEqual([]);
    expect([65519, 65520, Infinity].map(halfBits)).toEqual([0x7bff, 0x7c00, 0x7c00]);
  });

  it("of any float32 is the nearest", () => {
    for (let power = -30; power < 17; power += 1) {
      for (let i = 0; i < 40; i += 1) {
        const value = Math.fround(2 ** power * (1 + ((i * 7919) % 4096) / 4096 + i * 2 ** -20));
        expect(halfBits(value)).toBe(nearest(value));
      }
    }
  });
});

it.each([
  [() => assemble("{}", [], 2), "The file is newer than this page."], [() => fileOf(small()).slice(0, 7), "The file is not complete."],
  [() => new Uint8Array(99), "This is no .hmk file."], [damaged, "The file is damaged."],
])("says what it is of %#", (make, start) => {
  expect(asProblem(verdict(() => loads(make()))).sentence).toMatch(start);
});
