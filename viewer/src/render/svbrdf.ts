/** SVBRDF: a lit object whose reflectance is decoded at every pixel. Twin of `hmkcta.render.svbrdf`. */

import type { Still } from "../gpu/frameContraction";
import type { Decoder } from "../gpu/decoder";
import type { Values } from "../gpu/uniform";
import type { Metadata } from "../reader/metadata";
import type { Light, State } from "../state";
import { zenithFirst } from "./angles";
import { type Layout, channelsAt, layOut } from "./layout";
import { Directions, type FixedDirection, NO_AXIS } from "./measured";
import type { MeshMaker } from "./mesh";
import type { Progress, Renderer, Side } from "./renderer";
import { type Directed, Shading } from "./shading";
import { Surface } from "./surface";
import { codedWhite } from "./white";
import { type Rays, type Vector, cameraRays, direction, dot, scaled } from "./vector";

const FLAG_Y_UP = 1;
const FLAG_COSINE = 2;

export class SvbrdfRenderer implements Renderer {
  private constructor(
    private readonly directed: Directed, readonly notes: string[], private readonly surface: Surface,
    private readonly directions: Directions, private readonly shadings: Map<Decoder, Shading>, private readonly codedWhite: number,
  ) {}

  /** Compiles, and meanwhile makes what needs no compiler and draws what the first frame will see. */
  static async make(device: GPUDevice, metadata: Metadata, decoders: Decoder[], first: [State, number, number]): Promise<SvbrdfRenderer> {
    const layout = layOut(metadata.axes, "svbrdf");
    const moving = [...layout.lights, ...layout.views, ...layout.space, layout.channel];
    const still = metadata.axes.flatMap((_, axis) => (moving.includes(axis) ? [] : [axis]));
    const [rows, columns] = layout.space.map((n) => metadata.axes[n]!.size) as [number, number];
    const notes: string[] = [];
    const directed = { layout, still, axes: [layout.views, layout.lights].map((axes) => zenithFirst(metadata.axes, axes)) };
    const surface = new Surface(device, rows, columns);
    const drawn = surface.compile().then(() => surface.draw(...first));
    const compiled = Promise.all([drawn, Promise.all(decoders.map((decoder) => Shading.make(device, decoder, directed)))]);
    compiled.catch(() => undefined); // awaited below, unless the tables fail before
    await new Promise((resolve) => setTimeout(resolve)); // what is to be compiled is sent at the end of a task
    surface.prepareMesh(first[0]);
    const directions = Directions.make(device, metadata, layout, notes);
    const [, shadings] = await compiled;
    return new SvbrdfRenderer(directed, notes, surface, directions, new Map(decoders.map((decoder, n) => [decoder, shadings[n]!])),
      codedWhite(metadata.sourceDtype)); // the model's: an original is sent as float16
  }

  async prepare(state: State, sides: Side[]): Promise<void> {
    await Promise.all(sides.map(({ decoder, level }) => {
      const shading = this.shadings.get(decoder)!;
      return shading.prepare(level, shading.contracts(this.sets(state)));
    }));
  }

  draw(side: Side, _slot: 0 | 1, state: State, target: GPUTexture): Progress {
    const rays = this.surface.draw(state, target.width, target.height);
    const shading = this.shadings.get(side.decoder)!;
    const sets = this.sets(state);
    const fixed = shading.contracts(sets);
    const { pass, frame } = shading.shader(side.level, fixed);
    frame.run(fixed ? sets! : [this.standing(state)]);
    pass.run(this.frame(state, rays, target, shading.flags, fixed ? frame.stride : 0),
      [this.directions.buffer, ...this.surface.seen, target], [target.width, target.height, 1], frame.group(side.level));
    return { share: 1, decoded: 0 };
  }

  ahead(): void {
    this.shadings.forEach((shading) => shading.ahead());
  }

  /** Take a mesh of the user's for the shape "mesh". */
  setMesh(make: MeshMaker): void {
    this.surface.setMesh(make);
  }

  destroy(): void {
    [...this.shadings.values(), this.surface, this.directions].forEach((each) => each.destroy());
  }

  private frame(state: State, rays: Rays, target: GPUTexture, flags: number, stride: number): Values {
    const layout: Layout = this.directed.layout;
    const [y, x] = layout.space as [number, number];
    const { surface } = state;
    const stands = this.stands(state);
    const values: Values = {
      ...rays, ...this.directions.values, width: target.width, height: target.height, light_count: state.lights.length,
      rows: this.surface.rows, columns: this.surface.columns, y_axis: y, x_axis: x, set_numbers: stride,
      coded_white: surface.coded ? this.codedWhite : 0,
      flags: (surface.yUp ? FLAG_Y_UP : 0) + (surface.cosine ? 0 : FLAG_COSINE) + flags,
      channel_axis: layout.channels.length === 3 ? layout.channel ?? NO_AXIS : NO_AXIS, channels: layout.channels,
      "stands[0]": stands.slice(0, 4), "stands[1]": stands.slice(4, 8),
    };
    const fixed = this.fixedLights(state);
    state.lights.forEach((light, n) => {
      const found = fixed?.[n];
      values[`lights[${n}].place`] = lightPlace(light);
      values[`lights[${n}].strength`] = [...scaled(light.colour, light.intensity), found?.height ?? 0];
      values[`lights[${n}].corners`] = [...found?.taps.values() ?? []].flatMap(({ index }) => index);
      values[`lights[${n}].shares`] = [...found?.taps.values() ?? []].flatMap(({ weight }) => weight);
    });
    return values;
  }

  /** The lights, if all are the same at all pixels: distant ones on a plane; else null. */
  private fixedLights(state: State): FixedDirection[] | null {
    const { lights, surface } = state;
    if (surface.shape !== "plane" || lights.some(({ point }) => point) || this.directions.lights.axes.length === 0) {
      return null;
    }
    const front = cameraRays(state.camera, 1).eye[0] >= 0 ? 1 : -1; // the plane lies at x = 0, its columns along y
    const axes: Vector[] = [[0, 1, 0], [0, 0, surface.yUp ? front : -front], [front, 0, 0]];
    return lights.map((light) => {
      const towards = direction(light.azimuth, light.elevation);
      return this.directions.lights.interpolate(axes.map((axis) => dot(axis, towards)) as Vector);
    });
  }

  /** What the contracted axes stand at, a set for each light that is the same at all pixels; null if they are not. */
  private sets(state: State): Still[] | null {
    const lights = this.fixedLights(state);
    return lights?.map(({ taps }) => new Map([...this.standing(state), ...taps])) ?? null;
  }

  /** What axes stand at that neither directions nor texels move; that of the colours at all of them. */
  private standing(state: State): Still {
    const stands = this.stands(state);
    const { still, layout } = this.directed;
    const channels = channelsAt(layout, state.position);
    const standing: Still = new Map(still.map((axis) => [axis, { index: [stands[axis]!], weight: [1] }]));
    return layout.channel === null ? standing : standing.set(layout.channel, { index: channels, weight: channels.map(() => 1) });
  }

  /** Where the axes stand that nothing else moves along; time at its nearest frame. */
  private stands(state: State): number[] {
    return state.position.map((place, n) => (n === this.directed.layout.time ? Math.round(state.time) : place));
  }
}

function lightPlace(light: Light): number[] {
  const towards = direction(light.azimuth, light.elevation);
  return light.point ? [...scaled(towards, light.distance), 1] : [...towards, 0];
}
