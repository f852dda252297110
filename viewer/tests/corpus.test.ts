/** Cases of the shared corpus (`tests/corpus`), read by this reader: the same reasons at the same places as in Python. */

import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import { DEFAULT_LIMITS } from "../src/reader/limits";
import { loads } from "../src/reader/read";
import { HmkError } from "../src/reader/reasons";
import { assemble } from "./files";

type Path = (string | number)[];
interface Edit { op: string; at?: number; size?: number; number?: number; hex?: string; from?: string; path?: Path; to?: unknown; header?: Edit[] }
interface Case { name: string; base: string; edits: Edit[]; kind: string; reason: string; where?: string; limits?: Record<string, number> }

const TESTS = new URL("../../tests/", import.meta.url);
const { cases } = JSON.parse(readFileSync(new URL("corpus/cases.json", TESTS), "utf8")) as { cases: Case[] };
/** JSON here makes 4 of 4.0: these cases are of the other reader. */
const PYTHON_ONLY = new Set(["a size of 4.0"]);

interface Parts { text: Buffer; sections: Buffer[] }

function split(data: Buffer): Parts {
  const length = data.readUInt32LE(12);
  const text = data.subarray(20, 20 + length);
  let at = 20 + length;
  const sections = lengths(JSON.parse(text.toString()) as Header).map((size) => {
    at += size + 4;
    return data.subarray(at - size - 4, at - 4);
  });
  return { text, sections };
}

interface Header {
  axes: { size: number; coordinates?: { dtype: string; width: number } | unknown[] }[];
  stages: { runs: number[][]; bits?: number }[];
}

function lengths({ axes, stages }: Header): number[] {
  const coordinates = axes.flatMap(({ size, coordinates: given }) =>
    given === undefined || Array.isArray(given) ? [] : [size * Math.max(1, given.width) * (given.dtype === "F32" ? 4 : 8)]);
  const runs = stages.flatMap(({ runs: own, bits }) => own.map(([, coded, cells, ...numbers]) =>
    coded! + (bits === undefined ? 0 : 4 * cells! + 2 * numbers.reduce((all, each) => all + each, 0))));
  return [...coordinates, ...runs];
}

function changed(value: unknown, [first, ...rest]: Path, edit: Edit): unknown {
  if (first === undefined) {
    return edit.to;
  }
  const inner = value as Record<string | number, unknown>;
  if (rest.length === 0 && !("to" in edit)) {
    delete inner[first];
  } else {
    inner[first] = changed(inner[first], rest, edit);
  }
  return inner;
}

function withHeader(text: Buffer, edits: Edit[]): Buffer {
  const header = edits.reduce<unknown>((value, edit) => changed(value, edit.path!, edit), JSON.parse(text.toString()));
  return Buffer.from(JSON.stringify(header));
}

function apply(data: Buffer, edit: Edit): Buffer {
  const fresh = Buffer.from(edit.hex ?? "", "hex");
  const patched = (whole: Buffer, at: number): Buffer => {
    const start = at < 0 ? at + whole.length : at;
    return Buffer.concat([whole.subarray(0, start), fresh, whole.subarray(start + fresh.length)]);
  };
  switch (edit.op) {
    case "append": return Buffer.concat([data, fresh]);
    case "truncate": return data.subarray(0, edit.size);
    case "bytes": return patched(data, edit.at!);
  }
  const { text, sections } = split(data);
  if (edit.op === "text") {
    const old = Buffer.from(edit.from!, "hex");
    const at = text.indexOf(old);
    return Buffer.from(assemble(Buffer.concat([text.subarray(0, at), fresh, text.subarray(at + old.length)]), sections));
  }
  if (edit.op === "section") {
    sections[edit.number!] = patched(sections[edit.number!]!, edit.at!);
    return Buffer.from(assemble(text, sections));
  }
  if (edit.op === "rewrite") {
    return Buffer.from(assemble(withHeader(text, edit.header!), [fresh, ...sections.slice(1)]));
  }
  return Buffer.from(assemble(withHeader(text, [edit]), sections));
}

describe("corpus", () => {
  test.each(cases.filter(({ name }) => !PYTHON_ONLY.has(name)))("$name", ({ base, edits, kind, reason, where, limits }) => {
    const start = base === "" ? Buffer.alloc(0) : readFileSync(new URL(`fixtures/${base}`, TESTS));
    const data = new Uint8Array(edits.reduce(apply, start));
    try {
      loads(data, { ...DEFAULT_LIMITS, ...limits });
    } catch (error) {
      expect(error).toBeInstanceOf(HmkError);
      const told = error as HmkError;
      expect([told.kind, told.reason], told.message).toEqual([kind, reason]);
      expect(where === undefined || told.where === where, `${told.where} in place of ${where}`).toBe(true);
      return;
    }
    expect.fail("it was taken");
  });

  test.each(["small", "merged", "own", "half"])("the fixture %s is read", (name) => {
    const expected = JSON.parse(readFileSync(new URL(`fixtures/v1-${name}.json`, TESTS), "utf8")) as { shape: number[][][][] };
    const { stages } = loads(new Uint8Array(readFileSync(new URL(`fixtures/v1-${name}.hmk`, TESTS))));
    expect(stages.map(({ shape }) => [...shape])).toEqual(expected.shape.map((shape) => shape.flat(2)));
  });
});
