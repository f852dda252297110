/** A model on the GPU: the pages of its image, filled as the levels arrive, and the decoder's bindings (group 0). */

import type { Metadata } from "../reader/metadata";
import type { PackedLevel } from "../reader/packed";
import { uniformLevels } from "./contraction";
import { type ImageLayout, eachCoefficients, layOutImage, packTables } from "./image";
import { PAGE_SHIFT, decoderUniform, imagePages } from "./prelude";

const PAGE_WORDS = 2 ** PAGE_SHIFT;

export class Decoder {
  /** Levels whose numbers are on the GPU: none above is ever read. */
  arrived = 0;
  readonly pages: number;
  readonly bytes: number;
  readonly layout: GPUBindGroupLayout;
  /** Levels whose loops have constant bounds. */
  readonly uniform: number[];
  private readonly image: ImageLayout;
  private readonly buffers: GPUBuffer[];
  private readonly groups = new Map<number, GPUBindGroup>();
  private readonly uniforms: GPUBuffer[] = [];

  /** `levels` have their tables; their numbers may still be missing. */
  constructor(private readonly device: GPUDevice, readonly metadata: Metadata, private readonly levels: PackedLevel[]) {
    this.image = layOutImage(levels);
    this.uniform = uniformLevels(metadata, levels);
    const words = this.image.coefficients[levels.length]!;
    this.pages = imagePages(words);
    this.bytes = 4 * words;
    this.buffers = Array.from({ length: this.pages }, (_, page) => device.createBuffer({
      size: 4 * Math.max(1, Math.min(PAGE_WORDS, words - page * PAGE_WORDS)),
      usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST,
    }));
    const entry = (binding: number, type: GPUBufferBindingType): GPUBindGroupLayoutEntry =>
      ({ binding, visibility: GPUShaderStage.COMPUTE, buffer: { type } });
    this.layout = device.createBindGroupLayout({
      entries: [entry(0, "uniform"), ...this.buffers.map((_, page) => entry(page + 1, "read-only-storage"))],
    });
    this.write(0, packTables(levels, this.image));
  }

  /** Upload the numbers of the next level. */
  addLevel(): void {
    const l = this.arrived;
    eachCoefficients(this.levels[l]!, l, this.image, (at, halves) => {
      this.write(at, wholeWords(halves));
    });
    this.arrived = l + 1;
  }

  /** The bindings with which a shader adds up so many levels. */
  group(levels: number): GPUBindGroup {
    let group = this.groups.get(levels);
    if (group === undefined) {
      const buffer = this.device.createBuffer({ size: 16, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
      this.device.queue.writeBuffer(buffer, 0, decoderUniform(this.metadata, levels));
      this.uniforms.push(buffer);
      group = this.device.createBindGroup({
        layout: this.layout,
        entries: [buffer, ...this.buffers].map((each, binding) => ({ binding, resource: { buffer: each } })),
      });
      this.groups.set(levels, group);
    }
    return group;
  }

  destroy(): void {
    [...this.buffers, ...this.uniforms].forEach((buffer) => buffer.destroy());
  }

  /** Words from `start` on, over the bounds of pages. */
  private write(start: number, words: Uint32Array<ArrayBuffer>): void {
    for (let done = 0; done < words.length;) {
      const page = Math.floor((start + done) / PAGE_WORDS);
      const inside = start + done - page * PAGE_WORDS;
      const count = Math.min(words.length - done, PAGE_WORDS - inside);
      this.device.queue.writeBuffer(this.buffers[page]!, 4 * inside, words, done, count);
      done += count;
    }
  }
}

/** Halves as words, an odd last half with a 0 behind it; a copy only where the file has them at an odd place. */
function wholeWords(halves: Uint16Array): Uint32Array<ArrayBuffer> {
  if (halves.length % 2 === 0 && halves.byteOffset % 4 === 0) {
    return new Uint32Array(halves.buffer as ArrayBuffer, halves.byteOffset, halves.length / 2);
  }
  const even = new Uint16Array(2 * Math.ceil(halves.length / 2));
  even.set(halves);
  return new Uint32Array(even.buffer);
}
