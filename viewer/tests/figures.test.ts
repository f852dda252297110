/** What the page says, as functions of its state. */

import { describe, expect, it } from "vitest";
import { badge, current, errorScale, headline, pageTitle, pictureLabel, pictureName, sideNames } from "../src/figures";
import { type Action, type Drawn, type Shown, reduced } from "../src/store";
import { LIGHTFIELD, RANGE, VOLUME, axis, shown } from "./made";

const ARRIVED: Action[] = [{ type: "arrive" }, { type: "arrive" }, { type: "arrive" }, { type: "range", range: RANGE }];

function chosen(kind: "volume" | "lightfield" | "generic", choose: (state: Shown["state"]) => void, axes = kind === "lightfield" ? LIGHTFIELD : VOLUME): Shown {
  return reduced(shown(kind, axes, ARRIVED), { type: "choose", choose });
}

function drawn({ kind, state }: Shown, whole = true): Drawn {
  return { kind, state, whole, width: 8, height: 8, milliseconds: 1 };
}

describe("figures", () => {
  it.each([[1, "11.9 dB"], [2, "20.3 dB"], [3, "28.3 dB"]])("of level %d are the file's: %s", (level, snr) => {
    const state = chosen("volume", (made) => {
      made.level = level;
    });
    expect(headline(state)).toEqual([snr, `SNR at level ${level} of 3`]);
    expect(pictureLabel(state)).toContain(`${snr} SNR at level ${level} of 3`);
    expect(pictureName(state)).toBe(level === 3 ? "wood.png" : `wood-level-${level}.png`);
    expect(pageTitle(state)).toBe("some/wood.hmk: hmkcta");
  });

  it("name both sides of a comparison", () => {
    const state = chosen("volume", (made) => {
      Object.assign(made, { level: 2, compare: { ...made.compare, mode: "split", level: 3 } });
    });
    expect(sideNames(state)).toEqual(["Level 2", "Level 3"]);
    expect(pictureName(state)).toBe("wood-level-2-beside-level-3.png");
    expect(pictureLabel(state)).toContain("Level 2 beside level 3");
    const original = reduced(reduced(state, { type: "original" }), { type: "choose", choose: (made) => {
      made.compare.mode = "heat";
    } });
    expect(sideNames(original)).toEqual(["Level 2", "Original"]);
    expect(pictureName(original)).toBe("wood-level-2-error-original.png");
  });

  it("say how far a picture is that is not what was chosen", () => {
    const before = shown("volume", VOLUME, ARRIVED);
    const half = reduced(before, { type: "share", share: 0.345 });
    expect(badge(before)).toBe(null);
    expect(badge(half)).toBe("decoding 34 %");
    expect(badge(reduced(half, { type: "share", share: 0.9999 }))).toBe("decoding 99 %");
    expect(badge(reduced(half, { type: "drawn", drawn: drawn(half, false) })), "half a picture is none").toBe("decoding 34 %");
    const whole = reduced(half, { type: "drawn", drawn: drawn(half) });
    expect([badge(whole), current(whole)]).toEqual([null, true]);
    const next = reduced(whole, { type: "choose", choose: (state) => {
      state.level = 1;
    } });
    expect(current(next)).toBe(false);
    expect(badge(reduced(next, { type: "share", share: 0 }))).toBe("decoding 0 %, still level 3");
    expect(badge(reduced(reduced(next, { type: "share", share: 0.5 }), { type: "choose", choose: (state) => {
      state.level = 2;
    } })), "nothing of another choice").toBe("decoding 0 %, still level 3");
    expect(badge(reduced(next, { type: "saving", saving: 0.5 }))).toBe("saving 50 %");
  });

  it("have the ends of the error's colours in the units of the source, whatever the exposure", () => {
    const heat = (kind: "volume" | "lightfield" | "generic", gain: number): Shown => chosen(kind, (state) => {
      Object.assign(state.compare, { mode: "heat", gain });
      Object.assign(state.own, { gain: false });
      state.tone.stops = 2;
    }, kind === "generic" ? [axis("a", 9), axis("b", 9)] : undefined);
    expect(errorScale(heat("lightfield", 4))).toEqual({ most: 180 / 4, unit: "" });
    expect(errorScale(heat("generic", 8))).toEqual({ most: 160 / 8, unit: "" });
    expect(errorScale(heat("volume", 8)), "colours are no values").toEqual({ most: 12.5, unit: "% of white" });
    expect(errorScale(shown("volume", VOLUME, ARRIVED))).toBe(null);
  });

  it.each([
    ["wood.hmk", "wood.png"], ["Wood.HMK", "Wood.png"], ["wood.old.hmk", "wood.old.png"], ["wood", "wood.png"],
    ["of\\a/b.hmk", "b.png"], [".hmk", "hmkcta.png"], ["https://example.org/", "hmkcta.png"],
  ])("name a picture of %s %s", (name, picture) => {
    expect(pictureName({ ...shown("volume", VOLUME, ARRIVED), name })).toBe(picture);
  });
});
