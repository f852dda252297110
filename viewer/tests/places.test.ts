/** Where a model is on its axes when it is shown as something else. */

import { describe, expect, it } from "vitest";
import { carryPlaces, frameOf, framesOf, showFrame, startPlaces } from "../src/places";
import type { Axis } from "../src/reader/metadata";
import { type State, newState } from "../src/state";

function axis(name: string, size: number, role: Axis["role"]): Axis {
  return { name, size, role, coords: null, unit: "" };
}

const VOLUME = [axis("time", 6, "time"), ...["z", "y", "x"].map((name) => axis(name, 8, "space")), axis("dose", 5, "other")];
const LIGHTFIELD = [axis("row", 3, "view"), axis("column", 5, "view"), axis("y", 8, "space"), axis("x", 8, "space"), axis("time", 4, "time")];

function started(axes: Axis[]): State {
  const state = newState(axes.length);
  startPlaces(state, axes);
  return state;
}

describe("places on axes", () => {
  it("begin in the middle, at the first of two channels, with a picture of the last space axes", () => {
    const state = started([axis("c", 2, "channel"), ...VOLUME]);
    expect(state.position).toEqual([0, 3, 4, 4, 4, 2]);
    expect([state.slice.y, state.slice.x, state.slice.colour]).toEqual([3, 4, false]);
  });

  it.each(["volume", "svbrdf"] as const)("keep the frame of a %s in slices, and that of slices", (kind) => {
    const state = started(VOLUME);
    state.time = 1.4;
    carryPlaces(state, VOLUME, kind, "generic");
    expect(state.position).toEqual([1, 4, 4, 4, 2]);
    carryPlaces(state, VOLUME, "generic", kind);
    expect(state.time, "nothing moved meanwhile").toBe(1.4);
    state.position[0] = 5;
    carryPlaces(state, VOLUME, "generic", kind);
    expect(state.time).toBe(5);
  });

  it("keep the nearest camera and the frame of a light field", () => {
    const state = started(LIGHTFIELD);
    Object.assign(state, { time: 3, view: { ...state.view, row: 1.8, column: 0.4 } });
    carryPlaces(state, LIGHTFIELD, "lightfield", "generic");
    expect(state.position).toEqual([2, 0, 4, 4, 3]);
    Object.assign(state.position, [1, 4]);
    carryPlaces(state, LIGHTFIELD, "generic", "lightfield");
    expect([state.view.row, state.view.column, state.time]).toEqual([1, 4, 3]);
  });

  it("keep the only camera axis, numbered row by row", () => {
    const axes = [axis("view", 9, "view"), ...LIGHTFIELD.slice(2, 4)];
    const state = started(axes);
    Object.assign(state.view, { row: 2, column: 1 });
    carryPlaces(state, axes, "lightfield", "generic");
    expect(state.position[0]).toBe(7);
    state.position[0] = 5;
    carryPlaces(state, axes, "generic", "lightfield");
    expect([state.view.row, state.view.column]).toEqual([1, 2]);
  });

  it("stay where nothing else is shown", () => {
    const state = started(VOLUME);
    carryPlaces(state, VOLUME, "volume", "volume");
    carryPlaces(state, VOLUME, "generic", "generic");
    expect(state).toEqual(started(VOLUME));
  });

  it.each(["volume", "generic"] as const)("has frames to show one after another as %s", (kind) => {
    const state = started(VOLUME);
    expect(framesOf(VOLUME, kind, state)).toBe(6);
    showFrame(VOLUME, kind, state, 4);
    expect([frameOf(VOLUME, kind, state), kind === "generic" ? state.position[0] : state.time]).toEqual([4, 4]);
    showFrame(VOLUME, kind, state, 9);
    expect(frameOf(VOLUME, kind, state)).toBe(5);
    showFrame(VOLUME, kind, state, -1);
    expect(frameOf(VOLUME, kind, state)).toBe(0);
  });

  it("has one frame where slices show all of time, or there is none", () => {
    const state = started(VOLUME);
    state.slice.x = 0;
    const before = structuredClone(state);
    expect(framesOf(VOLUME, "generic", state)).toBe(1);
    showFrame(VOLUME, "generic", state, 3);
    expect(state).toEqual(before);
    const still = VOLUME.slice(1);
    showFrame(still, "volume", state, 3);
    showFrame(still, "generic", state, 3);
    expect([framesOf(still, "volume", state), state]).toEqual([1, before]);
  });
});
