/**
 * Decoded elements in a 3D texture: pictures of cameras, slices of a volume. What a frame needs is decoded once and
 * kept for as long as level, time and axes stay; a large request is decoded over several frames.
 */

import { FrameContraction, type Still, contractedModes } from "../gpu/frameContraction";
import type { Decoder } from "../gpu/decoder";
import { Pass } from "../gpu/pass";
import { pickedPrelude } from "../gpu/picked";
import { pickedFiles } from "../gpu/shaders";
import { timeSteps } from "./layout";
import type { Span } from "./part";
import type { Progress } from "./renderer";

const NO_AXIS = 0xff;

/** Which elements: for each group (a camera, a z) its slices, each an index of every source axis. */
interface GridRequest {
  level: number;
  x: number; // axis numbers
  y: number | null; // null: all rows are the same
  rows: Span; // of the axis y
  columns: Span;
  time: { axis: number; at: number } | null;
  groups: number[][][];
}

/** How a model's grids are decoded: the shader, and the modes that it finds contracted. */
interface GridShader {
  pass: Pass;
  frame: FrameContraction;
  still: number[]; // axes that stand still in all requests, time aside
}

/** The shader that decodes grids along some axes; modes of which none moves are contracted for each frame. */
async function gridShader(device: GPUDevice, decoder: Decoder, moving: (number | null)[]): Promise<GridShader> {
  const { metadata } = decoder;
  const picks = metadata.axes.map((axis) => (axis.role === "time" ? 2 : 1));
  const still = metadata.axes.flatMap((_, axis) => (moving.includes(axis) ? [] : [axis]));
  const options = { picks, contracted: contractedModes(decoder, still) };
  const frame = new FrameContraction(device, decoder, options);
  const head = pickedPrelude(decoder.tree, decoder.pages, options);
  const [pass] = await Promise.all([
    Pass.make(device, {
      entry: "decode_grid", struct: "GridFrame", decoder: frame.layout, head, shaders: pickedFiles(head, "grid"),
      bindings: ["storage", "store-3d"],
    }),
    frame.compile(),
  ]);
  return { pass, frame, still };
}

class GridCache {
  texture: GPUTexture | null = null;
  private slots: GPUBuffer | null = null;
  private key = "";
  private held: (string | null)[] = []; // what each slot has decoded

  constructor(private readonly device: GPUDevice, private readonly decoder: Decoder, private readonly shader: GridShader) {}

  /**
   * Decode up to `budget` missing elements of a request (at least one group). Returns the first slice of each group,
   * and how far it is.
   */
  fill(request: GridRequest, budget: number): { first: number[]; progress: Progress } {
    const [width, height] = [request.columns.count, request.rows.count];
    const each = request.groups[0]?.length ?? 1;
    const wanted = request.groups.map((group) => group.flat().join());
    const key = JSON.stringify([request.level, request.x, request.y, request.rows, request.columns, request.time, each]);
    const room = this.texture === null ? 0 : this.texture.depthOrArrayLayers / each;
    if (this.texture?.width !== width || this.texture.height !== height || room < wanted.length || room % 1 !== 0) {
      this.allocate(width, height, wanted.length, each);
    } else if (key !== this.key) {
      this.held.fill(null);
    }
    this.key = key;
    const places = this.place(wanted);
    let left = budget;
    let [there, decoded] = [0, 0];
    wanted.forEach((name, i) => {
      const slot = places[i]!;
      if (this.held[slot] === name) {
        there += 1;
        return;
      }
      if (left <= 0) {
        return;
      }
      there += 1;
      this.decode(request, request.groups[i]!, slot * each, width, height);
      this.held[slot] = name;
      left -= width * height * each;
      decoded += width * height * each;
    });
    return { first: places.map((slot) => slot * each), progress: { share: there / wanted.length, decoded } };
  }

  destroy(): void {
    this.texture?.destroy();
    this.slots?.destroy();
    this.texture = null;
  }

  /** No side is too long: pictures are parts of at most 2048, and groups at most 2048 slices of a volume or 256 cameras. */
  private allocate(width: number, height: number, groups: number, each: number): void {
    this.destroy();
    this.texture = this.device.createTexture({
      size: [width, height, groups * each], dimension: "3d", format: "r32float",
      usage: GPUTextureUsage.STORAGE_BINDING | GPUTextureUsage.TEXTURE_BINDING,
    });
    this.slots = this.device.createBuffer({
      size: 32 * groups * each, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST,
    });
    this.held = new Array<string | null>(groups).fill(null);
  }

  /** A slot for each group: where it is already, else any that no other wanted group has. */
  private place(wanted: string[]): number[] {
    const taken = new Set<number>();
    const places = wanted.map((name) => {
      const slot = this.held.indexOf(name);
      if (slot >= 0) {
        taken.add(slot);
      }
      return slot;
    });
    let next = 0;
    return places.map((slot) => {
      if (slot >= 0) {
        return slot;
      }
      while (taken.has(next)) {
        next += 1;
      }
      taken.add(next);
      return next;
    });
  }

  private decode(request: GridRequest, group: number[][], first: number, width: number, height: number): void {
    const table = new Uint32Array(8 * group.length);
    group.forEach((slice, i) => table.set(slice, 8 * i));
    this.device.queue.writeBuffer(this.slots!, 32 * first, table);
    const count = request.time === null ? 1 : this.decoder.metadata.axes[request.time.axis]!.size;
    const { frames, weight } = timeSteps(request.time?.at ?? 0, count);
    const { pass, frame } = this.shader;
    frame.run([this.standing(group[0]!, request.time?.axis, frames, weight)]);
    pass.run({
      width, height, depth: first + group.length, first, x_axis: request.x, y_axis: request.y ?? NO_AXIS,
      x_first: request.columns.first, x_step: request.columns.step, y_first: request.rows.first, y_step: request.rows.step,
      time_axis: request.time?.axis ?? NO_AXIS, time: frames, time_weight: [1 - weight, weight],
    }, [this.slots!, this.texture!], [width, height, group.length], frame.group(request.level));
  }

  /** Where the axes stand that do not move, time between two frames. */
  private standing(place: number[], time: number | undefined, frames: [number, number], weight: number): Still {
    return new Map(this.shader.still.map((axis) => {
      const between = axis === time && weight > 0;
      return [axis, between ? { index: frames, weight: [1 - weight, weight] }
        : { index: [axis === time ? frames[0] : place[axis]!], weight: [1] }];
    }));
  }
}

/** For each model the caches of both sides of a comparison, and the shader that they share. */
export class Grids {
  private constructor(private readonly grids: Map<Decoder, { shader: GridShader; caches: [GridCache, GridCache] }>) {}

  /** Of grids along some axes. */
  static async make(device: GPUDevice, decoders: Decoder[], moving: (number | null)[]): Promise<Grids> {
    const entries = decoders.map(async (decoder) => {
      const shader = await gridShader(device, decoder, moving);
      const cache = (): GridCache => new GridCache(device, decoder, shader);
      return [decoder, { shader, caches: [cache(), cache()] as [GridCache, GridCache] }] as const;
    });
    return new Grids(new Map(await Promise.all(entries)));
  }

  cache(decoder: Decoder, slot: 0 | 1): GridCache {
    return this.grids.get(decoder)!.caches[slot];
  }

  destroy(): void {
    this.grids.forEach(({ shader: { pass, frame }, caches }) => {
      [...caches, pass, frame].forEach((each) => each.destroy());
    });
  }
}
