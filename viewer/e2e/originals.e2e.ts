/** What a model is compared with: files of its shape; and what becomes of the page where they, or an address, fail. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import type { Page } from "playwright-core";
import { describe, expect, it } from "vitest";
import { control, dropFile, haveBrowser, makeModels, opening, pixels, reached, setControls } from "./browser";

const there = haveBrowser();
const folder = there ? makeModels() : "";
const size = 64;

describe.runIf(there)("originals in Chromium", () => {
  let page: Page;
  const open = opening(folder, size, (opened) => {
    page = opened;
  });

  it("keeps saying what it assumes when there is an original", async () => {
    await open("bare.hmk", undefined, "--original", join(folder, "bare.npy"));
    await reached(page, "ready");
    expect(await page.locator("#loading").textContent()).toContain("light has no directions as coordinates");
  });

  it("compares with a file of the same shape, whatever its axes are called", async () => {
    await open("material.hmk", undefined, "--original", join(folder, "renamed.hmk"));
    await reached(page, "ready");
    const alone = await pixels(page, size);
    await setControls(page, { Show: "split" });
    expect(await control(page, "With").inputValue()).toBe("original");
    const found = await pixels(page, size);
    const line = (i: number): boolean => Math.abs(Math.floor(i / 3) % size + 0.5 - size / 2) < 1; // between the two sides
    expect(found.filter((_, i) => !line(i))).toEqual(alone.filter((_, i) => !line(i)));
  });

  it.each<[string, number, (whole: Buffer) => Buffer, string]>([
    ["missing", 404, (whole) => whole, "The original cannot be shown. There is no file other.hmk on 127.0.0.1"],
    ["damaged", 200, (whole) => Buffer.concat([whole.subarray(0, -9), Buffer.alloc(9, 1)]), "The original cannot be shown. The file is damaged."],
    ["another kind of file", 200, () => Buffer.alloc(100, 77), "The original cannot be shown. This is no .hmk file"],
    ["of another shape", 200, () => readFileSync(join(folder, "volume.hmk")), "The original has another shape than the model."],
  ])("shows the model without its original where that is %s", async (_, status, made, sentence) => {
    await open("stack.hmk", "&never");
    await reached(page, "ready");
    const base = page.url().split("?")[0]!;
    await page.route("**/files/other.hmk", (route) => route.fulfill({ status, body: made(readFileSync(join(folder, "stack.hmk"))) }));
    await page.goto(`${base}?file=files/stack.hmk&original=files/other.hmk&pixels=${size}x${size}`);
    await reached(page, "ready");
    const told = page.getByRole("alert");
    expect((await told.locator("h1").textContent())!.startsWith(sentence)).toBe(true);
    expect(await told.textContent()).toContain("The model is shown without it.");
    expect(await told.evaluate((element) => element.classList.contains("aside"))).toBe(true);
    expect(await page.locator("#loading").textContent()).toBe("");
    await setControls(page, { Show: "split" });
    expect(await control(page, "With").inputValue(), "levels are left to compare with").toBe("1");
    await setControls(page, { Show: "none", Level: "1" });
    await told.evaluate((element) => element.remove());
    expect(new Set(await pixels(page, size)).size, "a picture, not a blank").toBeGreaterThan(20);
  });

  it("keeps the view that was chosen while the original was on its way", async () => {
    await open("volume.hmk", "&never");
    await reached(page, "ready");
    const base = page.url().split("?")[0]!;
    let send: () => Promise<void> = () => Promise.resolve();
    await page.route("**/files/other.hmk", (route) => {
      send = () => route.fulfill({ body: readFileSync(join(folder, "volume.hmk")) });
    });
    await page.goto(`${base}?file=files/volume.hmk&original=files/other.hmk&pixels=${size}x${size}`);
    await reached(page, "model-ready");
    const before = await pixels(page, size);
    await page.locator("canvas").dispatchEvent("wheel", { deltaY: -400 });
    const chosen = await pixels(page, size);
    expect(chosen).not.toEqual(before);
    await send();
    await reached(page, "ready");
    expect(await pixels(page, size)).toEqual(chosen);
  });

  it("says nothing of an address that fails once another file was dropped", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    let fail: () => Promise<void> = () => Promise.resolve();
    await page.route("**/files/late.hmk", (route) => {
      fail = () => route.fulfill({ status: 404 });
    });
    await page.goto(`${page.url().split("?")[0]!}?file=files/late.hmk`);
    await dropFile(page, "good.hmk", readFileSync(join(folder, "stack.hmk")));
    await reached(page, "ready");
    await fail();
    await page.waitForTimeout(300);
    expect(await page.getByRole("alert").isVisible()).toBe(false);
    expect(await page.evaluate(() => document.documentElement.dataset["state"])).toBe("ready");
  });
});
