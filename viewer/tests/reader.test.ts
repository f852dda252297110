/** The reader against the corpus shared with Python, the fixtures, and damage. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { DEFAULT_LIMITS } from "../src/reader/limits";
import { halfBits, halfValues } from "../src/reader/half";
import { BASIS_NUMBERS, CORE_NUMBERS } from "../src/reader/narrow";
import { Reading, loads } from "../src/reader/read";
import { asProblem } from "../src/problem";
import { HmkError, REASONS } from "../src/reader/reasons";
import { FIXTURES, build, fixture, readCorpus } from "./corpus";

const CASES = readCorpus();

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

function bytes(name: string): Uint8Array<ArrayBuffer> {
  return new Uint8Array(fixture(name));
}

describe("corpus", () => {
  it("is there and exercises every reason", () => {
    expect(CASES.length).toBeGreaterThan(200);
    expect(new Set(CASES.map((each) => each.expect.reason))).toEqual(new Set([...REASONS.keys(), "ok"]));
  });

  it.each(CASES.filter((each) => each.base !== null))("$expect.reason: $name", (each) => {
    const error = verdict(() => loads(build(each)!, { ...DEFAULT_LIMITS, ...each.limits }));
    expect([error?.kind ?? "ok", error?.reason ?? "ok"]).toEqual([each.expect.kind, each.expect.reason]);
    if (each.expect.where !== undefined) {
      expect(error?.where).toBe(each.expect.where);
    }
  });
});

it("has the reasons of the specification", () => {
  const text = readFileSync(join(import.meta.dirname, "..", "..", "docs", "format.md"), "utf-8");
  const rows = [...text.matchAll(/^\| `([a-z-]+)` \| (Compatibility|Corruption|InsufficientData|ResourceLimit|Io) \| (.*) \|$/gm)]
    .map(([, code, kind, sentence]) => [code, kind, sentence])
    .filter(([code]) => !["output-exists", "disk-full", "unwritable"].includes(code ?? ""));
  expect(new Set(rows.map(String))).toEqual(
    new Set([...REASONS].map(([code, { kind, sentence }]) => String([code, kind, sentence]))));
});

describe.each(["v1.0-small.hmk", "v1.1-eight.hmk", "v1.2-eight.hmk", "v1.2-lone.hmk"])("damage of %s", (name) => {
  const small = bytes(name);

  it("reports every truncation as such", () => {
    for (let size = 0; size < small.length; size += 1) {
      const error = verdict(() => loads(small.slice(0, size)));
      expect(error?.reason, `cut to ${size}`).toBe("truncated");
    }
  });

  it("reports every flipped bit", () => {
    const unnoticed: number[] = [];
    const data = small.slice();
    for (let bit = 0; bit < 8 * data.length; bit += 1) {
      data[bit >> 3]! ^= 1 << (bit & 7);
      if (verdict(() => loads(data)) === null) {
        unnoticed.push(bit);
      }
      data[bit >> 3]! ^= 1 << (bit & 7);
    }
    expect(unnoticed).toEqual([]);
    expect(verdict(() => loads(data))).toBeNull();
  }, 120_000);
});

describe("short tables", () => {
  it.each(["eight", "mixed"])("are those of the version before: %s", (name) => {
    const [before, short] = ["v1.1", "v1.2"].map((version) => loads(bytes(`${version}-${name}.hmk`)).levels);
    short!.forEach((level, l) => {
      for (const [key, table] of Object.entries(level)) {
        if (!["core", "coreScale", "basis"].includes(key)) {
          expect(table, key).toEqual(before![l]![key as keyof typeof level]);
        }
      }
    });
  });

  it("make no more than the file holds", () => {
    // A tensor of zeros whose nodes own billions of rows.
    const zero = build({
      name: "", base: "v1.2-lone.hmk", expect: { kind: "", reason: "" }, edits: [
        { op: "metadata", path: ["axes", 0, "size"], value: 2 ** 32 - 1 },
        { op: "array-put", name: "level/1/shape", at: 0, values: [0, 0, 0, 0, 0, 0, 0, 0, 0] },
        { op: "array-put", name: "level/1/child", at: 1, values: [0] },
      ],
    })!;
    expect(verdict(() => loads(zero))?.reason).toBe("array-shape");
  });
});

describe.each(FIXTURES)("reading in parts: %s", (name) => {
  const file = bytes(name);
  const length = Number(new DataView(file.buffer).getBigUint64(0, true));

  /** The file as it is after its first `end` bytes have come: zeros behind them. */
  const arrived = (end: number): Uint8Array<ArrayBuffer> => {
    const part = new Uint8Array(file.length);
    part.set(file.subarray(0, end));
    return part;
  };

  it("needs for a level no byte behind it", () => {
    const reading = new Reading(file.subarray(8, 8 + length), file.length);
    reading.readTables(arrived(reading.tablesEnd));
    reading.metadata.levels.forEach((_, l) => {
      reading.readLevel(l + 1, arrived(reading.levelEnd(l + 1)));
    });
    expect(reading.levelEnd(1)).toBeLessThan(reading.levelEnd(2));
    expect(reading.levelEnd(reading.metadata.levels.length)).toBe(file.length);
  });

  it("has in each level the numbers of the whole file", () => {
    const reading = new Reading(file.subarray(8, 8 + length), file.length);
    const memory = arrived(reading.tablesEnd);
    reading.readTables(memory);
    loads(file).levels.forEach((level, l) => {
      const { core } = reading.levels[l]!; // what a decoder has at hand from the first
      expect(core).not.toEqual(level.core);
      memory.set(file.subarray(0, reading.levelEnd(l + 1)));
      reading.readLevel(l + 1, memory);
      expect(reading.levels[l]).toEqual(level);
      expect(core).toEqual(level.core);
    });
  });

  it("notices a level that is not there yet", () => {
    const reading = new Reading(file.subarray(8, 8 + length), file.length);
    reading.readTables(arrived(reading.tablesEnd));
    const error = verdict(() => reading.readLevel(1, arrived(reading.levelEnd(1) - 1)));
    expect(error?.reason).toBe("array-crc");
    expect(error?.message, "as Python writes them").toMatch(
      /found stored bytes whose checksum \(CRC-32\) is 0x[0-9a-f]{8}, allowed 0x[0-9a-f]{8}, as the metadata say\./,
    );
  });
});

describe("bytes", () => {
  const values = halfValues();

  it.each<[string, Uint16Array, (byte: number) => number]>([
    ["basis", BASIS_NUMBERS, (byte) => byte / 128],
    ["core", CORE_NUMBERS, (byte) => (byte * Math.abs(byte)) / 16129],
  ])("stand for the nearest half-precision numbers in a %s", (_, table, exact) => {
    expect(table).toHaveLength(256);
    for (let byte = -128; byte < 128; byte += 1) {
      const bits = table[byte & 255]!;
      const off = (pattern: number): number => Math.abs(values[pattern]! - exact(byte));
      expect(bits & 0x8000, `sign of ${byte}`).toBe(byte < 0 ? 0x8000 : 0);
      expect(off(bits), `byte ${byte}`).toBeLessThan(byte === 0 ? 1e-9 : Math.min(off(bits - 1), off(bits + 1)));
    }
  });

  it("is the inverse of the value of a pattern, with ties to even", () => {
    for (let bits = 0; bits < 0x4000; bits += 1) {
      expect(halfBits(values[bits]!)).toBe(bits);
      expect(halfBits((values[bits]! + values[bits + 1]!) / 2)).toBe(bits + (bits & 1));
    }
  });
});

describe("headlines", () => {
  const sentence = (name: string): string => {
    const found = CASES.find((each) => each.name === name)!;
    return asProblem(verdict(() => loads(build(found)!, { ...DEFAULT_LIMITS, ...found.limits }))).sentence;
  };

  it.each([
    ["version 2.0", "The file is newer than this page."], ["seven bytes", "The file is not complete."],
    ["metadata is a list", "This is no .hmk file."], ["last bit flipped", "The file is damaged."],
  ])("fit the problem: %s", (name, start) => {
    expect(sentence(name)).toMatch(start);
  });

  it("take a picture for what it is", () => {
    const png = Uint8Array.from([0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10, ...new Array<number>(40).fill(0)]);
    expect(asProblem(verdict(() => loads(png))).sentence).toMatch("This is no .hmk file");
    const text = new Uint8Array(40);
    text[0] = 20;
    expect(asProblem(verdict(() => loads(text))).sentence).toMatch("This is no .hmk file");
  });
});
