/** The module in pages of one's own: the examples of docs/web.md as they stand, and elements decoded by a shader. */

import { readFileSync } from "node:fs";
import { type Server, createServer } from "node:http";
import type { AddressInfo } from "node:net";
import { join } from "node:path";
import { gzipSync } from "node:zlib";
import type { Browser, Page } from "playwright-core";
import { PNG } from "pngjs";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { open } from "../src/module";
import { haveBrowser, launch, makeModels } from "./browser";

const ROOT = join(import.meta.dirname, "..", "..");
const MODULE = join(ROOT, "python", "hmkcta", "viewer_page", "hmkcta.js");
const EXAMPLES = [...readFileSync(join(ROOT, "docs", "web.md"), "utf-8").matchAll(/^```html\n(.*?)^```$/gms)].map(([, html]) => html!);
const PLAIN = '<script type="module">import { open } from "./hmkcta.js"; window.openFile = open;</script>';
const TYPES: Record<string, string> = { js: "text/javascript", html: "text/html", hmk: "application/octet-stream" };

const there = haveBrowser();
const folder = there ? makeModels() : "";

/** In the page: some elements by a shader, of a level. */
async function byShader([file, indices, level]: [string, number[][], number]): Promise<number[]> {
  const model = await (window as unknown as { openFile: typeof open }).openFile(file);
  const device = await (await navigator.gpu.requestAdapter())!.requestDevice();
  const failed = new Promise<never>((_, reject) => {
    device.addEventListener("uncapturederror", ({ error }) => reject(new Error(error.message)));
  });
  const gpu = model.onGpu(device);
  const module = device.createShaderModule({ code: `${gpu.code}
    @group(1) @binding(0) var<storage, read> asked: array<array<u32, AXES>>;
    @group(1) @binding(1) var<storage, read_write> found: array<f32>;
    @compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3u) {
      if (id.x < arrayLength(&found)) { found[id.x] = decode_element(asked[id.x], decoder.stages); }
    }` });
  const entries = (["read-only-storage", "storage"] as const).map((type, binding) =>
    ({ binding, visibility: GPUShaderStage.COMPUTE, buffer: { type } }));
  const own = device.createBindGroupLayout({ entries });
  const pipeline = await device.createComputePipelineAsync({
    layout: device.createPipelineLayout({ bindGroupLayouts: [gpu.layout, own] }), compute: { module },
  });
  const buffer = (size: number, usage: number): GPUBuffer => device.createBuffer({ size, usage });
  const asked = buffer(4 * indices.length * model.shape.length, GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST);
  const found = buffer(4 * indices.length, GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC);
  const read = buffer(4 * indices.length, GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST);
  device.queue.writeBuffer(asked, 0, Uint32Array.from(indices.flat()));
  const encoder = device.createCommandEncoder();
  const pass = encoder.beginComputePass();
  pass.setPipeline(pipeline);
  pass.setBindGroup(0, gpu.group(level));
  pass.setBindGroup(1, device.createBindGroup({ layout: own,
    entries: [asked, found].map((each, binding) => ({ binding, resource: { buffer: each } })) }));
  pass.dispatchWorkgroups(Math.ceil(indices.length / 64));
  pass.end();
  encoder.copyBufferToBuffer(found, 0, read, 0, 4 * indices.length);
  device.queue.submit([encoder.finish()]);
  await Promise.race([read.mapAsync(GPUMapMode.READ), failed]);
  const values = [...new Float32Array(read.getMappedRange())];
  gpu.destroy();
  return values;
}

describe.runIf(there)("hmkcta.js in Chromium", () => {
  let browser: Browser;
  let server: Server;

  beforeAll(async () => {
    browser = await launch();
    server = createServer((request, response) => {
      const name = (request.url ?? "/").slice(1);
      const pages: Record<string, string> = { "plain.html": PLAIN, "example0.html": EXAMPLES[0]!, "example1.html": EXAMPLES[1]!, "favicon.ico": "" };
      const path = name === "hmkcta.js" ? MODULE : join(folder, name === "model.hmk" ? "volume.hmk" : name);
      response.setHeader("Content-Type", TYPES[name.split(".").pop() ?? ""] ?? "text/plain");
      response.end(pages[name] ?? readFileSync(path));
    });
    await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  });
  afterAll(async () => {
    await browser?.close();
    server?.close();
  });

  /** A page of this server; what its scripts throw fails the test. */
  async function visit(name: string): Promise<{ page: Page; thrown: string[] }> {
    const page = await browser.newPage();
    const thrown: string[] = [];
    page.on("pageerror", (error) => thrown.push(error.message));
    page.on("console", (message) => message.type() === "error" && thrown.push(message.text()));
    await page.goto(`http://127.0.0.1:${(server.address() as AddressInfo).port}/${name}`, { waitUntil: "networkidle" });
    return { page, thrown };
  }

  it("draws the same picture by each example of the manual, on the CPU and on the GPU", async () => {
    const model = await open(new Blob([new Uint8Array(readFileSync(join(folder, "volume.hmk")))]));
    const { shape, values } = model.slice(model.shape.map((size, axis) => (axis < model.shape.length - 2 ? size >> 1 : null)));
    expect(EXAMPLES).toHaveLength(2);
    for (const number of EXAMPLES.keys()) {
      const { page, thrown } = await visit(`example${number}.html`);
      await page.waitForFunction(([height, width]) => {
        const canvas = document.querySelector("canvas")!;
        return canvas.height === height && canvas.width === width;
      }, shape);
      await page.waitForTimeout(500);
      const picture = PNG.sync.read(await page.locator("canvas").screenshot());
      expect(thrown).toEqual([]);
      expect([picture.height, picture.width]).toEqual(shape);
      const white = number === 0 ? Math.max(...values) : 1;
      values.forEach((value, i) => {
        expect(Math.abs(picture.data[4 * i]! - 255 * Math.min(1, Math.max(0, value / white)))).toBeLessThan(1.01);
      });
      await page.close();
    }
    expect(new Set(values.map((value) => Math.round(255 * value))).size).toBeGreaterThan(20);
  });

  it("reads a file of another host, which lets this page read no length of a part, or pack it on the way", async () => {
    const bytes = readFileSync(join(folder, "volume.hmk"));
    const asked: (string | undefined)[] = [];
    const elsewhere = createServer((request, response) => {
      response.setHeader("Access-Control-Allow-Origin", "*");
      asked.push(request.headers.range);
      if (request.headers.range !== undefined) {
        response.writeHead(206, { "Content-Range": `bytes 0-99/${bytes.length}` }).end(bytes.subarray(0, 100));
      } else {
        const packed = gzipSync(bytes);
        response.writeHead(200, { "Content-Encoding": "gzip", "Content-Length": packed.length }).end(packed);
      }
    });
    await new Promise<void>((resolve) => elsewhere.listen(0, "127.0.0.1", resolve));
    const { page, thrown } = await visit("plain.html");
    const found = await page.evaluate(async (address) => {
      const model = await (window as unknown as { openFile: typeof open }).openFile(address);
      return model.at(model.shape.map(() => 1));
    }, `http://127.0.0.1:${(elsewhere.address() as AddressInfo).port}/volume.hmk`).finally(() => elsewhere.close());
    const model = await open(new Blob([new Uint8Array(bytes)]));
    expect([thrown, asked]).toEqual([[], ["bytes=0-65535", undefined]]);
    expect(found).toBe(model.at(model.shape.map(() => 1)));
    await page.close();
  });

  it.each(["stack", "merged", "ageing", "volume", "cut", "random", "bare"])("decodes %s in a shader as on the CPU", async (name) => {
    const model = await open(new Blob([new Uint8Array(readFileSync(join(folder, `${name}.hmk`)))]));
    const indices = Array.from({ length: 200 }, (_, i) => model.shape.map((size, axis) => (i * (7 + 2 * axis) + axis) % size));
    for (const level of [1, model.levels]) {
      const { page } = await visit("plain.html");
      const found = await page.evaluate(byShader, [`/${name}.hmk`, indices, level] as [string, number[][], number]);
      const expected = indices.map((index) => model.at(index, level));
      const largest = Math.max(...expected.map(Math.abs));
      const off = expected.map((value, i) => Math.abs(value - found[i]!) / largest);
      expect(Math.max(...off)).toBeLessThan(1e-5);
      await page.close();
    }
  });
});
