/** A product grid of directions: an axis of zeniths and one of azimuths. Twin of `hmkcta.render.angles`. */

import { Problem } from "../problem";
import type { Axis } from "../reader/metadata";
import type { Vector } from "./vector";

const TURN = 2 * Math.PI;
const AZIMUTH = /phi|azim/i;

/** The angles of an axis, ascending, in radians, with their indices: four words each, as the shader reads them. */
interface AngleList {
  axis: number;
  count: number;
  words: Uint32Array;
}

/** Of two axes of angles that of the zeniths first: the first one, unless its name says azimuth. */
export function zenithFirst(axes: Axis[], numbers: number[]): number[] {
  return numbers.length === 2 && AZIMUTH.test(axes[numbers[0]!]!.name) ? [...numbers].reverse() : numbers;
}

/** Zeniths and azimuths of two axes with one angle an index. */
export function angleLists(axes: Axis[], numbers: [number, number]): [AngleList, AngleList] {
  const [zenith, azimuth] = zenithFirst(axes, numbers) as [number, number];
  const down = anglesOf(axes[zenith]!);
  if (down.some((angle) => angle < 0 || Math.cos(angle) < -0.2)) {
    throw new Problem(`The coordinates of ${axes[zenith]!.name} are no zenith angles above the surface.`, "", "It is shown as slices.");
  }
  const rising = down.map((angle, index): [number, number] => [Math.min(angle, Math.PI / 2), index]).sort(ascending);
  const around = anglesOf(axes[azimuth]!).map((angle, index): [number, number] => [((angle % TURN) + TURN) % TURN, index]).sort(ascending);
  const [[first, after], [last, before]] = [around[0]!, around.at(-1)!];
  return [
    { axis: zenith, ...listed(rising.length > 1 ? rising : [...rising, ...rising]) },
    { axis: azimuth, ...listed([[last - TURN, before], ...around, [first + TURN, after]]) }, // one more at either end
  ];
}

/** The two angles of a list around one, as indices of its axis, with their weights. */
export function interpolateAngle({ count, words }: AngleList, angle: number): { index: number[]; weight: number[] } {
  const floats = new Float32Array(words.buffer);
  let low = 0;
  while (low < count - 2 && floats[4 * (low + 1)]! <= angle) {
    low += 1;
  }
  const first = floats[4 * low]!;
  const share = Math.min(1, Math.max(0, (angle - first) / Math.max(floats[4 * low + 4]! - first, 1e-6)));
  return { index: [words[4 * low + 1]!, words[4 * low + 5]!], weight: [1 - share, share] };
}

/** Zenith and azimuth of a local direction, 0 to a turn. */
export function anglesAt([x, y, z]: Vector): [number, number] {
  const azimuth = Math.atan2(y, x);
  return [Math.atan2(Math.hypot(x, y), z), azimuth < 0 ? azimuth + TURN : azimuth];
}

function ascending([a, i]: [number, number], [b, j]: [number, number]): number {
  return a - b || i - j;
}

function listed(entries: [number, number][]): { count: number; words: Uint32Array } {
  const words = new Uint32Array(4 * entries.length);
  const floats = new Float32Array(words.buffer);
  entries.forEach(([angle, index], n) => {
    floats[4 * n] = angle;
    words[4 * n + 1] = index;
  });
  return { count: entries.length, words };
}

function anglesOf({ name, coords, unit }: Axis): number[] {
  if (coords === null || coords.width !== 0) {
    throw new Problem(`The axis ${name} has no angles as coordinates.`,
      "Of two axes of lights, or of views, one has zeniths and the other one azimuths.", "It is shown as slices.");
  }
  const scale = unit.toLowerCase().includes("deg") ? Math.PI / 180 : 1;
  return Array.from(coords.values, (angle) => scale * angle);
}
