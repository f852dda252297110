/** Light field: a view between the cameras, shifted by what lies in focus. Twin of `hmkcta.render.lightfield`. */

import type { Decoder } from "../gpu/decoder";
import { Pass } from "../gpu/pass";
import type { Axis, Metadata } from "../reader/metadata";
import type { State } from "../state";
import { Grids } from "./grid";
import { type Layout, channelsAt, layOut } from "./layout";
import { partSeen } from "./part";
import type { Progress, Renderer, Side } from "./renderer";

const MOST_CAMERAS = 256;

/** Positions in steps of the camera grid, and the indices of the view axes of each. */
export interface Cameras {
  place: [number, number][]; // row, column
  index: number[][];
  regular: boolean; // a full grid, numbered row by row
  last: [number, number];
}

/** Where the cameras stand. */
export function findCameras(axes: Axis[], layout: Layout): Cameras {
  const views = layout.views.map((n) => axes[n]!);
  const [first, second] = views;
  let place: [number, number][];
  let index: number[][];
  if (second !== undefined) {
    place = Array.from({ length: first!.size * second.size }, (_, i) => [Math.floor(i / second.size), i % second.size]);
    index = place;
  } else {
    const { size, coords } = first!;
    index = Array.from({ length: size }, (_, i) => [i]);
    if (coords?.width === 2) {
      place = inSteps(Array.from({ length: size }, (_, i) => [coords.values[2 * i]!, coords.values[2 * i + 1]!]));
    } else {
      const side = Math.round(Math.sqrt(size));
      const columns = side * side === size ? side : size;
      place = Array.from({ length: size }, (_, i) => [Math.floor(i / columns), i % columns]);
    }
  }
  const last: [number, number] = [Math.max(...place.map(([row]) => row)), Math.max(...place.map(([, column]) => column))];
  const columns = last[1] + 1;
  const regular = place.length === (last[0] + 1) * columns
    && place.every(([row, column], i) => row === Math.floor(i / columns) && column === i % columns);
  return { place, index, regular, last };
}

/** Coordinates from 0 in units of their smallest step. */
function inSteps(places: [number, number][]): [number, number][] {
  const sides = [0, 1] as const;
  const low = sides.map((k) => Math.min(...places.map((place) => place[k])));
  const moved = places.map(([row, column]): [number, number] => [row - low[0]!, column - low[1]!]);
  const steps = sides.flatMap((k) => {
    const along = [...new Set(moved.map((place) => place[k]))].sort((a, b) => a - b);
    return along.slice(1).map((value, i) => value - along[i]!);
  }).filter((step) => step > 1e-9);
  const step = steps.length > 0 ? Math.min(...steps) : 1;
  const whole = (value: number): number => (Math.abs(value - Math.round(value)) < 1e-4 ? Math.round(value) : value);
  return moved.map(([row, column]) => [whole(row / step), whole(column / step)]);
}

/** The cameras that a view needs, with weights and shifts (y, x). */
export function aim(cameras: Cameras, view: State["view"]): { camera: number; weight: number; shift: [number, number] }[] {
  const offsets = cameras.place.map(([row, column]): [number, number] => [row - view.row, column - view.column]);
  const weights = offsets.map(([row, column]) => (view.aperture > 0 || !cameras.regular
    ? Math.max(0, 1 - Math.hypot(row, column) / (view.aperture + 1))
    : Math.max(0, 1 - Math.abs(row)) * Math.max(0, 1 - Math.abs(column))));
  if (!weights.some((weight) => weight > 0)) {
    const distances = offsets.map(([row, column]) => Math.hypot(row, column));
    weights[distances.indexOf(Math.min(...distances))] = 1;
  }
  const total = weights.reduce((sum, weight) => sum + weight, 0);
  return weights.flatMap((weight, camera) => (weight > 0
    ? [{ camera, weight: weight / total, shift: offsets[camera]!.map((offset) => view.focus * offset) as [number, number] }]
    : []));
}

export class LightfieldRenderer implements Renderer {
  readonly notes: string[] = [];
  private readonly table: GPUBuffer;

  private constructor(
    private readonly device: GPUDevice, private readonly pass: Pass, private readonly layout: Layout,
    private readonly cameras: Cameras, private readonly grids: Grids,
  ) {
    this.table = device.createBuffer({
      size: 16 * MOST_CAMERAS, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST,
    });
  }

  static async make(device: GPUDevice, metadata: Metadata, decoders: Decoder[]): Promise<LightfieldRenderer> {
    const layout = layOut(metadata.axes, "lightfield");
    const cameras = findCameras(metadata.axes, layout);
    const pass = await Pass.make(device, {
      entry: "shade_lightfield", struct: "LightfieldFrame", shaders: ["lightfield"],
      bindings: ["storage", "texture-3d", "store-2d"],
    });
    return new LightfieldRenderer(device, pass, layout, cameras, await Grids.make(device, decoders, [...layout.views, ...layout.space, layout.channel]));
  }

  draw(side: Side, slot: 0 | 1, state: State, target: GPUTexture, budget: number): Progress {
    const { layout, cameras } = this;
    const { axes } = side.decoder.metadata;
    const aimed = aim(cameras, state.view).sort((a, b) => b.weight - a.weight).slice(0, MOST_CAMERAS);
    const [y, x] = layout.space as [number, number];
    const groups = aimed.map(({ camera }) => channelsAt(layout, state.position).map((channel) => {
      const index = state.position.map((place, n) => (n === x || n === y || n === layout.time ? 0 : place));
      layout.views.forEach((axis, k) => {
        index[axis] = cameras.index[camera]![k]!;
      });
      if (layout.channel !== null) {
        index[layout.channel] = channel;
      }
      return index;
    }));
    const cache = this.grids.cache(side.decoder, slot);
    const time = layout.time === null ? null : { axis: layout.time, at: state.time };
    const shifted = Math.max(...aimed.flatMap(({ shift }) => shift.map(Math.abs)));
    const { rows, columns, step, scale, offsetY, offsetX } = partSeen(axes[y]!.size, axes[x]!.size, target, state, shifted + 1);
    const { first, progress } = cache.fill({ level: side.level, x, y, rows, columns, time, groups }, budget);
    const total = aimed.reduce((sum, { weight }) => sum + weight, 0);
    this.device.queue.writeBuffer(this.table, 0, Float32Array.from(
      aimed.flatMap(({ weight, shift }, i) => [weight / total, shift[0] / step, shift[1] / step, first[i]!])));
    this.pass.run({
      width: target.width, height: target.height, cameras: aimed.length, channels: layout.channels.length, rows: rows.count,
      columns: columns.count, scale, offset_y: offsetY, offset_x: offsetX,
    }, [this.table, cache.texture!, target], [target.width, target.height, 1]);
    return progress;
  }

  destroy(): void {
    this.pass.destroy();
    this.table.destroy();
    this.grids.destroy();
  }
}
