/** Any model as a picture of two of its axes, at chosen places of the others. */

import type { Decoder } from "../gpu/decoder";
import { Pass } from "../gpu/pass";
import type { Metadata } from "../reader/metadata";
import type { State } from "../state";
import { colourTable } from "./colours";
import { Grids } from "./grid";
import { shownChannels } from "./layout";
import { partSeen } from "./part";
import { type Progress, type Renderer, type Side, filledBuffer } from "./renderer";
import { windowEnd } from "./window";

const STRIP = 8; // times as long as it is high

/** Rows and columns of the picture. An array of one axis is a strip, all of whose rows are the same. */
export function sliceSize(metadata: Metadata, state: State): [rows: number, columns: number] {
  const { x, y } = state.slice;
  const columns = metadata.axes[x]!.size;
  return [x === y ? Math.max(1, Math.round(columns / STRIP)) : metadata.axes[y]!.size, columns];
}

/** The axis whose indices can be shown as colours: another one than those across and down. */
export function colourAxis(metadata: Metadata, state: State): number | null {
  const { x, y, colour } = state.slice;
  const n = metadata.axes.findIndex((axis, i) => axis.role === "channel" && axis.size > 2 && i !== x && i !== y);
  return colour && n >= 0 ? n : null;
}

export class SliceRenderer implements Renderer {
  readonly notes: string[] = [];
  private readonly colours: GPUBuffer;
  private colourName = "";
  private grids: Grids | null = null;
  private moving = ""; // the axes that they are along

  private constructor(
    private readonly device: GPUDevice, private readonly pass: Pass, private readonly decoders: Decoder[],
  ) {
    this.colours = filledBuffer(device, colourTable("grey"), GPUBufferUsage.STORAGE);
  }

  static async make(device: GPUDevice, decoders: Decoder[]): Promise<SliceRenderer> {
    const pass = await Pass.make(device, {
      entry: "shade_slice", struct: "SliceFrame", shaders: ["slice"], bindings: ["storage", "texture-3d", "store-2d"],
    });
    return new SliceRenderer(device, pass, decoders);
  }

  /** Have the shader for the axes of the picture: the modes of all others are contracted. */
  async prepare(state: State): Promise<void> {
    const wanted = (): (number | null)[] => [state.slice.x, state.slice.y, colourAxis(this.decoders[0]!.metadata, state)];
    for (let moving = wanted(); moving.join() !== this.moving; moving = wanted()) { // they may change meanwhile
      const made = await Grids.make(this.device, this.decoders, moving);
      this.grids?.destroy();
      this.grids = made;
      this.moving = moving.join();
    }
  }

  draw(side: Side, slot: 0 | 1, state: State, target: GPUTexture, budget: number): Progress {
    const { metadata } = side.decoder;
    const { x, y, low, high, colours } = state.slice;
    const channel = colourAxis(metadata, state);
    const shown = channel === null ? [state.position] : shownChannels(metadata.axes[channel]!.size).map((index) =>
      state.position.map((place, n) => (n === channel ? index : place)));
    const cache = this.grids!.cache(side.decoder, slot);
    const group = shown.map((index) => index.map((place, n) => (n === x || n === y ? 0 : place)));
    const { rows, columns, scale, offsetY, offsetX } = partSeen(...sliceSize(metadata, state), target, state);
    const { progress } = cache.fill({ level: side.level, x, y: x === y ? null : y, rows, columns, time: null, groups: [group] }, budget);
    if (colours !== this.colourName) {
      this.device.queue.writeBuffer(this.colours, 0, colourTable(colours));
      this.colourName = colours;
    }
    this.pass.run({
      width: target.width, height: target.height, channels: shown.length, rows: rows.count, columns: columns.count, scale, offset_y: offsetY,
      offset_x: offsetX, low, high: windowEnd(low, high), values: state.compare.mode === "heat" ? 1 : 0,
    }, [this.colours, cache.texture!, target], [target.width, target.height, 1]);
    return progress;
  }

  destroy(): void {
    this.pass.destroy();
    this.colours.destroy();
    this.grids?.destroy();
  }
}
