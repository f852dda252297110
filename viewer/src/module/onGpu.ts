/** A file's numbers on a GPU, for a shader of one's own to decode. */

import decode from "../../../python/hmkcta/shaders/decode.wgsl?raw";
import image from "../../../python/hmkcta/shaders/image.wgsl?raw";
import { Decoder } from "../gpu/decoder";
import { prelude } from "../gpu/prelude";
import { Problem } from "../problem";
import { largestCost } from "../reader/check";
import { ON_GPU } from "../reader/limits";
import { upto } from "../reader/metadata";
import type { Reading } from "../reader/read";

export class OnGpu {
  /**
   * WGSL to put before a shader of one's own: `decode_element(index: array<u32, AXES>, stages: u32) -> f32`, whose indices
   * must be in range, and `decoder.stages`, how many the bindings say.
   */
  readonly code: string;
  /** Of group 0. */
  readonly layout: GPUBindGroupLayout;
  private readonly decoder: Decoder;

  constructor(device: GPUDevice, { metadata, stages, arrived }: Reading) {
    const cost = Math.max(...stages.map(largestCost));
    if (cost > ON_GPU) {
      throw new Problem(`A level takes ${cost} multiply-adds an element; shaders do up to ${ON_GPU}.`);
    }
    const read = upto(metadata, arrived);
    this.decoder = new Decoder(device, read, stages.slice(0, read.stages.length));
    while (this.decoder.arrived < arrived) {
      this.decoder.addLevel();
    }
    this.layout = this.decoder.layout;
    this.code = [prelude(this.decoder.tree, this.decoder.pages), image, decode].join("\n");
  }

  /** Bytes on the GPU. */
  get bytes(): number {
    return this.decoder.bytes;
  }

  /** What to bind as group 0 for so many levels: without a number, for all that there were when this was made. */
  group(levels = this.decoder.arrived): GPUBindGroup {
    if (!Number.isInteger(levels) || levels < 1 || levels > this.decoder.arrived) {
      throw new RangeError(`level ${levels}; allowed: 1 to ${this.decoder.arrived}, which had arrived when this was made`);
    }
    return this.decoder.group(levels);
  }

  destroy(): void {
    this.decoder.destroy();
  }
}
