/** SVBRDF: a lit object whose reflectance is decoded at every pixel. Twin of `hmkcta.render.svbrdf`. */

import { FrameContraction, contractedModes } from "../gpu/contract";
import type { Decoder } from "../gpu/decoder";
import { Pass } from "../gpu/pass";
import { picksFit, prelude } from "../gpu/prelude";
import { SHADERS } from "../gpu/shaders";
import type { Values } from "../gpu/uniform";
import type { LevelBounds, Metadata } from "../reader/metadata";
import type { Light, State } from "../state";
import { type DirectionTable, GRID, buildTable, directionsOf } from "./directions";
import { type Layout, layOut } from "./layout";
import { type Mesh, VERTEX_NUMBERS, makeMesh } from "./mesh";
import { type Progress, type Renderer, type Side, filledBuffer } from "./renderer";
import { type Rays, cameraRays, clipFromWorld, direction, scaled } from "./vector";

const NO_AXIS = 0xff;
const FLAG_Y_UP = 1;
const FLAG_COSINE = 2;
const FLAG_NEAREST = 4;
const [NEAR, FAR] = [1e-2, 100];
const TARGETS: GPUTextureFormat[] = ["rgba32float", "rgba16float", "rgba16float"];

/** A mesh on the GPU. */
interface Drawn {
  key: string;
  vertices: GPUBuffer;
  indices: GPUBuffer;
  count: number;
}

interface Tables {
  buffer: GPUBuffer;
  light: number[]; // first record, first grid entry, side, axis
  view: number[];
}

/**
 * A model's shaders, and whether its texels are interpolated. Level 1 has one of its own, which takes a fraction of the
 * time to compile; the other one is compiled once the first frame is there.
 */
interface Shading {
  first: Pass;
  all: Pass | null;
  compile: () => Promise<void>; // of `all`; starts once
  nearest: boolean;
  frame: FrameContraction | null; // of modes in which neither directions, texels nor colours are
  still: number[]; // their axes and others that stand
}

export class SvbrdfRenderer implements Renderer {
  private seen: GPUTexture[] = [];
  private depth: GPUTexture | null = null;
  private readonly surface: GPUBuffer;
  private custom: ((repeat: number) => Mesh) | null = null;
  private meshes = 0;

  private constructor(
    private readonly device: GPUDevice, readonly layout: Layout, readonly notes: string[],
    private readonly rasteriser: GPURenderPipeline, private readonly tables: Tables,
    private readonly shadings: Map<Decoder, Shading>, private mesh: Drawn,
  ) {
    this.surface = device.createBuffer({ size: 80, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
  }

  /** Compiles first, and meanwhile makes what needs no compiler. */
  static async make(device: GPUDevice, metadata: Metadata, decoders: Decoder[]): Promise<SvbrdfRenderer> {
    const layout = layOut(metadata.axes, "svbrdf");
    const notes: string[] = [];
    const compiled = Promise.all([makeRasteriser(device), Promise.all(decoders.map((decoder) => makeShading(device, decoder, layout)))]);
    compiled.catch(() => undefined); // awaited below, unless the tables fail before
    const tables = makeTables(device, metadata, layout, notes);
    const [rows, columns] = layout.space.map((n) => metadata.axes[n]!.size) as [number, number];
    const mesh = uploaded(device, meshKey("sphere", 1, 0), makeMesh("sphere", 1, rows, columns)); // what is shown first
    const [rasteriser, shadings] = await compiled;
    return new SvbrdfRenderer(device, layout, notes, rasteriser, tables,
      new Map(decoders.map((decoder, n) => [decoder, shadings[n]!])), mesh);
  }

  async prepare(_: State, sides: Side[]): Promise<void> {
    await Promise.all(sides.map(({ decoder, level }) => (level === 1 ? null : this.shadings.get(decoder)!.compile())));
  }

  draw(side: Side, _slot: 0 | 1, state: State, target: GPUTexture): Progress {
    const { axes } = side.decoder.metadata;
    const [rows, columns] = this.layout.space.map((n) => axes[n]!.size) as [number, number];
    const rays = cameraRays(state.camera, target.width / target.height);
    this.drawSurface(state, rays, rows, columns, target);
    const { first, all, nearest, frame, still } = this.shadings.get(side.decoder)!;
    const stands = this.stands(state);
    frame?.run(new Map(still.map((axis) => [axis, { index: [stands[axis]!], weight: [1] }])));
    const pass = side.level === 1 ? first : all!;
    pass.run(this.frame(state, rays, rows, columns, target, nearest), [this.tables.buffer, ...this.seen, target],
      [target.width, target.height, 1], side.decoder.group(side.level, frame?.cores));
    return { complete: true, decoded: 0 };
  }

  ahead(): void {
    this.shadings.forEach(({ compile }) => {
      compile().catch(() => undefined); // `prepare` hears of a failure
    });
  }

  /** Take a mesh of the user's for the shape "mesh". */
  setMesh(make: (repeat: number) => Mesh): void {
    this.custom = make;
    this.meshes += 1;
  }

  destroy(): void {
    this.shadings.forEach(({ first, all, frame }, decoder) => {
      [first, all].forEach((pass) => pass?.destroy());
      if (frame !== null) {
        decoder.forget(frame.cores);
        frame.destroy();
      }
    });
    [this.surface, this.tables.buffer, this.mesh.vertices, this.mesh.indices].forEach((each) => each.destroy());
    [...this.seen, this.depth].forEach((each) => each?.destroy());
  }

  private frame(state: State, rays: Rays, rows: number, columns: number, target: GPUTexture, nearest: boolean): Values {
    const { layout, tables } = this;
    const [y, x] = layout.space as [number, number];
    const { surface } = state;
    const values: Values = {
      ...rays, width: target.width, height: target.height, light_count: state.lights.length, rows, columns,
      flags: (surface.yUp ? FLAG_Y_UP : 0) + (surface.cosine ? 0 : FLAG_COSINE) + (nearest ? FLAG_NEAREST : 0),
      light_table: tables.light, view_table: tables.view, y_axis: y, x_axis: x,
      channel_axis: layout.channels.length === 3 ? layout.channel ?? NO_AXIS : NO_AXIS, channels: layout.channels,
      "stands[0]": this.stands(state).slice(0, 4), "stands[1]": this.stands(state).slice(4, 8),
    };
    state.lights.forEach((light, n) => {
      values[`lights[${n}].place`] = lightPlace(light);
      values[`lights[${n}].strength`] = scaled(light.colour, light.intensity);
    });
    return values;
  }

  /** Where the axes stand that nothing else moves along; time at its nearest frame. */
  private stands(state: State): number[] {
    return state.position.map((place, n) => (n === this.layout.time ? Math.round(state.time) : place));
  }

  private drawSurface(state: State, rays: Rays, rows: number, columns: number, target: GPUTexture): void {
    this.prepareMesh(state, rows, columns);
    this.prepareTargets(target.width, target.height);
    const uniform = new Float32Array(20);
    uniform.set(clipFromWorld(rays, NEAR, FAR));
    uniform.set(rays.eye, 16);
    this.device.queue.writeBuffer(this.surface, 0, uniform);
    const encoder = this.device.createCommandEncoder();
    const pass = encoder.beginRenderPass({
      colorAttachments: this.seen.map((texture) => (
        { view: texture.createView(), loadOp: "clear" as const, storeOp: "store" as const, clearValue: [0, 0, 0, 0] })),
      depthStencilAttachment: {
        view: this.depth!.createView(), depthLoadOp: "clear", depthStoreOp: "discard", depthClearValue: 1,
      },
    });
    pass.setPipeline(this.rasteriser);
    pass.setBindGroup(0, this.device.createBindGroup({
      layout: this.rasteriser.getBindGroupLayout(0), entries: [{ binding: 0, resource: { buffer: this.surface } }],
    }));
    pass.setVertexBuffer(0, this.mesh.vertices);
    pass.setIndexBuffer(this.mesh.indices, "uint32");
    pass.drawIndexed(this.mesh.count);
    pass.end();
    this.device.queue.submit([encoder.finish()]);
  }

  private prepareMesh(state: State, rows: number, columns: number): void {
    const { shape, repeat } = state.surface;
    const custom = shape === "mesh" ? this.custom : null;
    const key = meshKey(shape, repeat, this.meshes);
    if (this.mesh.key === key) {
      return;
    }
    const mesh = custom === null ? makeMesh(shape === "mesh" ? "sphere" : shape, repeat, rows, columns) : custom(repeat);
    this.mesh.vertices.destroy();
    this.mesh.indices.destroy();
    this.mesh = uploaded(this.device, key, mesh);
  }

  private prepareTargets(width: number, height: number): void {
    if (this.depth?.width === width && this.depth.height === height) {
      return;
    }
    [...this.seen, this.depth].forEach((texture) => texture?.destroy());
    const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING;
    this.seen = TARGETS.map((format) => this.device.createTexture({ size: [width, height], format, usage }));
    this.depth = this.device.createTexture({
      size: [width, height], format: "depth32float", usage: GPUTextureUsage.RENDER_ATTACHMENT,
    });
  }
}

/** What a mesh is made of: its shape, how often the texels come, and which of the user's it is. */
function meshKey(shape: State["surface"]["shape"], repeat: number, custom: number): string {
  return JSON.stringify([shape, repeat, custom]);
}

function uploaded(device: GPUDevice, key: string, mesh: Mesh): Drawn {
  return {
    key, vertices: filledBuffer(device, mesh.vertices, GPUBufferUsage.VERTEX),
    indices: filledBuffer(device, mesh.indices, GPUBufferUsage.INDEX), count: mesh.indices.length,
  };
}

function lightPlace(light: Light): number[] {
  const towards = direction(light.azimuth, light.elevation);
  return light.point ? [...scaled(towards, light.distance), 1] : [...towards, 0];
}

async function makeShading(device: GPUDevice, decoder: Decoder, layout: Layout): Promise<Shading> {
  const colour = layout.channel !== null && layout.channels.length === 3;
  const picksWith = (texels: number): number[] => {
    const picks = decoder.metadata.axes.map(() => 1);
    const set = (axis: number | null | undefined, count: number): void => {
      if (axis !== null && axis !== undefined) {
        picks[axis] = count;
      }
    };
    set(layout.light, 3);
    set(layout.views[0], 3);
    layout.space.forEach((axis) => set(axis, texels));
    set(colour ? layout.channel : null, 3);
    return picks;
  };
  const nearest = !picksFit(decoder.metadata, picksWith(2));
  const channels = colour ? 3 : 1;
  const { metadata, uniform } = decoder;
  const moving = [layout.light, ...layout.views, ...layout.space, layout.channel];
  const still = metadata.axes.flatMap((_, axis) => (moving.includes(axis) ? [] : [axis]));
  const picks = picksWith(nearest ? 1 : 2);
  const contracted = contractedModes(decoder, still);
  const frame = contracted.length > 0 ? await FrameContraction.make(device, decoder, { picks, contracted }) : null;
  const made = (levels: LevelBounds[]): Promise<Pass> => Pass.make(device, {
    entry: "shade_svbrdf", struct: "SvbrdfFrame", decoder: frame === null ? decoder.layout : decoder.framed,
    head: prelude({ ...metadata, levels }, decoder.pages,
      { channels, uniform: uniform.filter((l) => l < levels.length), picks, contracted }),
    shaders: ["image", "decode", "weighted", "svbrdf"],
    bindings: ["storage", "texture-2d", "texture-2d", "texture-2d", "store-2d"],
  });
  const one = metadata.levels.length === 1;
  let compiling: Promise<void> | null = one ? Promise.resolve() : null;
  const shading: Shading = {
    nearest, frame, still, first: await made(metadata.levels.slice(0, 1)), all: null,
    compile: () => compiling ??= made(metadata.levels).then((pass) => {
      shading.all = pass;
    }),
  };
  if (one) {
    shading.all = shading.first;
  }
  return shading;
}

function makeRasteriser(device: GPUDevice): Promise<GPURenderPipeline> {
  const module = device.createShaderModule({ code: SHADERS.gbuffer });
  const attributes = [[0, "float32x3"], [12, "float32x3"], [24, "float32x4"], [40, "float32x2"]] as const;
  return device.createRenderPipelineAsync({
    layout: "auto",
    vertex: {
      module, entryPoint: "surface_vertex",
      buffers: [{
        arrayStride: 4 * VERTEX_NUMBERS,
        attributes: attributes.map(([offset, format], shaderLocation) => ({ shaderLocation, offset, format })),
      }],
    },
    fragment: { module, entryPoint: "surface_fragment", targets: TARGETS.map((format) => ({ format })) },
    depthStencil: { format: "depth32float", depthWriteEnabled: true, depthCompare: "less" },
  });
}

/** Triangulations of lights and views in one buffer: records and grid of each; offsets in groups of four words. */
function makeTables(device: GPUDevice, metadata: Metadata, layout: Layout, notes: string[]): Tables {
  const words: Uint32Array[] = [];
  let at = 0;
  const add = (axis: number | null | undefined): number[] => {
    if (axis === null || axis === undefined) {
      return [0, 0, GRID, NO_AXIS];
    }
    const { vectors, assumed } = directionsOf(metadata.axes[axis]!);
    if (assumed) {
      notes.push(`${metadata.axes[axis]!.name} has no directions as coordinates: `
        + "a spiral from the zenith down to 75 degrees is assumed.");
    }
    const table: DirectionTable = buildTable(vectors);
    words.push(table.words);
    const start = at;
    at += table.words.length / 4;
    return [start, start + 4 * table.triangles, GRID, axis];
  };
  const [light, view] = [add(layout.light), add(layout.views[0])];
  const all = new Uint32Array(Math.max(4, 4 * at));
  let done = 0;
  for (const part of words) {
    all.set(part, done);
    done += part.length;
  }
  return { light, view, buffer: filledBuffer(device, all, GPUBufferUsage.STORAGE) };
}
