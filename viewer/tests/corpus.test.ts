/** The reader against the corpus of cases shared with Python (`tests/corpus`). */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { describe, expect, it } from "vitest";
import { DEFAULT_LIMITS } from "../src/reader/limits";
import { loads } from "../src/reader/read";
import { HmkError, REASONS } from "../src/reader/reasons";
import { assemble } from "./files";

const TESTS = join(import.meta.dirname, "..", "..", "tests");
const PYTHON = join(TESTS, "..", "python", "hmkcta", "hmkfile");

type Path = (string | number)[];

interface Change {
  path: Path;
  to?: unknown;
}

interface Edit {
  op: "append" | "truncate" | "bytes" | "text" | "rewrite" | "section" | "header";
  hex?: string;
  size?: number;
  at?: number;
  number?: number;
  from?: string;
  header?: Change[];
  path?: Path;
  to?: unknown;
}

interface Case {
  name: string;
  base: string;
  edits?: Edit[];
  limits?: Record<string, number>;
  kind: string;
  reason: string;
  where?: string;
}

const { cases: CASES } = JSON.parse(readFileSync(join(TESTS, "corpus", "cases.json"), "utf-8")) as { cases: Case[] };

interface Header {
  axes: { size: number; coordinates?: { dtype: string; width: number } | number[] }[];
  stages: { bits?: number; runs: number[][] }[];
}

/** A sound file's header text, and the payloads of its sections. */
function split(data: Buffer): { text: Buffer; sections: Buffer[] } {
  const end = 20 + data.readUInt32LE(12);
  const text = data.subarray(20, end);
  const { axes, stages } = JSON.parse(text.toString("utf-8")) as Header;
  const coordinates = axes.flatMap(({ size, coordinates: given }) => (given === undefined || Array.isArray(given) ? []
    : [size * Math.max(1, given.width) * (given.dtype === "F32" ? 4 : 8)]));
  const runs = stages.flatMap((stage) => stage.runs.map(([, coded, cells, core, ...basis]) =>
    coded! + (stage.bits === undefined ? 0 : 4 * cells! + 2 * basis.reduce((sum, each) => sum + each, core!))));
  let at = end;
  const sections = [...coordinates, ...runs].map((length) => {
    at += length + 4;
    return data.subarray(at - length - 4, at - 4);
  });
  return { text, sections };
}

function changed(value: unknown, change: Change): unknown {
  if (change.path.length === 0) {
    return change.to;
  }
  const copy = structuredClone(value) as Record<string | number, unknown>;
  const last = change.path.at(-1)!;
  const parent = change.path.slice(0, -1).reduce((at, key) => at[key] as Record<string | number, unknown>, copy);
  if ("to" in change) {
    parent[last] = change.to;
  } else if (Array.isArray(parent)) {
    parent.splice(Number(last), 1);
  } else {
    delete parent[last];
  }
  return copy;
}

function applied(data: Buffer, edit: Edit): Buffer {
  const hex = Buffer.from(edit.hex ?? "", "hex");
  const put = (into: Buffer, at: number): Buffer => {
    const from = at < 0 ? into.length + at : at;
    return Buffer.concat([into.subarray(0, from), hex, into.subarray(from + hex.length)]);
  };
  switch (edit.op) {
    case "append": return Buffer.concat([data, hex]);
    case "truncate": return data.subarray(0, edit.size);
    case "bytes": return put(data, edit.at!);
  }
  let { text, sections } = split(data);
  const withHeader = (changes: Change[]): Buffer =>
    Buffer.from(JSON.stringify(changes.reduce<unknown>(changed, JSON.parse(text.toString("utf-8")))));
  if (edit.op === "text") {
    const from = Buffer.from(edit.from!, "hex");
    const at = text.indexOf(from);
    text = at < 0 ? text : Buffer.concat([text.subarray(0, at), hex, text.subarray(at + from.length)]);
  } else if (edit.op === "rewrite") {
    text = withHeader(edit.header!);
    sections = [hex, ...sections.slice(1)];
  } else if (edit.op === "section") {
    sections = sections.map((own, n) => (n !== edit.number ? own : edit.at === undefined ? hex : put(own, edit.at)));
  } else {
    text = withHeader([edit as Change]);
  }
  return Buffer.from(assemble(text, sections, data.readUInt32LE(8)));
}

function build({ base, edits = [] }: Case): Uint8Array<ArrayBuffer> {
  const data = base === "" ? Buffer.alloc(0) : readFileSync(join(TESTS, "fixtures", base));
  return new Uint8Array(edits.reduce(applied, data));
}

it.each(["small", "merged", "own", "half"])("the fixture %s has the shapes that were written down beside it", (name) => {
  const expected = JSON.parse(readFileSync(join(TESTS, "fixtures", `v1-${name}.json`), "utf-8")) as { shape: number[][][][] };
  const { stages } = loads(new Uint8Array(readFileSync(join(TESTS, "fixtures", `v1-${name}.hmk`))));
  expect(stages.map(({ shape }) => [...shape])).toEqual(expected.shape.map((shape) => shape.flat(2)));
});

describe("the corpus", () => {
  it.each(CASES)("$reason: $name", (each) => {
    let found: unknown = null;
    try {
      loads(build(each), { ...DEFAULT_LIMITS, ...each.limits });
    } catch (error) {
      found = error;
    }
    expect(found).toBeInstanceOf(HmkError);
    const { kind, reason, where } = found as HmkError;
    expect([kind, reason, where], (found as HmkError).message).toEqual([each.kind, each.reason, each.where ?? where]);
  });

  it("exercises every reason, but for a path that cannot be read", () => {
    expect(new Set([...CASES.map(({ reason }) => reason), "unreadable"])).toEqual(new Set(REASONS.keys()));
  });
});

it("has the reasons of Python, in the same words", () => {
  const text = readFileSync(join(PYTHON, "reasons.py"), "utf-8");
  const said = text.slice(0, text.indexOf("WRITER_REASONS"));
  const sentences = [...said.matchAll(/^ {4}"([a-z0-9-]+)": (?:Reason\([\w.]+, )?"((?:[^"\\]|\\.)*)"/gm)]
    .map(([, code, sentence]) => [code, sentence!.replaceAll("\\\\", "\\")]);
  expect(sentences.length).toBeGreaterThan(30);
  expect(new Map(sentences as [string, string][])).toEqual(new Map(Array.from(REASONS, ([code, { sentence }]) => [code, sentence])));
});
