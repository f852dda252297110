/** The page's one state: what actions make of it. */

import { describe, expect, it } from "vitest";
import { newLight } from "../src/state";
import { type Action, type Shown, reduced } from "../src/store";
import { LIGHTFIELD, RANGE, VOLUME, axis, shown } from "./made";

const ARRIVED: Action[] = [{ type: "arrive" }, { type: "arrive" }, { type: "arrive" }, { type: "range", range: RANGE }];

function choose(before: Shown, act: (state: Shown["state"]) => void): Shown {
  return reduced(before, { type: "choose", choose: act });
}

describe("the state", () => {
  it("is never changed in place", () => {
    const before = shown("volume", VOLUME, ARRIVED);
    const after = choose(before, (state) => {
      state.tone.stops = 2;
      state.lights.push(newLight());
    });
    expect([before.state.tone.stops, before.state.lights.length]).toEqual([0, 1]);
    expect([after.state.tone.stops, after.state.lights.length]).toEqual([2, 2]);
    expect(() => {
      after.state.volume.opacity[0]![1] = 1;
    }).toThrow(TypeError);
  });

  it("stays the same where nothing is chosen that it is not", () => {
    const before = shown("volume", VOLUME, ARRIVED);
    expect(choose(before, (state) => {
      state.level = 9;
    }).state).toBe(before.state);
  });

  it("follows the levels that arrive, unless another one was chosen", () => {
    const two = shown("volume", VOLUME, ARRIVED.slice(0, 2));
    expect(two.state.level).toBe(2);
    expect(reduced(two, { type: "arrive" }).state.level).toBe(3);
    const first = choose(two, (state) => {
      state.level = 1;
    });
    expect(reduced(first, { type: "arrive" }).state.level).toBe(1);
  });

  it.each<[string, (state: Shown["state"]) => void, (state: Shown["state"]) => unknown, unknown]>([
    ["a level that is not there", (state) => Object.assign(state, { level: 7 }), ({ level }) => level, 3],
    ["no level", (state) => Object.assign(state, { level: -1 }), ({ level }) => level, 1],
    ["places beside the axes", (state) => state.position.splice(0, 4, -3, 99, 2, 5), ({ position }) => position, [0, 7, 2, 5]],
    ["a frame after the last", (state) => Object.assign(state, { time: 80 }), ({ time }) => time, 5],
    ["an original that is not there", (state) => Object.assign(state.compare, { level: null }), ({ compare }) => compare.level, 1],
    ["a divider beside the picture", (state) => Object.assign(state.compare, { position: 1.5 }), ({ compare }) => compare.position, 1],
    ["an exposure that the slider lacks", (state) => Object.assign(state.tone, { stops: -60 }), ({ tone }) => tone.stops, -6],
    ["a light that was removed", (state) => Object.assign(state, { light: 4 }), ({ light }) => light, 0],
    ["more lights than the shader has", (state) => state.lights.push(...Array.from({ length: 20 }, () => newLight())), ({ lights }) => lights.length, 8],
    ["a box upside down", (state) => Object.assign(state.volume, { clipLow: [2, 0, 0], clipHigh: [0.5, 1, 1] }), ({ volume }) => volume.clipLow[0], 0.49],
  ])("takes of %s what there is", (_, act, get, expected) => {
    expect(get(choose(shown("volume", VOLUME, ARRIVED), act).state)).toEqual(expected);
  });

  it("plays only where there is more than one frame", () => {
    const playing = reduced(shown("volume", VOLUME, ARRIVED), { type: "play", playing: true });
    expect(playing.playing).toBe(true);
    const slices = reduced(playing, { type: "show-as", kind: "generic" });
    expect(slices.playing).toBe(true);
    expect(choose(slices, (state) => {
      state.slice.x = 0;
    }).playing, "all frames are in the picture").toBe(false);
    expect(reduced(shown("lightfield", LIGHTFIELD, ARRIVED), { type: "play", playing: true }).playing).toBe(false);
  });

  it("is as before where a choice cannot be drawn", () => {
    const before = shown("volume", VOLUME, ARRIVED);
    const after = choose(before, (state) => {
      state.volume.mode = "iso";
      state.lights[0]!.azimuth = 7;
    });
    expect(reduced(after, { type: "restore", state: before.state }).state).toEqual(before.state);
  });
});

describe("what is the file's own", () => {
  const GREY = [axis("y", 8, "space"), axis("x", 8, "space")];

  it("is the white of its type, until another one is chosen, and again", () => {
    const own = shown("lightfield", LIGHTFIELD, ARRIVED, "uint8");
    expect(own.state.tone.white).toBe(255);
    const chosen = choose(own, (state) => {
      state.own.white = false;
      state.tone.white = 100;
    });
    expect(reduced(chosen, { type: "range", range: { ...RANGE, high: 9 } }).state.tone.white).toBe(100);
    expect(choose(chosen, (state) => {
      state.own.white = true;
    }).state.tone.white).toBe(255);
  });

  it("is measured where the type says nothing", () => {
    expect(shown("lightfield", LIGHTFIELD, ARRIVED).state.tone.white).toBe(180);
    expect(shown("volume", VOLUME, ARRIVED, "uint8").state.volume).toMatchObject({ low: 20, high: 180 });
  });

  it("is the window of slices, too", () => {
    expect(shown("generic", GREY, ARRIVED, "uint8").state.slice).toMatchObject({ low: 0, high: 255 });
    expect(shown("generic", GREY, ARRIVED, "int16").state.slice).toMatchObject({ low: 20, high: 180 });
    expect(shown("generic", VOLUME, ARRIVED, "uint8").state.slice, "of a measured volume").toMatchObject({ low: 20, high: 180 });
  });

  it.each<["volume" | "lightfield" | "generic", number, number]>([
    ["lightfield", 1, 8], ["lightfield", 3, 8], ["generic", 1, 8], ["volume", 1, 8]])(
    "is how much errors are amplified: as the errors are that it tells of, in %s at level %d", (kind, level, most) => {
      const axes = kind === "lightfield" ? LIGHTFIELD : kind === "volume" ? VOLUME : GREY;
      const made = choose(shown(kind, axes, ARRIVED), (state) => {
        state.level = level;
      });
      const white = { lightfield: 180, generic: 160, volume: 160 }[kind];
      expect(made.state.compare.gain).toBe(2 ** Math.round(Math.log2(white / (2.6 * most))));
      const turned = choose(made, (state) => {
        state.camera.azimuth = 77;
        state.tone.stops = 3;
        state.zoom = 4;
      });
      expect(turned.state.compare.gain, "whatever is in view").toBe(made.state.compare.gain);
    });
});
