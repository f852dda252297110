/** A model on the GPU: the pages of its image, filled as the levels arrive, and the decoder's bindings (group 0). */

import { type Metadata, levelEnds } from "../reader/metadata";
import type { PackedLevel } from "../reader/packed";
import { type ImageLayout, eachCoefficients, layOutImage, packTables } from "./image";
import { PAGE_SHIFT, decoderUniform, imagePages } from "./prelude";
import { type Tree, treeOf } from "./tree";

const PAGE_WORDS = 2 ** PAGE_SHIFT;
const FRAME_BINDING = 8; // as in the prelude

export class Decoder {
  /** Levels whose numbers are on the GPU: none above is ever read. */
  arrived = 0;
  readonly pages: number;
  readonly bytes: number;
  readonly layout: GPUBindGroupLayout;
  /** What its shaders are made for. */
  readonly tree: Tree;
  private readonly image: ImageLayout;
  private readonly buffers: GPUBuffer[];
  /** As `layout`, with contracted cores behind all pages that there can be. */
  readonly framed: GPUBindGroupLayout;
  private readonly groups = new Map<GPUBuffer | null, GPUBindGroup[]>();
  private readonly uniforms = new Map<number, GPUBuffer>();

  constructor(private readonly device: GPUDevice, readonly metadata: Metadata, readonly stages: PackedLevel[]) {
    this.image = layOutImage(stages);
    this.tree = treeOf(metadata, stages);
    const words = this.image.coefficients[stages.length]!;
    this.pages = imagePages(words);
    this.bytes = 4 * words;
    this.buffers = Array.from({ length: this.pages }, (_, page) => device.createBuffer({
      size: 4 * Math.max(1, Math.min(PAGE_WORDS, words - page * PAGE_WORDS)),
      usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST,
    }));
    const entry = (binding: number, type: GPUBufferBindingType): GPUBindGroupLayoutEntry =>
      ({ binding, visibility: GPUShaderStage.COMPUTE | GPUShaderStage.FRAGMENT, buffer: { type } });
    const entries = [entry(0, "uniform"), ...this.buffers.map((_, page) => entry(page + 1, "read-only-storage"))];
    this.layout = device.createBindGroupLayout({ entries });
    this.framed = device.createBindGroupLayout({ entries: [...entries, entry(FRAME_BINDING, "read-only-storage")] });
  }

  /** Upload the numbers of the next level, and before the first one's the tables of all. */
  addLevel(): void {
    if (this.arrived === 0) {
      this.write(0, packTables(this.stages, this.image));
    }
    const t = levelEnds(this.metadata)[this.arrived]! - 1; // cuts before it have no numbers
    eachCoefficients(this.stages[t]!, t, this.image, (at, halves) => {
      this.write(at, wholeWords(halves));
    });
    this.arrived += 1;
  }

  /** Where the scales of all cells begin and end in the image, in words. */
  get scales(): [number, number] {
    return [this.image.scales[0]!, this.image.coefficients[0]!];
  }

  /** The bindings with which a shader adds up so many levels, of the model or of the contracted cores of its frame. */
  group(levels: number, cores: GPUBuffer | null = null): GPUBindGroup {
    const groups = this.groups.get(cores) ?? [];
    this.groups.set(cores, groups);
    return groups[levels] ??= this.device.createBindGroup({
      layout: cores === null ? this.layout : this.framed,
      entries: [
        ...[this.uniformOf(levels), ...this.buffers].map((buffer, binding) => ({ binding, resource: { buffer } })),
        ...(cores === null ? [] : [{ binding: FRAME_BINDING, resource: { buffer: cores } }]),
      ],
    });
  }

  /** Contracted cores are no longer used. */
  forget(cores: GPUBuffer): void {
    this.groups.delete(cores);
  }

  private uniformOf(levels: number): GPUBuffer {
    let buffer = this.uniforms.get(levels);
    if (buffer === undefined) {
      buffer = this.device.createBuffer({ size: 12, usage: GPUBufferUsage.UNIFORM | GPUBufferUsage.COPY_DST });
      this.device.queue.writeBuffer(buffer, 0, decoderUniform(this.metadata, levels));
      this.uniforms.set(levels, buffer);
    }
    return buffer;
  }

  destroy(): void {
    [...this.buffers, ...this.uniforms.values()].forEach((buffer) => buffer.destroy());
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
