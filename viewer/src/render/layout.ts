/** Which source axes are lights, views, rows, columns, colours and frames: the twin of `hmkcta.render.layout`. */

import { Problem } from "../problem";
import type { Axis, FileKind, Role } from "../reader/metadata";

const NAMES = { svbrdf: "material", lightfield: "light field", volume: "volume" };

const DRAWN = ["z", "y", "x"]; // names that tell what axes are drawn as

export interface Layout {
  lights: number[]; // one axis of directions, or two of angles
  views: number[]; // likewise; of a light field cameras, or row and column of their grid
  time: number | null;
  space: number[]; // y, x, or z, y, x of a volume
  channel: number | null;
  channels: number[]; // indices shown as red, green, blue; one for grey
}

/** Find the axes of a kind's renderer by their roles; throws a sentence if they do not make this kind. */
export function layOut(axes: Axis[], kind: Exclude<FileKind, "generic">): Layout {
  const having = (role: Role): number[] => axes.flatMap((axis, n) => (axis.role === role ? [n] : []));
  const [lights, views] = [having("light"), having("view")];
  const wanted = kind === "volume" ? 3 : 2;
  const space = asDrawn(axes, having("space")).slice(-wanted);
  if (space.length < wanted) {
    throw new Problem(`A ${NAMES[kind]} needs ${wanted} axes of role space; this file has ${space.length}.`, "",
      "It is shown as slices.");
  }
  if (kind === "svbrdf" && (lights.length > 2 || views.length > 2)) {
    throw new Problem("A material has one or two axes of lights, and of views; this file has more.", "",
      "It is shown as slices.");
  }
  if (kind === "lightfield" && (views.length < 1 || views.length > 2)) {
    throw new Problem(`A light field needs one or two axes of role view; this file has ${views.length}.`, "",
      "It is shown as slices.");
  }
  const channel = kind === "volume" ? null : having("channel").find((n) => axes[n]!.size > 1) ?? null;
  return {
    space, channel, views: kind === "volume" ? [] : views, time: having("time")[0] ?? null,
    lights: kind === "svbrdf" ? lights : [],
    channels: channel === null ? [0] : shownChannels(axes[channel]!.size),
  };
}

/** Axes as they are drawn: slices, rows, columns. These are z, y and x where axes have these names, in whatever order a
 * file has them, else they are in array order. */
export function asDrawn(axes: Axis[], numbers: number[]): number[] {
  const place = (n: number): number => DRAWN.indexOf(axes[n]!.name.toLowerCase());
  const named = numbers.every((n) => place(n) >= 0);
  return [...numbers].sort((a, b) => (named && place(a) - place(b)) || a - b);
}

/** The channels that are shown where axes stand: one of two, in grey, is chosen like the place on any other axis. */
export function channelsAt({ channel, channels }: Layout, position: number[]): number[] {
  return channel !== null && channels.length === 1 ? [position[channel]!] : channels;
}

/** The first three of a colour, else long, middle and short end of a spectrum. */
export function shownChannels(size: number): number[] {
  if (size === 2) {
    return [0];
  }
  return size <= 4 ? [0, 1, 2] : [size - 1, Math.floor(size / 2), 0];
}

/** The two frames a time lies between, and the weight of the second. */
export function timeSteps(time: number, count: number): { frames: [number, number]; weight: number } {
  const first = Math.min(Math.floor(time), Math.max(count - 2, 0));
  return { frames: [first, Math.min(first + 1, count - 1)], weight: time - first };
}
