/** Which part of a picture is decoded, and where it lies in a frame. */

import { expect, it } from "vitest";
import { MOST, type Part, fitted, partSeen, wholeSpan, zoomAbout } from "../src/render/part";
import { type State, newState } from "../src/state";

const FRAME = { width: 700, height: 500 };

function at(zoom: number, pan: [number, number] = [0, 0]): State {
  return Object.assign(newState(2), { zoom, pan });
}

/** The element in whose sample a pixel of the frame is, down or across. */
function shown({ scale, offsetX, offsetY, rows, columns }: Part, pixel: number, down: boolean): number {
  const { first, step, count } = down ? rows : columns;
  const sample = Math.floor((down ? offsetY : offsetX) + scale * pixel + 0.5);
  return sample < 0 || sample >= count ? NaN : first + sample * step;
}

it("is the whole picture where a texture holds it", () => {
  for (const state of [at(1), at(7, [300, -80])]) {
    const part = partSeen(1000, MOST, FRAME, state);
    expect(part).toMatchObject({ step: 1, ...fitted(1000, MOST, 700, 500, state) });
    expect([part.rows, part.columns]).toEqual([
      { start: 0, first: 0, step: 1, count: 1000 }, { start: 0, first: 0, step: 1, count: MOST }]);
  }
});

it.each([
  [2400, 2400, 1, [0, 0]], [3, 3000, 1, [0, 0]], [40, 3000, 3, [900, 0]], [375, 3000, 1, [0, 0]], [100_000, 100_000, 1, [0, 0]],
  [100_000, 100_000, 13, [-40_000, 2000]], [100_000, 100_000, 200, [49_000, -49_000]], [5000, 5000, 0.2, [0, 0]],
  [5000, 3, 1, [1e6, 1e6]], [2049, 2049, 1.3, [100, 100]],
] as const)("%i x %i elements, %d times as large, moved by %j, fit a texture and are where all of them would be", (rows, columns, zoom, pan) => {
  const state = at(zoom, [...pan]);
  const part = partSeen(rows, columns, FRAME, state);
  for (const [{ first, step, count }, size] of [[part.rows, rows], [part.columns, columns]] as const) {
    expect(count).toBeGreaterThan(0);
    expect(count).toBeLessThanOrEqual(MOST);
    expect(first).toBeGreaterThanOrEqual(0);
    expect(first + (count - 1) * step).toBeLessThan(size);
  }
  const whole = fitted(rows, columns, FRAME.width, FRAME.height, state);
  for (const [down, pixels, offset, size] of [[true, 500, whole.offsetY, rows], [false, 700, whole.offsetX, columns]] as const) {
    for (let pixel = 0; pixel < pixels; pixel += 7) {
      const element = Math.round(offset + whole.scale * pixel);
      if (element >= part.step && element < size - part.step) {
        expect(Math.abs(shown(part, pixel, down) - element)).toBeLessThan(part.step);
      }
    }
  }
});

it("decodes nothing anew for a small move, and each element where pixels are larger", () => {
  const spans = (state: State): unknown => {
    const { rows, columns } = partSeen(9000, 9000, FRAME, state);
    return [rows, columns];
  };
  expect(spans(at(1, [40, 40]))).toEqual(spans(at(1)));
  expect(spans(at(10, [4, 4]))).toEqual(spans(at(10)));
  expect(partSeen(9000, 9000, FRAME, at(20)).step).toBe(1);
});

it("has the elements beside what is seen, too, where views are shifted", () => {
  const { rows } = partSeen(9000, 9000, FRAME, at(40), 600);
  const { offsetY, scale } = fitted(9000, 9000, 700, 500, at(40));
  expect(rows.first).toBeLessThanOrEqual(offsetY - 600);
  expect(rows.first + (rows.count - 1) * rows.step).toBeGreaterThanOrEqual(offsetY + 500 * scale + 600);
});

it("takes every k-th element of a long side of a volume", () => {
  expect(wholeSpan(MOST)).toEqual({ start: 0, first: 0, step: 1, count: MOST });
  expect(wholeSpan(5000)).toEqual({ start: 0, first: 1, step: 3, count: 1667 });
});

it("zooms about a place, which stays where it is", () => {
  const state = at(1.5, [20, -7]);
  const element = (x: number, y: number): number[] => {
    const { scale, offsetX, offsetY } = fitted(300, 400, 700, 500, state);
    return [offsetX + scale * (700 * x - 0.5), offsetY + scale * (500 * y - 0.5)];
  };
  const before = element(0.9, 0.2);
  zoomAbout([0.9, 0.2], 3, [300, 400], [700, 500], state);
  expect(state.zoom).toBe(4.5);
  element(0.9, 0.2).forEach((each, i) => expect(each).toBeCloseTo(before[i]!, 9));
  zoomAbout([0.1, 0.1], 1e9, [300, 400], [700, 500], state);
  expect(state.zoom).toBe(200);
  const middle = structuredClone(state.pan);
  zoomAbout([0.5, 0.5], 0.5, [300, 400], [700, 500], state);
  expect(state.pan).toEqual(middle);
});
