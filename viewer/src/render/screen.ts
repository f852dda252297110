/** From radiance to the canvas: two radiance pictures, `display.wgsl`, a copy to what the browser shows. */

import { Pass } from "../gpu/pass";
import { BACKGROUND, CURVES, type State } from "../state";
import type { Shown } from "../store";
import { heatTable } from "./colours";
import { filledBuffer } from "./renderer";
import { span } from "./window";

const MODES = ["none", "split", "heat"];
const FLAG_SRGB = 1;
const FLAG_PREMULTIPLIED = 2;

export interface Tone {
  white: number; // the value that shows as white; of errors their span
  srgb: boolean;
  premultiplied: boolean;
}

/** How a state's radiance is shown. */
export function toneOf(shown: Shown): Tone {
  const { kind, state } = shown;
  const light = kind === "svbrdf" || kind === "lightfield";
  const white = state.compare.mode === "heat" ? span(shown) : light ? state.tone.white : 1;
  return { white, srgb: kind === "svbrdf", premultiplied: kind === "volume" };
}

export class Screen {
  /** Radiance of the two sides of a comparison. */
  pictures: GPUTexture[] = [];
  private shown: GPUTexture | null = null;
  private readonly heat: GPUBuffer;
  private context: GPUCanvasContext | null = null;

  private constructor(
    private readonly device: GPUDevice, private readonly canvas: HTMLCanvasElement, private readonly pass: Pass,
  ) {
    this.heat = filledBuffer(device, heatTable(), GPUBufferUsage.STORAGE);
  }

  static async make(device: GPUDevice, canvas: HTMLCanvasElement): Promise<Screen> {
    const pass = await Pass.make(device, {
      entry: "show", struct: "DisplayFrame", shaders: ["display"],
      bindings: ["texture-2d", "texture-2d", "storage", "store-8"],
    });
    return new Screen(device, canvas, pass);
  }

  /** Have pictures of this size. */
  resize(width: number, height: number): void {
    if (this.shown?.width === width && this.shown.height === height) {
      return;
    }
    [...this.pictures, this.shown].forEach((texture) => texture?.destroy());
    const both = GPUTextureUsage.STORAGE_BINDING | GPUTextureUsage.TEXTURE_BINDING;
    this.pictures = [0, 1].map(() => this.device.createTexture({ size: [width, height], format: "rgba32float", usage: both }));
    this.shown = this.device.createTexture({
      size: [width, height], format: "rgba8unorm", usage: GPUTextureUsage.STORAGE_BINDING | GPUTextureUsage.COPY_SRC,
    });
  }

  /** Show the pictures. */
  present(state: State, tone: Tone): void {
    const { width, height } = this.shown!;
    this.develop(state, tone);
    if (this.canvas.width !== width || this.canvas.height !== height) { // which empties it: not before there is a picture
      Object.assign(this.canvas, { width, height });
    }
    const encoder = this.device.createCommandEncoder();
    encoder.copyTextureToTexture({ texture: this.shown! }, { texture: this.canvasTexture() }, [width, height]);
    this.device.queue.submit([encoder.finish()]);
  }

  /** The pictures as they would be shown, for a file. */
  async read(state: State, tone: Tone): Promise<ImageData> {
    const { width, height } = this.shown!;
    this.develop(state, tone);
    const row = 256 * Math.ceil(width / 64); // bytes, as WebGPU has them
    const buffer = this.device.createBuffer({ size: row * height, usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ });
    const encoder = this.device.createCommandEncoder();
    encoder.copyTextureToBuffer({ texture: this.shown! }, { buffer, bytesPerRow: row }, [width, height]);
    this.device.queue.submit([encoder.finish()]);
    await buffer.mapAsync(GPUMapMode.READ);
    const [bytes, image] = [new Uint8Array(buffer.getMappedRange()), new ImageData(width, height)];
    for (let y = 0; y < height; y += 1) {
      image.data.set(bytes.subarray(y * row, y * row + 4 * width), 4 * width * y);
    }
    buffer.destroy();
    return image;
  }

  /** From radiance to `shown`. The colours of errors are those of numbers, whatever the exposure. */
  private develop(state: State, tone: Tone): void {
    const { width, height } = this.shown!;
    const { mode, position, gain } = state.compare;
    const [first, second] = this.pictures as [GPUTexture, GPUTexture];
    this.pass.run({
      width, height, mode: MODES.indexOf(mode), flags: (tone.srgb ? FLAG_SRGB : 0) + (tone.premultiplied ? FLAG_PREMULTIPLIED : 0),
      exposure: (mode === "heat" ? 1 : 2 ** state.tone.stops) / tone.white, split: position * width, gain,
      curve: CURVES.indexOf(state.tone.curve), background: BACKGROUND,
    }, [first, mode === "none" ? first : second, this.heat, this.shown!], [width, height, 1]);
  }

  /** Where the browser takes the picture from. The page is painted anew when a canvas gets its context: not before there is one. */
  private canvasTexture(): GPUTexture {
    if (this.context === null) {
      this.context = this.canvas.getContext("webgpu")!;
      const usage = GPUTextureUsage.COPY_DST | GPUTextureUsage.RENDER_ATTACHMENT;
      this.context.configure({ device: this.device, format: "rgba8unorm", usage });
    }
    return this.context.getCurrentTexture();
  }
}
