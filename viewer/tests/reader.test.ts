/** The reader against the corpus shared with Python, the fixtures, and damage. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { DEFAULT_LIMITS } from "../src/reader/limits";
import { Reading, loads } from "../src/reader/read";
import { asProblem } from "../src/problem";
import { HmkError, REASONS } from "../src/reader/reasons";
import { build, fixture, readCorpus } from "./corpus";

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

describe("damage", () => {
  const small = bytes("v1.0-small.hmk");

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

describe("reading in parts", () => {
  const file = bytes("v1.0-merged.hmk");
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

  it("notices a level that is not there yet", () => {
    const reading = new Reading(file.subarray(8, 8 + length), file.length);
    reading.readTables(arrived(reading.tablesEnd));
    const error = verdict(() => reading.readLevel(1, arrived(reading.levelEnd(1) - 1)));
    expect(error?.reason).toBe("array-crc");
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
