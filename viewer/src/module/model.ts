/** A file as an array: elements and slices by their indices, decoded when they are asked for. */

import { axisPlaces, decodeRows, sourceValue } from "../decode/element";
import { type Axis, type FileKind, type LevelQuality, levelEnds } from "../reader/metadata";
import type { Reading } from "../reader/read";
import { OnGpu } from "./onGpu";
import { shown } from "./shown";

/** One index, which counts from the end if it is negative; `[from, to]`, without the latter; `null`: the whole axis. */
export type Index = number | readonly [from: number, to: number] | null;

export interface Slice {
  /** Sizes of the axes that were not given one index. */
  shape: number[];
  /** The last axis runs fastest. */
  values: Float32Array<ArrayBuffer>;
}

export class Model {
  /** Levels whose numbers are there. */
  arrived = 0;
  /** Sizes of the axes. */
  readonly shape: readonly number[];
  private readonly places: { mode: number; stride: number }[];

  constructor(private readonly reading: Reading) {
    this.shape = this.axes.map((axis) => axis.size);
    this.places = axisPlaces(reading.metadata);
  }

  /** Name, size, role, coordinates and unit of every axis. */
  get axes(): readonly Axis[] {
    return this.reading.metadata.axes;
  }

  get kind(): FileKind {
    return this.reading.metadata.kind;
  }

  /** Levels that the file has. */
  get levels(): number {
    return this.reading.metadata.levels.length;
  }

  /** SNR in dB and errors up to each level. */
  get quality(): readonly LevelQuality[] {
    return this.reading.metadata.quality;
  }

  /** One element, of the first `level` levels. */
  at(index: readonly number[], level = this.arrived): number {
    return this.decode(this.ranges(index, false), level)[0]!;
  }

  /** Some elements. */
  slice(index: readonly Index[], level = this.arrived): Slice {
    const ranges = this.ranges(index, true);
    const shape = ranges.map(([from, to]) => to - from).filter((_, axis) => typeof index[axis] !== "number");
    return { shape, values: this.decode(ranges, level) };
  }

  /** The numbers of the levels that have arrived on a GPU, and the WGSL that decodes them there. */
  onGpu(device: GPUDevice): OnGpu {
    return new OnGpu(device, this.reading);
  }

  /** Elements of some ranges, the last axis fastest. */
  private decode(ranges: [from: number, to: number][], level: number): Float32Array<ArrayBuffer> {
    const stages = levelEnds(this.reading.metadata)[this.checkedLevel(level) - 1]!;
    const shape = ranges.map(([from, to]) => to - from);
    const values = new Float32Array(shape.reduce((count, size) => count * size, 1));
    const rows = new Array<number>(this.reading.metadata.modeSizes.length).fill(0);
    const { transform } = this.reading.metadata;
    for (let at = 0; at < values.length; at += 1) {
      rows.fill(0);
      for (let axis = ranges.length - 1, flat = at; axis >= 0; axis -= 1) {
        const { mode, stride } = this.places[axis]!;
        rows[mode]! += (ranges[axis]![0] + flat % shape[axis]!) * stride;
        flat = Math.floor(flat / shape[axis]!);
      }
      values[at] = sourceValue(decodeRows(this.reading.stages, rows, stages), transform);
    }
    return values;
  }

  /** What an index says of each axis; only where `several` may it be more than one place. */
  private ranges(index: readonly Index[], several: boolean): [from: number, to: number][] {
    const names = this.axes.map((axis) => axis.name).join(", ");
    if (!Array.isArray(index)) {
      throw new RangeError(`index: ${shown(index)}; allowed: an array of ${this.axes.length}, one an axis (${names})`);
    }
    if (index.length !== this.axes.length) {
      throw new RangeError(`${index.length} indices; allowed: ${this.axes.length}, one an axis (${names})`);
    }
    return this.axes.map(({ name, size }, axis) => {
      const each = index[axis] as Index;
      if (several && each === null) {
        return [0, size];
      }
      if (several && Array.isArray(each) && each.length === 2) {
        const [from, to] = [bounded(`start of ${name}`, each[0], size, size), bounded(`end of ${name}`, each[1], size, size)];
        return [from, Math.max(from, to)];
      }
      const from = bounded(`index of ${name}`, each, size, size - 1, several ? ", [from, to] or null" : "");
      return [from, from + 1];
    });
  }

  private checkedLevel(level: number): number {
    if (!Number.isInteger(level) || level < 1 || level > this.arrived) {
      throw new RangeError(`level ${level}; allowed: 1 to ${this.arrived}, of which the numbers are there`);
    }
    return level;
  }
}

/** An index from the start of an axis. */
function bounded(what: string, index: unknown, size: number, most: number, or = ""): number {
  const found = typeof index === "number" && index < 0 ? index + size : index;
  if (typeof found !== "number" || !Number.isInteger(found) || found < 0 || found > most) {
    throw new RangeError(`${what}: ${shown(index)}; allowed: whole numbers from ${-size} to ${most}${or}`);
  }
  return found;
}
