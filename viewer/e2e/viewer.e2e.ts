/** The viewer as a user has it: every kind, its controls, and what goes wrong; pixels held to NumPy's. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import type { Locator, Page } from "playwright-core";
import { PNG } from "pngjs";
import { describe, expect, it } from "vitest";
import {
  Server, WITHOUT_WEBGPU, control, dropFile, haveBrowser, launch, makeModels, opening, pixels, reached, setControls,
  settled,
} from "./browser";

/** Of 255: rounding, and sums in another order. */
const TOLERANCE = 6;
/** Pixels at edges that the rasteriser and the ray see on different sides. */
const EDGES = 0.03;

interface Scene {
  name: string;
  file: string;
  controls: Record<string, string>;
  drag: [number, number];
  mesh: string;
}

interface Document {
  size: number;
  pictures: Scene[];
  slices: { rows: number; columns: number; window: [number, number]; levels: Record<string, number[]> };
}

const there = haveBrowser();
const folder = there ? makeModels() : "";
const { size, pictures, slices }: Document = there
  ? JSON.parse(readFileSync(join(folder, "pictures.json"), "utf-8")) as Document
  : { size: 0, pictures: [], slices: { rows: 0, columns: 0, window: [0, 1], levels: {} } };

describe.runIf(there)("viewer in Chromium", () => {
  let page: Page;
  const open = opening(folder, size, (opened) => {
    page = opened;
  });

  const labelled = (label: string): Locator => control(page, label);
  const set = (values: Record<string, string>): Promise<void> => setControls(page, values);
  const drop = (name: string, bytes: Buffer): Promise<void> => dropFile(page, name, bytes);

  it.each(pictures)("shows $name as NumPy does", async ({ name, file, controls, drag, mesh }) => {
    const original = name.includes("original") ? ["--original", join(folder, file.replace(".hmk", ".npy"))] : [];
    await open(file, undefined, ...original);
    await reached(page, "ready");
    await page.evaluate(() => document.querySelectorAll("details").forEach((each) => each.toggleAttribute("open", true)));
    await set(controls);
    if (mesh !== "") {
      await drop(mesh, readFileSync(join(folder, mesh)));
      await expect.poll(() => labelled("Shape").inputValue()).toBe("mesh");
    }
    if (drag[0] !== 0) {
      await page.mouse.move(250, 300);
      await page.mouse.down();
      await page.mouse.move(250 + drag[0], 300 + drag[1], { steps: 5 });
      await page.mouse.up();
    }
    const found = await pixels(page, size);
    const expected = readFileSync(join(folder, `${name}.rgb`));
    const off = found.filter((value, i) => Math.abs(value - expected[i]!) > TOLERANCE).length / found.length;
    expect(new Set(found).size, "a picture, not a blank").toBeGreaterThan(20);
    expect(off).toBeLessThan(EDGES);
  });

  it("shows slices of an array of any axes", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    for (const level of ["2", "1"]) {
      await set({ Level: level, Across: "1", Down: "0", trial: "4" });
      const found = await pixels(page, size);
      const { rows, columns, window: [low, high], levels } = slices;
      const scale = Math.max(rows, columns) / size;
      for (let py = 0; py < size; py += 1) {
        for (let px = 0; px < size; px += 1) {
          const row = Math.floor((rows - 1) / 2 + scale * (py - (size - 1) / 2) + 0.5);
          const column = Math.floor((columns - 1) / 2 + scale * (px - (size - 1) / 2) + 0.5);
          const value = levels[level]![row * columns + column];
          if (column < 0 || column >= columns || value === undefined) {
            continue;
          }
          const grey = 255 * Math.min(1, Math.max(0, (value - low) / (high - low)));
          expect(Math.abs(found[3 * (py * size + px)]! - grey)).toBeLessThan(3);
        }
      }
    }
  });

  it("reads the value under the pointer", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await settled(page);
    const box = (await page.locator("canvas").boundingBox())!;
    await page.mouse.move(box.x + box.width / 2 + 3, box.y + box.height / 2 + 3);
    const text = await page.locator("#readout").textContent();
    const [, row, column, value] = /depth (\d+), across (\d+), trial 4: (\S+)/.exec(text ?? "")!.map(Number);
    expect(value).toBeCloseTo(slices.levels["2"]![row! * slices.columns + column!]!, 2);
  });

  it("changes level, compares and resets by keys", async () => {
    await open("material.hmk");
    await reached(page, "ready");
    await page.locator("canvas").focus();
    await page.keyboard.press("[");
    expect(await labelled("Level").inputValue()).toBe("1");
    await page.keyboard.press("]");
    expect(await labelled("Level").inputValue()).toBe("2");
    await page.keyboard.press("c");
    await settled(page);
    expect(await page.locator("#divider").isVisible()).toBe(true);
    const before = await pixels(page, size);
    await page.keyboard.press("ArrowLeft");
    expect(await pixels(page, size)).not.toEqual(before);
    await page.keyboard.press("r");
    expect(await pixels(page, size)).toEqual(before);
  });

  it("compares, lists its keys and saves the picture by keys", async () => {
    await open("material.hmk");
    await reached(page, "ready");
    await page.locator("canvas").focus();
    const modes: string[] = [];
    for (let i = 0; i < 3; i += 1) {
      await page.keyboard.press(i === 1 ? "Shift+C" : "c");
      modes.push(await labelled("Show").inputValue());
    }
    expect(modes).toEqual(["split", "heat", "none"]);
    const keys = page.locator("#keys table");
    expect(await keys.isVisible()).toBe(false);
    await page.keyboard.press("?");
    expect(await keys.isVisible()).toBe(true);
    expect(await keys.textContent()).toContain("save the picture");
    await page.keyboard.press("?");
    expect(await keys.isVisible()).toBe(false);
    await settled(page);
    const [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("s")]);
    expect(download.suggestedFilename()).toBe("material.png");
    const saved = PNG.sync.read(readFileSync(await download.path()));
    expect([saved.width, saved.height]).toEqual([size, size]);
    expect(new Set(saved.data).size).toBeGreaterThan(20);
  });

  it("turns by one finger, and by two comes nearer and moves the light", async () => {
    await open("material.hmk");
    await reached(page, "ready");
    const session = await page.context().newCDPSession(page);
    const touch = (type: "touchStart" | "touchMove" | "touchEnd", ...places: [number, number][]): Promise<unknown> =>
      session.send("Input.dispatchTouchEvent", { type, touchPoints: places.map(([x, y], id) => ({ x, y, id })) });
    const before = await pixels(page, size);
    await page.evaluate(() => Object.assign(document.querySelector("canvas")!.style, { width: "500px", height: "500px" }));
    await touch("touchStart", [200, 200]);
    await touch("touchMove", [260, 220]);
    await touch("touchEnd");
    const turned = await pixels(page, size);
    expect(turned).not.toEqual(before);
    const covered = (picture: Uint8Array): number => new Set([0, size - 1].flatMap((row) =>
      Array.from({ length: size }, (_, x) => picture[3 * (row * size + x)]))).size;
    expect(covered(turned), "nothing but background at the upper and lower border").toBe(1);
    const azimuth = await labelled("Azimuth").inputValue();
    await page.evaluate(() => Object.assign(document.querySelector("canvas")!.style, { width: "500px", height: "500px" }));
    await touch("touchStart", [200, 200], [260, 200]);
    await touch("touchMove", [150, 200], [330, 200]);
    await touch("touchEnd");
    expect(covered(await pixels(page, size)), "the object is larger than the picture").toBeGreaterThan(1);
    expect(await labelled("Azimuth").inputValue()).not.toBe(azimuth);
  });

  it("shows an array of one axis as a strip", async () => {
    await open("series.hmk");
    await reached(page, "ready");
    const found = await pixels(page, size);
    const middle = Array.from({ length: size }, (_, x) => found[3 * ((size / 2) * size + x)]!);
    expect(Math.max(...middle)).toBe(255);
    expect(Math.min(...middle)).toBe(0);
    expect(found.subarray(3 * size * (size / 2 + 2), 3 * size * (size / 2 + 3))).toEqual(found.subarray(3 * size * (size / 2), 3 * size * (size / 2 + 1)));
    await page.evaluate(() => Object.assign(document.querySelector("canvas")!.style, { width: "320px", height: "320px" }));
    await page.mouse.move(160, 160);
    await page.mouse.move(164, 160);
    expect(await page.locator("#readout").textContent()).toMatch(/^t 20: /);
    expect(await page.getByLabel("Down", { exact: true }).count()).toBe(0);
  });

  it("edits the transfer function by keys", async () => {
    await open("volume.hmk");
    await reached(page, "ready");
    const points = page.getByRole("group", { name: "Opacity over the values" }).getByRole("button");
    expect(await points.count()).toBe(3);
    const before = await pixels(page, size);
    await points.nth(1).focus();
    for (let i = 0; i < 20; i += 1) {
      await page.keyboard.press("ArrowRight");
    }
    expect(await points.nth(1).getAttribute("aria-label")).toContain("value 55 %");
    expect(await pixels(page, size)).not.toEqual(before);
    await page.keyboard.press("Delete");
    expect(await points.count()).toBe(2);
    expect(await points.nth(0).getAttribute("aria-label"), "the ends stay").not.toContain("Delete");
    await page.keyboard.press("Delete");
    expect(await points.count()).toBe(2);
    await points.nth(0).press("Enter");
    expect([await points.count(), await points.nth(1).evaluate((each) => each === document.activeElement)], "a point by a key").toEqual([3, true]);
    await page.keyboard.press("Delete");
    expect(await points.count()).toBe(2);
    const { x, y, width, height } = (await page.locator(".transfer svg").boundingBox())!;
    await page.mouse.move(x + 0.5 * width, y + 0.5 * height);
    await page.mouse.down();
    expect(await points.count()).toBe(3);
    await page.mouse.move(x + 0.25 * width, y + 0.1 * height, { steps: 4 });
    await page.mouse.up();
    expect(await points.nth(1).getAttribute("aria-label"), "a new point follows the drag").toContain("value 25 %");
    expect(await points.count()).toBe(3);
  });

  it("plays time", async () => {
    await open("volume.hmk");
    await reached(page, "ready");
    await page.getByRole("button", { name: "Play" }).click();
    await expect.poll(() => page.getByLabel("Frame", { exact: true }).inputValue(), { timeout: 30_000 }).not.toBe("0");
    await page.getByRole("button", { name: "Pause" }).click();
    await settled(page);
    const frame = await page.getByLabel("Frame", { exact: true }).inputValue();
    await page.waitForTimeout(500); // longer than frames are shown
    expect(await page.getByLabel("Frame", { exact: true }).inputValue()).toBe(frame);
    await page.getByRole("button", { name: "Play" }).waitFor();
  });

  it("takes a dropped file, and says of a damaged one that it is", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    const good = readFileSync(join(folder, "volume.hmk"));
    const damaged = Buffer.from(good);
    damaged[damaged.length - 9]! ^= 4;
    await drop("damaged.hmk", damaged);
    await reached(page, "failed");
    const sentence = page.getByRole("alert");
    await sentence.getByText("The file is damaged").waitFor();
    expect(await sentence.textContent()).toContain("stages[1].runs[");
    expect(await sentence.textContent()).toContain("The first 1 of 2 levels are whole");
    await drop("short.hmk", good.subarray(0, 900));
    await sentence.getByText("The file is not complete").waitFor();
    await drop("picture.png", Buffer.from("89504e470d0a1a0a0000000d49484452", "hex"));
    await sentence.getByText("This is no .hmk file").waitFor();
    await drop("good.hmk", good);
    await reached(page, "ready");
    expect(await sentence.isVisible()).toBe(false);
    expect(await page.locator("#file").textContent()).toBe("good.hmk");
  });

  it("says what is not there", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    const base = page.url().split("?")[0]!;
    await page.goto(`${base}?file=files/other.hmk`);
    await reached(page, "failed");
    expect(await page.getByRole("alert").textContent()).toContain("There is no file other.hmk");
    await page.goto(`${base}?file=data:text/plain,1`);
    await reached(page, "failed");
    expect(await page.getByRole("alert").textContent()).toContain("http and https only");
    await page.goto(`${base}?file=index.html`);
    await reached(page, "failed");
    expect(await page.getByRole("alert").textContent()).toContain("what begins like a web page");
    await page.goto(`${base}?file=files/stack.hmk&pixels=0x0`);
    await reached(page, "failed");
    expect(await page.getByRole("alert").textContent()).toContain("pixels: found 0x0, allowed 1x1 to ");
    await page.goto(`${base}?file=files/stack.hmk&original=&pixels=1x1`);
    await reached(page, "ready");
    await page.goto(`${base}?file=`);
    await reached(page, "empty");
    await page.goto(base);
    await reached(page, "empty");
    expect(await page.getByRole("heading", { name: "Show an .hmk file" }).isVisible()).toBe(true);
  });

  it("loads whole files from servers without ranges, and says where a connection was lost", async () => {
    await open("volume.hmk", "&never");
    await reached(page, "ready");
    const whole = readFileSync(join(folder, "volume.hmk"));
    await page.route("**/files/volume.hmk", (route) => route.fulfill({ status: 200, body: whole }));
    await page.reload();
    await reached(page, "ready");
    await page.unroute("**/files/volume.hmk");
    let answers = 0;
    await page.route("**/files/volume.hmk", (route) => {
      answers += 1;
      return answers > 1 ? route.abort("connectionreset") : route.fulfill({
        status: 206, body: whole.subarray(0, 300), headers: { "Content-Range": `bytes 0-299/${whole.length}` },
      });
    });
    await page.reload();
    await reached(page, "failed");
    expect(await page.getByRole("alert").textContent()).toContain("The connection was lost after 300 B of ");
  });

  it("has names on all controls, at phone width too", async () => {
    await open("material.hmk", "&none");
    await page.setViewportSize({ width: 390, height: 740 });
    await reached(page, "ready");
    const nameless = await page.evaluate(() => Array.from(document.querySelectorAll<HTMLElement>("input, select, button")).filter(
      (element) => !element.hidden && element.getAttribute("aria-label") === null && element.textContent.trim() === ""
        && ((element as HTMLInputElement).labels?.length ?? 0) === 0).length);
    expect(nameless).toBe(0);
    const width = await page.evaluate(() => document.documentElement.scrollWidth);
    expect(width).toBeLessThanOrEqual(390);
    const canvas = (await page.locator("canvas").boundingBox())!;
    expect(canvas.width).toBe(390);
    expect(canvas.height).toBeGreaterThan(200);
  });

  it("says so where there is no WebGPU", async () => {
    const other = await launch(WITHOUT_WEBGPU);
    const server = await Server.start(join(folder, "stack.hmk"));
    const without = await other.newPage();
    await without.addInitScript("delete Navigator.prototype.gpu");
    await without.goto(server.url);
    await reached(without, "failed");
    expect(await without.getByRole("alert").textContent()).toContain("no WebGPU");
    await other.close();
    await server.stop();
  });

  it("ends cleanly with Ctrl-C", async () => {
    const one = await Server.start(join(folder, "stack.hmk"));
    expect(await one.stop()).toBe(0);
  });
});
