/** What is chosen on the page and cannot be drawn, and controls that depend on what there is. */

import { join } from "node:path";
import { readFileSync } from "node:fs";
import type { Page } from "playwright-core";
import { describe, expect, it } from "vitest";
import { control, dropFile, haveBrowser, makeModels, opening, pixels, reached, setControls, settled } from "./browser";

const there = haveBrowser();
const folder = there ? makeModels() : "";

describe.runIf(there)("choices in Chromium", () => {
  let page: Page;
  const open = opening(folder, 64, (opened) => {
    page = opened;
  });

  /** Have the adapter be without memory for the next decoded elements, and with it again. */
  const outOfMemory = (): Promise<void> => page.evaluate(() => {
    const make = GPUDevice.prototype.createTexture;
    GPUDevice.prototype.createTexture = function limited(this: GPUDevice, description) {
      if (description.dimension === "3d") {
        GPUDevice.prototype.createTexture = make;
        throw new Error("no memory is left");
      }
      return make.call(this, description);
    };
  });

  it("refuses what cannot be drawn, and keeps what was shown, with live controls", async () => {
    await open("volume.hmk");
    await reached(page, "ready");
    await page.setViewportSize({ width: 900, height: 900 });
    const before = await pixels(page, 64);
    const told = page.getByRole("alert");
    await outOfMemory();
    await setControls(page, { "Show as": "generic" });
    await told.getByText("no memory is left").waitFor();
    await expect.poll(() => page.getByLabel("Mode", { exact: true }).isVisible()).toBe(true);
    expect(await control(page, "Show as").inputValue()).toBe("volume");
    expect(await pixels(page, 64)).toEqual(before);
    await page.keyboard.press("Escape");
    expect(await told.isVisible()).toBe(false);
    expect(await page.evaluate(() => document.documentElement.dataset["state"])).toBe("ready");
    await setControls(page, { "Show as": "generic" });
    await page.getByLabel("Across", { exact: true }).waitFor();
    expect(await pixels(page, 64)).not.toEqual(before);
    await outOfMemory();
    await setControls(page, { Across: "0", Down: "2" });
    await told.getByText("no memory is left").waitFor();
    await settled(page);
    expect([await control(page, "Across").inputValue(), await control(page, "Down").inputValue()]).not.toEqual(["0", "2"]);
    await setControls(page, { Across: "0", Down: "2" });
    await settled(page);
    expect(await control(page, "Across").inputValue()).toBe("0");
  });

  it("has live controls where the first picture could not be drawn", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await page.goto(`${page.url().split("?")[0]!}?file=&pixels=64x64`);
    await reached(page, "empty");
    await outOfMemory();
    await dropFile(page, "good.hmk", readFileSync(join(folder, "volume.hmk")));
    const told = page.getByRole("alert");
    await told.getByText("no memory is left").waitFor();
    await control(page, "Mode").waitFor();
    await setControls(page, { Mode: "emission" });
    expect(new Set(await pixels(page, 64)).size).toBeGreaterThan(20);
    await page.getByRole("button", { name: "Close the message" }).click();
    expect(await told.isVisible()).toBe(false);
  });
});
