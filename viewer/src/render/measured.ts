/** Measured directions of views and of lights: lists along one axis, or grids of the angles of two. */

import type { Still } from "../gpu/frameContraction";
import type { Metadata } from "../reader/metadata";
import { angleLists, anglesAt, interpolateAngle } from "./angles";
import { GRID, buildTable, directionsOf, interpolateDirection } from "./directions";
import type { Layout } from "./layout";
import { filledBuffer } from "./renderer";
import type { Vector } from "./vector";

export const NO_AXIS = 0xff;

/** Directions around one, the same at all pixels, by axis; and the height that they interpolate. */
export interface FixedDirection {
  taps: Still;
  height: number;
}

/** How the shader finds directions, and how the host does. */
interface Measured {
  axes: number[]; // zeniths before azimuths
  table: number[]; // first record, first grid entry, side, axis
  angles: number[][]; // of both axes first entry, entries (0: none), axis
  words: Uint32Array[];
  interpolate: (direction: Vector) => FixedDirection;
}

const NO_LIST = [[0, 0, NO_AXIS], [0, 0, NO_AXIS]];

export class Directions {
  readonly buffer: GPUBuffer;

  private constructor(device: GPUDevice, readonly views: Measured, readonly lights: Measured) {
    const parts = [...views.words, ...lights.words];
    const all = new Uint32Array(Math.max(4, parts.reduce((sum, part) => sum + part.length, 0)));
    parts.reduce((at, part) => (all.set(part, at), at + part.length), 0);
    this.buffer = filledBuffer(device, all, GPUBufferUsage.STORAGE);
  }

  /** Adds sentences on what had to be assumed to `notes`. */
  static make(device: GPUDevice, metadata: Metadata, layout: Layout, notes: string[]): Directions {
    const views = measured(metadata, layout.views, 0, notes);
    const start = views.words.reduce((sum, part) => sum + part.length / 4, 0);
    return new Directions(device, views, measured(metadata, layout.lights, start, notes));
  }

  get values(): Record<string, number[]> {
    const { views, lights } = this;
    return Object.fromEntries([
      ...[views, lights].map(({ table }, n) => [`tables[${n}]`, table] as const),
      ...[...views.angles, ...lights.angles].map((each, n) => [`angles[${n}]`, each] as const),
    ]);
  }

  /** Whether any directions lie on a grid of angles. */
  get gridded(): boolean {
    return this.views.axes.length > 1 || this.lights.axes.length > 1;
  }

  destroy(): void {
    this.buffer.destroy();
  }
}

function measured(metadata: Metadata, axes: number[], start: number, notes: string[]): Measured {
  const [one, two] = axes;
  if (one === undefined) {
    return { axes, table: [0, 0, GRID, NO_AXIS], angles: NO_LIST, words: [], interpolate: ([, , z]) => ({ taps: new Map(), height: z }) };
  }
  if (two !== undefined) {
    return grid(metadata, [one, two], start);
  }
  const { vectors, assumed } = directionsOf(metadata.axes[one]!);
  if (assumed) {
    notes.push(`${metadata.axes[one]!.name} has no directions as coordinates: a spiral from the zenith down to 75 degrees is assumed.`);
  }
  const table = buildTable(vectors);
  return {
    axes, table: [start, start + 4 * table.triangles, GRID, one], angles: NO_LIST, words: [table.words],
    interpolate: (direction) => {
      const { index, weight, height } = interpolateDirection(table, direction);
      return { taps: new Map([[one, { index, weight }]]), height };
    },
  };
}

function grid(metadata: Metadata, axes: [number, number], start: number): Measured {
  const lists = angleLists(metadata.axes, axes);
  const [zeniths, azimuths] = lists;
  const [least, most] = [zeniths.words, zeniths.words.subarray(4 * (zeniths.count - 1))].map((words) =>
    new Float32Array(words.buffer, words.byteOffset, 1)[0]!) as [number, number];
  return {
    axes: lists.map(({ axis }) => axis), table: [0, 0, GRID, NO_AXIS], words: lists.map(({ words }) => words),
    angles: [[start, zeniths.count, zeniths.axis], [start + zeniths.count, azimuths.count, azimuths.axis]],
    interpolate: (direction) => {
      const [zenith, azimuth] = anglesAt(direction);
      return {
        taps: new Map([[zeniths.axis, interpolateAngle(zeniths, zenith)], [azimuths.axis, interpolateAngle(azimuths, azimuth)]]),
        height: Math.cos(Math.min(most, Math.max(least, zenith))),
      };
    },
  };
}
