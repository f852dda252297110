/** What is chosen on the page and cannot be drawn, and controls that depend on what there is. */

import { join } from "node:path";
import { readFileSync } from "node:fs";
import type { Locator, Page } from "playwright-core";
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

  /** Rest the pointer `right` pixels right of the middle of the picture and 120 below it. */
  const rest = async (right: number): Promise<void> => {
    const box = (await page.locator("canvas").boundingBox())!;
    await page.mouse.move(box.x + box.width / 2 + right, box.y + box.height / 2 + 120);
  };

  /** What is read under the pointer, once nothing is drawn any more. */
  const readout = async (): Promise<string> => {
    await settled(page);
    return (await page.locator("#readout").textContent())!;
  };

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

  it("plays time and steps through it in slices, too", async () => {
    await open("volume.hmk");
    await reached(page, "ready");
    await setControls(page, { "Show as": "generic" });
    const time = control(page, "time");
    const before = await pixels(page, 64);
    await page.locator("canvas").focus();
    await page.keyboard.press(".");
    expect(await time.inputValue()).toBe("1");
    expect(await pixels(page, 64)).not.toEqual(before);
    await page.keyboard.press(",");
    expect(await time.inputValue()).toBe("0");
    await page.keyboard.press("Space");
    const [play, pause] = ["Play", "Pause"].map((name) => page.getByRole("button", { name })) as [Locator, Locator];
    expect([await play.isVisible(), await pause.isVisible()]).toEqual([false, true]);
    await expect.poll(() => time.inputValue(), { timeout: 30_000 }).not.toBe("0");
    await setControls(page, { Across: "0" });
    await expect.poll(() => pause.isVisible(), { message: "all frames are in the picture" }).toBe(false);
    await setControls(page, { Across: "3" });
    await play.waitFor();
  });

  it("reads what is under a pointer that rests while something else changes", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await settled(page);
    await rest(120);
    const seen = [await readout()];
    await page.locator("canvas").focus();
    for (const key of ["[", "+", "ArrowLeft"]) {
      for (let i = 0; i < 3; i += 1) {
        await page.keyboard.press(key);
      }
      seen.push(await readout());
    }
    await setControls(page, { trial: "1" });
    seen.push(await readout());
    expect(new Set(seen).size, seen.join("; ")).toBe(5);
    await rest(121);
    expect(await readout()).toBe(seen.at(-1));
  });

  it("shows data of one value as it is rendered, with a window that can be typed", async () => {
    await open("constant.hmk");
    await reached(page, "ready");
    const { constant } = JSON.parse(readFileSync(join(folder, "pictures.json"), "utf-8")) as { constant: number[] };
    const middle = async (): Promise<number[]> => [...(await pixels(page, 64)).subarray(3 * 2080, 3 * 2080 + 3)];
    expect(await middle()).toEqual(constant);
    const number = page.getByLabel("High, as a number");
    expect([await control(page, "Low").inputValue(), await number.inputValue()]).toEqual(["0", "5"]);
    await number.fill("10");
    await number.press("Enter");
    expect((await middle())[0]! / 255).toBeCloseTo(0.5, 1);
    await number.fill("much");
    await number.press("Enter");
    expect(await number.inputValue()).toBe("10");
    await setControls(page, { High: "0" });
    await expect.poll(() => number.inputValue()).toBe("0");
    expect(await middle(), "a window upside down is one, too").toEqual([255, 255, 255]);
  });

  it("opens another model and a mesh by the panel's button, and offers the mesh once there is one", async () => {
    await open("material.hmk");
    await reached(page, "ready");
    const mesh = page.locator("option[value=mesh]");
    expect(await mesh.isDisabled()).toBe(true);
    const choose = async (file: string): Promise<void> => {
      const [chooser] = await Promise.all([page.waitForEvent("filechooser"), page.getByRole("button", { name: "Open …" }).press("Enter")]);
      await chooser.setFiles(join(folder, file));
    };
    await choose("patch.glb");
    await expect.poll(() => control(page, "Shape").inputValue()).toBe("mesh");
    expect(await mesh.isDisabled()).toBe(false);
    const before = await pixels(page, 64);
    await setControls(page, { "Show as": "generic" });
    await page.getByLabel("Across", { exact: true }).waitFor();
    await setControls(page, { "Show as": "svbrdf" });
    await page.getByLabel("Shape", { exact: true }).waitFor();
    expect(await pixels(page, 64), "the mesh is still there").toEqual(before);
    await choose("stack.hmk");
    await expect.poll(() => page.title()).toBe("stack.hmk: hmkcta");
    await page.goto(`${page.url().split("?")[0]!}?file=files/other.hmk`);
    await reached(page, "failed");
    await choose("stack.hmk");
    await expect.poll(() => page.title()).toBe("stack.hmk: hmkcta");
    await reached(page, "ready");
  });

  it("opens what the keyboard is on, and the panel for the list of keys", async () => {
    await open("volume.hmk", "&pixels=64x64&panel=closed");
    await reached(page, "ready");
    const panel = page.locator("#panel");
    expect(await panel.isVisible()).toBe(false);
    await page.locator("canvas").focus();
    await page.keyboard.press("?");
    expect(await page.locator("#keys table").isVisible()).toBe(true);
    await page.keyboard.press("?");
    expect([await panel.isVisible(), await page.locator("#keys table").isVisible()]).toEqual([true, false]);
    await page.getByText("Clip", { exact: true }).focus();
    await page.keyboard.press("Space");
    expect(await control(page, "x from").isVisible()).toBe(true);
    expect(await page.getByRole("button", { name: "Play" }).isVisible(), "the key was not for the picture").toBe(true);
    await page.getByRole("button", { name: "Controls" }).click();
    expect(await panel.isVisible()).toBe(false);
  });

  it("moves the light that the panel shows", async () => {
    await open("material.hmk");
    await reached(page, "ready");
    await page.getByRole("button", { name: "Add a light" }).click();
    const azimuth = (): Promise<string> => control(page, "Azimuth").inputValue();
    const before = await azimuth();
    await page.locator("canvas").focus();
    await page.keyboard.press("Shift+ArrowLeft");
    expect(await azimuth()).not.toBe(before);
    await setControls(page, { Light: "0" });
    expect(await azimuth(), "the first one did not move").toBe("60");
    await setControls(page, { Light: "1" });
    await page.getByRole("button", { name: "Remove" }).click();
    await page.locator("canvas").focus();
    await page.keyboard.press("Shift+ArrowLeft");
    expect(await azimuth(), "the one that is left moves").not.toBe("60");
  });

  it("zooms slices about the pointer", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await settled(page);
    await rest(120);
    const before = await readout();
    for (let i = 0; i < 5; i += 1) {
      await page.mouse.wheel(0, -400);
    }
    expect(await readout()).toBe(before);
    await rest(160);
    expect(await readout(), "pixels are large").toBe(before);
  });
});
