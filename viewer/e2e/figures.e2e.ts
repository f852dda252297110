/** Every figure that the page shows, held to the file's own while each control is moved by mouse, key and touch; and pictures that are not whole yet. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import type { CDPSession, Locator, Page } from "playwright-core";
import { PNG } from "pngjs";
import { describe, expect, it } from "vitest";
import { loads } from "../src/reader/read";
import { control, haveBrowser, makeModels, opening, pixels, reached, setControls, settled } from "./browser";

const there = haveBrowser();
const folder = there ? makeModels() : "";
const size = 64;
const SEVERAL = 3; // shader passes of a frame that decodes nothing

interface Told {
  means: Record<string, number>;
}
const { means } = there ? JSON.parse(readFileSync(join(folder, "pictures.json"), "utf-8")) as Told : { means: {} };

/** In the page: where what it shows contradicts itself or the SNR of the file's levels. */
function faults(snrs: string[]): string[] {
  const found: string[] = [];
  const same = (what: string, shown: unknown, expected: unknown): void => {
    if (shown !== expected) {
      found.push(`${what}: ${String(shown)}, not ${String(expected)}`);
    }
  };
  const text = (selector: string): string => document.querySelector(selector)!.textContent;
  const labelled = (label: string): HTMLInputElement | null =>
    Array.from(document.querySelectorAll<HTMLInputElement>("input, select")).find((each) => each.labels?.[0]?.textContent === label) ?? null;
  const ranges = Array.from(document.querySelectorAll<HTMLInputElement>(".row input[type=range]")).filter((each) => each.checkVisibility());
  for (const input of ranges) {
    const row = input.parentElement!;
    const shown = row.querySelector("output")?.textContent ?? row.querySelector<HTMLInputElement>(".number")!.value;
    same(`what is read out of ${row.textContent}`, input.getAttribute("aria-valuetext"), shown);
  }
  const level = Number(labelled("Level")!.value);
  same("headline", text(".big"), `${snrs[level - 1]} SNR at level ${level} of ${snrs.length}`);
  const [mode, other] = [labelled("Show")!.value, labelled("With")!.value];
  const label = document.querySelector("canvas")!.ariaLabel!;
  if (mode === "none") {
    same("picture's label names the level", label.includes(`. ${snrs[level - 1]} SNR at level ${level} of ${snrs.length}. `), true);
  }
  const divider = document.getElementById("divider")!;
  same("divider", divider.hidden, mode !== "split");
  if (mode === "split") {
    same("left", text("#left"), `Level ${level}`);
    same("right", text("#right"), `Level ${other}`);
    same("divider", divider.getAttribute("aria-valuenow"), String(Math.round(100 * Number(labelled("Divider")!.value))));
  }
  same("error's colours", document.getElementById("error-bar")!.hidden, mode !== "heat");
  return found;
}

describe.runIf(there)("figures in Chromium", () => {
  let page: Page;
  let slow = false;
  const open = opening(folder, size, async (opened) => {
    page = opened;
    if (slow) { // an adapter that takes so long to decode that a picture takes several frames
      await page.addInitScript((several) => {
        let passes = 0;
        const dispatch = GPUComputePassEncoder.prototype.dispatchWorkgroups;
        GPUComputePassEncoder.prototype.dispatchWorkgroups = function counted(this: GPUComputePassEncoder, ...given) {
          passes += 1;
          return dispatch.apply(this, given);
        };
        const work = GPUQueue.prototype.onSubmittedWorkDone;
        GPUQueue.prototype.onSubmittedWorkDone = async function late(this: GPUQueue) {
          await new Promise((resolve) => setTimeout(resolve, passes > several ? 250 : 0));
          passes = 0;
          return work.call(this);
        };
        const badges: string[] = [];
        new MutationObserver(() => {
          const badge = document.getElementById("decoding");
          if (badge?.hidden === false && badges.at(-1) !== badge.textContent) {
            badges.push(badge.textContent);
          }
        }).observe(document, { childList: true, subtree: true, characterData: true, attributes: true });
        Object.assign(window, { badges });
      }, SEVERAL);
    }
  });
  const openSlow = async (file: string): Promise<void> => {
    slow = true;
    await open(file).finally(() => {
      slow = false;
    });
  };

  /** The picture on the screen before something is done, while it is drawn, and when nothing is drawn any more. */
  const shotsUntilStill = async (act: () => Promise<void>): Promise<string[]> => {
    const shot = async (): Promise<string> => (await page.screenshot({ clip: { x: 0, y: 0, width: size, height: size } })).toString("base64");
    const shots = [await shot()];
    await act();
    while (await page.evaluate(() => document.querySelector("canvas")!.ariaBusy) === "true") {
      shots.push(await shot());
    }
    return [...shots, await shot()];
  };

  /** The SNR of a file's levels as the page says it. */
  const snrs = (file: string): string[] => loads(new Uint8Array(readFileSync(join(folder, file)))).metadata.quality.map(({ snrDb }) => `${snrDb.toFixed(1)} dB`);

  /** What moves a slider to a share of its way. */
  const moving = (session: CDPSession): Record<string, (slider: Locator, share: number) => Promise<void>> => {
    const place = async (slider: Locator, share: number): Promise<[number, number]> => {
      await slider.scrollIntoViewIfNeeded();
      const box = (await slider.boundingBox())!;
      return [box.x + 8 + share * (box.width - 16), box.y + box.height / 2];
    };
    return {
      mouse: async (slider, share) => {
        const [x, y] = await place(slider, share);
        await page.mouse.move(x, y);
        await page.mouse.down();
        await page.mouse.up();
      },
      key: async (slider, share) => {
        await slider.focus();
        await page.keyboard.press(share < 0.5 ? "Home" : "End");
        await page.keyboard.press(share < 0.5 ? "ArrowRight" : "ArrowLeft");
        await page.keyboard.press(share < 0.5 ? "ArrowLeft" : "ArrowRight");
      },
      touch: async (slider, share) => {
        const [x, y] = await place(slider, share);
        await session.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: [{ x, y }] });
        await session.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
      },
    };
  };

  it.each(["stack", "photographs", "material", "volume"])("are the file's whatever moves whichever control: %s", async (name) => {
    await open(`${name}.hmk`);
    await reached(page, "ready");
    await page.evaluate(() => document.querySelectorAll("details").forEach((each) => each.toggleAttribute("open", true)));
    const told = snrs(`${name}.hmk`);
    const wrong = (): Promise<string[]> => page.evaluate(faults, told);
    expect(await wrong()).toEqual([]);
    const session = await page.context().newCDPSession(page);
    const saved: Record<string, Buffer> = {};
    const save = async (): Promise<string> => {
      await page.locator("canvas").focus();
      const [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("s")]);
      saved[download.suggestedFilename()] ??= readFileSync(await download.path());
      expect(readFileSync(await download.path()), download.suggestedFilename()).toEqual(saved[download.suggestedFilename()]);
      return download.suggestedFilename();
    };
    expect(await save()).toBe(`${name}.png`);
    for (const [by, move] of Object.entries(moving(session))) {
      const level = control(page, "Level");
      await move(level, 0);
      expect([by, await level.inputValue(), await page.locator(".big").textContent()]).toEqual([by, "1", `${told[0]} SNR at level 1 of 2`]);
      expect(await wrong()).toEqual([]);
      expect(await save()).toBe(`${name}-level-1.png`);
      await move(level, 1);
      expect([by, await page.locator(".big").textContent()]).toEqual([by, `${told[1]} SNR at level 2 of 2`]);
    }
    expect(await save(), "and the picture is the one that it was").toBe(`${name}.png`);
    expect(saved[`${name}.png`]).not.toEqual(saved[`${name}-level-1.png`]);
    for (const mode of ["none", "split", "heat"]) {
      await setControls(page, { Show: mode });
      for (const slider of await page.locator(".row input[type=range]:visible").all()) {
        for (const [by, move] of Object.entries(moving(session))) {
          for (const share of [0.2, 0.7]) {
            await move(slider, share);
            expect(await wrong(), `${await slider.evaluate((each) => each.parentElement!.textContent)} by ${by}`).toEqual([]);
          }
        }
      }
      for (const select of await page.locator("select:visible").all()) {
        if (!["Show", "Show as"].includes(await select.evaluate((each) => (each as HTMLSelectElement).labels[0]!.textContent))) {
          await select.focus();
          await page.keyboard.press("ArrowDown");
          expect(await wrong()).toEqual([]);
          await page.keyboard.press("ArrowUp");
          expect(await wrong()).toEqual([]);
        }
      }
    }
    await page.locator("canvas").focus();
    for (const key of ["[", "]", "c", "e", "E", ".", ",", "+", "-", "r", "ArrowLeft", "Shift+ArrowUp", "c", "c", "["]) {
      await page.keyboard.press(key);
      expect(await wrong(), key).toEqual([]);
    }
  });

  it.each(["photographs", "photograph"])("show 8-bit pictures as bright as they are: %s", async (name) => {
    await open(`${name}.hmk`);
    await reached(page, "ready");
    const found = await pixels(page, size);
    const mean = found.reduce((sum, value) => sum + value, 0) / found.length;
    expect(Math.abs(mean / means[name]! - 1)).toBeLessThan(0.01);
  });

  it("have another white where it is chosen, and the type's again", async () => {
    await open("photographs.hmk");
    await reached(page, "ready");
    const number = page.getByLabel("White, as a number");
    expect(await number.inputValue()).toBe("255");
    const own = await pixels(page, size);
    await setControls(page, { "White, as a number": "510" });
    const darker = await pixels(page, size);
    own.forEach((value, i) => expect(Math.abs(darker[i]! - value / 2)).toBeLessThan(1.6));
    await page.getByRole("button", { name: "White of the file" }).click();
    expect(await number.inputValue()).toBe("255");
    expect(await pixels(page, size)).toEqual(own);
  });

  it.each<[string, number]>([["photographs", 255], ["photograph", 255]])("have errors in the units of the source, whatever is in view: %s", async (name, white) => {
    await open(`${name}.hmk`);
    await reached(page, "ready");
    await setControls(page, { Level: "1", Show: "heat", With: "2" });
    const { rmse } = loads(new Uint8Array(readFileSync(join(folder, `${name}.hmk`)))).metadata.quality[0]!;
    const scale = async (): Promise<string[]> => page.locator("#error-bar span").allTextContents();
    const most = white / 2 ** Math.round(Math.log2(white / (2.6 * rmse)));
    expect((await scale()).map(Number)).toEqual([0, most / 2, most].map((each) => Number(each.toPrecision(3))));
    expect(await page.locator("#error-unit").textContent()).toContain("units of the source");
    const before = [await scale(), await pixels(page, size)];
    await setControls(page, { Exposure: "3" });
    expect([await scale(), await pixels(page, size)], "exposure makes no errors").toEqual(before);
    await page.evaluate(() => document.querySelector("canvas")!.dispatchEvent(new WheelEvent("wheel", { deltaY: -900 })));
    await settled(page);
    expect(await scale()).toEqual(before[0]);
    await setControls(page, { Amplify: "2" });
    expect(Number((await scale())[2])).toBeCloseTo(white / 4, 0);
    await page.getByRole("button", { name: "As the file's error needs" }).click();
    expect(await scale()).toEqual(before[0]);
  });

  it("says of a picture that is half decoded how far it is, and keeps the last whole one", async () => {
    await openSlow("deep.hmk");
    await reached(page, "ready");
    await settled(page);
    const badges = await page.evaluate(() => (window as unknown as { badges: string[] }).badges);
    expect(badges.find((text) => text !== "decoding 0 %"), "of the first picture, the only one that is shown before it is whole")
      .toMatch(/^decoding [1-9]\d? %$/);
    // A file so small is read whole before anything is drawn: no level comes before the last.
    expect(badges.filter((text) => !/^decoding \d+ %$/.test(text))).toEqual([]);
    const shares = badges.map((text) => Number(text.split(" ")[1]));
    expect(shares.length, badges.join("; ")).toBeGreaterThan(2);
    expect([...shares].sort((one, other) => one - other)).toEqual(shares);
    expect(await page.locator("#decoding").isVisible()).toBe(false);
    const whole = await pixels(page, size);
    const shots = await shotsUntilStill(() => control(page, "Level").press("ArrowLeft"));
    expect(whole).not.toEqual(await pixels(page, size));
    expect(shots.at(-1)).not.toBe(shots[0]);
    expect(shots.filter((each) => each !== shots[0] && each !== shots.at(-1)), "neither level").toEqual([]);
    const later = await page.evaluate(() => (window as unknown as { badges: string[] }).badges.slice(-3));
    later.forEach((text) => expect(text).toMatch(/^decoding [1-9]\d? %, still level 2$/));
  });

  it("compares what is decoded and nothing else", async () => {
    await openSlow("deep.hmk");
    await reached(page, "ready");
    await pixels(page, size);
    await page.evaluate(() => (window as unknown as { badges: string[] }).badges.splice(0));
    const shots = await shotsUntilStill(() => setControls(page, { Show: "heat" }));
    expect(await page.evaluate(() => (window as unknown as { badges: string[] }).badges.length), "several frames were needed").toBeGreaterThan(2);
    expect(shots.at(-1)).not.toBe(shots[0]);
    expect(shots.filter((each) => each !== shots[0] && each !== shots.at(-1))).toEqual([]);
  });

  it("plays every frame in order, each of them whole, until it is paused, and saves what was chosen once it is whole", async () => {
    await openSlow("volume.hmk");
    await reached(page, "ready");
    await settled(page);
    const { length } = loads(new Uint8Array(readFileSync(join(folder, "volume.hmk")))).metadata.axes;
    expect(length).toBeGreaterThan(2);
    await page.evaluate(() => {
      const seen: string[] = [];
      const frame = Array.from(document.querySelectorAll("label")).find((each) => each.textContent === "Frame")!.control as HTMLInputElement;
      const [statistics, decoding] = ["statistics", "decoding"].map((id) => document.getElementById(id)!);
      new MutationObserver(() => {
        if (decoding!.hidden && seen.at(-1) !== frame.value) {
          seen.push(frame.value); // shown whole
        }
      }).observe(statistics!, { childList: true, characterData: true, subtree: true });
      Object.assign(window, { seen });
    });
    await page.getByRole("button", { name: "Play" }).click();
    const seen = (): Promise<number[]> => page.evaluate(() => (window as unknown as { seen: string[] }).seen.map(Number));
    await expect.poll(async () => (await seen()).length, { timeout: 60_000 }).toBeGreaterThan(4);
    await page.getByRole("button", { name: "Pause" }).click();
    await settled(page);
    const frames = await seen();
    frames.slice(1).forEach((frame, i) => expect(frame, frames.join()).toBe((frames[i]! + 1) % 3));
    const paused = await control(page, "Frame").inputValue();
    await page.waitForTimeout(600); // longer than frames are shown
    expect(await control(page, "Frame").inputValue()).toBe(paused);
    await control(page, "Level").press("ArrowLeft");
    await page.locator("canvas").focus();
    const [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("s")]);
    expect(download.suggestedFilename()).toBe("volume-level-1.png");
    const { data } = PNG.sync.read(readFileSync(await download.path()));
    await page.locator("canvas").evaluate((canvas) => canvas.blur()); // a frame tells of the focus
    const shown = await pixels(page, size);
    expect(Uint8Array.from(shown, (_, i) => data[4 * Math.floor(i / 3) + (i % 3)]!)).toEqual(shown);
  });

  it("saves at full size what is shown with fewer pixels", async () => {
    await open("material.hmk", "&never");
    await reached(page, "ready");
    const [width, height] = await page.locator("canvas").evaluate((canvas) => [canvas.clientWidth, canvas.clientHeight]) as [number, number];
    await page.locator("canvas").focus();
    await page.keyboard.press("ArrowLeft"); // while it moves
    const [download] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("s")]);
    const saved = PNG.sync.read(readFileSync(await download.path()));
    expect([saved.width, saved.height]).toEqual([width, height]);
  });

  it("are read by finger and by keys, too", async () => {
    await open("stack.hmk");
    await reached(page, "ready");
    await settled(page);
    const readout = page.locator("#readout");
    const box = (await page.locator("canvas").boundingBox())!;
    const session = await page.context().newCDPSession(page);
    const [x, y] = [box.x + box.width / 2 + 3, box.y + box.height / 2 + 3];
    await session.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: [{ x, y }] });
    await session.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
    expect(await readout.textContent()).toMatch(/^depth \d+, across \d+, trial 4: /);
    const touched = await readout.textContent();
    await page.locator("canvas").focus();
    for (let i = 0; i < 6; i += 1) {
      await page.keyboard.press("ArrowLeft");
    }
    expect(await readout.textContent()).toMatch(/^depth \d+, across \d+, trial 4: /);
    expect(await readout.textContent()).not.toBe(touched);
    await setControls(page, { Show: "split" });
    await page.locator("#divider").focus();
    await page.keyboard.press("ArrowLeft");
    expect([await page.locator("#divider").getAttribute("aria-valuetext"), await control(page, "Divider").inputValue()]).toEqual(
      ["49 %, level 2 and level 1", "0.49"]);
  });
});
