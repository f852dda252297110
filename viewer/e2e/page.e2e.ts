/** The page around the picture: its shape and focus, what is said beside it, and files that are dropped on it. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import type { Page } from "playwright-core";
import { PNG } from "pngjs";
import { describe, expect, it } from "vitest";
import { control, dropFile, haveBrowser, makeModels, opening, pixels, reached, setControls, settled } from "./browser";

const BACKGROUND = [14, 15, 18];
const FOCUS = [108, 195, 187];

const there = haveBrowser();
const folder = there ? makeModels() : "";
const { slices } = there
  ? JSON.parse(readFileSync(join(folder, "pictures.json"), "utf-8")) as { slices: { rows: number; columns: number } }
  : { slices: { rows: 0, columns: 0 } };

describe.runIf(there)("the page in Chromium", () => {
  let page: Page;
  const open = opening(folder, 64, (opened) => {
    page = opened;
  });

  /** What is on the screen, nothing of which lies on the picture; a pixel of it. */
  async function screen(): Promise<(x: number, y: number) => number[]> {
    await settled(page);
    await page.evaluate(() => document.querySelectorAll<HTMLElement>("#statistics, #readout, #toggle, #divider").forEach((element) => {
      element.style.opacity = "0";
    }));
    const { data, width } = PNG.sync.read(await page.screenshot());
    return (x, y) => [...data.subarray(4 * (y * width + x), 4 * (y * width + x) + 3)];
  }

  const stage = async (): Promise<{ width: number; height: number }> => (await page.locator("main").boundingBox())!;

  it("keeps the shape of a picture whose size the address fixes", async () => {
    await open("material.hmk", "&pixels=192x96");
    await reached(page, "ready");
    const [at, { width, height }] = [await screen(), await stage()];
    const places = Array.from({ length: width * height }, (_, i) => [i % width, Math.floor(i / width)] as const)
      .filter(([x, y]) => at(x, y).some((value, c) => Math.abs(value - BACKGROUND[c]!) > 6));
    const [across, down] = [0, 1].map((side) => places.map((place) => place[side]!).sort((a, b) => a - b));
    const extent = (along: number[]): number => along.at(-1)! - along[0]!;
    expect(extent(down!), "as large as fits").toBeGreaterThan(0.8 * width / 2);
    expect(extent(across!) / extent(down!), "a sphere is round").toBeCloseTo(1, 1);
  });

  it("reads and moves a picture of fixed size where it is", async () => {
    await open("stack.hmk", "&pixels=128x64");
    await reached(page, "ready");
    await setControls(page, { Across: "1", Down: "0" });
    await settled(page);
    const { width, height } = await stage();
    const scale = Math.max(slices.rows / 64, slices.columns / 128);
    const readAt = async (x: number, y: number): Promise<string | null> => {
      await page.mouse.move(x, y);
      const readout = page.locator("#readout");
      return await readout.isVisible() ? (await readout.textContent())!.split(",").slice(0, 2).join() : null;
    };
    /** The element at a place from the middle, in pixels of the screen. */
    const element = (x: number, y: number): string => [slices.rows, slices.columns].map((count, side) =>
      `${["depth", "across"][side]!} ${Math.round((count - 1) / 2 + (scale * (side === 0 ? y : x) * 128) / width)}`).join(", ");
    const [x, y] = [width / 2 + 90, height / 2 - 105];
    expect(await readAt(x, y)).toBe(element(90, -105));
    await page.mouse.down();
    await page.mouse.move(x - 150, y + 60);
    await page.mouse.up();
    await settled(page);
    expect(await readAt(x - 150, y + 60), "what was taken hold of is below the pointer").toBe(element(90, -105));
    await page.locator("canvas").press("r");
    await page.locator("canvas").press("+");
    await page.locator("canvas").press("+");
    expect(await readAt(width / 2, height / 2 - width / 4 + 5)).toMatch(/^depth/);
    expect(await readAt(width / 2, height / 2 - width / 4 - 5), "above the picture").toBe(null);
  });

  it("takes the token off its address, and is reloaded without it", async () => {
    const refused: string[] = [];
    await open("stack.hmk", "&panel=closed");
    await reached(page, "ready");
    const address = page.url();
    expect(address).toMatch(/^http:\/\/127.0.0.1:\d+\/\?file=files\/stack.hmk&panel=closed$/);
    expect(await page.evaluate(() => document.cookie)).toBe("");
    page.on("response", (response) => {
      if (response.status() >= 400) {
        refused.push(response.url());
      }
    });
    await page.reload();
    await reached(page, "ready");
    expect(refused).toEqual([]);
    await page.evaluate(() => sessionStorage.clear()); // as with somebody who knows the address alone
    await page.reload();
    await reached(page, "failed");
    expect(await page.getByRole("alert").textContent()).toContain("open the whole address that hmkcta view printed");
  });

  it("has the divider of a picture of fixed size where its sides meet", async () => {
    await open("material.hmk", "&pixels=96x192");
    await reached(page, "ready");
    await setControls(page, { Show: "split", Divider: "0.25" });
    const { width, height } = await stage();
    const shown = height / 2; // how wide the picture is
    const middle = async (): Promise<number> => {
      const box = (await page.locator("#divider").boundingBox())!;
      return box.x + box.width / 2;
    };
    const at = await screen();
    const row = Array.from({ length: width }, (_, x) => at(x, 4)[0]!);
    const line = row.indexOf(Math.max(...row));
    expect(Math.max(...row), "a line between the sides").toBeGreaterThan(100);
    expect(Math.abs(await middle() - (width / 2 - shown / 4))).toBeLessThan(1);
    expect(Math.abs(await middle() - line)).toBeLessThan(1 + shown / 96);
    await page.mouse.move(await middle(), height / 2);
    await page.mouse.down();
    await page.mouse.move(width / 2 + shown / 4, height / 2, { steps: 3 });
    await page.mouse.up();
    await settled(page);
    expect(Number(await control(page, "Divider").inputValue())).toBeCloseTo(0.75, 2);
    expect(Math.abs(await middle() - (width / 2 + shown / 4))).toBeLessThan(1);
  });

  it("shows that the picture has the keyboard's focus, and not the mouse's", async () => {
    await open("stack.hmk", "&never");
    await reached(page, "ready");
    const { width, height } = await stage();
    const border = async (): Promise<number[][]> => {
      const at = await screen();
      return [at(1, height / 2), at(width - 2, height / 2), at(width / 2, 1), at(width / 2, height - 2)];
    };
    await page.mouse.click(width / 2, height / 2);
    expect(await page.evaluate(() => document.activeElement?.id)).toBe("canvas");
    expect(await border()).not.toContainEqual(FOCUS);
    await page.keyboard.press("Tab");
    await page.keyboard.press("Shift+Tab");
    expect(await border()).toEqual([FOCUS, FOCUS, FOCUS, FOCUS]);
  });

  /** A file with a wrong byte so far from its end. */
  function damaged(name: string, fromEnd: number): Buffer {
    const bytes = readFileSync(join(folder, name));
    bytes[bytes.length - fromEnd]! ^= 4;
    return bytes;
  }

  it("closes what is said beside a picture by a button and by Escape, and nothing else that is said", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    const told = page.getByRole("alert");
    const close = page.getByRole("button", { name: "Close the message" });
    const fail = async (): Promise<void> => {
      await dropFile(page, "damaged.hmk", damaged("volume.hmk", 9));
      await told.getByText("The first 1 of 2 levels are whole").waitFor();
    };
    await fail();
    await close.focus();
    await page.keyboard.press("Enter");
    expect(await told.isVisible()).toBe(false);
    expect(await page.evaluate(() => document.activeElement?.id)).toBe("canvas");
    await fail();
    await control(page, "Exposure").focus();
    await page.keyboard.press("Escape");
    expect(await told.isVisible()).toBe(false);
    expect(await page.evaluate(() => document.documentElement.dataset["state"])).toBe("failed");
    await page.goto(`${page.url().split("?")[0]!}?file=files/other.hmk`);
    await reached(page, "failed");
    expect(await close.isVisible()).toBe(false);
    await page.keyboard.press("Escape");
    expect(await told.isVisible()).toBe(true);
  });

  /** A file whose first level has a wrong byte. */
  function brokenStart(name: string): Buffer {
    const bytes = readFileSync(join(folder, name));
    const length = bytes.readUInt32LE(12);
    const { axes } = JSON.parse(bytes.toString("utf-8", 20, 20 + length)) as
      { axes: { size: number; coordinates?: { dtype: string; width: number } | number[] }[] };
    const sections = axes.flatMap(({ size, coordinates }) => (coordinates === undefined || Array.isArray(coordinates) ? []
      : [4 + size * Math.max(1, coordinates.width) * (coordinates.dtype === "F32" ? 4 : 8)]));
    bytes[20 + length + sections.reduce((sum, each) => sum + each, 0)]! ^= 4;
    return bytes;
  }

  it("keeps the model where a file that is dropped on it cannot be shown", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await page.evaluate(() => {
      const states: string[] = [];
      new MutationObserver(() => states.push(document.documentElement.dataset["state"]!)).observe(document.documentElement, { attributes: true });
      Object.assign(window, { states });
    });
    const states = (): Promise<string[]> => page.evaluate(() => (window as unknown as { states: string[] }).states.splice(0));
    const told = page.getByRole("alert");
    const before = await pixels(page, 64);
    const files: [string, Buffer, string][] = [
      ["picture.png", Buffer.from("89504e470d0a1a0a0000000d49484452", "hex"), "This is no .hmk file."],
      ["short.hmk", readFileSync(join(folder, "volume.hmk")).subarray(0, 900), "The file is not complete."],
      ["start.hmk", brokenStart("volume.hmk"), "The file is damaged."],
    ];
    for (const [name, bytes, sentence] of files) {
      await dropFile(page, name, bytes);
      await told.getByText(`${name} cannot be shown. ${sentence}`).waitFor();
      expect(await states()).toEqual(["loading", "ready"]);
      await page.getByRole("button", { name: "Close the message" }).click();
    }
    await dropFile(page, "mesh.obj", Buffer.from("f 1 2 3"));
    await told.getByText("mesh.obj cannot be shown. A mesh can be shown with a material only.").waitFor();
    expect([await page.title(), await page.locator("#file").textContent()]).toEqual(["stack.hmk: hmkcta", "stack.hmk"]);
    expect(await pixels(page, 64)).toEqual(before);
    await setControls(page, { Level: "1" });
    expect(await pixels(page, 64), "the model can still be drawn").not.toEqual(before);
    expect(await states()).toEqual([]);
    await dropFile(page, "good.hmk", readFileSync(join(folder, "volume.hmk")));
    await reached(page, "ready");
    expect((await states())[0]).toBe("loading");
    expect([await told.isVisible(), await page.title()]).toEqual([false, "good.hmk: hmkcta"]);
  });

  it("shows the last of two files that are dropped, whatever becomes of the first", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await page.evaluate(() => {
      const read = Blob.prototype.arrayBuffer;
      Blob.prototype.arrayBuffer = async function slow(this: Blob) {
        Blob.prototype.arrayBuffer = read; // of the first file only
        await new Promise((resolve) => setTimeout(resolve, 1500));
        return read.call(this);
      };
    });
    await dropFile(page, "picture.png", Buffer.from("89504e470d0a1a0a0000000d49484452", "hex"));
    expect(await page.evaluate(() => document.documentElement.dataset["state"])).toBe("loading");
    await dropFile(page, "good.hmk", readFileSync(join(folder, "volume.hmk")));
    await reached(page, "ready");
    await page.waitForTimeout(1800);
    expect(await page.getByRole("alert").isVisible()).toBe(false);
    expect(await page.title()).toBe("good.hmk: hmkcta");
    expect(await page.evaluate(() => document.documentElement.dataset["state"])).toBe("ready");
  });

  it("has nothing beside a file that cannot be shown where none was", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await page.goto(`${page.url().split("?")[0]!}?file=`);
    await reached(page, "empty");
    await dropFile(page, "mesh.obj", Buffer.from("f 1 2 3"));
    await page.getByRole("alert").getByText("mesh.obj cannot be shown.").waitFor();
    expect(await page.locator("#welcome").isVisible()).toBe(true);
    expect(await page.locator("#statistics").textContent()).toBe("");
    await dropFile(page, "start.hmk", brokenStart("volume.hmk"));
    await page.getByRole("alert").getByText("The file is damaged.").waitFor();
    expect(await page.evaluate(() => document.documentElement.dataset["state"])).toBe("failed");
    expect(await page.getByRole("button", { name: "Close the message" }).isVisible()).toBe(false);
  });

  it("says nothing of progress where there is none: without an adapter, and without a file", async () => {
    await open("volume.hmk", "&never");
    await reached(page, "ready");
    const status = (): Promise<[boolean, string | null]> => Promise.all([
      page.getByRole("progressbar").isVisible(), page.locator("#statistics").textContent()]);
    expect((await status())[1], "a model has numbers").toContain("KiB");
    await page.route("**/files/other.hmk", (route) => route.fulfill({ status: 404 }));
    await page.goto(`${page.url().split("?")[0]!}?file=files/other.hmk`);
    await reached(page, "failed");
    expect(await status()).toEqual([false, ""]);
    const whole = readFileSync(join(folder, "volume.hmk"));
    const ends: number[] = [];
    await page.route("**/files/slow.hmk", async (route) => {
      const [, begin, end] = /(\d+)-(\d+)/.exec(route.request().headers()["range"]!)!.map(Number) as [number, number, number];
      const last = Math.min(end, begin + Math.ceil(whole.length / 16) - 1, whole.length - 1);
      await new Promise((resolve) => setTimeout(resolve, begin > 0 ? 300 : 0));
      await route.fulfill({
        status: 206, body: whole.subarray(begin, last + 1), headers: { "Content-Range": `bytes ${begin}-${last}/${whole.length}` },
      });
      ends.push(last);
    });
    await page.addInitScript("navigator.gpu.requestAdapter = () => Promise.resolve(null)");
    await page.goto(`${page.url().split("?")[0]!}?file=files/slow.hmk`);
    await reached(page, "failed");
    expect(await page.getByRole("alert").textContent()).toContain("found no graphics adapter");
    const before = ends.length;
    expect(await status()).toEqual([false, ""]);
    await expect.poll(() => ends.length, { timeout: 30_000 }).toBeGreaterThan(before);
    await page.waitForTimeout(200);
    expect(ends.at(-1)).toBeLessThan(whole.length - 1);
    expect(await status(), "when more of the file has come").toEqual([false, ""]);
  });

  it("keeps the frame of a volume in slices, and that of slices", async () => {
    await open("volume.hmk");
    await reached(page, "ready");
    await setControls(page, { Frame: "2", "Show as": "generic" });
    await page.getByLabel("Across", { exact: true }).waitFor();
    expect(await control(page, "time").inputValue()).toBe("2");
    await setControls(page, { time: "1", "Show as": "volume" });
    await page.getByLabel("Mode", { exact: true }).waitFor();
    expect(await control(page, "Frame").inputValue()).toBe("1");
  });
});
