/** What is told of a file as it arrives. */

import { describe, expect, it } from "vitest";
import { load } from "../src/load";
import { ByteSource } from "../src/stream";
import type { Node } from "./encoder";
import { encode, fileOf } from "./files";
import { small } from "./models";

/** A file that arrives up to where it is let. */
class Let extends ByteSource {
  asked: number[] = [];
  private go: () => void = () => undefined;

  constructor(private readonly file: Uint8Array, private limit = file.length) {
    super("a.hmk", new Uint8Array(file.length));
  }

  let(limit: number): void {
    this.limit = limit;
    this.go();
  }

  protected override async fetchTo(end: number): Promise<void> {
    this.asked.push(end);
    while (this.have < end) {
      const next = Math.min(end, this.limit);
      if (next > this.have) {
        this.add(this.file.slice(this.have, next));
      } else {
        await new Promise<void>((resolve) => { this.go = resolve; });
      }
    }
  }
}

/** All that is told, with the levels that are read by then. */
async function told(source: ByteSource, also: (what: string) => void = () => undefined): Promise<string[]> {
  const all: string[] = [];
  const tell = (what: string): void => {
    all.push(what);
    also(what);
  };
  await load(source, {
    onStart: ({ arrived }) => tell(`start ${arrived}`), onLevel: (_, level) => tell(`level ${level}`),
  }).catch((error: unknown) => tell((error as { reason: string }).reason));
  return all;
}

const file = fileOf(small());
const FIRST = file.length - encode(small()).sections.slice(1).reduce((sum, { length }) => sum + length + 4, 0); // the end of level 1

/** As the small file, with a level of 700 KB behind the first one. */
function large(): Uint8Array {
  const [rows, ranks] = [[1200, 300], [1200, 300]];
  const [root] = small().stages[0]!.nodes as [Node];
  const empty: Node = {
    ...root, kind: "cells", rows, extents: rows.map((each) => [each]), clusters: [1, 1], mixture: [0, 0], ranks, cluster: [[], []],
    part: [null, null], grid: [null, null], k: [[], []], core: [], basis: [[], []],
  };
  const one: Node = { ...empty, part: rows.map((each) => new Array<number>(each).fill(0)), core: [] };
  const stored = [{ core: new Array<number>(360_000).fill(0x3c00), basis: [[], []], scale: [1] }];
  const node = { ...one, core: stored[0]!.core };
  return fileOf({
    header: {
      axes: rows.map((size, n) => ({ name: `a${n}`, size })), organisation: [[0], [1]], dtype: "float32",
      quality: [0, 1].map(() => ({ snr_db: 1, rmse: 1, max_abs_error: 1 })),
    },
    coordinates: [],
    stages: [{ nodes: [node], runs: [1], step: null, isHalf: true, stored }, { nodes: [{ ...empty, core: node.core }], runs: [1], step: null, isHalf: true, stored }],
  });
}

describe("a file", () => {
  it("is told of once all of it is read where that takes no time", async () => {
    expect(await told(new Let(file))).toEqual(["start 2", "level 1", "level 2"]);
  });

  it("has its first level shown where the rest does not come", async () => {
    const source = new Let(file, FIRST);
    const all = await told(source, (what) => what === "level 1" && source.let(file.length));
    expect(all).toEqual(["start 1", "level 1", "level 2"]);
  });

  it("has its first level shown where the rest is long, which is not asked for before", async () => {
    const source = new Let(large());
    let asked: number[] = [];
    const all = await told(source, (what) => {
      asked = what === "start 1" ? [...source.asked] : asked;
    });
    expect(all).toEqual(["start 1", "level 1", "level 2"]);
    expect(asked.at(-1)).toBeLessThan(source.size / 2 + 1000);
    expect(source.asked.at(-1)).toBe(source.size);
  });

  it("has what is whole shown where the rest is damaged", async () => {
    const bytes = file.slice();
    bytes[bytes.length - 9]! ^= 4;
    expect(await told(new Let(bytes))).toEqual(["start 1", "level 1", "section-crc"]);
    bytes[FIRST - 1]! ^= 4;
    expect(await told(new Let(bytes))).toEqual(["section-crc"]);
  });
});
