/** What all renderers share: a picture of a model at a level, as radiance in a texture. */

import type { Decoder } from "../gpu/decoder";
import type { State } from "../state";

/** One side of a comparison: a model on the GPU and how many of its levels are shown. */
export interface Side {
  decoder: Decoder;
  level: number;
}

/** How much of what a picture needs has been decoded, 1 if all of it has, and how many elements just were. */
export interface Progress {
  share: number;
  decoded: number;
}

/** A renderer of one kind. */
export interface Renderer {
  /** Sentences on what had to be assumed. */
  readonly notes: string[];
  /** Compile what a state and these sides need that was not needed before. */
  prepare?(state: State, sides: Side[]): Promise<void>;
  /** Draw one side into a texture; elements that are kept from frame to frame are decoded up to `budget` at a time. */
  draw(side: Side, slot: 0 | 1, state: State, target: GPUTexture, budget: number): Progress;
  /** Begin to compile what further levels need: a picture is there. */
  ahead?(): void;
  destroy(): void;
}

/** A buffer with some numbers. */
export function filledBuffer(
  device: GPUDevice, data: Float32Array<ArrayBuffer> | Uint32Array<ArrayBuffer>, usage: number,
): GPUBuffer {
  const buffer = device.createBuffer({ size: Math.max(16, data.byteLength), usage: usage | GPUBufferUsage.COPY_DST });
  device.queue.writeBuffer(buffer, 0, data);
  return buffer;
}
