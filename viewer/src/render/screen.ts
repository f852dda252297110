/** From radiance to the canvas: two radiance pictures, `display.wgsl`, a copy to what the browser shows. */

import { Pass } from "../gpu/pass";
import { BACKGROUND, CURVES, type State } from "../state";
import { heatTable } from "./colours";
import { filledBuffer } from "./renderer";

const MODES = ["none", "split", "heat"];
const FLAG_SRGB = 1;
const FLAG_PREMULTIPLIED = 2;

export interface Tone {
  white: number; // the value that shows as white
  srgb: boolean;
  premultiplied: boolean;
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
    const { mode, position, gain } = state.compare;
    const [first, second] = this.pictures as [GPUTexture, GPUTexture];
    if (this.canvas.width !== width || this.canvas.height !== height) { // which empties it: not before there is a picture
      Object.assign(this.canvas, { width, height });
    }
    this.pass.run({
      width, height, mode: MODES.indexOf(mode), flags: (tone.srgb ? FLAG_SRGB : 0) + (tone.premultiplied ? FLAG_PREMULTIPLIED : 0),
      exposure: 2 ** state.tone.stops / tone.white, split: position * width, gain, curve: CURVES.indexOf(state.tone.curve),
      background: BACKGROUND,
    }, [first, mode === "none" ? first : second, this.heat, this.shown!], [width, height, 1]);
    const encoder = this.device.createCommandEncoder();
    encoder.copyTextureToTexture({ texture: this.shown! }, { texture: this.canvasTexture() }, [width, height]);
    this.device.queue.submit([encoder.finish()]);
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
