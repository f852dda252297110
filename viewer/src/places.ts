/** Where a model is on its axes: at first, and when it is shown as something else. */

import type { Axis, FileKind } from "./reader/metadata";
import { findCameras } from "./render/lightfield";
import { asDrawn, layOut } from "./render/layout";
import type { State } from "./state";

const CAMERAS = { svbrdf: [20, 20, 3.4], volume: [30, 25, 5.4], plane: [0, 0, 3.6], cloth: [20, 38, 5.3] } as const;

/** The camera, view point and zoom that suit what is shown. */
export function resetView(state: State, axes: Axis[], kind: FileKind): void {
  const { shape } = state.surface;
  const [azimuth, elevation, distance] = CAMERAS[kind === "volume" ? "volume" : shape === "plane" || shape === "cloth" ? shape : "svbrdf"];
  state.camera = { azimuth, elevation, distance, fov: 38, target: [0, 0, 0] };
  state.zoom = 1;
  state.pan = [0, 0];
  if (kind === "lightfield") {
    const { last } = findCameras(axes, layOut(axes, "lightfield"));
    Object.assign(state.view, { row: last[0] / 2, column: last[1] / 2 });
  }
}

/** Begin in the middle of all axes, with two of them as a picture. */
export function startPlaces(state: State, axes: Axis[]): void {
  const { slice } = state;
  state.position = axes.map(({ role, size }) => (role === "channel" && size === 2 ? 0 : Math.floor(size / 2)));
  const size = (n: number): number => axes[n]?.size ?? 1;
  const space = axes.flatMap((axis, n) => (axis.role === "space" ? [n] : []));
  const rest = axes.map((_, n) => n).sort((a, b) => size(b) - size(a));
  const chosen = space.length >= 2 ? asDrawn(axes, space).slice(-2) : [...new Set([...space, ...rest])].slice(0, 2).sort((a, b) => a - b);
  [slice.y, slice.x] = [chosen[0] ?? 0, chosen[1] ?? chosen[0] ?? 0];
  slice.colour = axes.some((axis) => axis.role === "channel" && axis.size > 2);
}

/** Have slices stand at the frame and the camera that were shown, and what they become at those of the slices. */
export function carryPlaces(state: State, axes: Axis[], from: FileKind, to: FileKind): void {
  if (from !== "generic" && to === "generic") {
    for (const [n, index] of standing(state, axes, from)) {
      state.position[n] = index;
    }
  } else if (from === "generic" && to !== "generic") {
    const { time, views } = layOut(axes, to);
    if (time !== null && Math.round(state.time) !== state.position[time]) { // else it stays between two frames
      state.time = state.position[time]!;
    }
    if (to === "lightfield") {
      const { place, index } = findCameras(axes, layOut(axes, to));
      const camera = index.findIndex((each) => each.every((at, i) => at === state.position[views[i]!]));
      [state.view.row, state.view.column] = place[camera]!;
    }
  }
}

/** The frames that can be shown one after another: one where there is no time, or slices show all of it as a picture. */
export function framesOf(axes: Axis[], kind: FileKind, { slice }: State): number {
  const n = timeAxis(axes);
  return n < 0 || (kind === "generic" && (n === slice.x || n === slice.y)) ? 1 : axes[n]!.size;
}

/** The frame that is shown; slices stand at one as on any other axis. */
export function frameOf(axes: Axis[], kind: FileKind, state: State): number {
  return kind === "generic" ? state.position[timeAxis(axes)] ?? 0 : state.time;
}

/** Show another frame, the nearest that there is. */
export function showFrame(axes: Axis[], kind: FileKind, state: State, frame: number): void {
  const shown = Math.min(framesOf(axes, kind, state) - 1, Math.max(0, frame));
  if (kind !== "generic") {
    state.time = shown;
  } else if (framesOf(axes, kind, state) > 1) {
    state.position[timeAxis(axes)] = shown;
  }
}

function timeAxis(axes: Axis[]): number {
  return axes.findIndex((axis) => axis.role === "time");
}

/** The nearest index on each axis that a kind moves along by something else than `position`. */
function standing(state: State, axes: Axis[], kind: Exclude<FileKind, "generic">): [axis: number, index: number][] {
  const layout = layOut(axes, kind);
  const frame: [number, number][] = layout.time === null ? [] : [[layout.time, Math.round(state.time)]];
  if (kind !== "lightfield") {
    return frame;
  }
  const { place, index } = findCameras(axes, layout);
  const distances = place.map(([row, column]) => Math.hypot(row - state.view.row, column - state.view.column));
  const nearest = index[distances.indexOf(Math.min(...distances))]!;
  return [...frame, ...layout.views.map((n, i): [number, number] => [n, nearest[i]!])];
}
