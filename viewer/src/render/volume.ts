/** Volume: rays through a box of decoded values. Twin of `hmkcta.render.volume`. */

import type { Decoder } from "../gpu/decoder";
import { Pass } from "../gpu/pass";
import type { Axis, Metadata } from "../reader/metadata";
import { BACKGROUND, type State, VOLUME_MODES } from "../state";
import { colourTable } from "./colours";
import { Grids } from "./grid";
import { type Layout, layOut } from "./layout";
import { type Span, wholeSpan } from "./part";
import { type Progress, type Renderer, type Side, filledBuffer } from "./renderer";
import { type Vector, cameraRays, direction } from "./vector";
import { windowEnd } from "./window";

const AMBIENT = 0.35;
const SPECULAR = 0.25;

/** Distance between neighbours on a space axis: from coordinates that rise evenly, else 1. */
export function spacing({ coords, size }: Axis): number {
  if (coords === null || coords.width !== 0 || size < 2) {
    return 1;
  }
  const mean = (coords.values[size - 1]! - coords.values[0]!) / (size - 1);
  const even = Array.from({ length: size - 1 }, (_, i) => coords.values[i + 1]! - coords.values[i]!)
    .every((step) => Math.abs(step - mean) <= 1e-3 * Math.abs(mean));
  return even && mean !== 0 ? Math.abs(mean) : 1;
}

export class VolumeRenderer implements Renderer {
  readonly notes: string[] = [];
  private readonly transfer: GPUBuffer;
  private transferKey = "";

  private constructor(
    private readonly device: GPUDevice, private readonly pass: Pass, private readonly layout: Layout,
    private readonly grids: Grids,
  ) {
    this.transfer = filledBuffer(device, colourTable("grey"), GPUBufferUsage.STORAGE);
  }

  static async make(device: GPUDevice, metadata: Metadata, decoders: Decoder[]): Promise<VolumeRenderer> {
    const layout = layOut(metadata.axes, "volume");
    const pass = await Pass.make(device, {
      entry: "shade_volume", struct: "VolumeFrame", shaders: ["volume"], bindings: ["storage", "texture-3d", "store-2d"],
    });
    return new VolumeRenderer(device, pass, layout, await Grids.make(device, decoders, [...layout.views, ...layout.space, layout.channel]));
  }

  draw(side: Side, slot: 0 | 1, state: State, target: GPUTexture, budget: number): Progress {
    const { axes } = side.decoder.metadata;
    const [z, y, x] = this.layout.space as [number, number, number];
    const [slices, rows, columns] = [z, y, x].map((n) => wholeSpan(axes[n]!.size)) as [Span, Span, Span];
    const groups = Array.from({ length: slices.count }, (_, k) => [state.position.map((place, n) => (
      n === z ? slices.first + k * slices.step : n === x || n === y || n === this.layout.time ? 0 : place))]);
    const time = this.layout.time === null ? null : { axis: this.layout.time, at: state.time };
    const cache = this.grids.cache(side.decoder, slot);
    const { progress } = cache.fill({ level: side.level, x, y, rows, columns, time, groups }, budget);
    this.updateTransfer(state);
    this.pass.run(this.frame(state, axes, target), [this.transfer, cache.texture!, target],
      [target.width, target.height, 1]);
    return progress;
  }

  destroy(): void {
    this.pass.destroy();
    this.transfer.destroy();
    this.grids.destroy();
  }

  private updateTransfer({ volume: { colours, opacity } }: State): void {
    const key = JSON.stringify([colours, opacity]);
    if (key !== this.transferKey) {
      this.device.queue.writeBuffer(this.transfer, 0, colourTable(colours, opacity));
      this.transferKey = key;
    }
  }

  private frame(state: State, axes: Axis[], target: GPUTexture): Record<string, number | ArrayLike<number>> {
    const { volume } = state;
    const { eye, right, up, forward } = cameraRays(state.camera, target.width / target.height);
    const shown = [...this.layout.space].reverse().map((n) => axes[n]!);
    const extent = shown.map((axis) => axis.size * spacing(axis));
    const largest = Math.max(...extent);
    const half = extent.map((each) => each / largest) as Vector;
    const unit = Math.min(...shown.map((axis) => (2 * spacing(axis)) / largest));
    const step = volume.step * unit;
    const light = state.lights[0];
    return {
      eye, right, up, forward, half, step, unit, width: target.width, height: target.height,
      mode: VOLUME_MODES.indexOf(volume.mode), most_steps: Math.ceil((2 * Math.hypot(...half)) / step) + 1,
      clip_low: volume.clipLow, clip_high: volume.clipHigh, iso: volume.iso, low: volume.low,
      high: windowEnd(volume.low, volume.high), ambient: AMBIENT, specular: SPECULAR,
      light: light === undefined ? [0, 0, 1] : direction(light.azimuth, light.elevation), background: BACKGROUND,
    };
  }
}
