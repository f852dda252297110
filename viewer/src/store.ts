/** All that the page shows of a model as one state, and the one function that makes the next one of it. */

import type { ValueRange } from "./decode/element";
import { carryPlaces, framesOf, resetView, startPlaces } from "./places";
import type { FileKind, Metadata } from "./reader/metadata";
import { findCameras } from "./render/lightfield";
import { layOut } from "./render/layout";
import { isCoded } from "./render/white";
import { ownGain, ownWhite, startWindow } from "./render/window";
import { MOST_LIGHTS, MOST_STOPS, type State, newState } from "./state";

/** A picture on the canvas. */
export interface Drawn {
  kind: FileKind;
  state: State;
  whole: boolean; // nothing of it is missing
  width: number;
  height: number;
  milliseconds: number;
}

/** Every figure on the page is a function of this (`figures.ts`). It is frozen: `reduced` makes the next one. */
export interface Shown {
  name: string; // of the file
  metadata: Metadata;
  kind: FileKind; // that it is shown as
  state: State; // what is chosen
  arrived: number; // levels that are there
  range: ValueRange | null; // of the values; null: not measured yet
  original: boolean; // whether there is one
  mesh: boolean; // likewise, of the user's
  playing: boolean;
  drawn: Drawn | null; // what the canvas shows
  share: number; // of the chosen picture, decoded; 1 where the canvas shows it
  saving: number | null; // of a picture that is saved, decoded
}

export type Action =
  | { type: "choose"; choose: (state: State) => void } // by a control, a key or the pointer
  | { type: "arrive" }
  | { type: "show-as"; kind: FileKind }
  | { type: "original" }
  | { type: "mesh" }
  | { type: "range"; range: ValueRange }
  | { type: "play"; playing: boolean }
  | { type: "share"; share: number }
  | { type: "saving"; saving: number | null }
  | { type: "drawn"; drawn: Drawn }
  | { type: "restore"; state: State };

export function firstShown(name: string, metadata: Metadata): Shown {
  const state = newState(metadata.axes.length);
  startPlaces(state, metadata.axes);
  return settled({
    name, metadata, kind: "generic", state, arrived: 0, range: null, original: false, mesh: false, playing: false, drawn: null, share: 1,
    saving: null,
  });
}

/** The state after an action. */
export function reduced(shown: Shown, action: Action): Shown {
  switch (action.type) {
    case "choose":
      return settled(shown, action.choose);
    case "arrive": // the next level is shown unless another one was chosen
      return settled({ ...shown, arrived: shown.arrived + 1 }, (state) => {
        state.level += shown.state.level >= shown.arrived ? 1 : 0;
      });
    case "show-as":
      return settled({ ...shown, kind: action.kind }, (state) => {
        const { metadata: { axes }, arrived, kind } = shown;
        resetView(state, axes, action.kind);
        carryPlaces(state, axes, arrived === 0 ? action.kind : kind, action.kind);
      });
    case "original":
      return settled({ ...shown, original: true }, (state) => {
        state.compare.level = null;
      });
    case "mesh":
      return settled({ ...shown, mesh: true }, (state) => {
        state.surface.shape = "mesh";
      });
    case "range":
      return settled({ ...shown, range: action.range });
    case "restore":
      return settled({ ...shown, state: action.state, share: 1 });
    case "play":
      return { ...shown, playing: action.playing && framesOf(shown.metadata.axes, shown.kind, shown.state) > 1 };
    case "share":
      return { ...shown, share: action.share };
    case "saving":
      return { ...shown, saving: action.saving };
    case "drawn": { // perhaps while something else was chosen
      const { drawn } = action;
      return { ...shown, drawn, share: drawn.whole && drawn.state === shown.state && drawn.kind === shown.kind ? 1 : shown.share };
    }
  }
}

function clamped(value: number, low: number, high: number): number {
  return Math.min(high, Math.max(low, value));
}

/** Something chosen, brought into what there is, and what is the file's own found anew; the same state where that changes nothing. */
function settled(shown: Shown, choose: (state: State) => void = () => undefined): Shown {
  const state = structuredClone(shown.state);
  choose(state);
  bringInto(state, shown);
  takeOwn(state, { ...shown, state });
  const same = JSON.stringify(state) === JSON.stringify(shown.state);
  const share = same || shown.share === 1 ? shown.share : 0; // of another picture by now
  return { ...shown, share, state: frozen(same ? shown.state : state), playing: shown.playing && framesOf(shown.metadata.axes, shown.kind, state) > 1 };
}

/** Hold all that is chosen to what there is. */
function bringInto(made: State, { metadata: { axes, levels }, arrived, kind, original }: Shown): void {
  const { compare, tone, volume, view, camera } = made;
  made.level = clamped(Math.round(made.level), 1, Math.max(1, arrived));
  compare.mode = original || levels.length > 1 ? compare.mode : "none";
  compare.level = compare.level === null ? (original ? null : 1) : clamped(compare.level, 1, Math.max(1, arrived));
  compare.position = clamped(compare.position, 0, 1);
  made.position = made.position.map((at, n) => clamped(Math.round(at), 0, axes[n]!.size - 1));
  made.time = clamped(made.time, 0, Math.max(0, (axes.find(({ role }) => role === "time")?.size ?? 1) - 1));
  tone.stops = clamped(tone.stops, -MOST_STOPS, MOST_STOPS);
  camera.elevation = clamped(camera.elevation, -89.9, 89.9);
  made.lights = made.lights.slice(0, MOST_LIGHTS);
  made.light = clamped(made.light, 0, made.lights.length - 1);
  made.lights.forEach((light) => {
    light.elevation = clamped(light.elevation, -90, 90);
  });
  if (kind === "lightfield") {
    const { last } = findCameras(axes, layOut(axes, kind));
    [view.row, view.column] = [clamped(view.row, 0, last[0]), clamped(view.column, 0, last[1])];
  }
  volume.clipHigh = volume.clipHigh.map((high) => clamped(high, 0.01, 1)) as State["volume"]["clipHigh"];
  volume.clipLow = volume.clipLow.map((low, n) => clamped(low, 0, volume.clipHigh[n]! - 0.01)) as State["volume"]["clipLow"];
}

/** White, windows and the error's amplification, unless they were chosen. */
function takeOwn(state: State, shown: Shown): void {
  const { own } = state;
  state.surface.coded = own.coded ? isCoded(shown.metadata.sourceDtype) : state.surface.coded;
  if (shown.range !== null) {
    state.tone.white = own.white ? ownWhite(shown, shown.range) : state.tone.white;
    Object.assign(state.slice, own.slice ? startWindow(shown, shown.range, "slice") : {});
    Object.assign(state.volume, own.volume ? startWindow(shown, shown.range, "volume") : {});
    state.compare.gain = own.gain ? ownGain(shown) : state.compare.gain;
  }
}

/** Whatever changes a state elsewhere is an error. */
function frozen<Value>(value: Value): Value {
  if (typeof value === "object" && value !== null && !Object.isFrozen(value)) {
    Object.values(Object.freeze(value)).forEach(frozen);
  }
  return value;
}
