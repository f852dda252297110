/** The module for pages of one's own, but for WebGPU: that is tested in the browser. */

import { createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { describe, expect, it } from "vitest";
import { HmkError, type Model, open, Problem } from "../src/module";
import { asProblem } from "../src/problem";
import type { Reading } from "../src/reader/read";
import { fileOf } from "./files";
import { elementOf, merged, small as smallContent, someRows } from "./models";

const bytes = fileOf(smallContent());
const indices = someRows([4, 3]);
const values = indices.map((index) => elementOf(smallContent(), index));

async function small(): Promise<Model> {
  return open(bytes);
}

describe("a model", () => {
  it("has the elements that the fixture says", async () => {
    const model = await small();
    expect(indices.length).toBeGreaterThan(5);
    indices.forEach((index, i) => values[i]!.forEach((value, l) => {
      const size = Math.max(1e-3, Math.abs(value));
      expect(Math.abs(model.at(index, l + 1) - value) / size).toBeLessThan(1e-6);
    }));
    expect(model.at(indices[0]!)).toBe(model.at(indices[0]!, model.levels));
  });

  it("has the elements of a file whose first stage is a cut", async () => {
    const content = merged();
    const model = await open(fileOf(content));
    expect([model.levels, content.stages.length]).toEqual([3, 4]);
    for (const rows of someRows([15, 6, 2])) {
      const index = [Math.floor(rows[0]! / 3), rows[1]!, rows[2]!, rows[0]! % 3];
      elementOf(content, rows).slice(1).forEach((value, l) => {
        expect(Math.abs(model.at(index, l + 1) - value)).toBeLessThan(1e-6 * Math.max(1, Math.abs(value)));
      });
    }
  });

  it("says what it is", async () => {
    const model = await small();
    expect(model.shape).toEqual(model.axes.map((axis) => axis.size));
    expect([model.levels, model.arrived, model.quality.length]).toEqual([2, 2, 2]);
    expect(model.kind).toBe("volume");
  });

  it("slices as an array does", async () => {
    const model = await open(new Blob([fileOf(merged())]));
    const whole = model.slice(model.shape.map(() => null));
    expect(whole.shape).toEqual(model.shape);
    expect(new Set(whole.values).size).toBeGreaterThan(20);
    const index = model.shape.map((size, axis) => (axis === 0 ? -1 : axis === 1 ? [1, size] as const : null));
    const part = model.slice(index);
    expect(part.shape).toEqual([model.shape[1]! - 1, ...model.shape.slice(2)]);
    const row = whole.values.length / model.shape[0]!;
    expect(part.values).toEqual(whole.values.subarray(whole.values.length - row + row / model.shape[1]!));
    expect(model.slice(model.shape.map(() => [0, 0] as const)).values).toHaveLength(0);
  });

  it.each<[string, (model: Model) => unknown]>([
    ["1 indices; allowed: 2, one an axis (", (model) => model.at([0])],
    ["index of ", (model) => model.at(model.shape)],
    ["; allowed: whole numbers from -", (model) => model.at(model.shape.map((size) => -size - 1))],
    ["index of ", (model) => model.at([0.5, 0])],
    ["end of ", (model) => model.slice([[0, 1000], 0])],
    ["index: undefined; allowed: an array of 2, one an axis (", (model) => model.at(undefined as never)],
    ["index: 3; allowed: an array of 2", (model) => model.slice(3 as never)],
    [": undefined; allowed: whole numbers from -", (model) => model.slice([0, undefined] as never)],
    [", [from, to] or null", (model) => model.slice([0, [1]] as never)],
    [': "1"; allowed: whole numbers from -', (model) => model.at([0, "1"] as never)],
    [": null; allowed: whole numbers from -", (model) => model.at([0, null] as never)],
    ["end of ", (model) => model.slice([0, [0, undefined]] as never)],
    ["level 3; allowed: 1 to 2", (model) => model.at([0, 0], 3)],
    ["level 0; allowed: 1 to 2", (model) => model.at([0, 0], 0)],
  ])("refuses with %j", async (sentence, use) => {
    const model = await small();
    expect(() => use(model)).toThrow(RangeError);
    expect(() => use(model)).toThrow(sentence);
  });
});

describe("opening", () => {
  it("tells of each level while the next one is not there", async () => {
    const told: number[][] = [];
    const model = await open(bytes.buffer, (early, level) => {
      told.push([level, early.arrived]);
      expect(() => early.at(indices[0]!, level + 1)).toThrow(RangeError);
    });
    expect(told).toEqual([[1, 1], [2, 2]]);
    expect(model.arrived).toBe(2);
  });

  it("waits for what is done with a level", async () => {
    let done = 0;
    await open(bytes, async (_, level) => {
      expect(done).toBe(level - 1);
      await new Promise((resolve) => setTimeout(resolve, 5));
      done = level;
    });
    expect(done).toBe(2);
  });

  it("reads an address", async () => {
    const server = createServer((request, response) => {
      response.statusCode = request.url === "/a.hmk" ? 200 : 404;
      response.end(response.statusCode === 200 ? bytes : "");
    });
    await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
    const base = `http://127.0.0.1:${(server.address() as AddressInfo).port}`;
    try {
      expect((await open(`${base}/a.hmk`)).at(indices[0]!)).toBe((await small()).at(indices[0]!));
      await expect(open(new URL(`${base}/b.hmk`))).rejects.toThrow("There is no file b.hmk");
    } finally {
      server.closeAllConnections();
      server.close();
    }
  });

  it.each([[undefined, "undefined"], [null, "null"], [7, "7"], [{}, "[object Object]"], [[bytes], "[[object Uint8Array]]"]])(
    "refuses %s, which is nothing to read", async (source, shown) => {
      await expect(open(source as never)).rejects.toThrow(Problem);
      await expect(open(source as never)).rejects.toThrow(`source: found ${shown}, allowed an address, a Blob`);
    });

  it.each<[string, string]>([
    ["<!DOCTYPE html>\n<html><body>404</body></html>", "a web page, allowed an .hmk file. Next: see in a browser"],
    ["\n <html lang=en></html>", "a web page"], ["\x93NUMPY\x01\0v\0{'descr'", "a NumPy array (.npy), allowed"],
    ["PK\x03\x04\x14\0\0\0", "a zip archive"], ["\x1f\x8b\x08\0\0\0\0\0", "a file packed by gzip"],
    ["version https://git-lfs.github.com/spec/v1\n", "a pointer of Git LFS"], ["plain text of somebody", "no .hmk file, allowed"],
  ])("says what a file begins like that is none: %j", async (text, what) => {
    const other = open(new Blob([Buffer.from(text, "latin1"), new Uint8Array(60)]));
    await expect(other).rejects.toThrow(HmkError);
    await expect(other).rejects.toThrow(`header: found what begins like ${what}`);
    expect(asProblem(await other.catch((error: unknown) => error)).sentence).toBe("This is no .hmk file.");
  });

  it("takes other limits", async () => {
    const nodes = smallContent().stages.reduce((sum, stage) => sum + stage.nodes.length, 0);
    await expect(open(bytes, undefined, { nodes: nodes - 1 })).rejects.toThrow("nodes-limit");
    expect((await open(bytes, undefined, { nodes })).levels).toBe(2);
  });

  it("decodes on the CPU what takes too long in a shader", async () => {
    const model = await small();
    const { stages } = (model as unknown as { reading: Reading }).reading;
    stages[1]!.shape.set([1, 1, 800, 800, 600, 600]);
    expect(() => model.onGpu({} as GPUDevice)).toThrow(/A level takes \d+ multiply-adds an element; shaders do up to 262144/);
  });

  it("refuses damage and what is no address", async () => {
    const damaged = bytes.slice();
    damaged[damaged.length - 1]! ^= 1;
    await expect(open(damaged)).rejects.toThrow(HmkError);
    await expect(open("file:///a.hmk")).rejects.toThrow(Problem);
    await expect(open("no address")).rejects.toThrow(Problem);
  });
});
