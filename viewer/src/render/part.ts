/**
 * The part of a picture that is decoded: all of it, unless it is larger than a texture. Then it is what is seen, and
 * every k-th element of that where it is shown so small that all of them would not fit.
 */

import type { State } from "../state";

const [LEAST_ZOOM, MOST_ZOOM] = [0.2, 200];
export const MOST = 2048; // samples of a side: WebGPU promises no larger 3D textures
const TILE = MOST / 4; // parts begin at multiples of it, so that a small step decodes nothing

/** Samples of an axis: `count` elements from `first` on, each of which stands for the `step` around it. */
export interface Span {
  start: number; // of the elements that the first sample stands for
  first: number;
  step: number;
  count: number;
}

/** Where a picture of rows x columns lies in a frame: pixels of it a frame pixel, and those at the first one's centre. */
interface Place {
  scale: number;
  offsetY: number;
  offsetX: number;
}

/** A part of a picture, and where its samples lie in a frame. */
export interface Part extends Place {
  rows: Span;
  columns: Span;
  step: number;
}

export function fitted(rows: number, columns: number, width: number, height: number, state: State): Place {
  const scale = Math.max(rows / height, columns / width) / state.zoom;
  return {
    scale, offsetY: (rows - 1) / 2 - (scale * (height - 1)) / 2 - state.pan[1],
    offsetX: (columns - 1) / 2 - (scale * (width - 1)) / 2 - state.pan[0],
  };
}

/** Show a picture of rows x columns so many times as large; what is at a place of the frame, from 0 to 1, stays there. */
export function zoomAbout(
  place: [x: number, y: number], factor: number, [rows, columns]: [number, number], [width, height]: [number, number], state: State,
): void {
  const before = fitted(rows, columns, width, height, state).scale;
  state.zoom = Math.min(MOST_ZOOM, Math.max(LEAST_ZOOM, state.zoom * factor));
  const more = fitted(rows, columns, width, height, state).scale - before;
  state.pan = [state.pan[0] + more * (place[0] - 0.5) * width, state.pan[1] + more * (place[1] - 0.5) * height];
}

/** Samples of an axis with so many elements, from an element that is seen on. */
function spanned(size: number, step: number, seen = 0): Span {
  const whole = Math.ceil(size / step) <= MOST;
  const start = whole ? 0 : Math.max(0, Math.floor(seen / step / TILE)) * TILE * step;
  const first = Math.min(start + Math.floor((step - 1) / 2), size - 1);
  return { start, first, step, count: Math.min(MOST, Math.floor((size - 1 - first) / step) + 1) };
}

/** All of an axis, if need be every k-th element. */
export function wholeSpan(size: number): Span {
  return spanned(size, Math.ceil(size / MOST));
}

/** What a frame shows of a picture of rows x columns, and `margin` elements beside it. */
export function partSeen(
  rows: number, columns: number, frame: { width: number; height: number }, state: State, margin = 0,
): Part {
  const { scale, offsetY, offsetX } = fitted(rows, columns, frame.width, frame.height, state);
  const seen = (offset: number, pixels: number, size: number): [number, number] => {
    const low = Math.min(size - 1, Math.max(0, offset - scale / 2 - margin));
    return [low, Math.max(low, Math.min(size, offset + scale * pixels + margin))];
  };
  const [down, across] = [seen(offsetY, frame.height, rows), seen(offsetX, frame.width, columns)];
  const fits = (size: number, [low, high]: [number, number], step: number): boolean =>
    Math.ceil(size / step) <= MOST || (high - low) / step <= MOST - TILE;
  let step = 1;
  while (!fits(rows, down, step) || !fits(columns, across, step)) {
    step *= 2;
  }
  const [y, x] = [spanned(rows, step, down[0]), spanned(columns, step, across[0])];
  const among = (offset: number, { start }: Span): number => (offset - start - (step - 1) / 2) / step;
  return { rows: y, columns: x, step, scale: scale / step, offsetY: among(offsetY, y), offsetX: among(offsetX, x) };
}
