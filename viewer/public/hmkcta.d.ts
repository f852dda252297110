/** Types of hmkcta.js: read .hmk files and decode them, on the CPU or in a shader of one's own (docs/web.md). */

/** One index, which counts from the end if it is negative; `[from, to]`, without the latter; `null`: the whole axis. */
export type Index = number | readonly [from: number, to: number] | null;

export interface Slice {
  /** Sizes of the axes that were not given one index. */
  shape: number[];
  /** The last axis runs fastest. */
  values: Float32Array<ArrayBuffer>;
}

export interface Axis {
  name: string;
  size: number;
  role: "space" | "view" | "light" | "time" | "channel" | "other";
  /** `width` numbers an index; 0: one number each. */
  coords: { values: Float64Array | Float32Array; width: number } | null;
  unit: string;
}

/** Of one level and those above it, in source values. */
export interface LevelQuality {
  snrDb: number;
  rmse: number;
  maxAbsError: number;
}

export interface Model {
  /** Sizes of the axes. */
  readonly shape: readonly number[];
  readonly axes: readonly Axis[];
  readonly kind: "svbrdf" | "lightfield" | "volume" | "generic";
  /** Levels that the file has, and those whose numbers are there. */
  readonly levels: number;
  arrived: number;
  readonly quality: readonly LevelQuality[];
  /** One element, of the first `level` levels: of all that have arrived, if none are named. */
  at(index: readonly number[], level?: number): number;
  slice(index: readonly Index[], level?: number): Slice;
  onGpu(device: GPUDevice): OnGpu;
}

export interface OnGpu {
  /** WGSL to put before a shader of one's own: `decode_element(index: array<u32, AXES>, stages: u32) -> f32`. */
  readonly code: string;
  /** Of group 0. */
  readonly layout: GPUBindGroupLayout;
  /** Bytes on the GPU. */
  readonly bytes: number;
  /** What to bind as group 0 for so many levels: without a number, for all that had arrived when this was made. */
  group(levels?: number): GPUBindGroup;
  destroy(): void;
}

/** For `instanceof`; models come from `open`. */
export declare const Model: { readonly prototype: Model; [Symbol.hasInstance](value: unknown): value is Model };

/** A file that is damaged, incomplete, newer or no .hmk file. */
export declare class HmkError extends Error {
  private constructor();
  /** A code of docs/format.md, section 8. */
  readonly reason: string;
}

/** A file that could not be fetched, or a source that is nothing to read. */
export declare class Problem extends Error {
  private constructor();
  readonly sentence: string;
}

/** What is told of a level as soon as its numbers are there; the next one waits for what it returns. */
export type LevelListener = (model: Model, level: number) => void | Promise<void>;

/** The largest sizes taken (docs/format.md, section 7). */
export interface Limits {
  order: number;
  axes: number;
  elements: number;
  levels: number;
  nodes: number;
  clusters: number;
  mixture: number;
  rank: number;
  level_cost: number;
  widened: number;
  json_bytes: number;
  json_depth: number;
  json_string: number;
}

/** Of files that are trusted `limits` may let pass more than usual. */
export declare function open(
  source: string | URL | Blob | BufferSource, onLevel?: LevelListener, limits?: Partial<Limits>): Promise<Model>;
